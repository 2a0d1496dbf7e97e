//! What to photograph again, and how: from the figures of the views and what structure from motion came to.

use super::dataset::Registration;
use super::response::CurveOrigin;
use super::state::ViewRecord;

/// Share of saturated pixels that is worth a shorter exposure.
const SATURATED: f64 = 0.01;
/// Share of black samples that is worth a longer one.
const DARK: f64 = 0.10;
/// Share of disagreeing samples that is taken for motion.
const MOTION: f64 = 0.02;
/// Shift within a bracket that is worth a tripod, share of the photograph's longest side.
const SHIFT: f64 = 1.0 / 500.0;
/// Sharpness against the set's median below which a view is called soft.
const SOFT: f32 = 0.7;
/// Points below which a view hangs loose.
const FEW_POINTS: usize = 60;
/// Reprojection error against the set's mean above which a view's pose is doubtful.
const ODD_ERROR: f64 = 2.0;

/// Views that a line names; the report's table has all.
const MAX_LISTED: usize = 12;

/// What is known of a set.
pub(super) struct Known<'a> {
    pub(super) records: &'a [ViewRecord],
    pub(super) registration: Option<&'a Registration>,
    pub(super) curve: Option<CurveOrigin>,
    /// How many times a side images are smaller than photographs.
    pub(super) downscale: u32,
}

/// Lines for people, each beginning with what it is about.
pub(super) fn advice(known: &Known<'_>) -> Vec<String> {
    let Known { records, registration, curve, downscale } = *known;
    let mut out = Vec::new();
    let names = |chosen: Vec<&ViewRecord>| {
        if chosen.len() == records.len() && chosen.len() > 1 {
            return "all views".to_owned();
        }
        let listed: Vec<&str> = chosen.iter().take(MAX_LISTED).map(|r| r.name.as_str()).collect();
        let more = chosen.len() - listed.len();
        listed.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
    };
    let say = |out: &mut Vec<String>, chosen: Vec<&ViewRecord>, what: &str| {
        if !chosen.is_empty() {
            out.push(format!("{}: {what}", names(chosen)));
        }
    };
    let pick = |test: &dyn Fn(&ViewRecord) -> bool| records.iter().filter(|r| test(r)).collect::<Vec<_>>();
    say(
        &mut out,
        pick(&|r| r.saturated > SATURATED),
        "saturated in every exposure in more than 1 % of the picture; add a shorter exposure",
    );
    say(&mut out, pick(&|r| r.dark > DARK), "black in every exposure in more than 10 % of the picture; add a longer exposure");
    let mut sharpness: Vec<f32> = records.iter().map(|r| r.figures.sharpness).collect();
    sharpness.sort_by(f32::total_cmp);
    let median = sharpness.get(sharpness.len() / 2).copied().unwrap_or(0.0);
    say(&mut out, pick(&|r| r.figures.sharpness < SOFT * median), "softer than the others; out of focus or shaken, photograph again");
    // Shifts are measured in the photographs.
    let side = |r: &ViewRecord| f64::from(downscale) * r.size_px[0].max(r.size_px[1]) as f64;
    say(
        &mut out,
        pick(&|r| r.offset_px.is_some_and(|px| px > (SHIFT * side(r)).max(3.0))),
        "the exposures of the bracket are shifted against each other; use a tripod, or a faster series",
    );
    let moving = pick(&|r| r.disagreeing > MOTION);
    if 2 * moving.len() > records.len() && moving.len() > 1 {
        // Not everything moves everywhere.
        let why = match curve {
            Some(CurveOrigin::Taken) => "the exposures in EXIF or the response curve are not those of the pictures; try --response recover",
            Some(CurveOrigin::Recovered) => {
                "the exposures in EXIF are not those of the pictures, or these were not developed alike; give exposures with --exposures, or shoot RAW"
            }
            None => "the exposures in EXIF are not those of the pictures, or the light changed; give exposures with --exposures",
        };
        let (n, all) = (moving.len(), records.len());
        out.push(format!("in {n} of {all} views the exposures disagree in more than 2 % of the picture: {why}"));
    } else {
        say(&mut out, moving, "the exposures of the bracket disagree in more than 2 % of the picture; something moved");
    }
    if let Some(registration) = registration {
        let of = |r: &ViewRecord| registration.views.get(&r.name);
        say(&mut out, pick(&|r| of(r).is_none()), "no pose was found; photograph from places in between, with more overlap");
        say(
            &mut out,
            pick(&|r| of(r).is_some_and(|v| v.points < FEW_POINTS)),
            "few points hold its pose; photograph from places in between",
        );
        say(
            &mut out,
            pick(&|r| of(r).is_some_and(|v| v.error_px > ODD_ERROR * registration.mean_error_px.max(0.3))),
            "its pose fits less well than the others'; leave it out if the reconstruction is blurred there",
        );
        if registration.models > 1 {
            out.push(format!("the set falls into {} parts that share too little; photograph what lies between them", registration.models));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use luxel_capture::Figures;

    use super::super::dataset::RegisteredView;
    use super::*;

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
            figures: Figures { sharpness: 1.0, ..Figures::default() },
            left_out: Vec::new(),
            notes: Vec::new(),
        }
    }

    #[test]
    fn each_fault_has_its_advice_and_its_views() {
        let mut records: Vec<ViewRecord> = ["a", "b", "c", "d", "e", "f"].map(record).into();
        records[0].saturated = 0.02;
        records[1].figures.sharpness = 0.4;
        records[2].offset_px = Some(12.0);
        records[3].disagreeing = 0.05;
        records[4].dark = 0.3;
        let registered = RegisteredView { points: 500, error_px: 0.5, focal_px: 500.0, kept: 1.0 };
        let views = ["a", "b", "c", "d", "e"].map(|n| (n.to_owned(), registered)).into();
        let registration = Registration { views, points: 900, mean_error_px: 0.5, mean_track: 4.0, models: 2 };
        let known = |records, downscale| Known { records, registration: None, curve: None, downscale };
        let found = advice(&Known { registration: Some(&registration), ..known(&records, 1) });
        for (view, part) in [("a", "shorter"), ("b", "softer"), ("c", "shifted"), ("d", "moved"), ("e", "longer"), ("f", "no pose")] {
            assert!(found.iter().any(|line| line.starts_with(&format!("{view}: ")) && line.contains(part)), "{view} {part}: {found:?}");
        }
        assert!(found.last().unwrap().contains("2 parts"));
        let (wide, small) = (ViewRecord { offset_px: Some(4.0), ..record("a") }, [record("a"), record("b")]);
        assert!(advice(&known(&small, 1)).is_empty());
        // Four pixels of 600 are a shift; of 4800, reduced to 600, they are none.
        assert_eq!([1, 8].map(|downscale| advice(&known(std::slice::from_ref(&wide), downscale)).len()), [1, 0]);
        let mut all: Vec<ViewRecord> = ["a", "b"].map(record).into();
        all.iter_mut().for_each(|r| r.disagreeing = 0.1);
        for (curve, part) in [(Some(CurveOrigin::Taken), "try --response recover"), (Some(CurveOrigin::Recovered), "developed alike")] {
            assert!(advice(&Known { curve, ..known(&all, 1) }).iter().any(|line| line.contains(part)), "{part}");
        }
    }
}
