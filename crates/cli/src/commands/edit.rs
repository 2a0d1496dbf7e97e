//! `luxel edit`: a scene with other light or without some splats, a report of what would change, or
//! a comparison of two scenes under the same edit.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::edit::{self, AppliedEdit, Overlay, RemovalReason, Removed, find_view, mask_names};
use luxel_app::edit::{Against, EditFidelity, FULL_SCALE_ERROR, compare_edits};
use luxel_app::run::ExplicitArgs;
use luxel_app::{files, output, schema, text};
use luxel_core::edit::{EditStack, Fidelity, MaskShares};
use luxel_core::{Dataset, Edit, Engine, Scene, Selection, View};
use serde_json::json;

use crate::args::{EditArgs, LoadArgs};
use crate::commands::info::{PERCENTILES, quantiles, scene_luminance};
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::inputs::{engine, masks};
use crate::output::console::Console;
use crate::output::tree::{Tree, set_point};

/// Reasons of removal, as reports name them.
const REASONS: [(&str, RemovalReason); 4] = [
    ("selected", RemovalReason::Selected),
    ("unseen", RemovalReason::Unseen),
    ("isolated", RemovalReason::Isolated),
    ("haze", RemovalReason::Haze),
];

/// Runs the command; `explicit` names the options that were given.
pub(crate) fn run(args: &EditArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    let request = DataRequest::new(&args.input, explicit);
    let stack = stack(args)?;
    let edits = &stack.edits;
    let removes = stack.delete.is_some() || stack.floaters;
    if stack.is_empty() && args.max_aspect.is_none() {
        bail!(
            "nothing to do: give a map such as --stops 1 or --power 0.8, --edits, --delete, --floaters, --max-aspect, --up or --origin \
             (luxel edit --help lists them)"
        );
    }
    let idle = edits.iter().find(|edit| edit.maps.is_empty());
    if let (Some(edit), false) = (idle, args.dry_run) {
        bail!("--where \"{}\" has no map behind it; add one, or --dry-run to see what it selects", edit.selection);
    }
    check_data(args, &stack, explicit)?;
    if let Some(other) = &args.against {
        return compare(args, edits, other, request, &console);
    }
    let target = target(args)?;
    if let Some(path) = &args.overlay {
        output::check_free(path, args.overwrite)?;
        if target.as_ref().is_some_and(|scene| output::is_same(path, scene)) {
            bail!("{}: cannot be both the scene (-o) and the overlay (--overlay); give the overlay another name", path.display());
        }
        output::check_extension(path, &["png"])?;
    }
    let source = SceneSource::open(&args.input.scene, &console)?;
    let mut scene = source.scene.clone();
    let mut engine = engine::engine(&args.input.device)?.engine;
    // Masks and floaters are of the scene as it is.
    let masks = masks::mask_shares(&stack.selecting(), &source, request, engine.as_mut(), &console)?;
    let removed = masks::removed(&stack, &source, &masks, request, engine.as_mut(), &console)?;
    if let Some(picture) = &args.overlay {
        let selected = Selected { stack: &stack, masks: &masks, removed: &removed };
        overlay(args, picture, &source, &selected, request, engine.as_mut(), &console)?;
    }
    let done = edit::apply(edits, &mut scene, &masks, args.sh_map.into(), &console)?;
    if removes {
        console.note(&format!("{}: {}", if args.dry_run { "would be removed" } else { "removed" }, removed.in_words()));
        if removed.count() > 0 {
            removed.apply(&mut scene, stack.removal_record())?;
        }
    }
    if let Some(most) = args.max_aspect {
        let count = scene.splats.limit_aspect(most);
        console.note(&format!("{} longer than {most} times their width, shortened to that", text::plural(count, "splat")));
        scene.edits.push(format!("max-aspect {most}"));
    }
    edit::align(&stack, &mut scene)?;
    let mut facts = json!({});
    if let Some(path) = target {
        luxel_io::write_scene_ply(&path, &scene).context("cannot write the scene")?;
        facts["scene"] = path.display().to_string().into();
        console.note(&format!("{}: {}", path.display(), text::plural(scene.splats.len(), "splat")));
    }
    // Last: a reader that leaves early costs no scene.
    if args.json || args.dry_run {
        let report = report(&source.scene, &done, removes.then_some(&removed));
        let text = if args.json { report.document(schema::EDIT) } else { report.text().trim_end().to_owned() };
        console.result(&report.event("report"), &text)?;
    }
    console.finish_silently(facts);
    Ok(())
}

/// Refuses a data set, and options of reading one, that nothing would use.
fn check_data(args: &EditArgs, stack: &EditStack, explicit: &ExplicitArgs) -> Result<()> {
    let selecting = stack.selecting();
    let has_masks = mask_names(&selecting).into_iter().any(edit::needs_dataset);
    if has_masks || args.overlay.is_some() || args.against.is_some() || stack.floaters {
        return Ok(());
    }
    let why = "and without a mask, --overlay, --floaters or --against none is; leave it out";
    if args.input.data.is_some() {
        bail!("--data is the data set that views are taken from, {why}");
    }
    LoadArgs::refuse(explicit, &[], why)
}

/// Returns what is done: the options, or the file in their place.
fn stack(args: &EditArgs) -> Result<EditStack> {
    if let Some(path) = &args.edit_file {
        return Ok(edit::read_stack(path)?);
    }
    let EditArgs { edits, delete, floaters, up, origin, .. } = args;
    Ok(EditStack { edits: edits.0.clone(), delete: delete.clone(), floaters: *floaters, up: *up, origin: *origin })
}

/// Returns the place of the edited scene; `None` for a dry run.
fn target(args: &EditArgs) -> Result<Option<PathBuf>> {
    let Some(path) = args.output.as_ref().filter(|_| !args.dry_run) else { return Ok(None) };
    if path.is_dir() {
        bail!("{}: is a folder, expected the scene file to write, such as {}", path.display(), path.join("edited.ply").display());
    }
    if let Err(error) = output::check_extension(path, &["ply"]) {
        bail!("{error}: luxel edit writes the exact scene; for another program write a .ply and give it to luxel export");
    }
    output::check_free(path, args.overwrite)?;
    Ok(Some(path.clone()))
}

/// The selections that an overlay shows beside the edits' own.
struct Selected<'a> {
    stack: &'a EditStack,
    masks: &'a MaskShares,
    removed: &'a Removed,
}

/// Draws the selected and removed splats over a view.
fn overlay(
    args: &EditArgs,
    picture: &Path,
    source: &SceneSource,
    selected: &Selected<'_>,
    request: DataRequest<'_>,
    engine: &mut dyn Engine,
    console: &Console,
) -> Result<()> {
    let Some(dataset) = source.dataset(request, console)? else {
        bail!("{}: a scene file has no views to draw an overlay on; give --data DATASET", args.input.scene.display());
    };
    let edits = selected.stack.selecting();
    let painted = mask_names(&edits).into_iter().find(|name| edit::needs_dataset(name));
    let view = match args.view.as_deref().or(painted.map(|name| name.view.as_str())) {
        Some(name) => find_view(&dataset, name)?,
        None => dataset.test.first().or(dataset.train.first()).context("the data set has no views")?,
    };
    let mut weights = edit::selection_weights(&selected.stack.edits, &source.scene, selected.masks, args.sh_map.into())?;
    let removed = weights.iter_mut().enumerate().filter(|(i, _)| selected.removed.is_removed(*i));
    removed.for_each(|(_, weight)| *weight = 1.0);
    let overlay = Overlay { scene: &source.scene, weights: &weights, camera: &view.camera, background: source.background(None) };
    edit::draw_overlay(picture, overlay, engine)?;
    console.note(&format!("{}: the selection over view {}", picture.display(), view.name));
    Ok(())
}

/// Returns the facts about each edit, in the units of the data set.
fn report(scene: &Scene, done: &[AppliedEdit], removed: Option<&Removed>) -> Tree {
    let mut facts = Tree::default();
    facts.set("splats", scene.splats.len()).set("color_model", scene.splats.color_model.name());
    let mut percentiles = Tree::default();
    percentiles.set("at_percent", PERCENTILES.to_vec());
    percentiles.set_f32s("luminance_sum", &quantiles((0..scene.splats.len()).map(|i| scene.luminance(i)).collect()));
    percentiles.set_f32s("luminance", &quantiles(scene_luminance(scene)));
    facts.group("percentiles", percentiles);
    for (i, AppliedEdit { applied, selection }) in done.iter().enumerate() {
        let mut group = Tree::default();
        group.set("edit", applied.edit.to_string());
        group.set("selected", selection.count).set("partly_selected", selection.partial);
        group.set("share_of_light", selection.light_share);
        if let Some([min, max]) = selection.bounds {
            for (name, corner) in [("min", min), ("max", max)] {
                set_point(&mut group, name, corner, scene);
            }
        }
        if let Some(shift) = applied.hue_shift {
            group.set("hue_shift", shift);
        }
        facts.group(&format!("edit_{}", i + 1), group);
    }
    if let Some(removed) = removed {
        let mut group = Tree::default();
        group.set("splats", removed.count()).set("share_of_light", removed.share_of_light(scene));
        for (name, reason) in REASONS {
            group.set(name, removed.count_of(reason));
        }
        facts.group("removed", group);
    }
    facts
}

/// Compares the scene with the one at `other` under the same edits.
fn compare(args: &EditArgs, edits: &[Edit], other: &Path, request: DataRequest<'_>, console: &Console) -> Result<()> {
    let Some(folder) = &args.output else { bail!("--against: give a folder for the comparison with -o") };
    output::check_new_folder(folder)?;
    if let Some(edit) = edits.iter().find(|edit| edit.selection != Selection::All) {
        bail!("--where \"{}\": an ideal edit of pixels knows no splats; compare maps of the whole scene", edit.selection);
    }
    let mut sources = [SceneSource::open(&args.input.scene, console)?, SceneSource::open(other, console)?];
    // Views are of one frame.
    let frame = sources[0].scene.world_from_local;
    sources[1].scene.move_to(frame);
    let with_data = sources.iter().find(|source| source.run.is_some()).unwrap_or(&sources[0]);
    let dataset = with_data.dataset(request, console)?.context("scene files have no views; give --data DATASET")?;
    let views = test_views(&dataset)?;
    let input = Against { scenes: [&sources[0].scene, &sources[1].scene], edits, views, folder };
    let found = compare_edits(input, &args.input.device.options(), console)?;
    let mut facts = Tree::default();
    facts.set("edits", found.edits.iter().map(ToString::to_string).collect::<Vec<_>>()).set("views", views.len());
    facts.set("error_picture_full_scale", FULL_SCALE_ERROR);
    for row in &found.rows {
        facts.group(&row.label, fidelity_facts(&row.fidelity));
    }
    files::write_json(&folder.join("comparison.json"), schema::EDIT_COMPARISON, &facts.json())?;
    let text = if args.json { facts.document(schema::EDIT_COMPARISON) } else { fidelity_table(&found.rows) };
    console.result(&facts.event("comparison"), &text)?;
    console.finish_silently(json!({ "output": folder.display().to_string() }));
    Ok(())
}

/// Returns the test views; without any, the training views.
fn test_views(dataset: &Dataset) -> Result<&[View]> {
    match (dataset.test.as_slice(), dataset.train.as_slice()) {
        ([], []) => bail!("the data set has no views"),
        ([], train) => Ok(train),
        (test, _) => Ok(test),
    }
}

fn fidelity_facts(fidelity: &Fidelity) -> Tree {
    let mut facts = Tree::default();
    facts.set("chromaticity_error", fidelity.chromaticity).set("chromaticity_error_p95", fidelity.chromaticity_p95);
    facts.set("chromaticity_error_by_light", fidelity.chromaticity_by_light);
    facts.set("luminance_error_stops", fidelity.luminance_stops).set("pixels", fidelity.pixels);
    facts
}

fn fidelity_table(rows: &[EditFidelity]) -> String {
    let width = rows.iter().map(|row| row.label.len()).max().unwrap_or(0).max(5);
    let mut out = format!(
        "chromaticity: sum of the channels' absolute differences to the ideally edited render, 0 to 2\n\
         {:width$}  -------- chromaticity --------  luminance\n{:width$}      mean       p95  by light      stops\n",
        "scene", ""
    );
    for EditFidelity { label, fidelity: f } in rows {
        out += &format!(
            "{label:width$}  {:8.5}  {:8.5}  {:8.5}  {:9.4}\n",
            f.chromaticity, f.chromaticity_p95, f.chromaticity_by_light, f.luminance_stops
        );
    }
    out.trim_end().to_owned()
}
