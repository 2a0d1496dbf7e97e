//! A Bayer mosaic to RGB by gradient-corrected linear interpolation (Malvar, He and Cutler 2004).
//!
//! In: `[H*W]` linear samples and the cell. Out: `[H*W]` RGB. Linear in the samples, so that
//! radiance scales through. At the border the mosaic is mirrored about its outermost pixels, which
//! keeps colours in their places. Below 2 pixels a side every channel is the nearest sample.

use rayon::prelude::*;

use crate::Cell;

/// Returns the colours of every pixel. Samples that are missing count as 0.
pub fn demosaic(width: usize, height: usize, cell: Cell, mosaic: &[f32]) -> Vec<[f32; 3]> {
    let mut pixels = vec![[0.0f32; 3]; width * height];
    if width == 0 {
        return pixels;
    }
    pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let at = |dx: isize, dy: isize| mosaic.get(mirrored(y, dy, height) * width + mirrored(x, dx, width)).copied().unwrap_or(0.0);
            *pixel = interpolate(cell, x, y, at);
        }
    });
    pixels
}

/// Returns the index `i + offset` mirrored about 0 and `side - 1`.
fn mirrored(i: usize, offset: isize, side: usize) -> usize {
    let last = side as isize - 1;
    let at = (i as isize + offset).abs();
    (if at > last { 2 * last - at } else { at }).clamp(0, last) as usize
}

fn interpolate(cell: Cell, x: usize, y: usize, at: impl Fn(isize, isize) -> f32) -> [f32; 3] {
    let here = at(0, 0);
    let near = [at(-1, 0), at(1, 0), at(0, -1), at(0, 1)];
    let far = [at(-2, 0), at(2, 0), at(0, -2), at(0, 2)];
    let corners = at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1);
    let cross: f32 = near.iter().sum();
    let far_cross: f32 = far.iter().sum();
    let color = cell.color(x, y);
    let mut out = [0.0; 3];
    if color == 1 {
        // Neighbours in the row are of one colour, in the column of the other.
        let along = |a: [f32; 2], far_a: [f32; 2], far_b: [f32; 2]| {
            (5.0 * here + 4.0 * (a[0] + a[1]) - corners - far_a[0] - far_a[1] + 0.5 * (far_b[0] + far_b[1])) / 8.0
        };
        let (row, column) = ([near[0], near[1]], [near[2], near[3]]);
        let (far_row, far_column) = ([far[0], far[1]], [far[2], far[3]]);
        let row_color = cell.color(x + 1, y);
        out[1] = here;
        out[row_color] = along(row, far_row, far_column);
        out[2 - row_color] = along(column, far_column, far_row);
    } else {
        out[color] = here;
        out[1] = (4.0 * here + 2.0 * cross - far_cross) / 8.0;
        out[2 - color] = (6.0 * here + 2.0 * corners - 1.5 * far_cross) / 8.0;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mosaic_of(cell: Cell, width: usize, height: usize, rgb: impl Fn(usize, usize) -> [f32; 3]) -> Vec<f32> {
        (0..width * height).map(|i| rgb(i % width, i / width)[cell.color(i % width, i / width)]).collect()
    }

    #[test]
    fn flat_colours_come_back_in_every_cell() {
        for colors in [[0, 1, 1, 2], [2, 1, 1, 0], [1, 0, 2, 1], [1, 2, 0, 1]] {
            let cell = Cell::bayer(colors).unwrap();
            for pixel in demosaic(7, 6, cell, &mosaic_of(cell, 7, 6, |_, _| [3.0, 0.5, 0.25])) {
                assert!((0..3).all(|c| (pixel[c] - [3.0, 0.5, 0.25][c]).abs() < 1e-6), "{colors:?} {pixel:?}");
            }
        }
    }

    #[test]
    fn grey_ramps_come_back_inside() {
        let cell = Cell::bayer([0, 1, 1, 2]).unwrap();
        let ramp = |x: usize, y: usize| [1.0 + 0.5 * x as f32 + 0.25 * y as f32; 3];
        let pixels = demosaic(12, 10, cell, &mosaic_of(cell, 12, 10, ramp));
        for (i, pixel) in pixels.iter().enumerate() {
            let (x, y) = (i % 12, i / 12);
            if (2..10).contains(&x) && (2..8).contains(&y) {
                assert!((0..3).all(|c| (pixel[c] - ramp(x, y)[c]).abs() < 1e-5), "{x} {y} {pixel:?}");
            }
        }
    }

    #[test]
    fn tiny_and_short_mosaics_do_not_panic() {
        let cell = Cell::bayer([0, 1, 1, 2]).unwrap();
        assert_eq!(demosaic(1, 1, cell, &[2.0]).len(), 1);
        assert_eq!(demosaic(0, 0, cell, &[]).len(), 0);
        assert_eq!(demosaic(3, 3, cell, &[1.0]).len(), 9);
    }
}
