//! Opcode lists of a DNG: which operation is done when.
//!
//! In: the lists. Out: [`Plan`], and functions that do its first parts. List 1 is for the stored
//! samples, list 2 for linear ones from 0 at black to 1 at white, list 3 for colours. Gains of
//! samples, and of colours before anything moves them, are left to the merging of exposures, where
//! a gain makes an exposure smaller and saturation stays what it was. An operation that the file
//! requires and that is not known, or not at its place, is an error; an optional one is left out
//! and named.

use luxel_core::photo::{Gain, LensStep, RawPixels};

use super::dng_opcodes::{BadPixels, Operation, ValueMap, opcodes};
use super::dng_samples::{Samples, ValueRange};
use crate::IoError;
use crate::input::Input;

/// Operations by the stage at which they are done.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Plan {
    /// On stored samples.
    pub(super) stored: Vec<StoredStep>,
    /// On linear samples.
    pub(super) linear: Vec<ValueMap>,
    /// Gains of samples.
    pub(super) gains: Vec<Gain>,
    /// On colours.
    pub(super) steps: Vec<LensStep>,
    /// Names of lists with the operations that are done.
    pub(super) applied: Vec<String>,
    /// Names of lists with the operations that are left out.
    pub(super) left_out: Vec<String>,
}

/// An operation on stored samples.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum StoredStep {
    BadPixels(BadPixels),
    Values(ValueMap),
}

impl Plan {
    /// Takes an operation of list `list`; `None` if it cannot be done there.
    fn take(&mut self, operation: Operation, list: usize, is_mosaic: bool) -> Option<()> {
        match operation {
            Operation::BadPixels(bad) if list == 1 => self.stored.push(StoredStep::BadPixels(bad)),
            Operation::Values(map) if list == 1 => self.stored.push(StoredStep::Values(map)),
            // Colours are those of samples where there is no mosaic.
            Operation::Values(map) if self.gains.is_empty() && self.steps.is_empty() && (list == 2 || !is_mosaic) => {
                self.linear.push(map);
            }
            Operation::Gain(gain) if list > 1 && self.steps.is_empty() => self.gains.push(gain),
            Operation::Gain(gain) if list == 3 || (list == 2 && !is_mosaic) => self.steps.push(LensStep::Gain(gain)),
            Operation::Warp(warp) if list == 3 || (list == 2 && !is_mosaic) => self.steps.push(LensStep::Warp(warp)),
            _ => return None,
        }
        Some(())
    }
}

/// Explains why lists cannot be followed.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum PlanError {
    /// A list is damaged; says how.
    Damaged(String),
    /// A list requires something unknown; says what.
    Unknown(String),
}

impl Plan {
    /// Reads the three lists.
    pub(super) fn new(lists: [Option<&[u8]>; 3], is_mosaic: bool) -> Result<Self, PlanError> {
        let mut plan = Self::default();
        for (i, bytes) in lists.into_iter().enumerate() {
            let list = i + 1;
            let Some(bytes) = bytes.filter(|bytes| !bytes.is_empty()) else { continue };
            let damaged = |message: String| PlanError::Damaged(format!("opcode list {list}: {message}"));
            let (mut applied, mut left_out) = (Vec::new(), Vec::new());
            for opcode in opcodes(bytes).map_err(damaged)? {
                let name = opcode.name();
                let operation = opcode.operation(list == 3 || !is_mosaic).map_err(damaged)?;
                let is_done = operation.and_then(|operation| plan.take(operation, list, is_mosaic)).is_some();
                if !is_done && !opcode.is_optional {
                    return Err(PlanError::Unknown(format!("opcode list {list} requires {name}, which is not known there")));
                }
                let names = if is_done { &mut applied } else { &mut left_out };
                if !names.contains(&name) {
                    names.push(name);
                }
            }
            for (names, out) in [(applied, &mut plan.applied), (left_out, &mut plan.left_out)] {
                if !names.is_empty() {
                    out.push(format!("opcode list {list} ({})", names.join(", ")));
                }
            }
        }
        Ok(plan)
    }
}

/// Does what is planned for stored samples.
pub(super) fn correct_stored(input: Input<'_>, plan: &Plan, mut samples: Samples<'_>) -> Result<(), IoError> {
    let range = ValueRange { black: [0.0; 4], white: 65535.0, saturated: f32::INFINITY };
    for step in &plan.stored {
        match step {
            StoredStep::BadPixels(bad) => samples.fix(input, bad)?,
            StoredStep::Values(map) => samples.map(map, range),
        }
    }
    Ok(())
}

/// Does what is planned for linear samples. Codes are put on a larger scale first, so that rounding
/// them loses nothing.
pub(super) fn correct_linear(plan: &Plan, pixels: &mut RawPixels, origin: [usize; 2]) {
    if plan.linear.is_empty() {
        return;
    }
    while 2.0 * pixels.white <= 65535.0 {
        pixels.codes.iter_mut().for_each(|code| *code = code.saturating_mul(2));
        pixels.black = pixels.black.map(|level| 2.0 * level);
        pixels.white *= 2.0;
    }
    let range = ValueRange { black: pixels.black, white: pixels.white, saturated: pixels.white };
    let per_pixel = if pixels.cell.is_some() { 1 } else { 3 };
    let mut samples = Samples { codes: &mut pixels.codes, width: pixels.width, per_pixel, origin, cell: pixels.cell };
    plan.linear.iter().for_each(|map| samples.map(map, range));
}
