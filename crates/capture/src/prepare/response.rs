//! The response curve of a set of developed pictures.
//!
//! In: the plan, the user's choice, and thinned frames of a few brackets. Out: [`SetCurve`], and a
//! note in the plan about assumptions. Degenerate: RAW files and radiance need no curve.

use luxel_core::Remedy;
use luxel_core::photo::{PhotoKind, StatedCurve};
use luxel_core::text::plural;

use super::{CurveTables, Photograph, Plan, PlannedView, PrepareError, PrepareNote};
use crate::{CapturedFrame, ResponseCurve, recover_response};

/// Views that a curve is recovered from, spread over the set.
const VIEWS: usize = 6;

/// The user's choice of a response curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ResponseChoice {
    /// Takes the curve that the files state, if it is another than sRGB's; else recovers it from
    /// brackets, if there are any; else takes sRGB's.
    #[default]
    Auto,
    /// Takes codes as proportional to light.
    Linear,
    /// Takes the curve of sRGB.
    Srgb,
    /// Recovers the curve from brackets, or fails.
    Recover,
}

/// The origin of a response curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveOrigin {
    /// A standard curve, because it was chosen or because none could be recovered.
    Standard,
    /// The brackets.
    Recovered,
}

/// The response curve of a set.
#[derive(Clone, Debug)]
pub struct SetCurve {
    /// Tables for both depths.
    pub tables: CurveTables,
    /// Name for people.
    pub name: String,
    /// Origin of the curve.
    pub origin: CurveOrigin,
}

/// Returns the views that a curve is recovered from: some with brackets, spread over the set.
pub fn views_for_response(plan: &Plan) -> Vec<&PlannedView> {
    let bracketed: Vec<_> = plan.views.iter().filter(|v| v.frames.len() > 1).collect();
    let step = bracketed.len().div_ceil(VIEWS).max(1);
    bracketed.into_iter().step_by(step).collect()
}

/// Returns the curve that all photographs state, if it is another than sRGB's, which developed pictures
/// have unless something else is known. Where only some state another one, a note says so.
fn stated_curve(photos: &[Photograph], notes: &mut Vec<PrepareNote>) -> Option<StatedCurve> {
    let is_other = |curve: &Option<StatedCurve>| curve.is_some_and(|curve| curve != StatedCurve::Srgb);
    let curves: Vec<Option<StatedCurve>> = photos.iter().map(|photo| photo.info.curve).collect();
    let others = curves.iter().filter(|curve| is_other(curve)).count();
    let first = curves.first().copied().flatten();
    if others > 0 && curves.iter().any(|curve| *curve != first) {
        notes.push(PrepareNote::new(format!(
            "{} of {} state another curve than the rest, and the set has one: prepare them apart, or say which",
            plural(others, "picture"),
            curves.len()
        )));
        return None;
    }
    first.filter(|_| others > 0)
}

/// Returns the response of a stated curve, and its name.
fn response_of(curve: StatedCurve) -> (ResponseCurve, String) {
    match curve {
        StatedCurve::Linear => (ResponseCurve::Linear, "linear, as the files state".to_owned()),
        StatedCurve::Srgb => (ResponseCurve::Srgb, "sRGB, as the files state".to_owned()),
        StatedCurve::Power(exponent) => {
            let signal: [f32; 256] = std::array::from_fn(|code| (code as f64 / 255.0).powf(exponent) as f32);
            (ResponseCurve::Curve(Box::new([signal; 3])), format!("code to the power of {exponent:.4}, as the files state"))
        }
    }
}

/// Chooses the curve of `photos`, or returns `None` where none is needed. `read_brackets` decodes the brackets
/// of [`views_for_response`], thinned; it is called only if the curve is to be recovered.
///
/// # Errors
/// A curve that has to be recovered and cannot be.
pub fn choose_response(
    plan: &mut Plan,
    photos: &[Photograph],
    choice: ResponseChoice,
    read_brackets: impl FnOnce(&[&PlannedView]) -> Vec<Vec<CapturedFrame>>,
) -> Result<Option<SetCurve>, PrepareError> {
    if plan.kind != PhotoKind::Developed {
        return Ok(None);
    }
    let has_brackets = plan.views.iter().any(|v| v.frames.len() > 1);
    let stated = if choice == ResponseChoice::Auto { stated_curve(photos, &mut plan.notes) } else { None };
    if let Some(curve) = stated {
        let (response, name) = response_of(curve);
        return Ok(Some(SetCurve { tables: CurveTables::new(&response), name, origin: CurveOrigin::Standard }));
    }
    let (response, name) = match choice {
        ResponseChoice::Linear => (ResponseCurve::Linear, "linear".to_owned()),
        ResponseChoice::Srgb => (ResponseCurve::Srgb, "sRGB".to_owned()),
        ResponseChoice::Auto if !has_brackets => {
            let text = "pictures without brackets are read as sRGB: a camera's own curve differs from it; bracket, or shoot RAW";
            plan.notes.push(PrepareNote::new(text));
            (ResponseCurve::Srgb, "sRGB".to_owned())
        }
        ResponseChoice::Auto | ResponseChoice::Recover => {
            let brackets = read_brackets(&views_for_response(plan));
            match recover_response(&brackets) {
                Ok(response) => {
                    (response, format!("recovered from the brackets of {} (Debevec and Malik)", plural(brackets.len(), "view")))
                }
                Err(error) if choice == ResponseChoice::Recover => {
                    let remedy = Remedy::advice("bracket").or(Remedy::set("response", "srgb"));
                    return Err(PrepareError::new(format!("the response curve cannot be recovered: {error}")).with_remedy(remedy));
                }
                Err(error) => {
                    let text = format!("the response curve cannot be recovered, so sRGB's is used: {error}");
                    plan.notes.push(PrepareNote::new(text));
                    (ResponseCurve::Srgb, "sRGB".to_owned())
                }
            }
        }
    };
    let origin = if matches!(response, ResponseCurve::Curve(_)) { CurveOrigin::Recovered } else { CurveOrigin::Standard };
    Ok(Some(SetCurve { tables: CurveTables::new(&response), name, origin }))
}
