//! Advice on what to photograph again, and how: from the metrics of the views and the result of
//! structure from motion.
//!
//! In: [`AdviceInput`]. Out: notes, each beginning with what it is about. Degenerate: without a
//! registration there is no advice on poses; a set of good views has no advice.

use luxel_core::Remedy;

use super::{CurveOrigin, PrepareNote, Registration, ViewRecord};

/// Share of saturated pixels that is worth a shorter exposure.
const SATURATED: f64 = 0.01;
/// Share of black samples that is worth a longer one.
const DARK: f64 = 0.10;
/// Share of disagreeing samples that counts as motion.
const MOTION: f64 = 0.02;
/// Shift within a bracket that is worth a tripod, share of the photograph's longest side.
const SHIFT: f64 = 1.0 / 500.0;
/// Sharpness against the set's median below which a view is called soft.
const SOFT: f32 = 0.7;
/// Points below which a view's pose is weakly supported.
const FEW_POINTS: usize = 60;
/// Reprojection error against the set's mean above which a view's pose is doubtful.
const ODD_ERROR: f64 = 2.0;

/// Views that a line names; the report's table has all.
const MAX_LISTED: usize = 12;

/// The facts that advice is drawn from.
#[derive(Clone, Copy, Debug)]
pub struct AdviceInput<'a> {
    /// Views that could be made.
    pub records: &'a [ViewRecord],
    /// Result of structure from motion, once there is one.
    pub registration: Option<&'a Registration>,
    /// Origin of the response curve of developed pictures.
    pub curve: Option<CurveOrigin>,
    /// Factor by which each side of the images is smaller than that of the photographs.
    pub downscale: u32,
}

/// Collects lines, each about some of the views.
struct AdviceLines<'a> {
    records: &'a [ViewRecord],
    lines: Vec<PrepareNote>,
}

impl<'a> AdviceLines<'a> {
    fn select(&self, test: impl Fn(&ViewRecord) -> bool) -> Vec<&'a ViewRecord> {
        self.records.iter().filter(|r| test(r)).collect()
    }

    /// Adds a line about these views, unless there are none.
    fn add_for(&mut self, views: &[&ViewRecord], text: &str) {
        if !views.is_empty() {
            self.lines.push(PrepareNote::new(format!("{}: {text}", self.names(views))));
        }
    }

    /// Adds a line about the views that pass a test.
    fn add_where(&mut self, test: impl Fn(&ViewRecord) -> bool, text: &str) {
        self.add_for(&self.select(test), text);
    }

    fn names(&self, views: &[&ViewRecord]) -> String {
        if views.len() == self.records.len() && views.len() > 1 {
            return "all views".to_owned();
        }
        let listed: Vec<&str> = views.iter().take(MAX_LISTED).map(|r| r.name.as_str()).collect();
        let more = views.len() - listed.len();
        listed.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
    }
}

/// Returns advice on what to photograph again, each note beginning with what it is about.
pub fn advice(input: &AdviceInput<'_>) -> Vec<PrepareNote> {
    let records = input.records;
    let mut out = AdviceLines { records, lines: Vec::new() };
    out.add_where(|r| r.saturated > SATURATED, "saturated in every exposure in more than 1 % of the picture; add a shorter exposure");
    out.add_where(|r| r.dark > DARK, "black in every exposure in more than 10 % of the picture; add a longer exposure");
    let mut sharpness: Vec<f32> = records.iter().map(|r| r.metrics.sharpness).collect();
    sharpness.sort_by(f32::total_cmp);
    let median = sharpness.get(sharpness.len() / 2).copied().unwrap_or(0.0);
    out.add_where(|r| r.metrics.sharpness < SOFT * median, "softer than the others; out of focus or shaken, photograph again");
    // Shifts are measured in the photographs.
    let side = |r: &ViewRecord| f64::from(input.downscale) * r.size_px[0].max(r.size_px[1]) as f64;
    out.add_where(
        |r| r.offset_px.is_some_and(|px| px > (SHIFT * side(r)).max(3.0)),
        "the exposures of the bracket are shifted against each other; use a tripod, or a faster series",
    );
    advise_on_motion(&mut out, input.curve);
    if let Some(registration) = input.registration {
        advise_on_poses(&mut out, registration);
    }
    out.lines
}

/// Adds lines about exposures that disagree: something moved, or the exposures or the curve are
/// wrong.
fn advise_on_motion(out: &mut AdviceLines<'_>, curve: Option<CurveOrigin>) {
    let moving = out.select(|r| r.disagreeing > MOTION);
    if 2 * moving.len() <= out.records.len() || moving.len() <= 1 {
        out.add_for(&moving, "the exposures of the bracket disagree in more than 2 % of the picture; something moved");
        return;
    }
    // Things do not move in most of the views.
    let (why, remedy) = match curve {
        Some(CurveOrigin::Standard) => {
            ("the exposures in EXIF or the response curve are not those of the pictures", Remedy::set("response", "recover"))
        }
        Some(CurveOrigin::Recovered) => (
            "the exposures in EXIF are not those of the pictures, or these were not developed alike",
            Remedy::give("exposures").or(Remedy::advice("shoot RAW")),
        ),
        None => ("the exposures in EXIF are not those of the pictures, or the light changed", Remedy::give("exposures")),
    };
    let (n, all) = (moving.len(), out.records.len());
    let text = format!("in {n} of {all} views the exposures disagree in more than 2 % of the picture: {why}");
    out.lines.push(PrepareNote::new(text).with_remedy(remedy));
}

fn advise_on_poses(out: &mut AdviceLines<'_>, registration: &Registration) {
    let found = |r: &ViewRecord| registration.views.get(&r.name);
    out.add_where(|r| found(r).is_none(), "no pose was found; photograph from places in between, with more overlap");
    out.add_where(|r| found(r).is_some_and(|v| v.points < FEW_POINTS), "few points hold its pose; photograph from places in between");
    out.add_where(
        |r| found(r).is_some_and(|v| v.error_px > ODD_ERROR * registration.mean_error_px.max(0.3)),
        "its pose fits less well than the others'; leave it out if the reconstruction is blurred there",
    );
    if registration.models > 1 {
        let text = format!("the set falls into {} parts that share too little; photograph what lies between them", registration.models);
        out.lines.push(PrepareNote::new(text));
    }
}

#[cfg(test)]
mod tests {
    use super::super::RegisteredView;
    use super::*;
    use crate::CaptureMetrics;

    fn record(name: &str) -> ViewRecord {
        ViewRecord {
            name: name.into(),
            key: String::new(),
            files: Vec::new(),
            stops: Vec::new(),
            camera: 0,
            size_px: [600, 400],
            proxy_px: [600, 400],
            proxy_reduction: 1,
            saturated: 0.0,
            dark: 0.0,
            negative: 0.0,
            disagreeing: 0.0,
            offset_px: None,
            metrics: CaptureMetrics { sharpness: 1.0, ..CaptureMetrics::default() },
            left_out: Vec::new(),
            notes: Vec::new(),
        }
    }

    #[test]
    fn each_fault_has_its_advice_and_its_views() {
        let mut records: Vec<ViewRecord> = ["a", "b", "c", "d", "e", "f"].map(record).into();
        records[0].saturated = 0.02;
        records[1].metrics.sharpness = 0.4;
        records[2].offset_px = Some(12.0);
        records[3].disagreeing = 0.05;
        records[4].dark = 0.3;
        let registered = RegisteredView { points: 500, error_px: 0.5, focal_px: 500.0, kept: 1.0 };
        let views = ["a", "b", "c", "d", "e"].map(|n| (n.to_owned(), registered)).into();
        let registration = Registration { views, points: 900, mean_error_px: 0.5, mean_track: 4.0, models: 2 };
        let input = |records, downscale| AdviceInput { records, registration: None, curve: None, downscale };
        let found = advice(&AdviceInput { registration: Some(&registration), ..input(&records, 1) });
        for (view, part) in [("a", "shorter"), ("b", "softer"), ("c", "shifted"), ("d", "moved"), ("e", "longer"), ("f", "no pose")] {
            assert!(
                found.iter().any(|line| line.text.starts_with(&format!("{view}: ")) && line.text.contains(part)),
                "{view} {part}: {found:?}"
            );
        }
        assert!(found.last().unwrap().text.contains("2 parts"));
        let (wide, small) = (ViewRecord { offset_px: Some(4.0), ..record("a") }, [record("a"), record("b")]);
        assert!(advice(&input(&small, 1)).is_empty());
        // Four pixels of 600 are a shift; of 4800, reduced to 600, they are not.
        assert_eq!([1, 8].map(|downscale| advice(&input(std::slice::from_ref(&wide), downscale)).len()), [1, 0]);
        let mut all: Vec<ViewRecord> = ["a", "b"].map(record).into();
        all.iter_mut().for_each(|r| r.disagreeing = 0.1);
        for (curve, part) in [(Some(CurveOrigin::Standard), "response curve"), (Some(CurveOrigin::Recovered), "developed alike")] {
            assert!(advice(&AdviceInput { curve, ..input(&all, 1) }).iter().any(|line| line.text.contains(part)), "{part}");
        }
    }
}
