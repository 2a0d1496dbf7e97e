//! FLIP's colour spaces.
//!
//! In YCxCz, contrast sensitivity is known and filters are linear. L*a*b* with Hunt's effect is the
//! space in which HyAB compares colours. White is linear (1, 1, 1).

/// The matrix from linear Rec.709 to XYZ, in FLIP's digits.
const XYZ_FROM_RGB: [[f32; 3]; 3] =
    [[0.412_386_56, 0.357_591_49, 0.180_450_49], [0.212_636_82, 0.715_182_98, 0.072_180_2], [0.019_330_62, 0.119_197_16, 0.950_372_6]];
/// The inverse of [`XYZ_FROM_RGB`].
const RGB_FROM_XYZ: [[f32; 3]; 3] =
    [[3.241_003_2, -1.537_399, -0.498_615_9], [-0.969_224_3, 1.875_93, 0.041_554_224], [0.055_639_42, -0.204_011_21, 1.057_149]];
/// XYZ of white: the sums of the rows of [`XYZ_FROM_RGB`].
const WHITE: [f32; 3] = [0.950_428_5, 1.0, 1.088_900_4];

/// Planes of opponent colours `[H*W]`.
pub(super) struct YCxCz {
    /// Like L*, but linear: -16 for black, 100 for white.
    pub(super) y: Vec<f32>,
    /// Red against green.
    pub(super) cx: Vec<f32>,
    /// Yellow against blue.
    pub(super) cz: Vec<f32>,
}

impl YCxCz {
    pub(super) fn with_capacity(pixels: usize) -> Self {
        let plane = || Vec::with_capacity(pixels);
        Self { y: plane(), cx: plane(), cz: plane() }
    }

    pub(super) fn push(&mut self, [y, cx, cz]: [f32; 3]) {
        self.y.push(y);
        self.cx.push(cx);
        self.cz.push(cz);
    }
}

fn transform(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Returns XYZ divided by that of white.
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    let xyz = transform(&XYZ_FROM_RGB, rgb);
    [xyz[0] / WHITE[0], xyz[1] / WHITE[1], xyz[2] / WHITE[2]]
}

pub(super) fn ycxcz_of_linear(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Converts YCxCz to linear Rec.709, which may lie outside of `[0, 1]`.
pub(super) fn linear_of_ycxcz([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) / 116.0;
    let (x, z) = (y + cx / 500.0, y - cz / 200.0);
    transform(&RGB_FROM_XYZ, [x * WHITE[0], y * WHITE[1], z * WHITE[2]])
}

/// L*a*b* with a chroma that decreases with lightness: dark colours look less colourful (Hunt's
/// effect).
#[derive(Clone, Copy, Debug)]
pub(super) struct HuntLab([f32; 3]);

impl HuntLab {
    /// Returns the HyAB distance, which is made for large differences: the absolute difference of
    /// lightness plus the Euclidean distance of chroma (Abasi et al. 2020).
    pub(super) fn difference(self, other: Self) -> f32 {
        let [l, a, b] = [0, 1, 2].map(|i| self.0[i] - other.0[i]);
        l.abs() + (a * a + b * b).sqrt()
    }
}

/// Converts linear light in `[0, 1]` to L*a*b* with Hunt's effect.
pub(super) fn hunt_lab(rgb: [f32; 3]) -> HuntLab {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |v: f32| if v > DELTA * DELTA * DELTA { v.cbrt() } else { v / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = relative_xyz(rgb).map(f);
    let lightness = 116.0 * y - 16.0;
    let fade = 0.01 * lightness;
    HuntLab([lightness, fade * 500.0 * (x - y), fade * 200.0 * (y - z)])
}

/// Returns the difference of green and blue, the largest in the RGB cube.
pub(super) fn largest_color_difference() -> f32 {
    hunt_lab([0.0, 1.0, 0.0]).difference(hunt_lab([0.0, 0.0, 1.0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opponent_colours_lead_back() {
        for rgb in [[0.0; 3], [1.0; 3], [0.2, 0.5, 0.9], [1.0, 0.0, 0.3]] {
            let back = linear_of_ycxcz(ycxcz_of_linear(rgb));
            assert!((0..3).all(|c| (back[c] - rgb[c]).abs() < 1e-5), "{rgb:?} {back:?}");
        }
    }

    #[test]
    fn greys_have_no_chroma() {
        let [y, cx, cz] = ycxcz_of_linear([1.0; 3]);
        assert!((y - 100.0).abs() < 1e-4 && cx.abs() < 1e-4 && cz.abs() < 1e-4);
        let HuntLab([l, a, b]) = hunt_lab([0.18; 3]);
        assert!((l - 49.496).abs() < 0.01 && a.abs() < 1e-3 && b.abs() < 1e-3, "{l} {a} {b}");
    }
}
