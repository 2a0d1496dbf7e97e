//! `luxel probe`: the light that arrives at a point, as an environment map.

use anyhow::Result;
use luxel::probe::{Probe, probe, unseen};
use luxel::run::ExplicitArgs;
use luxel::{output, text};
use luxel_core::{Camera, Dataset, Scene};

use crate::args::ProbeArgs;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Renders and writes the probe; `explicit` names the options that were given.
pub(crate) fn run(args: &ProbeArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    output::check_extension(&args.output, &["exr"])?;
    output::check_free(&args.output, args.overwrite)?;
    let source = SceneSource::open(&args.input.scene, &console)?;
    // For the up direction, and the size of a pixel in training.
    let dataset = source.dataset(DataRequest::new(&args.input, explicit), &console)?;
    if dataset.as_ref().is_none_or(|dataset| dataset.train.is_empty()) {
        console.note("no data set: rendered at the resolution of the map; give --data for that of training, at which light is right");
    }
    if let Some(dataset) = &dataset {
        warn_unseen(args, &source.scene, dataset, &console);
    }
    let options = args.options(source.background(None));
    let mut engine = engine::engine(&args.input.device)?.engine;
    let probe = probe(source.scene, &options, dataset.as_ref(), engine.as_mut(), &console)?;
    if probe.save_exr(&args.output, args.exr_type.sample(probe.image()))? > 0 {
        console.warn("values exceed 65504, the largest half float, and are cut there; leave --exr-type half out");
    }
    if probe.left_out > 0 {
        console.note(&format!("{} nearer than --near left out", text::plural(probe.left_out, "splat")));
    }
    let tree = describe(args, &probe);
    console.finish(tree.json(), tree.text().trim_end())
}

/// Warns of a point that no camera saw: the map would show what is behind what was photographed.
fn warn_unseen(args: &ProbeArgs, scene: &Scene, dataset: &Dataset, console: &Console) {
    // The scene's coordinates, in which its splats are.
    let dataset = dataset.in_frame(scene.world_from_local);
    let cameras: Vec<&Camera> = dataset.train.iter().map(|view| &view.camera).collect();
    if let Some(warning) = unseen(scene, &cameras, args.at) {
        console.warn(&warning);
    }
}

fn describe(args: &ProbeArgs, probe: &Probe) -> Tree {
    let singles = |values: [f64; 3]| values.map(|v| v as f32);
    let mut tree = Tree::default();
    tree.set("file", args.output.display().to_string()).set("size_px", format!("{}x{}", probe.width(), probe.height()));
    tree.set("color_space", probe.color_space().name());
    tree.set_f32s("mean_radiance", &singles(probe.summary.mean_radiance));
    tree.set_f32("peak_radiance", probe.summary.peak_radiance);
    tree.set_f32s("peak_direction", &singles(probe.summary.peak_direction));
    let mut irradiance = Tree::default();
    for (name, value) in ["+x", "-x", "+y", "-y", "+z", "-z"].into_iter().zip(probe.summary.irradiance) {
        irradiance.set_f32s(name, &singles(value));
    }
    tree.group("irradiance", irradiance);
    tree
}
