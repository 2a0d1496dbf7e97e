//! How well two scenes keep their colours under the same edit (LCD-GS, comparison of global
//! luminance editing between 3DGS and LCD-GS).
//!
//! In: [`Against`]: two scenes, maps of the whole scene, views. Out: [`EditFidelity`] per way of
//! editing, and a folder of images for each.
//!
//! Each scene is rendered unedited and edited, on black. The ideal is the unedited render with the
//! maps applied to each pixel's luminance, chromaticity kept; the edited render is compared with
//! that of its own scene. A scene of spherical harmonics is edited twice: by the luminance of its
//! colours in each direction, which is the best it can do, and by channels, as RGB values are
//! usually mapped. Pivots that are not given are the first scene's median for both. Pictures of the
//! chromaticity error go from black for 0 to yellow for [`FULL_SCALE_ERROR`].

use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::preview::{self, Look};
use luxel::{DeviceOptions, Observer, RADIANCE_SCALE, Result};
use luxel_core::edit::{Fidelity, Map, MaskShares, ShMap, chromaticity_distance};
use luxel_core::tone::Tonemap;
use luxel_core::{Edit, Image, Selection, View};
use luxel_io::{ExrOptions, ExrSample};
use luxel_metrics::colormap::magma;

use super::trial::{EditEngines, EditTrial, EditedView};
use crate::run::evaluation::unique_stems;
use crate::text;

/// Chromaticity error of the brightest colour in the error pictures.
pub const FULL_SCALE_ERROR: f64 = 0.2;

/// Two scenes to compare under the same edits.
#[derive(Clone, Copy, Debug)]
pub struct Against<'a> {
    /// The scenes; pivots are those of the first.
    pub scenes: [&'a luxel_core::Scene; 2],
    /// Edits of the whole scene.
    pub edits: &'a [Edit],
    /// Views to render.
    pub views: &'a [View],
    /// Folder for images.
    pub folder: &'a Path,
}

/// The fidelity of one way to edit one scene.
#[derive(Clone, Debug)]
pub struct EditFidelity {
    /// Name: `1-lcd`, `2-sh3-luminance`, `2-sh3-channels`.
    pub label: String,
    /// Errors against the ideal.
    pub fidelity: Fidelity,
}

/// The edits with their pivots, and their fidelity.
#[derive(Clone, Debug)]
pub struct EditComparison {
    /// Edits as they were resolved.
    pub edits: Vec<Edit>,
    /// Fidelity of each way to edit each scene.
    pub rows: Vec<EditFidelity>,
}

/// One way to edit one scene.
struct Candidate<'s> {
    label: String,
    scene: &'s luxel_core::Scene,
    sh_map: ShMap,
}

/// The edits and views that all candidates share.
struct Trial<'a> {
    edits: &'a [Edit],
    views: &'a [View],
    stems: &'a [String],
    folder: &'a Path,
}

/// Compares two scenes under the same edits, and writes images of each.
///
/// # Errors
/// An edit of a part of the scene, a device that gave up, the file system's refusal.
pub fn compare_edits(input: Against<'_>, device: &DeviceOptions, observer: &dyn Observer) -> Result<EditComparison> {
    if let Some(edit) = input.edits.iter().find(|edit| edit.selection != Selection::All) {
        bail!("\"where {}\": an ideal edit of pixels knows no splats, expected maps of the whole scene", edit.selection);
    }
    if let Some(edit) = input.edits.iter().find(|edit| edit.maps.iter().any(|map| matches!(map, Map::Light { .. }))) {
        bail!("\"{edit}\" changes one light, which is no map on the luminance of pixels, so there is no ideal to compare with");
    }
    let edits = resolved(input.edits, input.scenes[0])?;
    let stems = unique_stems(input.views.iter().map(|view| view.name.as_str()));
    let trial = Trial { edits: &edits, views: input.views, stems: &stems, folder: input.folder };
    let mut engines = EditEngines::open(device)?;
    let mut rows = Vec::new();
    for candidate in candidates(input.scenes) {
        observer.note(&format!("{}: {}", candidate.label, text::plural(input.views.len(), "view")));
        let fidelity = trial.measure(&candidate, &mut engines)?;
        rows.push(EditFidelity { label: candidate.label, fidelity });
    }
    Ok(EditComparison { edits, rows })
}

/// Returns the edits with their pivots, each as it finds the scene.
fn resolved(edits: &[Edit], scene: &luxel_core::Scene) -> Result<Vec<Edit>> {
    let mut scene = scene.clone();
    let apply = |edit: &Edit| {
        let applied = edit.apply(&mut scene, &MaskShares::new(), ShMap::Luminance);
        Ok(applied.with_context(|| format!("cannot apply \"{edit}\""))?.edit)
    };
    edits.iter().map(apply).collect()
}

/// Returns the ways to edit the scenes.
fn candidates<'s>(scenes: [&'s luxel_core::Scene; 2]) -> Vec<Candidate<'s>> {
    let mut candidates = Vec::new();
    for (i, scene) in scenes.into_iter().enumerate() {
        let model = scene.splats.color_model;
        let name = format!("{}-{}", i + 1, model.name());
        if model.separates_luminance() {
            candidates.push(Candidate { label: name, scene, sh_map: ShMap::Luminance });
        } else {
            candidates.push(Candidate { label: format!("{name}-luminance"), scene, sh_map: ShMap::Luminance });
            candidates.push(Candidate { label: format!("{name}-channels"), scene, sh_map: ShMap::Channels });
        }
    }
    candidates
}

impl Trial<'_> {
    /// Measures one way to edit one scene, and writes the images.
    fn measure(&self, candidate: &Candidate<'_>, engines: &mut EditEngines) -> Result<Fidelity> {
        let trial = EditTrial { name: &candidate.label, scene: candidate.scene, edits: self.edits, sh_map: candidate.sh_map };
        engines.measure(&trial, self.views, &mut |i, EditedView { before, after, ideal }| {
            let Some(stem) = self.stems.get(i) else { return Ok(()) };
            for (kind, image) in [("before", &before), ("edited", &after), ("ideal", &ideal)] {
                self.write(candidate, kind, stem, image)?;
            }
            self.write_error(candidate, stem, &after, &ideal)
        })
    }

    fn path(&self, candidate: &Candidate<'_>, name: &str) -> PathBuf {
        self.folder.join(&candidate.label).join(name)
    }

    fn write_error(&self, candidate: &Candidate<'_>, stem: &str, edited: &Image, ideal: &Image) -> Result<()> {
        let error = |(edited, ideal): (&[f32; 3], &[f32; 3])| chromaticity_distance(*edited, *ideal).unwrap_or(0.0);
        let color = |pair| magma((error(pair) / FULL_SCALE_ERROR) as f32);
        let rgb8: Vec<[u8; 3]> = edited.pixels.iter().zip(&ideal.pixels).map(color).collect();
        let path = self.path(candidate, &format!("{stem}_chromaticity_error.png"));
        luxel_io::write_png(&path, edited.width, edited.height, rgb8.as_flattened()).context("cannot write an error map")
    }

    fn write(&self, candidate: &Candidate<'_>, kind: &str, stem: &str, image: &Image) -> Result<()> {
        let path = |extension: &str| self.path(candidate, &format!("{stem}_{kind}.{extension}"));
        let color_space = candidate.scene.color_space;
        let numbers = vec![(RADIANCE_SCALE.to_owned(), candidate.scene.radiance_scale.get())];
        let options = ExrOptions { sample: ExrSample::Float, color_space, numbers, ..ExrOptions::default() };
        luxel_io::write_exr(&path("exr"), image, &options).context("cannot write an image")?;
        let mut normalized = image.clone();
        candidate.scene.radiance_scale.normalise(&mut normalized);
        preview::write(&path("png"), &normalized, color_space, &Look { curve: Tonemap::Mulaw.into(), exposure_ev: 0.0 })
    }
}
