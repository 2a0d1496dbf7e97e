//! Accuracy of the elementary functions, and movement of lanes.

use luxel_lanes::Level;

use super::*;

/// Largest relative error of `f` against `exact` over `arguments`.
fn worst(arguments: impl Iterator<Item = f32>, f: impl Fn(Lanes) -> [f32; LANES], exact: impl Fn(f64) -> f64) -> f64 {
    let all: Vec<f32> = arguments.collect();
    let mut worst = 0f64;
    for chunk in all.chunks_exact(LANES) {
        let mut lanes = Lanes::ZERO;
        lanes.0.copy_from_slice(chunk);
        for (x, y) in chunk.iter().zip(f(lanes)) {
            let expected = exact(f64::from(*x));
            worst = worst.max((f64::from(y) - expected).abs() / expected.abs().max(1e-30));
        }
    }
    worst
}

#[test]
fn elementary_functions_are_accurate_to_a_few_ulp() {
    let level = Level::best();
    let linear = |a: f32, b: f32| (0..16_000).map(move |i| a + (b - a) * i as f32 / 16_000.0);
    let logarithmic = |a: f32, b: f32| (0..16_000).map(move |i| a * (b / a).powf(i as f32 / 16_000.0));
    let reciprocal = worst(logarithmic(1e-4, 1e4), |x| with_simd!(level, s => V::load(s, &x).reciprocal().lanes()), f64::recip);
    assert!(reciprocal < 3e-7, "reciprocal {reciprocal}");
    let exp2 = worst(linear(-100.0, 100.0), |x| with_simd!(level, s => V::load(s, &x).exp2().lanes()), f64::exp2);
    assert!(exp2 < 4e-7, "exp2 {exp2}");
    let zero = with_simd!(level, s => V::splat(s, LOG2_OF_ZERO).exp2().lanes());
    assert_eq!(zero.map(f32::to_bits), [0; LANES]);
    let exp = worst(linear(-80.0, 80.0), |x| with_simd!(level, s => V::load(s, &x).exp().lanes()), f64::exp);
    assert!(exp < 1e-6, "exp {exp}");
    let ln = worst(logarithmic(1e-30, 0.9), |x| with_simd!(level, s => V::load(s, &x).ln().lanes()), f64::ln);
    assert!(ln < 1e-6, "ln {ln}");
    let ln_1p = worst(logarithmic(1e-30, 8e37), |x| with_simd!(level, s => V::load(s, &x).ln_1p().lanes()), f64::ln_1p);
    assert!(ln_1p < 2e-7, "ln_1p {ln_1p}");
}

#[test]
fn lanes_move_across_the_whole_vector() {
    let row = |start: usize| Lanes(std::array::from_fn(|lane| (start + lane) as f32));
    for level in [Level::best(), Level::baseline()] {
        let up = with_simd!(level, s => V::load(s, &row(1)).lanes_up().lanes());
        assert_eq!(up, row(0).0);
        let mut down = row(1).0;
        down[LANES - 1] = 0.0;
        assert_eq!(with_simd!(level, s => V::load(s, &row(0)).lanes_down().lanes()), down);
        let columns = with_simd!(level, s => {
            V::transpose(std::array::from_fn(|i| V::load(s, &row(LANES * i)))).map(V::lanes)
        });
        for (i, column) in columns.iter().enumerate() {
            assert_eq!(*column, std::array::from_fn(|lane| (LANES * lane + i) as f32), "column {i}");
        }
    }
}
