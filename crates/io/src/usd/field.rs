//! The arrays of a particle field, and the splats that they make.

use glam::DMat4;
use luxel_core::{ColorModel, ColorSpace, SH_OFFSET, Splats, logit, sh};

use super::cameras::Transform;
use super::{GAIN, TRAINED};
use crate::validity::{LeftOut, is_normalizable};

/// Attribute of the harmonics.
const RADIANCE: &str = "radiance:sphericalHarmonicsCoefficients";
/// Attribute of colours as points have them.
const DISPLAY_COLOR: &str = "primvars:displayColor";

/// Returns a splat's harmonics `[K,3]` of its radiance times a gain, as files hold them for
/// programs that know no gains.
pub(super) fn with_gain(trained: &[f32], gain: f32) -> Vec<f32> {
    let mut harmonics = trained.to_vec();
    // The degree does not matter to a factor.
    ColorModel::Sh { degree: 0 }.scale_radiance(&mut harmonics, &mut [], gain);
    harmonics.iter_mut().for_each(|value| *value = value.clamp(f32::MIN, f32::MAX));
    harmonics
}

/// Removes the rows in which a number of any of the arrays is not finite, or which have no
/// rotation; returns how many. An error if no row is left.
fn leave_out_unusable_rows(arrays: [&mut Vec<f32>; 7], widths: [usize; 7], count: usize) -> Result<LeftOut, String> {
    let mut is_finite = vec![true; count];
    for (array, width) in arrays.iter().zip(widths) {
        for (row, finite) in array.chunks_exact(width.max(1)).zip(&mut is_finite) {
            *finite &= row.iter().all(|v| v.is_finite());
        }
    }
    let rotations = arrays[1].as_chunks::<4>().0.iter();
    let is_kept: Vec<bool> = rotations.zip(&is_finite).map(|(q, finite)| *finite && is_normalizable(*q)).collect();
    let unfinite = is_finite.iter().filter(|finite| !**finite).count();
    let unturned = is_kept.iter().filter(|kept| !**kept).count() - unfinite;
    let left_out = LeftOut { unfinite: unfinite as u64, unturned: unturned as u64 };
    if left_out.total() == 0 {
        return Ok(left_out);
    }
    if left_out.total() == count as u64 {
        return Err(format!(
            "all of {count} splats have a number that is NaN or infinite, or an orientation of length 0, expected finite numbers; export the \
             file again"
        ));
    }
    for (array, width) in arrays.into_iter().zip(widths) {
        let rows = array.chunks_exact(width.max(1)).zip(&is_kept).filter(|(_, kept)| **kept);
        *array = rows.flat_map(|(row, _)| row.iter().copied()).collect();
    }
    Ok(left_out)
}

/// Fits an array to `count` rows of `fallback`'s width, as the schema says: numbers beyond them are
/// cut, and an array that is absent or too short is ignored.
fn fit(array: &mut Vec<f32>, name: &str, fallback: &[f32], count: usize, warnings: &mut Vec<String>) -> Result<(), String> {
    let width = fallback.len();
    let needed = count.checked_mul(width).ok_or("more splats than memory holds")?;
    let found = array.len();
    if found > needed {
        warnings.push(format!("{name:?} has {found} numbers, {width} for each of {count} splats are {needed}: those beyond are left out"));
        array.truncate(needed);
    } else if found < needed {
        let what = if found == 0 {
            format!("no {name:?}")
        } else {
            format!("{name:?} has {found} numbers, expected {width} for each of {count} splats: ignored")
        };
        warnings.push(format!("{what}, as the schema says; all splats have {fallback:?}"));
        *array = fallback.repeat(count);
    }
    Ok(())
}

/// The arrays of the file.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) positions: Vec<f32>,
    pub(super) orientations: Vec<f32>,
    pub(super) scales: Vec<f32>,
    pub(super) opacities: Vec<f32>,
    pub(super) coefficients: Vec<f32>,
    pub(super) degree: usize,
    pub(super) color_space: ColorSpace,
    /// Colours of the points, for splats without radiance.
    pub(super) display_color: Vec<f32>,
    /// Gains of edits.
    pub(super) gain: Vec<f32>,
    /// Harmonics before the gains.
    pub(super) trained: Vec<f32>,
    /// Transforms of the prims around it and its own, the outermost first.
    pub(super) transforms: Vec<Transform>,
}

impl Default for Field {
    /// Returns the schema's fallbacks.
    fn default() -> Self {
        Self {
            positions: Vec::new(),
            orientations: Vec::new(),
            scales: Vec::new(),
            opacities: Vec::new(),
            coefficients: Vec::new(),
            degree: 3,
            color_space: ColorSpace::LinearRec709,
            display_color: Vec::new(),
            gain: Vec::new(),
            trained: Vec::new(),
            transforms: Vec::new(),
        }
    }
}

/// Returns whether a property of the field's prim is read.
pub(super) fn is_read(name: &str) -> bool {
    let arrays = ["positions", "orientations", "scales", "opacities", RADIANCE, GAIN, TRAINED];
    arrays.contains(&name.strip_suffix('h').unwrap_or(name))
}

impl Field {
    /// Returns the array of a property, of floats or half floats; `None` for other properties.
    pub(super) fn array(&mut self, name: &str) -> Option<&mut Vec<f32>> {
        Some(match name {
            "positions" | "positionsh" => &mut self.positions,
            "orientations" | "orientationsh" => &mut self.orientations,
            "scales" | "scalesh" => &mut self.scales,
            "opacities" | "opacitiesh" => &mut self.opacities,
            RADIANCE | "radiance:sphericalHarmonicsCoefficientsh" => &mut self.coefficients,
            DISPLAY_COLOR => &mut self.display_color,
            GAIN => &mut self.gain,
            TRAINED => &mut self.trained,
            _ => return None,
        })
    }

    /// Returns the matrix from the field's coordinates to the stage's.
    pub(super) fn matrix(&self) -> Result<DMat4, String> {
        let mut matrix = DMat4::IDENTITY;
        for transform in &self.transforms {
            if transform.is_reset() {
                matrix = DMat4::IDENTITY;
            }
            matrix *= transform.matrix(None)?;
        }
        Ok(matrix)
    }

    /// Puts the colours of the points in the place of radiance that is absent: one for all, or one
    /// for each splat.
    fn take_display_color(&mut self, count: usize, warnings: &mut Vec<String>) {
        let colors = &self.display_color;
        if !self.coefficients.is_empty() || count == 0 || ![3, 3 * count].contains(&colors.len()) {
            return;
        }
        warnings.push(format!("no {RADIANCE:?}: the colours of {DISPLAY_COLOR:?} are read in their place"));
        let constant = colors.iter().map(|v| (v - SH_OFFSET) / sh::C0);
        self.coefficients = if colors.len() == 3 { constant.collect::<Vec<_>>().repeat(count) } else { constant.collect() };
        self.degree = 0;
    }

    /// Returns the splats; the error names the array that is wrong.
    pub(super) fn splats(mut self, warnings: &mut Vec<String>) -> Result<Splats, String> {
        if !self.positions.len().is_multiple_of(3) {
            return Err(format!("\"positions\" has {} numbers, expected three for each splat; export it again", self.positions.len()));
        }
        let count = self.positions.len() / 3;
        self.take_display_color(count, warnings);
        if self.coefficients.is_empty() {
            self.degree = 0;
        }
        let k = 3 * sh::coefficients(self.degree);
        fit(&mut self.orientations, "orientations", &[1.0, 0.0, 0.0, 0.0], count, warnings)?;
        fit(&mut self.scales, "scales", &[1.0; 3], count, warnings)?;
        fit(&mut self.opacities, "opacities", &[1.0], count, warnings)?;
        // Coefficients of 0 are grey: radiance of 0.5.
        fit(&mut self.coefficients, RADIANCE, &vec![0.0; k], count, warnings)?;
        self.drop_unfit_gains(count, warnings);
        let widths = [3, 4, 3, 1, k, 1, k];
        let Self { positions, orientations, scales, opacities, coefficients, gain, trained, .. } = &mut self;
        let arrays = [positions, orientations, scales, opacities, coefficients, gain, trained];
        if count > 0 {
            warnings.extend(leave_out_unusable_rows(arrays, widths, count)?.lines(count as u64));
        }
        if let Some(i) = self.opacities.iter().position(|o| !(0.0..=1.0).contains(o)) {
            return Err(format!("opacity of splat {i} is {}, expected 0 to 1; write opacities, not their logits", self.opacities[i]));
        }
        if let Some(i) = self.scales.iter().position(|s| *s < 0.0) {
            let message =
                format!("scale of splat {} is {}, expected 0 or more; write lengths, not their logarithms", i / 3, self.scales[i]);
            return Err(message);
        }
        self.take_gains(k, warnings)?;
        let (rotation, _) = self.orientations.as_chunks::<4>();
        Ok(Splats {
            color_model: ColorModel::Sh { degree: self.degree as u8 },
            rotation: rotation.to_vec(),
            position: self.positions.as_chunks::<3>().0.to_vec(),
            log_scale: self.scales.as_chunks::<3>().0.iter().map(|s| s.map(|s| s.max(f32::MIN_POSITIVE).ln())).collect(),
            opacity_logit: self.opacities.iter().map(|o| logit(*o)).collect(),
            sh: self.coefficients,
            raw_luminance: Vec::new(),
            smoothing: Vec::new(),
            gain: self.gain,
        })
    }

    /// Removes gains that do not fit the splats, with a warning.
    fn drop_unfit_gains(&mut self, count: usize, warnings: &mut Vec<String>) {
        let (found, expected) = ([self.gain.len(), self.trained.len()], [count, self.coefficients.len()]);
        if found == expected || found == [0, 0] {
            return;
        }
        let [gains, harmonics] = found;
        warnings.push(format!(
            "{GAIN:?} and {TRAINED:?} have {gains} and {harmonics} numbers, expected {count} and {} for {count} splats: ignored; cut-offs \
             follow the edited light",
            self.coefficients.len()
        ));
        (self.gain, self.trained) = (Vec::new(), Vec::new());
    }

    /// Puts the harmonics before the gains of edits in the place of the radiance that they make,
    /// `k` numbers a splat. A splat whose radiance is another keeps that: another program has
    /// changed it.
    fn take_gains(&mut self, k: usize, warnings: &mut Vec<String>) -> Result<(), String> {
        if let Some(i) = self.gain.iter().position(|gain| *gain < 0.0) {
            return Err(format!("{GAIN:?} of splat {i} is {}, expected 0 or more", self.gain[i]));
        }
        let mut changed = 0u64;
        let rows = self.coefficients.chunks_exact_mut(k).zip(self.trained.chunks_exact(k));
        for ((shown, trained), gain) in rows.zip(&mut self.gain) {
            if shown == with_gain(trained, *gain) {
                shown.copy_from_slice(trained);
            } else {
                *gain = 1.0;
                changed += 1;
            }
        }
        if changed > 0 {
            warnings.push(format!(
                "another program has changed the radiance of {changed} splats since {GAIN:?} was written: theirs is ignored; their cut-offs \
                 follow the light that the file has"
            ));
        }
        Ok(())
    }
}
