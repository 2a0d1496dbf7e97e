//! `luxel edit`: a scene with other light, a report of what that would be, or a comparison of two scenes under the same edit.

mod against;
mod overlay;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use luxel::run::ExplicitArgs;
use luxel::{files, text};
use luxel_core::Scene;
use luxel_core::edit::{Applied, MaskName, MaskShares, SelectionSummary};

use crate::args::{EditArgs, LoadArgs};
use crate::commands::info::{PERCENTILES, quantiles};
use crate::editing;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// `explicit` names the options that were given.
pub(crate) fn run(args: &EditArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let request = DataRequest { data: args.data.as_deref(), load: &args.load, explicit };
    let edits = &args.edits.0;
    if edits.is_empty() {
        bail!("nothing to do: give a map such as --stops 1 or --power 0.8 (luxel edit --help lists them)");
    }
    let idle = edits.iter().find(|edit| edit.maps.is_empty());
    if let (Some(edit), false) = (idle, args.dry_run) {
        bail!("--where \"{}\" has no map behind it; add one, or --dry-run to see what it selects", edit.selection);
    }
    check_data(args, explicit)?;
    if let Some(other) = &args.against {
        return against::run(args, other, request, &console);
    }
    let output = output(args)?;
    if let Some(path) = &args.overlay {
        files::check_free(path, args.overwrite)?;
        if output.as_ref().is_some_and(|output| files::is_same(path, output)) {
            bail!("{}: cannot be both the scene (-o) and its picture (--overlay); give the picture another name", path.display());
        }
    }
    let source = SceneSource::open(&args.scene, &console)?;
    let mut scene = source.scene.clone();
    let masks = masks(args, &source, request, &console)?;
    let done = editing::apply(edits, &mut scene, &masks, args.sh_map.into(), &console)?;
    if let Some(path) = output {
        luxel_io::write_scene_ply(&path, &scene).context("cannot write the scene")?;
        console.note(&format!("{}: {}", path.display(), text::plural(scene.splats.len(), "splat")));
    }
    // Last: a reader that leaves early costs no scene.
    if args.json || args.dry_run {
        let report = report(&source.scene, &done);
        let text = if args.json { format!("{:#}", report.json()) } else { report.text().trim_end().to_owned() };
        console.result(&report.event("report"), &text)?;
    }
    Ok(())
}

/// Refuses a data set, and options of reading one, where nothing looks at it.
fn check_data(args: &EditArgs, explicit: &ExplicitArgs) -> Result<()> {
    let has_masks = args.edits.0.iter().any(|edit| !edit.selection.masks().is_empty());
    if has_masks || args.overlay.is_some() || args.against.is_some() {
        return Ok(());
    }
    let why = "and without a mask, --overlay or --against none is; leave it out";
    if args.data.is_some() {
        bail!("--data is the data set that views are taken from, {why}");
    }
    LoadArgs::refuse(explicit, &[], why)
}

/// Where the scene goes; `None` for a dry run.
fn output(args: &EditArgs) -> Result<Option<PathBuf>> {
    let Some(path) = args.output.as_ref().filter(|_| !args.dry_run) else { return Ok(None) };
    if path.is_dir() {
        bail!("{}: is a folder, expected the scene file to write, such as {}", path.display(), path.join("edited.ply").display());
    }
    files::check_free(path, args.overwrite)?;
    Ok(Some(path.clone()))
}

/// Projects the masks and draws the overlay: all that needs a data set.
fn masks(args: &EditArgs, source: &SceneSource, request: DataRequest<'_>, console: &Console) -> Result<MaskShares> {
    let edits = &args.edits.0;
    let names: Vec<&MaskName> = edits.iter().flat_map(|edit| edit.selection.masks()).collect();
    let mut engine = engine::engine(&args.device)?.engine;
    let Some(picture) = &args.overlay else {
        return editing::mask_shares(edits, source, request, engine.as_mut(), console);
    };
    let Some(dataset) = source.dataset(request, console)? else {
        bail!("{}: a scene file has no views to lay a picture over; give --data DATASET", args.scene.display());
    };
    let masks = editing::project_masks(&names, &source.scene, &dataset, engine.as_mut())?;
    let view = match args.view.as_deref().or(names.first().map(|name| name.view.as_str())) {
        Some(name) => editing::view(&dataset, name)?,
        None => dataset.test.first().or(dataset.train.first()).context("the data set has no views")?,
    };
    let weights = overlay::weights(edits, &source.scene, &masks, args.sh_map.into())?;
    let background = source.background(None);
    overlay::draw(picture, &source.scene, &weights, (engine.as_mut(), &view.camera, background))?;
    console.note(&format!("{}: the selection over view {}", picture.display(), view.name));
    Ok(masks)
}

/// What each edit selects and does, in the units of the data set.
fn report(scene: &Scene, done: &[(Applied, SelectionSummary)]) -> Tree {
    let mut facts = Tree::default();
    facts.set("splats", scene.splats.len()).set("color_model", scene.splats.color_model.name());
    let mut percentiles = Tree::default();
    percentiles.set("at_percent", PERCENTILES.to_vec());
    percentiles.set_f32s("luminance", &quantiles((0..scene.splats.len()).map(|i| scene.luminance(i)).collect()));
    facts.group("percentiles", percentiles);
    for (i, (applied, summary)) in done.iter().enumerate() {
        let mut group = Tree::default();
        group.set("edit", applied.edit.to_string());
        group.set("selected", summary.count).set("partly_selected", summary.partial);
        group.set("share_of_light", summary.light_share);
        if let Some([min, max]) = summary.bounds {
            group.set_f32s("min", &min).set_f32s("max", &max);
        }
        if let Some(shift) = applied.hue_shift {
            group.set("hue_shift", shift);
        }
        facts.group(&format!("edit_{}", i + 1), group);
    }
    facts
}
