//! `luxel export`: a scene as a file for other programs.

mod page;

use anyhow::{Result, bail};
use luxel::export::{BakeError, BakeErrorValues, Exported, Format, export, exported_map};
use luxel::{Device, output};
use luxel_app::run::ExplicitArgs;
use luxel_app::text;
use luxel_io::SpzPositions;

use crate::args::ExportArgs;
use crate::commands::lights::{say_left_in_map, warn_of_unseen};
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Exports the scene; `explicit` names the options that were given.
pub(crate) fn run(args: &ExportArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    output::check_free(&args.output, args.overwrite)?;
    if page::is_page(&args.output) {
        return page::run(args, explicit, &console);
    }
    if explicit.contains("max_degree") {
        bail!("{}: --max-degree is for .html files; --degree is that of a bake", args.output.display());
    }
    let format = Format::from_path(&args.output)?;
    if format != Format::Spz && explicit.contains("spz_version") {
        bail!("{}: --spz-version is for .spz files; leave it out, or write .spz", args.output.display());
    }
    if let Some(map) = exported_map(&args.output).filter(|_| args.lights) {
        output::check_free(&map, args.overwrite)?;
    }
    let source = SceneSource::open(&args.input.scene, &console)?;
    let mut options = args.options();
    options.bake.check_for(&args.output)?;
    let dataset = source.dataset(DataRequest::new(&args.input, explicit), &console)?;
    let mut device = args.input.device.clone();
    if let Some(lights) = &mut options.lights {
        lights.cd_m2_per_unit = source.cd_m2_per_unit(DataRequest::new(&args.input, explicit));
        // Only the CPU engine renders coverage, which says which directions no view saw.
        if device.device == Device::Auto {
            device.device = Device::Cpu;
        }
    }
    let mut engine = engine::engine(&device)?.engine;
    let exported = export(source.scene, &args.output, &options, dataset.as_ref(), engine.as_mut(), &console)?;
    if let Some(positions) = &exported.positions {
        warn_of_positions(positions, format, &console);
    }
    warn_of_scale(args, &exported, &console)?;
    if let Some(lights) = &exported.lights {
        if lights.lamps == 0 {
            console.warn("no lamps found: all light is in the map; luxel lights with a lower --medians finds fainter ones");
        }
        say_left_in_map(&lights.left_in_map, &console);
        warn_of_unseen(lights.unseen_share, "", &console);
    }
    // An origin that was asked for is where it should be.
    if let (Some([x, y, z]), Format::Spz | Format::Sog, None) = (exported.origin, format, args.origin) {
        let (name, _) = small_format(format);
        console.warn(&format!(
            "positions are relative to the origin {x}, {y}, {z} of the data set's coordinates, for which {name} has no place; .ply, .glb and \
             .usda state it"
        ));
    }
    let tree = describe(args, &exported);
    console.finish(tree.json(), tree.text().trim_end())
}

/// Says where lengths are not those that the format takes them for.
fn warn_of_scale(args: &ExportArgs, exported: &Exported, console: &Console) -> Result<()> {
    let is_glb = Format::from_path(&args.output)? == Format::Glb;
    if let Some(metres) = exported.metres_per_unit.filter(|metres| is_glb && (metres - 1.0).abs() > 1e-6) {
        console.warn(&format!("glTF takes a unit for a metre, and one of this file is {metres} m: --scale-to 1 makes metres of it"));
    }
    Ok(())
}

/// Returns the name of a format for the web, and the bits of its coordinates.
fn small_format(format: Format) -> (&'static str, u8) {
    if format == Format::Sog { ("SOG", 16) } else { ("SPZ", 24) }
}

/// Says what the grid of positions of a format for the web costs.
fn warn_of_positions(positions: &SpzPositions, format: Format, console: &Console) {
    let (name, bits) = small_format(format);
    let SpzPositions { step, median_size, left_out } = *positions;
    if left_out > 0 {
        console.warn(&format!(
            "left out: {} so far out that {name}'s {bits} bits a coordinate would be too coarse for all the others; --crop chooses what is kept, \
             and .ply and .glb keep all",
            text::plural(left_out, "splat")
        ));
    }
    if positions.is_coarse() {
        console.warn(&format!(
            "{name}'s {bits} bits a coordinate have steps of {step} units here, the median splat is of size {median_size}: give --crop, or write .ply \
             or .glb"
        ));
    }
}

fn describe(args: &ExportArgs, exported: &Exported) -> Tree {
    let mut tree = Tree::default();
    tree.set("file", args.output.display().to_string()).set("splats", exported.splats);
    tree.set("file_bytes", exported.file_bytes).set("bake", exported.bake.clone());
    if let Some(origin) = exported.origin {
        tree.set("origin", origin.to_vec());
    }
    if !args.rotate.is_empty() || args.origin.is_some() {
        let (rotation, move_by) = (exported.file_from_world.rotation(), exported.file_from_world.translation());
        let scale = exported.file_from_world.scale();
        let row = |i: usize| (scale * rotation.row(i)).to_array().into_iter().chain([move_by[i]]);
        let rows: Vec<f64> = (0..3).flat_map(row).collect();
        tree.set("file_from_world", rows);
    }
    match exported.metres_per_unit {
        Some(metres) => tree.set("metres_per_unit", metres),
        None => tree.set("metres_per_unit", "unknown: the data set states no scale; --metres-per-unit gives it"),
    };
    tree.set("color_space", exported.color_space.map_or("sRGB, for a display", |space| space.name()));
    if let Some((model, space)) = &exported.exact_model {
        tree.set("exact_model", format!("{model}, {}", space.name()));
    }
    if exported.sizes_out_of_range > 0 {
        tree.set("sizes_out_of_range", exported.sizes_out_of_range);
    }
    if let Some(lights) = &exported.lights {
        tree.set("lamps", lights.lamps);
        tree.set("map", lights.map.as_ref().map_or_else(|| "in the package".to_owned(), |map| map.display().to_string()));
    }
    match &exported.error {
        Some(error) => tree.group("bake_error", describe_error(error)),
        None => tree.set("bake_error", "not measured: give --data DATASET for views to measure it on"),
    };
    tree
}

fn describe_error(error: &BakeError) -> Tree {
    let mut tree = Tree::default();
    tree.set("views", error.views);
    match error.values {
        BakeErrorValues::Display { psnr_db, mean_absolute_error_of_255 } => {
            tree.set("psnr_display_db", psnr_db).set("mean_absolute_error_of_255", mean_absolute_error_of_255)
        }
        BakeErrorValues::Linear { psnr_mu_law_db, relative_error_of_radiance } => {
            tree.set("psnr_mu_law_db", psnr_mu_law_db).set("relative_error_of_radiance", relative_error_of_radiance)
        }
    };
    tree
}
