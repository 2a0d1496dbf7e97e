//! The arrays of a particle field, and the splats that they make.

use luxel_core::{ColorModel, ColorSpace, Splats, logit, sh};

use crate::validity::{is_normalizable, left_out_line};

/// Removes the rows in which a number of any of the arrays is not finite; returns how many. An
/// error if no row is left.
fn leave_out_unfinite_rows(arrays: [&mut Vec<f32>; 5], widths: [usize; 5], count: usize) -> Result<u64, String> {
    let mut is_kept = vec![true; count];
    for (array, width) in arrays.iter().zip(widths) {
        for (row, kept) in array.chunks_exact(width).zip(&mut is_kept) {
            *kept &= row.iter().all(|v| v.is_finite());
        }
    }
    let left_out = is_kept.iter().filter(|kept| !**kept).count();
    if left_out == 0 {
        return Ok(0);
    }
    if left_out == count {
        return Err(format!("all of {count} splats have a number that is NaN or infinite, expected finite numbers"));
    }
    for (array, width) in arrays.into_iter().zip(widths) {
        let rows = array.chunks_exact(width).zip(&is_kept).filter(|(_, kept)| **kept);
        *array = rows.flat_map(|(row, _)| row.iter().copied()).collect();
    }
    Ok(left_out as u64)
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
    /// The place that the field is moved to, if it is.
    pub(super) translation: Option<[f32; 3]>,
    pub(super) is_translated: bool,
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
            translation: None,
            is_translated: false,
        }
    }
}

/// Returns whether a property of the field's prim is read.
pub(super) fn is_read(name: &str) -> bool {
    let arrays = ["positions", "orientations", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients"];
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
            "radiance:sphericalHarmonicsCoefficients" | "radiance:sphericalHarmonicsCoefficientsh" => &mut self.coefficients,
            _ => return None,
        })
    }

    /// Returns the splats; the error names the array that is wrong.
    pub(super) fn splats(mut self, warnings: &mut Vec<String>) -> Result<Splats, String> {
        let count = self.positions.len() / 3;
        let k = 3 * sh::coefficients(self.degree);
        if self.orientations.is_empty() && count > 0 {
            warnings.push("no \"orientations\": the splats are read as unturned".to_owned());
            self.orientations = [1.0, 0.0, 0.0, 0.0].repeat(count);
        }
        let lengths = [
            ("positions", self.positions.len(), 3),
            ("orientations", self.orientations.len(), 4),
            ("scales", self.scales.len(), 3),
            ("opacities", self.opacities.len(), 1),
            ("radiance:sphericalHarmonicsCoefficients", self.coefficients.len(), k),
        ];
        for (name, found, width) in lengths {
            if count.checked_mul(width) != Some(found) {
                return Err(format!("{name:?} has {found} numbers, expected {width} for each of {count} splats"));
            }
        }
        let widths = [3, 4, 3, 1, k];
        let arrays = [&mut self.positions, &mut self.orientations, &mut self.scales, &mut self.opacities, &mut self.coefficients];
        warnings.extend(left_out_line(leave_out_unfinite_rows(arrays, widths, count)?, count as u64));
        if let Some(i) = self.opacities.iter().position(|o| !(0.0..=1.0).contains(o)) {
            return Err(format!("opacity of splat {i} is {}, expected 0 to 1", self.opacities[i]));
        }
        if let Some(i) = self.scales.iter().position(|s| *s < 0.0) {
            return Err(format!("scale of splat {} is {}, expected 0 or more", i / 3, self.scales[i]));
        }
        let (rotation, _) = self.orientations.as_chunks::<4>();
        if let Some(i) = rotation.iter().position(|q| !is_normalizable(*q)) {
            return Err(format!("orientation of splat {i} is {:?}, expected a quaternion of length about 1", rotation[i]));
        }
        Ok(Splats {
            color_model: ColorModel::Sh { degree: self.degree as u8 },
            rotation: rotation.to_vec(),
            position: self.positions.as_chunks::<3>().0.to_vec(),
            log_scale: self.scales.as_chunks::<3>().0.iter().map(|s| s.map(|s| s.max(f32::MIN_POSITIVE).ln())).collect(),
            opacity_logit: self.opacities.iter().map(|o| logit(*o)).collect(),
            sh: self.coefficients,
            raw_luminance: Vec::new(),
            smoothing: Vec::new(),
            gain: Vec::new(),
        })
    }
}
