//! The page, section by section.

use std::fmt::Write as _;
use std::time::Duration;

use luxel::Result;
use luxel_metrics::{MAX_PSNR_DB, ViewMetrics};

use super::html::{document, escape};
use super::plot::{Axis, Mark, Plot, Point, Scale, Series};
use super::profile::{self, Profiled};
use super::{CurveSample, ReportInput, ReportSplit, views};
use crate::text;

/// Limit of points in a curve; more are not visible on a plot of this width.
const MOST_POINTS: usize = 400;

/// Returns the whole document.
pub(super) fn page(input: &ReportInput) -> Result<String> {
    let pictures = views::Pictures::new(input)?;
    let mut page = String::new();
    for warning in &input.warnings {
        let _ = write!(page, "<p class=\"note\"><b>Note:</b> {}</p>", escape(warning));
    }
    page += pictures.hero();
    page += &cards(input);
    page += &facts(input);
    page += &metrics(input);
    page += &super::field::section(&input.splits);
    page += &curves(&input.curve);
    page += &error_by_luminance(input);
    page += pictures.sections();
    page += &per_view(&input.splits);
    page += &configuration(input);
    page += &footer(input);
    Ok(document(&input.title, &input.subtitle, &page))
}

fn decibels(value: f64) -> String {
    if value >= MAX_PSNR_DB { format!("≥ {MAX_PSNR_DB:.0}") } else { format!("{value:.2}") }
}

/// Returns the most important metrics, large.
fn cards(input: &ReportInput) -> String {
    let mut cards: Vec<(String, &str, String)> = Vec::new();
    if let Some(split) = input.splits.first() {
        let (m, name) = (&split.mean, &split.name);
        cards.push((decibels(m.psnr_scene), "dB", format!("{name} PSNR, scene")));
        cards.push((decibels(m.psnr_gtmax), "dB", format!("{name} PSNR, gtmax")));
        cards.push((decibels(m.psnr_selfmax), "dB", format!("{name} PSNR, selfmax")));
        cards.push((format!("{:.4}", m.ssim_scene), "", format!("{name} SSIM, scene")));
        cards.push((format!("{:.4}", m.ssim_gtmax), "", format!("{name} SSIM, gtmax")));
        cards.push((decibels(m.psnr_black_scene), "dB", "a black image, scene".into()));
    }
    if let Some(last) = input.curve.last() {
        cards.push((text::count(last.splats), "", "splats".into()));
        if let Ok(elapsed) = Duration::try_from_secs_f64(last.elapsed_s) {
            cards.push((text::duration(elapsed), "", format!("for {} iterations", text::count(last.iteration as usize))));
        }
    }
    if cards.is_empty() {
        return String::new();
    }
    let mut out = String::from("<div class=\"cards\">");
    for (value, unit, name) in cards {
        let unit = if unit.is_empty() { String::new() } else { format!(" <span class=\"unit\">{unit}</span>") };
        let _ = write!(
            out,
            "<div class=\"card\"><div class=\"value\">{}{unit}</div><div class=\"name\">{}</div></div>",
            escape(&value),
            escape(&name)
        );
    }
    out + "</div>\n"
}

fn facts(input: &ReportInput) -> String {
    if input.facts.is_empty() {
        return String::new();
    }
    let mut out = String::from("<details class=\"facts\"><summary>About this run</summary><div class=\"scroll\"><table>");
    for (name, value) in &input.facts {
        let _ = write!(out, "<tr><th scope=\"row\">{}</th><td class=\"wrap\">{}</td></tr>", escape(name), escape(value));
    }
    out + "</table></div></details>\n"
}

/// Returns the head of a table of metrics, whose first column is `what`.
fn head(what: &str) -> String {
    let group = |name, span| format!("<th class=\"group\" colspan=\"{span}\">{name}</th>");
    let cells = ["scene", "gtmax", "selfmax", "scene", "gtmax", "selfmax", "scene", "scene", "gtmax"]
        .map(|name| format!("<th>{name}</th>"))
        .concat();
    let groups = group("PSNR, dB", 3) + &group("SSIM", 3) + &group("L1", 1) + &group("black image, dB", 2);
    format!("<thead><tr><th rowspan=\"2\">{what}</th>{groups}</tr><tr>{cells}</tr></thead>")
}

fn row(name: &str, m: &ViewMetrics) -> String {
    let db = [m.psnr_scene, m.psnr_gtmax, m.psnr_selfmax].map(decibels);
    let black = [m.psnr_black_scene, m.psnr_black_gtmax].map(decibels);
    let ssim = [m.ssim_scene, m.ssim_gtmax, m.ssim_selfmax].map(|v| format!("{v:.4}"));
    let l1 = format!("{:.5}", m.l1_scene);
    let cells = db.iter().chain(&ssim).chain([&l1]).chain(&black).fold(String::new(), |out, cell| out + "<td>" + cell + "</td>");
    format!("<tr><td>{}</td>{cells}</tr>", escape(name))
}

/// Returns the means of each split, and the protocols.
fn metrics(input: &ReportInput) -> String {
    let mut out = String::from("<section><h2>Metrics</h2>");
    if input.splits.is_empty() {
        out += "<p>No view was held out and none was evaluated, so there are no metrics.</p></section>\n";
        return out;
    }
    let _ = write!(out, "<div class=\"scroll\"><table>{}<tbody>", head("mean of"));
    for split in &input.splits {
        out += &row(&format!("{}, {}", split.name, text::plural(split.views.len(), "view")), &split.mean);
    }
    let scale = text::number(input.radiance_scale.get().into());
    let mu = input.mu;
    let _ = writeln!(
        out,
        "</tbody></table></div><p class=\"note\">PSNR in decibels. Every metric compares images under the mu-law, \
         T(p) = ln(1 + {mu} p) / ln(1 + {mu}), with p in 0 to 1; a PSNR means nothing without knowing what p is:</p><dl>\
         <dt>scene</dt><dd>p is radiance / {scale}, one constant for the whole scene, the same as in training; \
         what is brighter counts as 1.</dd>\
         <dt>gtmax</dt><dd>Both images are divided by the maximum of the view's ground truth, and the render is clipped to 1 \
         (HDR-NeRF's evaluation).</dd>\
         <dt>selfmax</dt><dd>Each image is divided by its own maximum (HDR-GS's evaluation): one wrong pixel in a lamp moves \
         everything, and a wrong overall brightness goes unseen.</dd>\
         <dt>black</dt><dd>What an entirely black image would score: the zero of the PSNR scale on this scene.</dd>\
         <dt>SSIM, L1</dt><dd>SSIM has an 11 x 11 Gaussian window (sigma 1.5 px) and is the mean of the channels; L1 is the mean absolute \
         difference.</dd></dl></section>"
    );
    out
}

/// Returns the metrics of every view.
fn per_view(splits: &[ReportSplit]) -> String {
    let mut out = String::new();
    for (i, split) in splits.iter().enumerate().filter(|(_, split)| !split.views.is_empty()) {
        let open = if i == 0 && split.views.len() <= 40 { " open" } else { "" };
        let heading = if i == 0 { "<h2>Every view</h2>" } else { "" };
        let _ = write!(
            out,
            "{heading}<details{open}><summary>{} of the {} split</summary><div class=\"scroll\"><table>{}<tbody>",
            text::plural(split.views.len(), "view"),
            escape(&split.name),
            head("view"),
        );
        for (name, metrics) in &split.views {
            out += &row(name, metrics);
        }
        out += "</tbody></table></div></details>\n";
    }
    out
}

/// Returns plots of loss, PSNR and splats over iterations.
fn curves(curve: &[CurveSample]) -> String {
    let series = |label: &str, color, mark, of: &dyn Fn(&CurveSample) -> Option<f64>| {
        let points = curve.iter().filter_map(|s| of(s).map(|y| Point { x: f64::from(s.iteration), y })).collect();
        Series { label: label.into(), color, mark, points }
    };
    let x = Axis { label: "iteration", scale: Scale::Linear };
    let axis = |label, scale| Axis { label, scale };
    let loss = series("", 1, Mark::Faint, &|s| Some(s.loss));
    let smooth = Series { label: String::new(), color: 1, mark: Mark::Line, points: smoothed(&loss.points) };
    let sparse = |s: Series, mark| Series { mark: if s.points.len() > 60 { mark } else { Mark::Dots }, points: thinned(s.points), ..s };
    let train = sparse(series("train", 2, Mark::Line, &|s| s.psnr_train), Mark::Line);
    let test = sparse(series("all test views", 1, Mark::Line, &|s| s.psnr_test), Mark::Line);
    let sample = sparse(series("some test views", 3, Mark::Line, &|s| s.psnr_test_sample), Mark::Line);
    let ssim = series("", 1, Mark::Line, &|s| s.ssim.map(|ssim| 1.0 - ssim));
    let l1 = series("", 2, Mark::Line, &|s| s.l1);
    let splats = series("", 1, Mark::Line, &|s| (s.splats > 0).then_some(s.splats as f64));
    let figure = |title, y, series| Plot { title, x, y, series, bars: Vec::new() }.figure();
    let parts = vec![
        Series { label: "1 − SSIM".into(), points: smoothed(&ssim.points), ..ssim },
        Series { label: "L1".into(), points: smoothed(&l1.points), ..l1 },
    ];
    let plots = [
        figure("PSNR, protocol scene", axis("dB", Scale::Linear), vec![train, sample, test]),
        figure("Training loss", axis("loss", Scale::Log), vec![Series { points: thinned(loss.points), ..loss }, smooth]),
        figure("Parts of the loss, on training views", axis("mu-law units", Scale::Log), parts),
        figure("Splats", axis("count", Scale::Linear), vec![Series { points: thinned(splats.points), ..splats }]),
    ];
    let plots: Vec<String> = plots.into_iter().flatten().collect();
    if plots.is_empty() {
        return String::new();
    }
    format!("<section><h2>Training</h2><div class=\"plots\">{}</div></section>\n", plots.concat())
}

/// Returns a running mean that lags by a fiftieth of the curve, at most [`MOST_POINTS`] points.
fn smoothed(points: &[Point]) -> Vec<Point> {
    let share = 1.0 / (points.len() as f64 / 50.0).max(1.0);
    let mut mean = None;
    let running = points.iter().filter(|point| point.y.is_finite()).map(|&Point { x, y }| {
        let next = mean.map_or(y, |m: f64| m + share * (y - m));
        mean = Some(next);
        Point { x, y: next }
    });
    thinned(running.collect())
}

/// Returns every n-th point and the last.
fn thinned(points: Vec<Point>) -> Vec<Point> {
    let stride = points.len().div_ceil(MOST_POINTS).max(1);
    let last = points.len().saturating_sub(1);
    points.into_iter().enumerate().filter(|(i, _)| i % stride == 0 || *i == last).map(|(_, point)| point).collect()
}

/// Returns the error by the ground truth's luminance.
fn error_by_luminance(input: &ReportInput) -> String {
    let plots = profile::plots(&[Profiled { label: "", color: 1, profile: &input.profile }]);
    if plots.is_empty() {
        return plots;
    }
    let split = input.splits.first().map_or("evaluated", |split| split.name.as_str());
    format!(
        "<section><h2>Error by luminance</h2><p>How far the render is from the ground truth, from the shadows to the lamps: pixels of all {} \
         views, in bins of a quarter decade of the ground truth's luminance, nothing clipped. The bars in the background say how many pixels \
         there are; dashed lines are relative errors. One normalised unit is {} in the units of the data set.</p>\
         <div class=\"plots\">{plots}</div></section>\n",
        escape(split),
        text::number(input.radiance_scale.get().into()),
    )
}

fn configuration(input: &ReportInput) -> String {
    if input.config_toml.trim().is_empty() {
        return String::new();
    }
    let config = escape(input.config_toml.trim_end());
    format!("<section><h2>Configuration</h2><details><summary>Every setting of this run</summary><pre>{config}</pre></details></section>\n")
}

fn footer(input: &ReportInput) -> String {
    let mut out = String::from("<footer>");
    for credit in &input.credits {
        let _ = write!(out, "<p>{}</p>", escape(credit));
    }
    let _ = write!(
        out,
        "<p>Made by Luxel {}. Pictures are for viewing; the radiance is in the EXR files.</p></footer>",
        env!("CARGO_PKG_VERSION")
    );
    out
}
