//! A display of an OpenColorIO configuration as a table, for programs that draw with a shader.
//!
//! In: a display and view, the colour space of radiance. Out: code values at [`SIDE`]^3 radiances,
//! whose logarithm is even from [`LOW_LOG2`] to [`HIGH_LOG2`] in each of R, G and B; 1 is diffuse
//! white, exposure is applied before. Between them the table is interpolated in tetrahedra, so that
//! greys stay on the diagonal. Radiance below the range counts as its lower end, negative values
//! too; above it as the upper end.

use luxel_core::{ColorSpace, Image};
use luxel_io::OcioDisplay;

use crate::Result;
use crate::error::Context;

/// Radiances along each axis of the table.
pub const SIDE: usize = 65;
/// Lower end of the range, log2 of radiance: 12 stops below middle grey.
pub const LOW_LOG2: f32 = -14.5;
/// Upper end of the range, log2 of radiance: 12 stops above middle grey.
pub const HIGH_LOG2: f32 = 9.5;

/// Code values of a display by radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplayLut {
    display: String,
    view: String,
    values: Vec<[f32; 3]>,
}

impl DisplayLut {
    /// Evaluates a display at each radiance of the table; `color_space` is that of the radiance, of
    /// whose light R, G and B are.
    ///
    /// # Errors
    /// OpenColorIO failed on it.
    pub fn bake(display: &OcioDisplay, color_space: ColorSpace) -> Result<Self> {
        let axis: Vec<f32> = (0..SIDE).map(|i| (LOW_LOG2 + (HIGH_LOG2 - LOW_LOG2) * i as f32 / (SIDE - 1) as f32).exp2()).collect();
        let at = |i: usize| [axis[i % SIDE], axis[i / SIDE % SIDE], axis[i / (SIDE * SIDE)]];
        let mut image = Image { width: SIDE * SIDE, height: SIDE, pixels: (0..SIDE.pow(3)).map(at).collect() };
        display.encode(&mut image, color_space.linear()).context("cannot make the table of a display")?;
        Ok(Self { display: display.display().to_owned(), view: display.view().to_owned(), values: image.pixels })
    }

    /// Returns the name of the display.
    pub fn display(&self) -> &str {
        &self.display
    }

    /// Returns the name of the view.
    pub fn view(&self) -> &str {
        &self.view
    }

    /// Returns the code values, 0 to 1, `[SIDE*SIDE*SIDE]`; R changes fastest, then G.
    pub fn values(&self) -> &[[f32; 3]] {
        &self.values
    }

    /// Returns the code values of a radiance, as a shader interpolates them.
    pub fn at(&self, radiance: [f32; 3]) -> [f32; 3] {
        let last = (SIDE - 1) as f32;
        let place = radiance.map(|v| (last * (v.max(f32::MIN_POSITIVE).log2() - LOW_LOG2) / (HIGH_LOG2 - LOW_LOG2)).clamp(0.0, last));
        let cell = place.map(|x| x.floor().min(last - 1.0));
        let within = [0, 1, 2].map(|c| place[c] - cell[c]);
        // The axes from the one that is farthest along its side of the cell.
        let mut order = [0usize, 1, 2];
        order.sort_by(|a, b| within[*b].total_cmp(&within[*a]));
        let mut corner = cell.map(|x| x as usize);
        let mut value = self.value(corner).map(|v| v * (1.0 - within[order[0]]));
        for (i, axis) in order.into_iter().enumerate() {
            corner[axis] += 1;
            let weight = within[axis] - order.get(i + 1).map_or(0.0, |next| within[*next]);
            let at_corner = self.value(corner);
            value = [0, 1, 2].map(|c| value[c] + weight * at_corner[c]);
        }
        value
    }

    fn value(&self, [r, g, b]: [usize; 3]) -> [f32; 3] {
        self.values.get((b * SIDE + g) * SIDE + r).copied().unwrap_or_default()
    }
}

#[cfg(test)]
#[cfg(feature = "ocio")]
mod tests {
    use std::path::Path;

    use super::*;

    /// Returns the root mean square and the largest error of the table against the transform.
    fn errors(lut: &DisplayLut, display: &OcioDisplay, radiance: &[[f32; 3]]) -> [f32; 2] {
        let mut exact = Image { width: radiance.len(), height: 1, pixels: radiance.to_vec() };
        display.encode(&mut exact, ColorSpace::LinearRec709).unwrap();
        let differences = radiance.iter().zip(&exact.pixels).flat_map(|(rgb, exact)| {
            let found = lut.at(*rgb);
            [0, 1, 2].map(|c| (found[c] - exact[c]).abs())
        });
        let differences: Vec<f32> = differences.collect();
        let squares: f32 = differences.iter().map(|d| d * d).sum();
        [(squares / differences.len() as f32).sqrt(), differences.iter().copied().fold(0.0, f32::max)]
    }

    #[test]
    fn the_table_of_a_display_is_near_the_transform() {
        let config = Path::new("ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5");
        let display = OcioDisplay::open(config, None, None).unwrap();
        let lut = DisplayLut::bake(&display, ColorSpace::LinearRec709).unwrap();
        assert_eq!((lut.values().len(), lut.display()), (SIDE.pow(3), display.display()));
        let log2 = |i: u32, from: f32, to: f32| from + (to - from) * (f64::from(i) * 0.618_033_988_749_894_9).fract() as f32;
        let greys: Vec<[f32; 3]> = (0..2000).map(|i| [log2(i, LOW_LOG2, HIGH_LOG2).exp2(); 3]).collect();
        let [_, worst] = errors(&lut, &display, &greys);
        assert!(worst < 0.5 / 255.0, "greys: {worst}");
        // Colours of reflectances and lamps: within four stops of one another.
        let colours: Vec<[f32; 3]> =
            (0..5000).map(|i| [0, 1, 2].map(|c| (log2(i, -10.0, 6.0) + log2(7 * i + 3000 * c, -2.0, 2.0)).exp2())).collect();
        let [mean, worst] = errors(&lut, &display, &colours);
        assert!(mean < 0.2 / 255.0 && worst < 2.0 / 255.0, "colours: {mean} {worst}");
        // Everything in the range, with the purest colours of the space.
        let pure: Vec<[f32; 3]> = (0..5000).map(|i| [0, 1, 2].map(|c| log2(7 * i + 3000 * c, LOW_LOG2, HIGH_LOG2).exp2())).collect();
        let [mean, worst] = errors(&lut, &display, &pure);
        assert!(mean < 0.3 / 255.0 && worst < 2.5 / 255.0, "all: {mean} {worst}");
        // Beyond the range it is as at the end.
        assert_eq!(lut.at([-1.0, 0.0, f32::NAN]), lut.values()[0]);
        assert_eq!(lut.at([1e9; 3]), lut.at([HIGH_LOG2.exp2(); 3]));
    }
}
