//! Numbers of KHR_gaussian_splatting as files have them, which is not always as the final extension
//! says.
//!
//! Drafts of the extension, and programs that followed them, wrote SCALE as logarithms and OPACITY
//! as logits, as PLY has them, under the names of the final ones. A file does not state which:
//! numbers that no length and no opacity can be tell.
//!
//! In: the numbers of an attribute. Out: logarithms and logits. Where most splats have such
//! numbers, all are read by the old convention, with a warning; where only a few have, the file is
//! wrong by either, and refused.

use luxel_core::{ColorSpace, logit};
use serde_json::Value;

/// How far an opacity may be beyond 0 and 1: rounding.
const OPACITY_TOLERANCE: f32 = 1e-3;

/// The colour spaces of the extension.
const DISPLAY: &str = "srgb_rec709_display";
const LINEAR: &str = "lin_rec709_display";

/// Returns logarithms of scale; the error names the splat whose numbers fit no convention.
pub(super) fn log_scales(scales: &[[f32; 3]], warnings: &mut Vec<String>) -> Result<Vec<[f32; 3]>, String> {
    let is_none = |scale: &[f32; 3]| scale.iter().any(|s| *s < 0.0);
    let negative = scales.iter().filter(|s| is_none(s)).count();
    if let Some(i) = scales.iter().position(is_none) {
        if 2 * negative <= scales.len() {
            return Err(format!(
                "SCALE of splat {i} is {:?}, expected lengths of 0 or more, or logarithms, of which more than {negative} of {} splats would \
                 have a negative one; export it by the final KHR_gaussian_splatting, which has lengths",
                scales[i],
                scales.len()
            ));
        }
        warnings.push(
            "SCALE has negative numbers, which no length is: read as logarithms, as before the final KHR_gaussian_splatting of 2026"
                .to_owned(),
        );
        return Ok(scales.to_vec());
    }
    Ok(scales.iter().map(|s| s.map(|s| s.max(f32::MIN_POSITIVE).ln())).collect())
}

/// Returns logits of opacity; the error names the splat whose number fits no convention.
pub(super) fn opacity_logits(opacities: &[f32], warnings: &mut Vec<String>) -> Result<Vec<f32>, String> {
    let is_none = |opacity: &f32| opacity.is_finite() && !(-OPACITY_TOLERANCE..=1.0 + OPACITY_TOLERANCE).contains(opacity);
    let outside = opacities.iter().filter(|o| is_none(o)).count();
    if let Some(i) = opacities.iter().position(is_none) {
        if 2 * outside <= opacities.len() {
            return Err(format!(
                "OPACITY of splat {i} is {}, expected 0 to 1, or logits, of which more than {outside} of {} would be outside of that; \
                 export it by the final KHR_gaussian_splatting, which has 0 to 1",
                opacities[i],
                opacities.len()
            ));
        }
        warnings.push(
            "OPACITY has numbers outside of 0 to 1, which no opacity is: read as logits, as before the final KHR_gaussian_splatting of 2026"
                .to_owned(),
        );
        return Ok(opacities.to_vec());
    }
    Ok(opacities.iter().map(|o| logit(o.clamp(0.0, 1.0))).collect())
}

/// Returns the space of a primitive's colours by the extension's name of it; without one they are a
/// display's, as of all programs before there was a name.
pub(super) fn color_space(stated: Option<&Value>) -> Result<ColorSpace, String> {
    match stated.map(|name| name.as_str().unwrap_or_default()) {
        None | Some(DISPLAY) => Ok(ColorSpace::DisplaySrgb),
        Some(LINEAR) => Ok(ColorSpace::LinearRec709),
        Some(other) => Err(format!("colour space {other:?}, expected {DISPLAY} or {LINEAR}; convert the splats' colours")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_logarithms_are_told_apart_by_their_sign() {
        let mut warnings = Vec::new();
        let lengths = [[0.1f32, 0.2, 0.3], [1.5, 0.0, 2.0]];
        let logarithms = log_scales(&lengths, &mut warnings).unwrap();
        assert!((logarithms[0][1] - 0.2f32.ln()).abs() < 1e-6 && warnings.is_empty());
        assert_eq!(log_scales(&[[-2.3, -1.6, 0.4], [-4.0, -4.0, -5.0]], &mut warnings).unwrap(), [[-2.3, -1.6, 0.4], [-4.0, -4.0, -5.0]]);
        assert!(warnings[0].contains("logarithms"), "{warnings:?}");
        let error = log_scales(&[[0.1; 3], [0.1, -0.2, 0.1], [0.2; 3]], &mut warnings).unwrap_err();
        assert!(error.contains("splat 1") && error.contains("export it by the final"), "{error}");
    }

    #[test]
    fn opacities_and_logits_are_told_apart_by_their_range() {
        let mut warnings = Vec::new();
        assert_eq!(opacity_logits(&[0.5, 1.000_1], &mut warnings).unwrap()[0], 0.0);
        assert!(warnings.is_empty());
        assert_eq!(opacity_logits(&[-3.0, 7.5, 0.5], &mut warnings).unwrap(), [-3.0, 7.5, 0.5]);
        assert!(warnings[0].contains("logits"), "{warnings:?}");
        assert!(opacity_logits(&[0.5, 0.1, 1.5], &mut warnings).unwrap_err().contains("splat 2"));
    }

    #[test]
    fn colour_spaces_are_those_of_the_extension() {
        assert_eq!(color_space(None), Ok(ColorSpace::DisplaySrgb));
        assert_eq!(color_space(Some(&LINEAR.into())), Ok(ColorSpace::LinearRec709));
        assert!(color_space(Some(&"lin_ap1_display".into())).unwrap_err().contains("convert"));
    }
}
