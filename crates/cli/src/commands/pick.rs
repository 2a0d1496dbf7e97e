//! `luxel pick`: what a pixel of a view is made of.

use std::fmt::Write as _;

use anyhow::{Context, Result, bail};
use luxel::edit::find_view;
use luxel_app::pick::{Pick, pick};
use luxel_app::run::ExplicitArgs;
use luxel_app::{schema, text};

use crate::args::PickArgs;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Picks and prints; `explicit` names the options that were given.
pub(crate) fn run(args: &PickArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet || args.json);
    let source = SceneSource::open(&args.input.scene, &console)?;
    let Some(dataset) = source.dataset(DataRequest::new(&args.input, explicit), &console)? else {
        bail!("{}: a scene file has no views; give --data DATASET", args.input.scene.display());
    };
    let view = find_view(&dataset, &args.view)?;
    let mut engine = engine::engine(&args.input.device)?.engine;
    let found = pick(&source.scene, view, args.px, source.background(None), args.count, engine.as_mut())?;
    let facts = serde_json::to_value(&found).context("cannot encode the pixel")?;
    if args.json {
        let text = serde_json::to_string_pretty(&schema::PICK.versioned(&found)).context("cannot encode the pixel")?;
        return console.finish(facts, &text);
    }
    console.finish(facts, report(&found).trim_end())
}

/// Returns the facts and the table of splats.
fn report(found: &Pick) -> String {
    let mut facts = Tree::default();
    facts.set("view", found.view.as_str()).set("pixel", format!("{},{}", found.pixel[0], found.pixel[1]));
    facts.set("color_space", found.color_space.name());
    facts.set_f32s("radiance", &found.radiance);
    if let Some(truth) = found.ground_truth {
        facts.set_f32s("ground_truth", &truth);
    }
    facts.set_f32("luminance", found.luminance).set_f32("luminance_sum", found.luminance_sum);
    facts.set_f32("coverage", found.coverage);
    match (found.depth, found.depth_of_point, found.point) {
        (Some(depth), Some(depth_of_point), Some(point)) => {
            facts.set("depth", depth).set("depth_of_point", depth_of_point).set("point", point.to_vec());
        }
        _ => {
            facts.set("point", "none: no splat covers the pixel");
        }
    }
    let mut out = facts.text();
    let listed = found.splats.len();
    let _ = writeln!(out, "\n{} of {}, by weight", text::count(listed), text::plural(found.contributing, "splat"));
    if listed > 0 {
        let _ = writeln!(out, "{:>9} {:>7} {:>7} {:>30} {:>8} {:>10}", "index", "weight", "opacity", "position", "depth", "L");
    }
    for splat in &found.splats {
        let position = splat.position.map(text::number).join(" ");
        let [depth, luminance] = [splat.depth, splat.luminance_sum.into()].map(text::number);
        let _ = writeln!(out, "{:>9} {:7.4} {:7.4} {position:>30} {depth:>8} {luminance:>10}", splat.index, splat.weight, splat.opacity);
    }
    out
}
