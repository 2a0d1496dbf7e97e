//! Reads the brackets that the response curve of a set of developed pictures is recovered from.
//!
//! Brackets are decoded one after another, and a thinned copy of each is kept.

use luxel_capture::prepare::{CurveTables, Photograph, PlannedView, developed_frame, thinned};
use luxel_capture::{CapturedFrame, ResponseCurve};
use luxel_io::{Photo, decode_photo};
use rayon::prelude::*;

/// Decodes and thins the frames of some views. Two bodies have two curves: the most used one
/// decides, and the note on mixed cameras says so.
pub(super) fn thinned_brackets(views: &[&PlannedView], photos: &[Photograph]) -> Vec<Vec<CapturedFrame>> {
    let placeholder = CurveTables::new(&ResponseCurve::Srgb);
    views
        .iter()
        .map(|view| {
            let frames: Vec<&Photograph> = view.frames.iter().filter_map(|i| photos.get(*i)).collect();
            // What cannot be decoded is reported when its view is made.
            frames.par_iter().filter_map(|photo| thinned_frame(photo, &placeholder)).collect()
        })
        .collect()
}

fn thinned_frame(photo: &Photograph, tables: &CurveTables) -> Option<CapturedFrame> {
    let bytes = luxel_io::read_file(&photo.path).ok()?;
    let Ok(Photo::Developed { width, height, codes }) = decode_photo(&photo.path, &bytes) else { return None };
    Some(thinned(&developed_frame([width, height], codes, tables, &photo.exposure?)))
}
