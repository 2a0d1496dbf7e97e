//! `luxel probe`: the light that arrives at a point, as an environment map.

use anyhow::{Context, Result};
use glam::DVec3;
use luxel::export::{UpAxis, file_from_world};
use luxel::run::ExplicitArgs;
use luxel::{files, text};
use luxel_core::environment::{MapSize, Projection, Rig, Summary};
use luxel_core::{Conversion, Dataset, Engine, Image, RenderOptions, Scene};
use luxel_io::ExrOptions;

use crate::args::ProbeArgs;
use crate::args::values::UpArg;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// `explicit` names the options that were given.
pub(crate) fn run(args: &ProbeArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    files::check_free(&args.output, args.overwrite)?;
    let source = SceneSource::open(&args.scene, &console)?;
    // What is up, and how large a pixel was in training.
    let dataset = source.dataset(DataRequest { data: args.data.as_deref(), load: &args.load, explicit }, &console)?;
    let environment_from_world = file_from_world(UpArg::up(args.up), UpAxis::PlusY, dataset.as_ref(), 1.0)?.rotation();
    let focal_px = dataset.as_ref().and_then(median_focal_px);
    if focal_px.is_none() {
        console.note("no data set: rendered at the resolution of the map; give --data for that of training, at which light is right");
    }
    drop(dataset);
    let background = source.background(None);
    let mut scene = source.scene;
    let left_out = leave_out_near(&mut scene, args);
    let (projection, width) = (Projection::from(args.projection), args.size as usize);
    let rig = Rig::new(DVec3::from_array(args.at), environment_from_world, MapSize { projection, width }, focal_px);
    let mut engine = engine::engine(&args.device)?.engine;
    let renders = renders(&rig, &scene, background, engine.as_mut())?;
    let mut image = rig.assemble(&renders);
    let color_space = args.colorspace.map_or(scene.color_space, Into::into);
    let conversion = Conversion::between(scene.color_space, color_space);
    for pixel in &mut image.pixels {
        *pixel = conversion.apply(pixel.map(|c| c * scene.radiance_scale));
    }
    let summary = Summary::of(&image, projection);
    let [x, y, z] = args.at;
    let options = ExrOptions {
        sample: args.exr_type.into(),
        color_space,
        environment: Some(projection),
        attributes: vec![("luxel:at".into(), format!("{x}, {y}, {z}"))],
        ..ExrOptions::default()
    };
    let too_bright = luxel_io::write_exr(&args.output, &image, &options).context("cannot write the probe")?;
    if too_bright > 0 {
        console.warn("values exceed 65504, the largest half float, and are cut there; write again with --exr-type float");
    }
    if left_out > 0 {
        console.note(&format!("{} nearer than --near left out", text::plural(left_out, "splat")));
    }
    let facts = facts(args, &image, color_space.name(), &summary);
    console.result(&facts.event("finished"), facts.text().trim_end())
}

/// Of the training views, pixels.
fn median_focal_px(dataset: &Dataset) -> Option<f64> {
    let mut focal: Vec<f64> = dataset.train.iter().map(|view| view.camera.focal_px.x).collect();
    focal.sort_unstable_by(f64::total_cmp);
    focal.get(focal.len() / 2).copied()
}

/// Removes splats whose centre is near, and counts them.
fn leave_out_near(scene: &mut Scene, args: &ProbeArgs) -> usize {
    let Some(radius) = args.near else { return 0 };
    let at = DVec3::from_array(args.at);
    let is_far = |p: [f32; 3]| DVec3::from_array(p.map(f64::from)).distance(at) >= f64::from(radius);
    let before = scene.splats.len();
    let kept: Vec<u32> = (0..before as u32).filter(|i| is_far(scene.splats.position[*i as usize])).collect();
    scene.splats = scene.splats.select(kept);
    before - scene.splats.len()
}

fn renders(rig: &Rig, scene: &Scene, background: [f32; 3], engine: &mut dyn Engine) -> Result<Vec<Image>> {
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = RenderOptions { raster: scene.raster, background, ..RenderOptions::default() };
    rig.cameras.iter().map(|camera| engine.render(camera, &options).context("cannot render the probe")).collect()
}

fn facts(args: &ProbeArgs, image: &Image, color_space: &str, summary: &Summary) -> Tree {
    let singles = |values: [f64; 3]| values.map(|v| v as f32);
    let mut facts = Tree::default();
    facts.set("file", args.output.display().to_string()).set("size_px", format!("{}x{}", image.width, image.height));
    facts.set("color_space", color_space);
    facts.set_f32s("mean_radiance", &singles(summary.mean_radiance));
    facts.set_f32("peak_radiance", summary.peak_radiance);
    facts.set_f32s("peak_direction", &singles(summary.peak_direction));
    let mut irradiance = Tree::default();
    for (name, value) in ["+x", "-x", "+y", "-y", "+z", "-z"].into_iter().zip(summary.irradiance) {
        irradiance.set_f32s(name, &singles(value));
    }
    facts.group("irradiance", irradiance);
    facts
}
