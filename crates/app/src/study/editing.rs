//! Luminance editing: luminance raised to a power, by a method that separates it from colour and by
//! one that does not.
//!
//! In: finished cells. Out: errors and pictures. On each data set the first method of either kind
//! is edited, 3DGS and LCD-GS before others, with the first seed: the whole scene under `L' = p (L
//! / p)^e` with e = [`EXPONENT`] and p the median of the last scene's splats. A scene of spherical
//! harmonics is edited twice, by the luminance of its colours and by channels, as RGB values
//! usually are. The ideal is the unedited render with the map on each pixel's luminance; errors are
//! of all test views ([`Fidelity`]), pictures of the one in the middle. Degenerate: data sets
//! without test views are left out.

use std::fmt::Write as _;

use luxel::error::Context;
use luxel::{DeviceOptions, Observer, Result};
use luxel_core::edit::{Fidelity, ShMap, chromaticity_distance};
use luxel_core::tone::Tonemap;
use luxel_core::{ColorSpace, Edit, Image, Map, Scene, Selection, View};

use super::matrix::{Cell, Matrix};
use super::method::StudyMethod;
use super::paper;
use crate::edit::trial::{EditEngines, EditTrial, EditedView};
use crate::report::html::escape;
use crate::report::picture::{self, Display, figure, radiance};
use crate::run::state;
use crate::text;

/// Exponent of the map, the paper's.
pub(super) const EXPONENT: f32 = 1.2;
/// Chromaticity error of the brightest colour in the error pictures.
const FULL_SCALE: f32 = 0.2;
/// Longest side of a picture in the page, pixels.
const MOST_PX: usize = 400;

/// The result of one way to edit one scene.
pub(super) struct Edited {
    /// Index into [`Matrix::sources`].
    pub(super) source: usize,
    /// Index into [`Matrix::methods`].
    pub(super) method: usize,
    /// The quantity that was mapped, where there is a choice.
    pub(super) how: &'static str,
    pub(super) fidelity: Fidelity,
    example: ExampleView,
}

/// A view in normalised units.
struct ExampleView {
    name: String,
    before: Image,
    after: Image,
    ideal: Image,
    color_space: ColorSpace,
}

/// A scene, and the ways in which it is edited.
struct Candidate<'a> {
    cell: &'a Cell,
    scene: Scene,
    ways: &'static [(&'static str, ShMap)],
}

/// Edits scenes and measures them; `finished` are the cells that have one.
pub(super) fn edit(matrix: &Matrix, finished: &[usize], device: &DeviceOptions, observer: &dyn Observer) -> Result<Vec<Edited>> {
    let mut engines = EditEngines::open(device)?;
    let mut edited = Vec::new();
    for (i, source) in matrix.sources.iter().enumerate() {
        // The data set of an earlier call may be gone.
        edited.extend(edit_source(matrix, finished, i, &mut engines, observer).unwrap_or_else(|error| {
            observer.warn(&format!("{}: {:#}", source.name, error.context("luminance editing is left out of the report")));
            Vec::new()
        }));
    }
    Ok(edited)
}

/// Edits and measures the scenes of a data set.
fn edit_source(
    matrix: &Matrix,
    finished: &[usize],
    source: usize,
    engines: &mut EditEngines,
    observer: &dyn Observer,
) -> Result<Vec<Edited>> {
    let candidates = candidates(matrix, finished, source, observer)?;
    let (Some(first), Some(last)) = (candidates.first(), candidates.last()) else { return Ok(Vec::new()) };
    let dataset = luxel_io::load_dataset(&first.cell.config.dataset, &first.cell.config.load).context("cannot read the data set")?;
    let mut edited = Vec::new();
    if dataset.test.is_empty() {
        return Ok(edited);
    }
    let map = Map::Power { exponent: EXPONENT, pivot: Some(last.scene.median_luminance()) };
    let edit = Edit { selection: Selection::All, maps: vec![map] };
    for candidate in &candidates {
        for (how, sh_map) in candidate.ways {
            let (fidelity, example) = compare(engines, candidate, &edit, *sh_map, &dataset.test)?;
            edited.push(Edited { source, method: candidate.cell.method, how, fidelity, example });
        }
    }
    Ok(edited)
}

/// Returns a scene of either kind: harmonics of radiance, then luminance separate from colour; of
/// each kind the paper's method if it is there.
fn candidates<'a>(matrix: &'a Matrix, finished: &[usize], source: usize, observer: &dyn Observer) -> Result<Vec<Candidate<'a>>> {
    let cells = || finished.iter().filter_map(|&i| matrix.cells.get(i)).filter(|cell| cell.source == source);
    let method = |cell: &&Cell| matrix.methods[cell.method];
    let chosen = |separates: bool| {
        let papers = |method: StudyMethod| paper::name_in_results(method).is_some_and(|name| name == "3DGS" || name == "LCD-GS");
        let mut of_kind = cells().filter(|cell| method(cell).color_model().is_some_and(|model| model.separates_luminance() == separates));
        of_kind.clone().find(|cell| papers(method(cell))).or_else(|| of_kind.next())
    };
    let candidate = |separates: bool| {
        let ways: &[_] =
            if separates { &[("", ShMap::Luminance)] } else { &[("by luminance", ShMap::Luminance), ("by channels", ShMap::Channels)] };
        let read = |cell: &'a Cell| Ok(Candidate { cell, scene: state::newest_scene(&cell.folder, observer)?.1, ways });
        chosen(separates).map(read)
    };
    [false, true].into_iter().filter_map(candidate).collect()
}

/// Measures one way to edit one scene, and keeps the images of the view in the middle.
fn compare(
    engines: &mut EditEngines,
    candidate: &Candidate<'_>,
    edit: &Edit,
    sh_map: ShMap,
    views: &[View],
) -> Result<(Fidelity, ExampleView)> {
    let Candidate { cell, scene, .. } = candidate;
    let name = cell.place.display().to_string();
    let mut example = None;
    let trial = EditTrial { name: &name, scene, edits: std::slice::from_ref(edit), sh_map };
    let fidelity = engines.measure(&trial, views, &mut |i, EditedView { mut before, mut after, mut ideal }| {
        if i == views.len() / 2 {
            [&mut before, &mut after, &mut ideal].into_iter().for_each(|image| scene.radiance_scale.normalise(image));
            example = Some(ExampleView { name: views[i].name.clone(), before, after, ideal, color_space: scene.color_space });
        }
        Ok(())
    })?;
    Ok((fidelity, example.context("no view to show")?))
}

impl Edited {
    /// `sh3 by channels`.
    pub(super) fn name(&self, matrix: &Matrix) -> String {
        format!("{} {}", matrix.methods[self.method].name(), self.how).trim_end().to_owned()
    }
}

/// Returns the section of the page; empty without edits.
pub(super) fn section(matrix: &Matrix, edited: &[Edited]) -> Result<String> {
    let mut out = String::new();
    for (i, source) in matrix.sources.iter().enumerate() {
        let of_source: Vec<&Edited> = edited.iter().filter(|edited| edited.source == i).collect();
        if of_source.is_empty() {
            continue;
        }
        let _ = write!(out, "<h3>{}</h3>{}", escape(&source.name), table(matrix, &of_source));
        for edited in of_source {
            out += &pictures(matrix, edited)?;
        }
    }
    if out.is_empty() {
        return Ok(out);
    }
    Ok(format!(
        "<section><h2>Luminance editing</h2><p>Every splat's luminance to the power {EXPONENT}, about the median of the scene's splats. Where luminance is a \
         separate parameter, chromaticity is kept. Spherical harmonics of radiance are mapped by the luminance of the colour in each direction and \
         fitted again, or channel by channel. The ideal is the unedited render with the same map on each pixel's luminance. The chromaticity error of a pixel is the \
         sum of the absolute differences of the channels' shares, 0 to 2; luminance differs where bright and dark splats share a pixel.</p>{out}</section>\n"
    ))
}

fn table(matrix: &Matrix, edited: &[&Edited]) -> String {
    let mut out = String::from(
        "<div class=\"scroll\"><table><thead><tr><th rowspan=\"2\">scene</th><th class=\"group\" colspan=\"3\">chromaticity error</th><th class=\"group\">luminance error</th></tr>\
         <tr><th>mean</th><th>95 %</th><th>by light</th><th>mean, EV</th></tr></thead><tbody>",
    );
    for edited in edited {
        let Fidelity { chromaticity, chromaticity_p95, chromaticity_by_light, luminance_stops, .. } = edited.fidelity;
        let _ = write!(
            out,
            "<tr><td><b>{}</b></td><td>{chromaticity:.5}</td><td>{chromaticity_p95:.5}</td><td>{chromaticity_by_light:.5}</td><td>{luminance_stops:.4}</td></tr>",
            escape(&edited.name(matrix))
        );
    }
    out + "</tbody></table></div>"
}

fn pictures(matrix: &Matrix, edited: &Edited) -> Result<String> {
    let ExampleView { name, before, after, ideal, color_space } = &edited.example;
    let display = Display { tonemap: Tonemap::Mulaw, exposure_ev: 0.0, color_space: *color_space, max_side_px: MOST_PX };
    // Black pixels have no chromaticity.
    let distance =
        |(after, ideal): (&[f32; 3], &[f32; 3])| chromaticity_distance(*after, *ideal).map_or([0.0; 3], |d| [d as f32, 1.0, 0.0]);
    let pixels = after.pixels.iter().zip(&ideal.pixels).map(distance).collect();
    let errors = Image { width: after.width, height: after.height, pixels };
    let mean = text::number(edited.fidelity.chromaticity);
    Ok(format!(
        "<h3>{} <span class=\"soft\">view {}</span></h3><div class=\"row four\">{}{}{}{}</div>\n",
        escape(&edited.name(matrix)),
        escape(name),
        figure(&radiance(before, &display)?, "before", "mu-law"),
        figure(&radiance(after, &display)?, "edited", "mu-law"),
        figure(&radiance(ideal, &display)?, "ideal", "mu-law"),
        figure(
            &picture::values(&errors, FULL_SCALE, MOST_PX)?,
            "chromaticity error",
            &format!("black 0 to yellow {FULL_SCALE}; mean of all views {mean}")
        ),
    ))
}
