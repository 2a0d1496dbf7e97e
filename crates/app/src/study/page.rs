//! `report.html` of a matrix: self-contained, as a run's report is.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use luxel::Result;
use luxel_metrics::LuminanceProfile;

use super::beside::OfStudy;
use super::matrix::Matrix;
use super::results::CellResult;
use super::tables::Tables;
use super::{Failure, MethodProfile};
use super::{beside, crops, html_table, paper};
use crate::report::html::{document, escape};
use crate::report::profile::{self, Profiled};
use crate::{machine, text};

/// The content of the page.
pub(super) struct Content<'a> {
    pub(super) matrix: &'a Matrix,
    pub(super) results: &'a [CellResult],
    pub(super) failures: &'a [Failure],
    /// Names of runs that are asked for and not finished.
    pub(super) missing: &'a [String],
    pub(super) tables: &'a Tables,
    /// Error by luminance.
    pub(super) profiles: &'a [MethodProfile],
    /// Luminance editing.
    pub(super) editing: String,
}

/// Returns the document.
pub(super) fn page(content: &Content<'_>) -> Result<String> {
    let matrix = content.matrix;
    let iterations = matrix.cells.first().map_or(0, |cell| cell.config.train.iterations) as usize;
    let subtitle = format!(
        "{}, {}, {}, {} iterations",
        text::plural(matrix.methods.len(), "method"),
        text::plural(matrix.sources.len(), "data set"),
        text::plural(matrix.seeds.len(), "seed"),
        text::count(iterations)
    );
    let names: Vec<&str> = matrix.sources.iter().map(|source| source.name.as_str()).collect();
    let mut body = notes(content);
    body += &tables(content);
    body += &activations(content);
    body += &profiles(content);
    body += &all_crops(content);
    body += &content.editing;
    let _ = writeln!(body, "<section><h2>Every run</h2>{}</section>", html_table::runs(matrix, content.results));
    body += &epilogue(content)?;
    Ok(document(&names.join(", "), &subtitle, &body))
}

/// Returns what the reader must know before the numbers.
fn notes(content: &Content<'_>) -> String {
    let mut notes: Vec<String> = Vec::new();
    for failure in content.failures {
        notes.push(format!("{} failed: {:#}", failure.run, failure.error));
    }
    let is_named = |run: &&String| content.failures.iter().all(|failure| failure.run != **run);
    let missing: Vec<&str> = content.missing.iter().filter(is_named).map(String::as_str).collect();
    if !missing.is_empty() {
        notes.push(format!("{} missing: {}", text::plural(missing.len(), "run"), missing.join(", ")));
    }
    let mut versions: Vec<&str> = content.results.iter().map(|result| result.metrics.luxel_version.as_str()).collect();
    versions.sort_unstable();
    versions.dedup();
    if versions.len() > 1 {
        notes.push(format!("runs were made by different versions of Luxel: {}", versions.join(", ")));
    }
    if content.results.iter().all(|result| result.test().is_none()) {
        notes.push("no view is held out in any data set, so there are no metrics of image quality".into());
    }
    notes.iter().map(|note| format!("<p class=\"note\"><b>Note:</b> {}</p>", escape(note))).collect()
}

fn tables(content: &Content<'_>) -> String {
    let matrix = content.matrix;
    let mut out = String::from("<section><h2>Results</h2>");
    let _ = write!(
        out,
        "<p>Means over {}{}. In each column the best is bold and the second best underlined. A PSNR depends on its protocol: \
         scene, gtmax and selfmax are explained <a href=\"#protocol\">below</a>.</p>",
        text::plural(matrix.seeds.len(), "seed"),
        if matrix.seeds.len() > 1 { ", with the standard deviation of a run (n − 1) below" } else { "" },
    );
    let average = content.tables.average.as_ref().filter(|table| table.has_values());
    if let Some(average) = average {
        let _ = write!(out, "<h3>All data sets</h3>{}", html_table::ours(matrix, average));
    }
    for (source, table) in matrix.sources.iter().zip(&content.tables.results) {
        let _ = write!(out, "<h3>{}</h3>{}", escape(&source.name), html_table::ours(matrix, table));
    }
    out += "<h3>Beside the paper</h3><p>The results of LCD-GS as published, on <b>other data</b>, on one RTX 4090, under a protocol that is not stated. \
            Compare the differences between methods, not the numbers.</p>";
    if let Some(OfStudy { table, data }) = beside::of_study(matrix, content.tables) {
        out += &html_table::gains(matrix, table, data);
        for papers in &paper::RESULTS {
            let _ = write!(out, "<h4>Rows of the paper on {}</h4>{}", papers.dataset, beside::html(matrix, table, papers, data));
        }
    }
    for table in &paper::RESULTS {
        let _ = write!(out, "<details><summary>The paper's table on {}</summary>{}</details>", table.dataset, html_table::papers(table));
    }
    out + "</section>\n"
}

fn activations(content: &Content<'_>) -> String {
    if content.tables.activations.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<section><h2>Activation of the luminance</h2><p>The paper's ablation: softplus, exponential and ReLU, nothing else changed.</p>",
    );
    for (source, table) in content.matrix.sources.iter().zip(&content.tables.activations) {
        let _ = write!(out, "<h3>{}</h3>{}", escape(&source.name), html_table::ours(content.matrix, table));
    }
    out += "<p class=\"note\">The paper's results, on other data:</p>";
    for table in &paper::ACTIVATIONS {
        out += &html_table::papers(table);
    }
    out + "</section>\n"
}

fn profiles(content: &Content<'_>) -> String {
    let matrix = content.matrix;
    let mut out = String::new();
    for (i, source) in matrix.sources.iter().enumerate() {
        let of_source = content.profiles.iter().filter(|of_method| of_method.source == i);
        let names: Vec<(usize, String, &LuminanceProfile)> =
            of_source.map(|p| (p.method, matrix.methods[p.method].name(), &p.profile)).collect();
        let series: Vec<Profiled<'_>> =
            names.iter().map(|(method, name, profile)| Profiled { label: name, color: method + 1, profile }).collect();
        let plots = profile::plots(&series);
        if !plots.is_empty() {
            let _ = write!(out, "<h3>{}</h3><div class=\"plots\">{plots}</div>", escape(&source.name));
        }
    }
    if out.is_empty() {
        return out;
    }
    format!(
        "<section><h2>Error by luminance</h2><p>From the shadows to the lamps: pixels of all test views and seeds, in bins of a quarter decade of the \
         ground truth's luminance, nothing clipped. Bars in the background are numbers of pixels; dashed lines are relative errors.</p>{out}</section>\n"
    )
}

fn all_crops(content: &Content<'_>) -> String {
    let mut out = String::new();
    for (source, of) in content.matrix.sources.iter().enumerate() {
        let crops = crops::section(content.matrix, content.results, source);
        // Images may have been deleted to make room; the tables need none.
        let crops = crops.unwrap_or_else(|error| format!("<p class=\"note\">Left out: {}</p>", escape(&format!("{error:#}"))));
        if !crops.is_empty() {
            let _ = write!(out, "<h3>{}</h3>{crops}", escape(&of.name));
        }
    }
    if out.is_empty() {
        return out;
    }
    format!(
        "<section><h2>Side by side</h2><p>Windows chosen by the ground truth alone, where its luminance varies most, in test views at a quarter and three \
         quarters of the list; renders of the first seed.</p>{out}</section>\n"
    )
}

/// Returns machine, iterations, seeds and protocol.
fn epilogue(content: &Content<'_>) -> Result<String> {
    let matrix = content.matrix;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut facts: Vec<(String, String)> = machine::facts(cores).into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    let seeds: Vec<String> = matrix.seeds.iter().map(u64::to_string).collect();
    facts.push(("iterations".into(), text::count(matrix.cells.first().map_or(0, |cell| cell.config.train.iterations) as usize)));
    facts.push(("seeds".into(), seeds.join(", ")));
    for (i, source) in matrix.sources.iter().enumerate() {
        facts.push((format!("data set {}", source.name), data_set(content, i)));
    }
    facts.push(("luxel".into(), luxel::VERSION.into()));
    let rows = facts.iter().fold(String::new(), |out, (name, value)| {
        out + &format!("<tr><th scope=\"row\">{}</th><td class=\"wrap\">{}</td></tr>", escape(name), escape(value))
    });
    Ok(format!(
        "<section id=\"protocol\"><h2>Machine and protocol</h2><div class=\"scroll facts\"><table>{rows}</table></div>{}\
         <details><summary>Options that all runs share</summary><pre>{}</pre></details></section>\n",
        protocol(content),
        escape(matrix.toml()?.trim_end())
    ))
}

fn data_set(content: &Content<'_>, source: usize) -> String {
    let Some(result) = content.results.iter().find(|result| result.source == source) else { return "no finished run".into() };
    let views = |split: &str| result.metrics.splits.get(split).map_or(0, |split| split.views.len());
    let size = result.measured.as_ref().filter(|measured| measured.views > 0).map(|measured| measured.size_px);
    let size = size.map_or_else(String::new, |[width, height]| format!(", {width}x{height}"));
    format!(
        "{} to train on, {} to test{size}; radiance scale {}",
        text::plural(views("train"), "view"),
        views("test"),
        text::number(result.metrics.radiance_scale.get().into())
    )
}

/// Returns the places where something was computed, each once.
fn named<'a>(places: impl Iterator<Item = &'a str>) -> String {
    let places: BTreeSet<&str> = places.filter(|place| !place.is_empty()).collect();
    if places.is_empty() { "an unknown machine".into() } else { places.into_iter().collect::<Vec<_>>().join(" or ") }
}

fn protocol(content: &Content<'_>) -> String {
    let mu = content.results.first().map_or(luxel_core::tone::MU, |result| result.metrics.mu);
    let peak = content.results.iter().find_map(|result| result.field()).map(|field| field.pu21_peak_luminance);
    let training = escape(&named(content.results.iter().map(|result| result.metrics.computed_by.as_str())));
    let rendering = escape(&named(content.results.iter().filter_map(|result| Some(result.measured.as_ref()?.computed_by.as_str()))));
    let mut out = format!(
        "<dl><dt>PSNR, SSIM</dt><dd>Means over the test views, in decibels, of images under the mu-law T(p) = ln(1 + {mu} p) / ln(1 + {mu}), p in 0 to 1. <b>scene</b>: \
         p is radiance over the data set's radiance scale, one constant, as in training. <b>gtmax</b>: both images over the maximum of the view's ground truth \
         (HDR-NeRF). <b>selfmax</b>: each image over its own maximum (HDR-GS). SSIM has an 11 x 11 Gaussian window and is the mean of the channels.</dd>\
         <dt>min</dt><dd>Wall-clock minutes of training, loading and evaluation left out, on {training}; {} at a time in the latest call. Runs side by side \
         slow each other down: compare times within one study only.</dd>\
         <dt>MB</dt><dd>10^6 bytes: peak of resident memory of the training process, images included. In the paper it is GPU memory.</dd>\
         <dt>fps</dt><dd>Frames per second of the test views at their size, one run at a time after all training, on {rendering}: the median of repeated passes \
         over all views, radiance in memory.</dd>",
        text::plural(content.matrix.jobs, "run"),
    );
    if let Some(peak) = peak {
        let _ = write!(out, "<dt>PU21</dt><dd>PSNR of the images on a display with {peak} cd/m² where radiance equals the scale.</dd>");
    }
    let has = |key: &str| content.results.iter().any(|result| (super::columns::by_key(key).value)(result).is_some());
    if has("hdr_flip") {
        out += "<dt>HDR-FLIP</dt><dd>Visibility of the difference when flipping between the images, 0 to 1, at the worst exposure.</dd>";
    }
    if has("lpips_alex") || has("lpips_vgg") {
        out += "<dt>LPIPS</dt><dd>On mu-law images by gtmax as [-1, 1], with the given weights.</dd>";
    }
    out + "<dt>train views</dt><dd>The same PSNR on the training views: the difference to the test views is overfitting.</dd></dl>"
}
