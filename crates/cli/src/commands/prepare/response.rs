//! The response curve of a set of developed pictures.
//!
//! In: the plan and the option. Out: [`SetCurve`], and a note on what was taken. Recovery decodes the brackets of a few views, one after another,
//! and keeps a thinned copy of each.

use anyhow::{Result, bail};
use luxel::text::plural;
use luxel_capture::{Frame, Response, recover_response};
use luxel_io::{Photo, PhotoKind, decode_photo};
use rayon::prelude::*;

use super::pixels::{Tables, developed_frame, thinned};
use super::plan::Plan;
use super::scan::PhotoFile;
use crate::args::ResponseArg;

/// Views that a curve is recovered from, spread over the set.
const VIEWS: usize = 6;
/// Pixels that are kept of a frame.
const PIXELS: usize = 40_000;

/// Where a curve comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CurveOrigin {
    /// A standard, asked for or for want of anything better.
    Taken,
    /// The brackets.
    Recovered,
}

/// The curve of a set.
pub(super) struct SetCurve {
    pub(super) tables: Tables,
    /// For people.
    pub(super) name: String,
    pub(super) origin: CurveOrigin,
}

/// The curve; `None` where nothing needs one.
pub(super) fn settle(plan: &mut Plan, photos: &[PhotoFile], arg: ResponseArg) -> Result<Option<SetCurve>> {
    if plan.kind != PhotoKind::Developed {
        return Ok(None);
    }
    let has_brackets = plan.views.iter().any(|v| v.frames.len() > 1);
    let (response, name) = match arg {
        ResponseArg::Linear => (Response::Linear, "linear".to_owned()),
        ResponseArg::Srgb => (Response::Srgb, "sRGB".to_owned()),
        ResponseArg::Auto if !has_brackets => {
            plan.notes
                .push("pictures without brackets are read as sRGB: a camera's own curve differs from it; bracket, or shoot RAW".to_owned());
            (Response::Srgb, "sRGB".to_owned())
        }
        ResponseArg::Auto | ResponseArg::Recover => {
            let brackets = thinned_brackets(plan, photos);
            match recover_response(&brackets) {
                Ok(response) => {
                    (response, format!("recovered from the brackets of {} (Debevec and Malik)", plural(brackets.len(), "view")))
                }
                Err(error) if arg == ResponseArg::Recover => bail!("--response recover: {error}; bracket, or say --response srgb"),
                Err(error) => {
                    plan.notes.push(format!("the response curve could not be recovered and is taken as sRGB's: {error}"));
                    (Response::Srgb, "sRGB".to_owned())
                }
            }
        }
    };
    let origin = if matches!(response, Response::Curve(_)) { CurveOrigin::Recovered } else { CurveOrigin::Taken };
    Ok(Some(SetCurve { tables: Tables::new(&response), name, origin }))
}

/// A camera of two bodies has two curves: the most used one decides, which is said by the note on mixed cameras.
fn thinned_brackets(plan: &Plan, photos: &[PhotoFile]) -> Vec<Vec<Frame>> {
    let bracketed: Vec<_> = plan.views.iter().filter(|v| v.frames.len() > 1).collect();
    let step = bracketed.len().div_ceil(VIEWS).max(1);
    let placeholder = Tables::new(&Response::Srgb);
    bracketed
        .iter()
        .step_by(step)
        .map(|view| {
            let frames: Vec<&PhotoFile> = view.frames.iter().filter_map(|i| photos.get(*i)).collect();
            // What cannot be decoded is told when its view is made.
            frames.par_iter().filter_map(|photo| thinned_frame(photo, &placeholder)).collect()
        })
        .collect()
}

fn thinned_frame(photo: &PhotoFile, tables: &Tables) -> Option<Frame> {
    let bytes = std::fs::read(&photo.path).ok()?;
    let Ok(Photo::Developed { width, height, codes }) = decode_photo(&photo.path, &bytes) else { return None };
    let exposure = photo.exposure?;
    let transfers = std::sync::Arc::clone(tables.of(&codes));
    let frame = developed_frame([width, height], codes, &transfers, exposure.signal_per_radiance(), exposure.iso);
    let step = ((width * height) as f64 / PIXELS as f64).sqrt().max(1.0) as usize;
    Some(thinned(&frame, step))
}
