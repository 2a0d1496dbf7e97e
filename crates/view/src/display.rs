//! The table of a display of OpenColorIO, which the page's shader draws with.
//!
//! `GET /api/display` answers with `[side*side*side]` code values, R, G and B as little-endian half
//! floats, R fastest; `/api/scene` has its side, its range and the names of display and view.

use bytes::Bytes;
use half::f16;
use luxel::display_lut::{DisplayLut, HIGH_LOG2, LOW_LOG2, SIDE};
use serde::Serialize;

/// A table for the page.
#[derive(Clone, Debug)]
pub(crate) struct ShownDisplay {
    pub(crate) facts: DisplayFacts,
    /// The code values.
    pub(crate) body: Bytes,
}

/// Facts about a table, as `/api/scene` gives them.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct DisplayFacts {
    display: String,
    view: String,
    /// Radiances along each axis.
    side: usize,
    /// Ends of the range, log2 of radiance at the exposure in force.
    range_log2: [f32; 2],
}

impl ShownDisplay {
    pub(crate) fn new(lut: &DisplayLut) -> Self {
        let values = lut.values().as_flattened().iter();
        let body: Vec<u8> = values.flat_map(|value| f16::from_f32(*value).to_le_bytes()).collect();
        let [display, view] = [lut.display(), lut.view()].map(str::to_owned);
        Self { facts: DisplayFacts { display, view, side: SIDE, range_log2: [LOW_LOG2, HIGH_LOG2] }, body: body.into() }
    }
}
