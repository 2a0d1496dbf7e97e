//! The luminance-error profile as plots: of one run, or of several in one figure.
//!
//! In: profiles over the same pixels, which each method has its own errors on. Out: two plots,
//! mean absolute error and error in stops. Empty bins have no point; of profiles without pixels
//! nothing is drawn.

use luxel_metrics::{LuminanceProfile, ProfileBin};

use super::plot::{Axis, Bar, Mark, Plot, Point, Scale, Series};

/// Width of the open bins at either end as they are drawn: a quarter decade, as a factor.
const OPEN_BIN: f64 = 1.78;

/// A profile with its label and colour.
pub struct Profiled<'a> {
    /// Text in the legend; empty for none.
    pub label: &'a str,
    /// Number of a colour of the page, from 1.
    pub color: usize,
    /// Error by luminance.
    pub profile: &'a LuminanceProfile,
}

/// Returns both plots; empty where there are no pixels.
pub fn plots(profiles: &[Profiled<'_>]) -> String {
    // All are of the same photographs, so the first says how many pixels there are.
    let Some(first) = profiles.iter().map(|of| of.profile).find(|profile| profile.count() > 0) else { return String::new() };
    let bars = bars(first);
    let points = |profile: &LuminanceProfile, of: fn(&ProfileBin) -> Option<f64>| {
        profile.bins.iter().filter_map(|bin| Some(Point { x: bin.mean_luminance()?, y: of(bin)? })).collect::<Vec<_>>()
    };
    let series = |of: fn(&ProfileBin) -> Option<f64>| {
        let of_profile =
            |p: &Profiled<'_>| Series { label: p.label.to_owned(), color: p.color, mark: Mark::Dots, points: points(p.profile, of) };
        profiles.iter().map(of_profile).collect::<Vec<_>>()
    };
    let luminances = points(first, ProfileBin::mean_luminance);
    let ends = [luminances.first().map_or(1.0, |p| p.x.max(1e-5)), luminances.last().map_or(1.0, |p| p.x)];
    let guide = |label: &str, share: f64| Series {
        label: label.into(),
        color: 1,
        mark: Mark::Guide,
        points: ends.map(|x| Point { x, y: share * x }).into(),
    };
    let x = Axis { label: "luminance of the ground truth, normalised units", scale: Scale::Log };
    let mut absolute = series(ProfileBin::mean_absolute_error);
    absolute.extend([guide("100 %", 1.0), guide("10 %", 0.1), guide("1 %", 0.01)]);
    let absolute = Plot {
        title: "Mean absolute error",
        x,
        y: Axis { label: "error, normalised units", scale: Scale::Log },
        series: absolute,
        bars: bars.clone(),
    };
    let stops = Plot {
        title: "Error in stops",
        x,
        y: Axis { label: "root mean square, EV", scale: Scale::Linear },
        series: series(ProfileBin::rms_stops),
        bars,
    };
    [absolute.figure(), stops.figure()].into_iter().flatten().collect()
}

/// Returns a bar for each bin that has pixels; the fullest is nine tenths high.
fn bars(profile: &LuminanceProfile) -> Vec<Bar> {
    let most = profile.bins.iter().map(|bin| bin.count).max().unwrap_or(0).max(1) as f64;
    let bar = |(i, bin): (usize, &ProfileBin)| {
        let (from, to) = LuminanceProfile::edges(i);
        let (from, to) = if from == 0.0 { (to / OPEN_BIN, to) } else { (from, if to.is_finite() { to } else { from * OPEN_BIN }) };
        Bar { from, to, share: 0.9 * bin.count as f64 / most }
    };
    profile.bins.iter().enumerate().filter(|(_, bin)| bin.count > 0).map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_profile_has_its_line_and_its_place_in_the_legend() {
        let mut profiles = [LuminanceProfile::default(), LuminanceProfile::default()];
        for (profile, factor) in profiles.iter_mut().zip([1.1, 1.5]) {
            for luminance in [0.01, 0.1, 1.0, 50.0] {
                profile.add([factor * luminance; 3], [luminance; 3]);
            }
        }
        let of = |i: usize, label| Profiled { label, color: i + 1, profile: &profiles[i] };
        let html = plots(&[of(0, "sh3"), of(1, "l<cd")]);
        assert_eq!(html.matches("<figure").count(), 2);
        assert_eq!(html.matches("<polyline").count(), 4);
        assert!(html.contains("sh3") && html.contains("l&lt;cd") && !html.contains("NaN"));
        assert!(plots(&[]).is_empty());
        assert!(plots(&[Profiled { label: "", color: 1, profile: &LuminanceProfile::default() }]).is_empty());
    }
}
