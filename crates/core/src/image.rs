//! Linear floating-point images.

/// Linear RGB radiance, `[H,W,3]`, rows from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// `[H*W]`, row-major.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// An image of one colour.
    pub fn filled(width: usize, height: usize, rgb: [f32; 3]) -> Self {
        Self { width, height, pixels: vec![rgb; width * height] }
    }

    /// From `width * height` pixels, row-major; `None` if there are more or fewer.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Option<Self> {
        (pixels.len() == width.checked_mul(height)?).then_some(Self { width, height, pixels })
    }

    /// Pixel in column `x` of row `y`.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> [f32; 3] {
        self.pixels[y * self.width + x]
    }

    /// Every channel of every pixel times `factor`.
    pub fn scale(&mut self, factor: f32) {
        for value in self.pixels.as_flattened_mut() {
            *value *= factor;
        }
    }
}

/// Luminance of the paper: R + G + B (LCD-GS eq. 4: the chromaticity sums to 1).
#[inline]
pub fn luminance_sum(rgb: [f32; 3]) -> f32 {
    rgb[0] + rgb[1] + rgb[2]
}

/// Relative luminance Y of linear Rec.709 (ITU-R BT.709).
#[inline]
pub fn luminance_rec709(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}
