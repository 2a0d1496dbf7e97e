//! Mono-HDR-GS's scene without its lift: log harmonics that come close to the lifted colours.
//!
//! In: splats of captured values, the lift, the training cameras. Out: the same splats as
//! [`ColorModel::LogSh`] of degree 3. For each splat and channel, ln of the lifted colour is fitted
//! by least squares over the directions from which training cameras see the splat, and with a small
//! weight over the whole sphere, so that other directions stay close, too. Degenerate: a splat that
//! no camera sees is fitted over the sphere alone; radiance below [`DARKEST`] counts as that.

use glam::DVec3;
use luxel_core::{Camera, ColorBasis, ColorModel, SH_OFFSET, Splats, least_squares, sh};
use rayon::prelude::*;

use super::lift::LiftTables;

/// Degree of the log harmonics.
const DEGREE: u8 = 3;
const COEFFICIENTS: usize = sh::coefficients(DEGREE as usize);
/// Directions over the sphere.
const SPHERE: usize = 48;
/// Weight of the sphere, of that of the directions from which a splat is seen.
const SPHERE_WEIGHT: f64 = 0.05;
/// Radiance that black counts as, normalised units: far below where the mu-law turns linear.
const DARKEST: f64 = 1e-7;
/// Splats of a task.
const CHUNK: usize = 256;

/// Sums of the normal equations of a splat: of products of the basis, and with each channel.
#[derive(Clone)]
struct Sums {
    gram: [[f64; COEFFICIENTS]; COEFFICIENTS],
    right: [[f64; 3]; COEFFICIENTS],
}

impl Sums {
    const ZERO: Self = Self { gram: [[0.0; COEFFICIENTS]; COEFFICIENTS], right: [[0.0; 3]; COEFFICIENTS] };

    fn add(&mut self, basis: &[f64; COEFFICIENTS], log_radiance: [f64; 3], weight: f64) {
        for (i, y) in basis.iter().enumerate() {
            let weighted = weight * y;
            self.gram[i].iter_mut().zip(basis).for_each(|(sum, other)| *sum += weighted * other);
            self.right[i].iter_mut().zip(log_radiance).for_each(|(sum, value)| *sum += weighted * (value - f64::from(SH_OFFSET)));
        }
    }

    fn solve(&self) -> [f32; 3 * COEFFICIENTS] {
        let rows = self.gram.iter().zip(&self.right).map(|(gram, right)| gram.iter().chain(right).copied().collect()).collect();
        let mut out = [0.0; 3 * COEFFICIENTS];
        for (out, value) in out.iter_mut().zip(least_squares::solve(rows).into_iter().flatten()) {
            *out = value as f32;
        }
        out
    }
}

/// A direction with its basis.
struct Direction {
    seen: ColorBasis<f32>,
    basis: [f64; COEFFICIENTS],
}

impl Direction {
    fn new(model: ColorModel, direction: [f32; 3]) -> Self {
        let seen = ColorBasis::new(model.max_degree(), direction);
        let log = ColorBasis::new(DEGREE.into(), direction);
        Self { seen, basis: std::array::from_fn(|m| f64::from(log.values[m])) }
    }
}

/// Returns the scene without its lift.
pub(crate) fn folded(splats: &Splats, lift: &LiftTables, cameras: &[&Camera]) -> Splats {
    let model = splats.color_model;
    let sphere: Vec<Direction> = sh::lattice(SPHERE).into_iter().map(|direction| Direction::new(model, direction)).collect();
    let log_radiance = |i: usize, direction: &Direction| {
        let (sh, raw) = (splats.sh_of(i), splats.raw_luminance_of(i));
        let ldr = model.radiance(&direction.seen, |m, c| sh[3 * m + c], |m| raw[m]);
        lift.radiance(ldr).map(|x| f64::from(x).max(DARKEST).ln())
    };
    let fit = |i: usize| {
        let at = DVec3::from_array(splats.position[i].map(f64::from));
        let mut sums = Sums::ZERO;
        let mut seen = 0;
        for camera in cameras {
            if camera.project(at).is_some_and(|(at_px, _)| camera.shows(at_px)) {
                let direction = (at - camera.eye()).normalize_or(DVec3::Z).to_array().map(|v| v as f32);
                let direction = Direction::new(model, direction);
                sums.add(&direction.basis, log_radiance(i, &direction), 1.0);
                seen += 1;
            }
        }
        let weight = SPHERE_WEIGHT * f64::from(seen.max(1)) / SPHERE as f64;
        sphere.iter().for_each(|direction| sums.add(&direction.basis, log_radiance(i, direction), weight));
        sums.solve()
    };
    let mut out = vec![0.0; splats.len() * 3 * COEFFICIENTS];
    out.par_chunks_mut(CHUNK * 3 * COEFFICIENTS).enumerate().for_each(|(chunk, out)| {
        for (i, sh) in (chunk * CHUNK..).zip(out.chunks_exact_mut(3 * COEFFICIENTS)) {
            sh.copy_from_slice(&fit(i));
        }
    });
    Splats { color_model: ColorModel::LogSh { degree: DEGREE }, sh: out, raw_luminance: Vec::new(), ..splats.clone() }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;
    use luxel_core::synthetic;

    use super::*;
    use crate::captured::mono_hdr_gs::lift::Lift;
    use crate::testing::camera_at;

    #[test]
    fn folded_colours_are_the_lifted_ones_towards_the_cameras_and_near_them_elsewhere() {
        let mut splats = synthetic::room(60, 3);
        let k = 3 * splats.color_model.sh_coefficients();
        for (i, sh) in splats.sh.chunks_exact_mut(k).enumerate() {
            sh[..3].copy_from_slice(&standard_normal(7, i as u64).map(|v: f32| 0.3 * v));
            sh[3..].iter_mut().for_each(|k| *k *= 0.1);
        }
        for (i, position) in splats.position.iter_mut().enumerate() {
            *position = standard_normal(8, i as u64).map(|v: f32| 0.2 * v);
            position[2] += 3.0;
        }
        let lift = Lift::new(32, 4).tables();
        let cameras: Vec<Camera> = (0..6).map(|i| camera_at([0.3 * f64::from(i) - 0.9, 0.1, 0.0], [64, 64])).collect();
        let found = folded(&splats, &lift, &cameras.iter().collect::<Vec<_>>());
        found.validate().unwrap();
        let error = |i: usize, direction: DVec3| {
            let direction = direction.normalize().to_array().map(|v| v as f32);
            let (a, b) = (found.radiance(i, direction), lift.radiance(splats.radiance(i, direction)));
            (0..3).map(|c| (a[c] / b[c] - 1.0).abs()).fold(0.0, f32::max)
        };
        for i in 0..splats.len() {
            let at = DVec3::from_array(splats.position[i].map(f64::from));
            for camera in &cameras {
                assert!(error(i, at - camera.eye()) < 0.02, "splat {i}: {}", error(i, at - camera.eye()));
            }
            assert!(error(i, DVec3::new(0.3, 0.2, -1.0)) < 0.2, "splat {i}");
        }
    }

    #[test]
    fn splats_that_no_camera_sees_are_fitted_too() {
        let splats = synthetic::room(5, 3);
        let found = folded(&splats, &Lift::new(8, 1).tables(), &[]);
        found.validate().unwrap();
        assert_eq!((found.position.clone(), found.color_model.name().as_str()), (splats.position, "logsh3"));
    }
}
