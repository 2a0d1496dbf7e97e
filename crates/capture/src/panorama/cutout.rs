//! Pinhole pictures out of an equirectangular image.
//!
//! In: radiance `[H, W]` with W = 2 H, a [`Face`] and a [`CutoutLens`]. Out: radiance of a square
//! picture. Pixels are means of bilinear samples in linear light, as many as the panorama has
//! pixels there; columns continue around the seam. Degenerate: a panorama without pixels gives
//! black.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec2, DVec3};
use luxel_core::Image;
use rayon::prelude::*;

/// Half of a cut-out's field, radians: 50 degrees, of which 5 are also in the neighbour.
const HALF_FIELD: f64 = 50.0 / 180.0 * PI;
/// Largest side of a cut-out, pixels. Six of that size have as many pixels as a photograph of 24
/// megapixels.
const MAX_SIDE_PX: f64 = 2000.0;

/// A direction in which a cut-out looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Face {
    /// Towards the middle of the panorama.
    Front,
    /// A quarter turn to the right.
    Right,
    /// Towards the seam.
    Back,
    /// A quarter turn to the left.
    Left,
    /// Towards the first row.
    Up,
    /// Towards the last row.
    Down,
}

impl Face {
    /// All directions.
    pub const ALL: [Self; 6] = [Self::Front, Self::Right, Self::Back, Self::Left, Self::Up, Self::Down];

    /// Returns the name in paths.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Right => "right",
            Self::Back => "back",
            Self::Left => "left",
            Self::Up => "up",
            Self::Down => "down",
        }
    }

    /// Returns the rotation from the cut-out's camera axes to those of the panorama.
    pub fn panorama_from_cutout(self) -> DMat3 {
        let [right, down, forward] = match self {
            Self::Front => [DVec3::X, DVec3::Y, DVec3::Z],
            Self::Right => [DVec3::NEG_Z, DVec3::Y, DVec3::X],
            Self::Back => [DVec3::NEG_X, DVec3::Y, DVec3::NEG_Z],
            Self::Left => [DVec3::Z, DVec3::Y, DVec3::NEG_X],
            Self::Up => [DVec3::X, DVec3::Z, DVec3::NEG_Y],
            Self::Down => [DVec3::X, DVec3::NEG_Z, DVec3::Y],
        };
        DMat3::from_cols(right, down, forward)
    }
}

/// The lens of all cut-outs of a panorama.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutoutLens {
    /// Width and height, pixels.
    pub side_px: usize,
    /// Focal length, pixels. The principal point is the middle.
    pub focal_px: f64,
}

impl CutoutLens {
    /// Returns the lens for panoramas of a width: as fine as these in the middle, up to a largest
    /// size.
    ///
    /// ```
    /// use luxel_capture::panorama::CutoutLens;
    ///
    /// let lens = CutoutLens::for_width(1024);
    /// assert_eq!(lens.side_px, 388);
    /// assert!((lens.focal_px - 1024.0 / std::f64::consts::TAU).abs() < 1.0);
    /// ```
    pub fn for_width(width: usize) -> Self {
        let side = (2.0 * HALF_FIELD.tan() * width as f64 / TAU).clamp(1.0, MAX_SIDE_PX).round();
        Self { side_px: side as usize, focal_px: 0.5 * side / HALF_FIELD.tan() }
    }
}

/// Returns what a panorama shows in a direction.
pub fn cut_out(panorama: &Image, face: Face, lens: CutoutLens) -> Image {
    let side = lens.side_px;
    let samples = (panorama.width as f64 / TAU / lens.focal_px - 0.01).ceil().max(1.0) as usize;
    let turn = face.panorama_from_cutout();
    let middle = 0.5 * side as f64;
    let pixel = |i: usize| {
        let mut sum = [0.0f64; 3];
        for sample in 0..samples * samples {
            let part = |n: usize| (n as f64 + 0.5) / samples as f64;
            let at = DVec2::new((i % side) as f64 + part(sample % samples), (i / side) as f64 + part(sample / samples));
            let seen = sampled(panorama, turn * ((at - middle) / lens.focal_px).extend(1.0));
            (0..3).for_each(|c| sum[c] += seen[c]);
        }
        sum.map(|v| (v / (samples * samples) as f64) as f32)
    };
    Image { width: side, height: side, pixels: (0..side * side).into_par_iter().map(pixel).collect() }
}

/// Returns the radiance of a panorama in a direction of its camera's axes.
fn sampled(panorama: &Image, direction: DVec3) -> [f64; 3] {
    let (width, height) = (panorama.width, panorama.height);
    if width == 0 || height == 0 {
        return [0.0; 3];
    }
    let latitude = direction.y.atan2(direction.x.hypot(direction.z));
    let x = (direction.x.atan2(direction.z) / TAU + 0.5) * width as f64 - 0.5;
    let y = ((latitude / PI + 0.5) * height as f64 - 0.5).clamp(0.0, (height - 1) as f64);
    let (left, top) = (x.floor(), y.floor());
    let (fx, fy) = (x - left, y - top);
    let column = |step: i64| (left as i64 + step).rem_euclid(width as i64) as usize;
    let row = |step: usize| (top as usize + step).min(height - 1);
    let at = |x: usize, y: usize| panorama.pixels.get(y * width + x).copied().unwrap_or_default().map(f64::from);
    let corners = [at(column(0), row(0)), at(column(1), row(0)), at(column(0), row(1)), at(column(1), row(1))];
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let mut out = [0.0; 3];
    for (corner, weight) in corners.iter().zip(weights) {
        (0..3).for_each(|c| out[c] += weight * corner[c]);
    }
    out
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;
    use luxel_core::Camera;

    use super::*;

    /// A panorama whose pixels are the directions that they show, plus 2.
    fn directions(width: u32) -> Image {
        let camera = Camera::panorama(DAffine3::IDENTITY, width);
        let [w, h] = camera.size_px.map(|side| side as usize);
        let pixel = |i: usize| {
            let at = DVec2::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
            camera.unproject(at).unwrap().to_array().map(|v| v as f32 + 2.0)
        };
        Image { width: w, height: h, pixels: (0..w * h).map(pixel).collect() }
    }

    #[test]
    fn each_pixel_shows_the_direction_of_its_ray() {
        // The second panorama is finer than the largest cut-out.
        for (width, lens) in [(512, CutoutLens::for_width(512)), (1024, CutoutLens { side_px: 60, focal_px: 25.2 })] {
            let panorama = directions(width);
            for face in Face::ALL {
                let turn = face.panorama_from_cutout();
                assert!((turn.determinant() - 1.0).abs() < 1e-12 && turn * turn.transpose() == DMat3::IDENTITY);
                let picture = cut_out(&panorama, face, lens);
                assert_eq!([picture.width, picture.height], [lens.side_px; 2]);
                for (i, pixel) in picture.pixels.iter().enumerate() {
                    let at = DVec2::new((i % lens.side_px) as f64 + 0.5, (i / lens.side_px) as f64 + 0.5);
                    let ray = (turn * ((at - 0.5 * lens.side_px as f64) / lens.focal_px).extend(1.0)).normalize();
                    let found = DVec3::from_array(pixel.map(|v| f64::from(v) - 2.0));
                    // Bilinear samples cut the corner of an arc of a pixel.
                    assert!(found.distance(ray) < 0.02, "{face:?} {at}: {found} {ray}");
                }
            }
        }
    }

    #[test]
    fn cut_outs_are_as_fine_as_the_panorama_up_to_a_size() {
        let lens = CutoutLens::for_width(4096);
        assert!((lens.focal_px - 4096.0 / TAU).abs() < 0.5, "{lens:?}");
        assert_eq!(CutoutLens::for_width(16384).side_px, 2000);
        assert_eq!(CutoutLens::for_width(2).side_px, 1);
    }
}
