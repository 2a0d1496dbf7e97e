//! `luxel mix`: scenes of the same geometry under different light, added.

use anyhow::{Context, Result, bail};
use luxel::mix::{MixInput, mix};
use luxel::output;
use luxel_app::run::open_scene;
use luxel_app::text;
use serde_json::json;

use crate::args::MixArgs;
use crate::output::console::Console;

/// Mixes and writes the scene.
pub(crate) fn run(args: &MixArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let (scenes, weights) = (args.scenes.len(), args.weights.len());
    if !args.weights.is_empty() && weights != scenes {
        bail!("--weights: {} for {}; give one for each scene", text::plural(weights, "weight"), text::plural(scenes, "scene"));
    }
    output::check_extension(&args.output, &["ply"])?;
    output::check_no_input(&args.output, args.scenes.iter().map(std::path::PathBuf::as_path))?;
    output::check_free(&args.output, args.overwrite)?;
    let weights = args.weights.iter().copied().chain(std::iter::repeat(1.0));
    let open = |(path, weight): (&std::path::PathBuf, f32)| {
        let scene = open_scene(path, &console)?.into_core();
        Ok(MixInput { name: path.display().to_string(), scene, weight })
    };
    let inputs: Vec<MixInput> = args.scenes.iter().zip(weights).map(open).collect::<Result<_>>()?;
    let mixed = mix(inputs)?;
    luxel_io::write_scene_ply(&args.output, &mixed).context("cannot write the scene")?;
    let (splats, lights) = (mixed.splats.len(), mixed.splats.color_model.lights());
    let path = args.output.display().to_string();
    let facts = json!({ "scene": path, "splats": splats, "lights": lights, "color_model": mixed.splats.color_model.name() });
    console.finish(facts, &format!("{path}: {} under {}", text::plural(splats, "splat"), text::plural(lights, "light")))
}
