//! `luxel lights`: the lamps of a scene, and the rest of its light.

use std::path::Path;

use anyhow::Result;
use luxel::lights::{AreaLight, EXTENSIONS, LightOptions, SceneLights, lights_json, map_path, no_cameras, scene_lights};
use luxel::{Device, output};
use luxel_app::run::ExplicitArgs;
use luxel_app::text;
use luxel_io::LightShape;

use crate::args::LightsArgs;
use crate::args::values::UpArg;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Finds and writes the lamps; `explicit` names the options that were given.
pub(crate) fn run(args: &LightsArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    output::check_extension(&args.output, &EXTENSIONS)?;
    output::check_free(&args.output, args.overwrite)?;
    let map = (!args.no_dome).then(|| map_path(&args.output));
    if let Some(map) = &map {
        output::check_free(map, args.overwrite)?;
    }
    let source = SceneSource::open(&args.input.scene, &console)?;
    let Some(dataset) = source.dataset(DataRequest::new(&args.input, explicit), &console)? else {
        return Err(no_cameras().into());
    };
    let mut device = args.input.device.clone();
    // Only the CPU engine renders coverage, which says which directions no view saw.
    if !args.no_dome && !args.no_fill && device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    let mut engine = engine::engine(&device)?.engine;
    let options = LightOptions { cd_m2_per_unit: source.cd_m2_per_unit(DataRequest::new(&args.input, explicit)), ..args.options() };
    let lights = scene_lights(source.scene, &dataset, &options, engine.as_mut(), &console)?;
    lights.save(&args.output, UpArg::up(args.up), &dataset)?;
    if lights.lights.is_empty() {
        console.warn("no lamps found: all light is in the map; a lower --medians finds fainter ones");
    }
    if args.portals && lights.portals.is_empty() {
        console.warn("no windows found, so there are no portals: a lower --windows finds fainter ones");
    }
    if !lights.portals.is_empty() && output::check_extension(&args.output, &["glb"]).is_ok() {
        console.warn("glTF has no portals: they are left out; write .usda, .json or .csv");
    }
    say_left_in_map(&lights.left_in_map, &console);
    if !args.no_fill && map.is_some() {
        warn_of_unseen(lights.unseen_share, "; --no-fill leaves them black", &console);
    }
    let tree = describe(args, &lights, map.as_deref());
    let mut json = tree.json();
    json["lights"] = lights_json(&lights);
    console.finish(json, &format!("{}{}", tree.text().trim_end(), lamps_text(&lights.lights)))
}

/// Says which bright things stay in the map.
pub(super) fn say_left_in_map(groups: &[String], console: &Console) {
    for group in groups {
        console.note(&format!("left in the map: {group}"));
    }
}

/// Says how much of the map no view saw; `remedy` goes behind it.
pub(super) fn warn_of_unseen(share: f64, remedy: &str, console: &Console) {
    if share > 0.01 {
        let percent = 100.0 * share;
        console.warn(&format!("no view saw {percent:.0} % of the map's directions: they have the median radiance of the views{remedy}"));
    }
}

fn describe(args: &LightsArgs, lights: &SceneLights, map: Option<&Path>) -> Tree {
    let mut tree = Tree::default();
    tree.set("file", args.output.display().to_string());
    tree.set("lamps", lights.lights.len());
    if args.portals {
        tree.set("portals", lights.portals.len());
    }
    tree.set("color_space", lights.color_space.name());
    if let Some(nits) = lights.cd_m2_per_unit {
        tree.set_f32("cd_m2_per_unit", nits as f32);
    }
    if let (Some(dome), Some(map)) = (&lights.dome, map) {
        tree.set("map", map.display().to_string());
        tree.set_f32s("mean_radiance", &dome.summary.mean_radiance.map(|v| v as f32));
        tree.set_f32("unseen_share", lights.unseen_share as f32);
    }
    tree
}

/// Returns the lamps as lines of a table.
fn lamps_text(lights: &[AreaLight]) -> String {
    if lights.is_empty() {
        return String::new();
    }
    let mut table = String::from("\nlamp  shape                    middle        size  intensity            error  cameras");
    for (i, light) in lights.iter().enumerate() {
        let [x, y, z] = light.middle;
        let size = match &light.shape {
            LightShape::Sphere { radius } | LightShape::Disk { radius, .. } => format!("r {}", text::number(*radius)),
            LightShape::Rect { size, .. } => size.map(text::number).join(" x "),
            LightShape::Mesh(mesh) => format!("area {}", text::number(mesh.mean_area)),
        };
        let [r, g, b] = light.intensity.map(text::number);
        let error = format!("{:.1} %", 100.0 * light.error);
        table += &format!(
            "\n{:<4}  {:<9} {x:8.3} {y:8.3} {z:8.3}  {size:>10}  {r} {g} {b}  {error:>7}  {}",
            i + 1,
            light.shape.name(),
            light.cameras
        );
    }
    table
}
