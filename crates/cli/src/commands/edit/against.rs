//! `luxel edit A --against B`: how well two scenes keep their colours under the same edit (LCD-GS, comparison of global luminance editing
//! between 3DGS and LCD-GS).
//!
//! Each scene is rendered as it is and edited. Ideal is the render as it is with the maps on each pixel's luminance, chromaticity kept; the
//! figures compare the edited render with that of its own scene. A scene of spherical harmonics is edited twice: by the luminance of its
//! colours in each direction, which is the best it can do, and by channels, as RGB values are usually mapped. Pivots that are not given are the
//! first scene's median for both. Renders are on black. Beside them stand pictures of the chromaticity error, black to yellow for 0 to
//! [`FULL_SCALE`].

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::colormap::magma;
use luxel::preview::{self, Look};
use luxel::run::evaluation::unique_stems;
use luxel::{files, text};
use luxel_core::edit::{Fidelity, FidelityMeter, MaskShares, ShMap, chromaticity_distance, ideally_edited};
use luxel_core::tone::Tonemap;
use luxel_core::{Dataset, Edit, Engine, Image, Map, MapChain, Scene, Selection, View};
use luxel_io::{ExrOptions, ExrSample};

use crate::args::EditArgs;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Chromaticity error of the brightest colour in its pictures.
const FULL_SCALE: f64 = 0.2;

/// One way to edit one scene.
struct Candidate<'s> {
    label: String,
    scene: &'s Scene,
    sh_map: ShMap,
}

/// What all candidates are put through.
struct Trial<'a> {
    edits: &'a [Edit],
    views: &'a [View],
    stems: &'a [String],
    folder: &'a Path,
}

/// One for a scene as it is, one for it edited: views are rendered by both, one view at a time.
struct Engines {
    before: Box<dyn Engine>,
    after: Box<dyn Engine>,
}

/// Compares `args.scene` with the scene at `other`.
pub(super) fn run(args: &EditArgs, other: &Path, request: DataRequest<'_>, console: &Console) -> Result<()> {
    let Some(folder) = &args.output else { bail!("--against: give a folder for the comparison with -o") };
    check_new(folder)?;
    if let Some(edit) = args.edits.0.iter().find(|edit| edit.selection != Selection::All) {
        bail!("--where \"{}\": an ideal edit of pixels knows no splats; compare maps of the whole scene", edit.selection);
    }
    let sources = [SceneSource::open(&args.scene, console)?, SceneSource::open(other, console)?];
    let with_data = sources.iter().find(|source| source.run.is_some()).unwrap_or(&sources[0]);
    let dataset = with_data.dataset(request, console)?.context("scene files have no views; give --data DATASET")?;
    let edits = resolved(&args.edits.0, &sources[0].scene)?;
    let views = views(&dataset)?;
    let stems = unique_stems(views.iter().map(|view| view.name.as_str()));
    let trial = Trial { edits: &edits, views, stems: &stems, folder };
    let mut engines = Engines { before: engine::engine(&args.device)?.engine, after: engine::engine(&args.device)?.engine };
    let mut facts = Tree::default();
    facts.set("edits", edits.iter().map(ToString::to_string).collect::<Vec<_>>()).set("views", views.len());
    facts.set("error_picture_full_scale", FULL_SCALE);
    let mut rows = Vec::new();
    for candidate in candidates(&sources) {
        console.note(&format!("{}: {}", candidate.label, text::plural(views.len(), "view")));
        let figures = trial.measure(&candidate, &mut engines)?;
        facts.group(&candidate.label, facts_of(&figures));
        rows.push((candidate.label, figures));
    }
    files::write_json(&folder.join("comparison.json"), &facts.json())?;
    let text = if args.json { format!("{:#}", facts.json()) } else { table(&rows) };
    console.result(&facts.event("comparison"), &text)
}

/// Results go to a folder of their own: empty, or not there yet.
fn check_new(folder: &Path) -> Result<()> {
    let has_entries = || std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
    if folder.is_file() || has_entries() {
        bail!("{}: exists already; give the name of a new folder", folder.display());
    }
    Ok(())
}

/// The edits with pivots by `scene`, each as it finds it.
fn resolved(edits: &[Edit], scene: &Scene) -> Result<Vec<Edit>> {
    let mut scene = scene.clone();
    let apply = |edit: &Edit| {
        let applied = edit.apply(&mut scene, &MaskShares::new(), ShMap::Luminance);
        Ok(applied.with_context(|| format!("cannot apply \"{edit}\""))?.edit)
    };
    edits.iter().map(apply).collect()
}

/// Test views; of a data set without, those trained on.
fn views(dataset: &Dataset) -> Result<&[View]> {
    match (dataset.test.as_slice(), dataset.train.as_slice()) {
        ([], []) => bail!("the data set has no views"),
        ([], train) => Ok(train),
        (test, _) => Ok(test),
    }
}

fn candidates(sources: &[SceneSource]) -> Vec<Candidate<'_>> {
    let mut candidates = Vec::new();
    for (i, SceneSource { scene, .. }) in sources.iter().enumerate() {
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
    /// Renders all views before and after, writes the pictures, and compares.
    fn measure(&self, candidate: &Candidate<'_>, engines: &mut Engines) -> Result<Fidelity> {
        let mut edited = candidate.scene.clone();
        for edit in self.edits {
            edit.apply(&mut edited, &MaskShares::new(), candidate.sh_map).with_context(|| format!("cannot apply \"{edit}\""))?;
        }
        for (engine, scene) in [(&mut engines.before, candidate.scene), (&mut engines.after, &edited)] {
            engine.load(&scene.splats, None).context("cannot load the scene")?;
        }
        let maps: Vec<Map> = self.edits.iter().flat_map(|edit| edit.maps.clone()).collect();
        let chain = MapChain::new(&maps, 1.0);
        let mut meter = FidelityMeter::default();
        for (view, stem) in self.views.iter().zip(self.stems) {
            let before = render(candidate.scene, view, engines.before.as_mut())?;
            let after = render(&edited, view, engines.after.as_mut())?;
            let ideal = ideally_edited(&before, &chain);
            meter.add(&after, &ideal);
            for (kind, image) in [("before", &before), ("edited", &after), ("ideal", &ideal)] {
                self.write(candidate, kind, stem, image)?;
            }
            self.write_error(candidate, stem, &after, &ideal)?;
        }
        meter.figures().with_context(|| format!("{}: all pixels are black, before or after", candidate.label))
    }

    fn path(&self, candidate: &Candidate<'_>, name: &str) -> PathBuf {
        self.folder.join(&candidate.label).join(name)
    }

    fn write_error(&self, candidate: &Candidate<'_>, stem: &str, edited: &Image, ideal: &Image) -> Result<()> {
        let error = |(edited, ideal): (&[f32; 3], &[f32; 3])| chromaticity_distance(*edited, *ideal).unwrap_or(0.0);
        let color = |pair| magma((error(pair) / FULL_SCALE) as f32);
        let rgb8: Vec<[u8; 3]> = edited.pixels.iter().zip(&ideal.pixels).map(color).collect();
        let path = self.path(candidate, &format!("{stem}_chromaticity_error.png"));
        luxel_io::write_png(&path, edited.width, edited.height, rgb8.as_flattened()).context("cannot write an error map")
    }

    fn write(&self, candidate: &Candidate<'_>, kind: &str, stem: &str, image: &Image) -> Result<()> {
        let path = |extension: &str| self.path(candidate, &format!("{stem}_{kind}.{extension}"));
        let color_space = candidate.scene.color_space;
        let options = ExrOptions { sample: ExrSample::Float, color_space, ..ExrOptions::default() };
        luxel_io::write_exr(&path("exr"), image, &options).context("cannot write an image")?;
        let mut normalized = image.clone();
        candidate.scene.radiance_scale.normalise(&mut normalized);
        Ok(preview::write(&path("png"), &normalized, color_space, Look { tonemap: Tonemap::Mulaw, exposure_ev: 0.0 })?)
    }
}

/// A view of a loaded scene, on black, in the units of the data set.
fn render(scene: &Scene, view: &View, engine: &mut dyn Engine) -> Result<Image> {
    let options = scene.render_options();
    let mut image = engine.render(&view.camera, &options).with_context(|| format!("cannot render view {}", view.name))?;
    scene.radiance_scale.restore(&mut image);
    Ok(image)
}

fn facts_of(figures: &Fidelity) -> Tree {
    let mut facts = Tree::default();
    facts.set("chromaticity_error", figures.chromaticity).set("chromaticity_error_p95", figures.chromaticity_p95);
    facts.set("chromaticity_error_by_light", figures.chromaticity_by_light);
    facts.set("luminance_error_stops", figures.luminance_stops).set("pixels", figures.pixels);
    facts
}

fn table(rows: &[(String, Fidelity)]) -> String {
    let width = rows.iter().map(|(label, _)| label.len()).max().unwrap_or(0).max(5);
    let mut out = format!(
        "chromaticity: sum of the channels' absolute differences to the ideally edited render, 0 to 2\n\
         {:width$}  -------- chromaticity --------  luminance\n{:width$}      mean       p95  by light      stops\n",
        "scene", ""
    );
    for (label, f) in rows {
        out += &format!(
            "{label:width$}  {:8.5}  {:8.5}  {:8.5}  {:9.4}\n",
            f.chromaticity, f.chromaticity_p95, f.chromaticity_by_light, f.luminance_stops
        );
    }
    out.trim_end().to_owned()
}
