//! Movement of lanes.

use luxel_lanes::Level;

use super::*;

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
