//! `luxel probe`: the light that arrives at a point, as an environment map.

use anyhow::Result;
use luxel::preview::Look;
use luxel::probe::{Probe, light_json, probe, unseen};
use luxel::{Device, output};
use luxel_app::run::ExplicitArgs;
use luxel_app::text;
use luxel_core::environment::Light;
use luxel_core::{Camera, Dataset, Scene};

use crate::args::ProbeArgs;
use crate::args::look::note_of_pictures;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Renders and writes the probe; `explicit` names the options that were given.
pub(crate) fn run(args: &ProbeArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    output::check_extension(&args.output, &["exr"])?;
    output::check_free(&args.output, args.overwrite)?;
    let preview = args.ocio_look.curve(args.tonemap)?.map(|curve| (args.output.with_extension("png"), curve));
    if let Some((path, _)) = &preview {
        output::check_free(path, args.overwrite)?;
    }
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
    let mut device = args.input.device.clone();
    // Only the CPU engine renders coverage.
    if args.alpha && device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    let mut engine = engine::engine(&device)?.engine;
    let probe = probe(source.scene, &options, dataset.as_ref(), engine.as_mut(), &console)?;
    if probe.save_exr(&args.output, args.exr_type.sample(probe.image()))? > 0 {
        console.warn("values exceed 65504, the largest half float, and are cut there; leave --exr-type half out");
    }
    if let Some((path, curve)) = preview {
        note_of_pictures(&curve).into_iter().for_each(|note| console.note(&note));
        probe.save_preview(&path, &Look { curve, exposure_ev: args.exposure })?;
    }
    if probe.left_out > 0 {
        console.note(&format!("{} nearer than --near left out", text::plural(probe.left_out, "splat")));
    }
    let tree = describe(args, &probe);
    let mut json = tree.json();
    json["lights"] = probe.lights.iter().map(light_json).collect();
    console.finish(json, &format!("{}{}", tree.text().trim_end(), lights_text(&probe.lights)))
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

/// Lamps that the text lists.
const MOST_LINES: usize = 8;

/// Returns the lights as lines of a table.
fn lights_text(lights: &[Light]) -> String {
    if lights.is_empty() {
        return String::new();
    }
    let mut table = String::from("\nlights           direction       solid angle, sr        peak  irradiance");
    for (i, light) in lights.iter().take(MOST_LINES).enumerate() {
        let [x, y, z] = light.direction;
        // A scene's unit may make all of them small or large.
        let [r, g, b] = light.irradiance.map(text::number);
        let (peak, angle) = (text::number(light.peak_radiance.into()), light.solid_angle);
        table += &format!("\n  {:<3} {x:7.3} {y:7.3} {z:7.3}  {angle:16.3e}  {peak:>10}  {r} {g} {b}", i + 1);
    }
    if lights.len() > MOST_LINES {
        table += &format!("\n  and {} more; --log-format json has all", lights.len() - MOST_LINES);
    }
    table
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_of_a_dim_scene_have_digits() {
        let light = |radiance: f64| Light {
            direction: [0.6, 0.8, 0.0],
            solid_angle: 2e-3,
            radiance: [radiance; 3],
            peak_radiance: radiance as f32,
            irradiance: [2e-3 * radiance; 3],
        };
        let table = lights_text(&[light(0.02), light(3e6)]);
        let lines: Vec<Vec<&str>> = table.lines().skip(2).map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(lines[0], ["1", "0.600", "0.800", "0.000", "2.000e-3", "0.02000", "4.000e-5", "4.000e-5", "4.000e-5"]);
        assert_eq!(lines[1][5..], ["3.000e6", "6000.0", "6000.0", "6000.0"]);
    }
}
