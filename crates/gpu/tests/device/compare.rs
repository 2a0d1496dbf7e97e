//! Comparison of two results, with failures and the parity table.

use std::sync::{Mutex, PoisonError};

/// The worst differences between two series.
#[derive(Clone, Copy, Debug, Default)]
pub struct Worst {
    /// Largest difference.
    pub absolute: f64,
    /// Largest difference over the largest value of the series.
    pub relative: f64,
    /// Index, and both values: found, expected.
    pub at: usize,
    pub values: [f64; 2],
}

/// Compares two series; NaN on either side is an infinite difference, unless both are the same
/// bits.
pub fn worst(found: &[f32], expected: &[f32]) -> Worst {
    assert_eq!(found.len(), expected.len(), "lengths differ");
    let largest = expected.iter().fold(0f64, |m, v| m.max(f64::from(v.abs())));
    let mut out = Worst::default();
    for (at, (a, b)) in found.iter().zip(expected).enumerate() {
        if a.to_bits() == b.to_bits() {
            continue;
        }
        let difference = (f64::from(*a) - f64::from(*b)).abs();
        let difference = if difference.is_nan() { f64::INFINITY } else { difference };
        if difference > out.absolute {
            out = Worst {
                absolute: difference,
                relative: difference / largest.max(f64::MIN_POSITIVE),
                at,
                values: [f64::from(*a), f64::from(*b)],
            };
        }
    }
    out
}

/// The worst differences by row of the parity table, in the order of the tests.
static TABLE: Mutex<Vec<(String, Worst)>> = Mutex::new(Vec::new());

/// Adds a difference to the table; its row is the text before the colon.
fn note(what: &str, worst: Worst) {
    let name = what.split(':').next().unwrap_or(what);
    let mut table = TABLE.lock().unwrap_or_else(PoisonError::into_inner);
    match table.iter_mut().find(|(row, _)| row == name) {
        None => table.push((name.to_owned(), worst)),
        Some((_, row)) => {
            row.absolute = row.absolute.max(worst.absolute);
            row.relative = row.relative.max(worst.relative);
        }
    }
}

/// Prints the parity table of the tests that have run.
pub fn print_table() {
    println!("| pass | absolute, relative |\n|---|---|");
    for (name, Worst { absolute, relative, .. }) in TABLE.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        println!("| {name} | {absolute:.1e}, {relative:.1e} |");
    }
}

/// Fails unless the worst difference is within `relative` of the series' largest value.
pub fn assert_close(what: &str, found: &[f32], expected: &[f32], relative: f64) {
    let worst = worst(found, expected);
    note(what, worst);
    let Worst { absolute, relative: found_relative, at, values } = worst;
    assert!(
        found_relative <= relative,
        "{what}: differs by {absolute:e}, {found_relative:e} of the largest where {relative:e} is allowed: number {at} is {} and should be {}",
        values[0],
        values[1]
    );
}

/// Fails unless all but `most` values are within `relative` of the largest, and those within
/// `band`: for values that jump at thresholds.
pub fn assert_close_but_few(what: &str, found: &[f32], expected: &[f32], relative: f64, (most, band): (usize, f64)) {
    let largest = expected.iter().fold(f64::MIN_POSITIVE, |m, v| m.max(f64::from(v.abs())));
    let is_beyond = |(a, b): (&f32, &f32), limit: f64| {
        let difference = (f64::from(*a) - f64::from(*b)).abs();
        difference.is_nan() || difference > limit * largest
    };
    let beyond = |limit: f64| found.iter().zip(expected).filter(|pair| is_beyond(*pair, limit)).count();
    let worst = worst(found, expected);
    note(what, worst);
    assert!(
        beyond(relative) <= most && beyond(band) == 0,
        "{what}: {} of {} beyond {relative:e}, worst {worst:?}",
        beyond(relative),
        found.len()
    );
}
