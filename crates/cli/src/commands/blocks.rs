//! `luxel split` and `luxel merge`: a large data set in blocks of the ground, and their scenes as
//! one.

use std::ffi::OsString;

use anyhow::{Context, Result};
use luxel::{LoadOptions, TrainConfig, output};
use luxel_app::blocks::{BlockPart, SplitBlock, SplitOptions, merge, split};
use luxel_app::run::ExplicitArgs;
use luxel_app::text;
use serde_json::json;

use crate::args::{MergeArgs, SplitArgs};
use crate::output::console::Console;

/// Divides a data set; `words` are those of the command line.
pub(crate) fn run_split(args: &SplitArgs, explicit: &ExplicitArgs, words: &[OsString]) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let options = SplitOptions {
        dataset: args.dataset.clone(),
        output: args.output.clone(),
        grid: args.grid,
        max_splats: args.max_splats,
        border: args.border,
        load: args.load.options(),
        image_memory: args.image_memory,
        train: TrainConfig::default().with_preset(|id| explicit.contains(id)),
    };
    let program = words.first().map_or_else(|| "luxel".into(), Clone::clone);
    let found = split(&options, &console)?;
    let mut behind = load_words(&found.load);
    if let Some(most) = options.max_splats {
        behind.extend(["--max-splats".into(), most.to_string()]);
    }
    let behind: Vec<OsString> = behind.into_iter().map(Into::into).chain(args.train.iter().cloned()).collect();
    let mut jobs = String::new();
    for block in &found.blocks {
        let command = [program.clone(), "train".into(), block.dataset.clone().into(), "-o".into(), block.run.clone().into()];
        let command = command.iter().chain(&behind);
        let words: Vec<&str> =
            command.map(|word| word.to_str().context("jobs.txt: a word is not UTF-8; rename it")).collect::<Result<_>>()?;
        jobs += &words.iter().map(|word| text::shell_word(word)).collect::<Vec<_>>().join(" ");
        jobs.push('\n');
    }
    let path = args.output.join("jobs.txt");
    luxel_app::files::write_text(&path, &jobs)?;
    let [columns, rows] = found.grid;
    let line = |block: &SplitBlock| {
        let share = format!("{:.0} % of the points", 100.0 * block.share);
        format!(
            "{}: {} to train on, {} to test, {share}",
            block.dataset.display(),
            text::plural(block.train_views, "view"),
            block.test_views
        )
    };
    let lines: Vec<String> = found.blocks.iter().map(line).collect();
    let object = |block: &SplitBlock| {
        json!({ "dataset": block.dataset.display().to_string(), "run": block.run.display().to_string(), "train_views": block.train_views,
            "test_views": block.test_views, "share": block.share })
    };
    let facts = json!({ "blocks": found.blocks.iter().map(object).collect::<Vec<_>>(), "grid": found.grid, "radiance_scale": found.radiance_scale,
        "jobs": path.display().to_string() });
    let size = format!("{} in {columns}x{rows}, radiance scale {}", text::plural(found.blocks.len(), "block"), found.radiance_scale);
    console.finish(facts, &format!("{}\n{size}\njobs    {}", lines.join("\n"), path.display()))
}

/// Returns the options of reading a data set that are not the defaults, as words. Full size is
/// not the default where images are large, so the reduction is always among them.
fn load_words(load: &LoadOptions) -> Vec<String> {
    let default = LoadOptions::default();
    let mut words: Vec<String> = Vec::new();
    let mut add = |flag: &str, value: Option<String>| words.extend(value.into_iter().flat_map(|value| [flag.to_owned(), value]));
    add("--format", load.format.map(|format| format.name().to_owned()));
    add("--transfer", load.transfer.map(|transfer| transfer.to_string()));
    add("--input-color-space", load.color_space.map(|space| space.name().to_owned()));
    add("--downscale", Some(load.downscale.to_string()));
    add("--masks", (load.masks != default.masks).then(|| load.masks.to_string()));
    add("--layer", load.layer.clone());
    words
}

/// Joins the scenes of all blocks.
pub(crate) fn run_merge(args: &MergeArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    output::check_extension(&args.output, &["ply"])?;
    output::check_free(&args.output, args.overwrite)?;
    let merged = merge(&args.blocks, &console)?;
    luxel_io::write_scene_ply(&args.output, &merged.scene).context("cannot write the scene")?;
    let line = |part: &BlockPart| {
        let gain = if part.gain_ev == 0.0 { String::new() } else { format!(", {:+.3} stops", part.gain_ev) };
        format!("{}: {} of {}{gain}", part.name, text::count(part.kept), text::plural(part.splats, "splat"))
    };
    let lines: Vec<String> = merged.parts.iter().map(line).collect();
    let object = |part: &BlockPart| json!({ "name": part.name, "splats": part.splats, "kept": part.kept, "gain_ev": part.gain_ev });
    let (path, splats) = (args.output.display().to_string(), merged.scene.splats.len());
    let facts = json!({ "scene": path, "splats": splats, "blocks": merged.parts.iter().map(object).collect::<Vec<_>>() });
    console.finish(facts, &format!("{}\n{path}: {}", lines.join("\n"), text::plural(splats, "splat")))
}
