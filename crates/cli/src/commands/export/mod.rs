//! `luxel export`: a scene as a file of another program.
//!
//! Splats are chosen ([`prune`]), exposed for a display ([`exposure`]), baked, perhaps refined ([`refine`]), measured ([`error`]) in the world of the data set, and then turned into
//! that of the file ([`world`]).

mod error;
mod exposure;
mod gain;
mod prune;
mod refine;
mod world;

use std::path::Path;

use anyhow::{Context, Result, bail};
use luxel::run::ExplicitArgs;
use luxel::{files, text};
use luxel_core::{Dataset, Engine, Scene};
use luxel_io::{Appearance, BakeOptions, Baked};

use crate::args::{BakeArg, ExportArgs};
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

pub(crate) use world::{Target, file_from_world};

/// Formats by extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Usda,
    Glb,
    Spz,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        Ok(match extension.as_str() {
            "ply" => Self::Ply,
            "usda" | "usd" => Self::Usda,
            "glb" => Self::Glb,
            "spz" => Self::Spz,
            "usdc" | "usdz" => bail!("{}: binary USD is not written; write .usda, which usdcat converts", path.display()),
            "gltf" => bail!("{}: glTF is written as one file; write .glb", path.display()),
            _ => bail!("{}: unknown extension, expected .ply, .usda, .usd, .glb or .spz", path.display()),
        })
    }

    fn target(self) -> Target {
        match self {
            Self::Ply | Self::Spz => Target::MinusY,
            Self::Usda | Self::Glb => Target::PlusY,
        }
    }
}

/// What comes into the file.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Plan {
    format: Format,
    options: BakeOptions,
    /// The radiance model beside it.
    is_exact: bool,
}

/// Settles what the options and the format leave open, and refuses what does not go together.
fn plan(args: &ExportArgs, scene: &Scene) -> Result<Plan> {
    let format = Format::of(&args.output)?;
    let bake = args.bake.unwrap_or(match format {
        Format::Ply | Format::Glb => BakeArg::Exact,
        Format::Usda => BakeArg::Linear,
        Format::Spz => BakeArg::Display,
    });
    let name = args.output.display();
    match (format, bake) {
        (Format::Spz, BakeArg::Linear | BakeArg::Exact) => {
            bail!("{name}: SPZ has 8 bits a colour; use --bake display, or .usda, .ply or .glb")
        }
        (Format::Usda, BakeArg::Exact) => bail!("{name}: USD holds harmonics only; use --bake linear, or .ply or .glb for the exact model"),
        _ => {}
    }
    if bake != BakeArg::Linear && args.colorspace.is_some() {
        bail!("--colorspace is of linear bakes: display bakes are sRGB, and the exact model keeps its space; add --bake linear");
    }
    if bake == BakeArg::Linear && (args.tonemap.is_some() || args.refine > 0) {
        bail!("--tonemap and --refine are of display bakes; add --bake display");
    }
    let appearance = match bake {
        BakeArg::Linear => {
            let default = if format == Format::Glb { luxel_core::ColorSpace::LinearRec709 } else { scene.color_space };
            Appearance::Linear { color_space: args.colorspace.map_or(default, Into::into), exposure_ev: args.exposure }
        }
        BakeArg::Display | BakeArg::Exact => {
            Appearance::Display { tonemap: args.tonemap.map_or_else(Default::default, Into::into), exposure_ev: args.exposure }
        }
    };
    let options = BakeOptions { appearance, max_degree: args.degree };
    Ok(Plan { format, options, is_exact: bake == BakeArg::Exact })
}

/// `explicit` names the options that were given.
pub(crate) fn run(args: &ExportArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    files::check_free(&args.output, args.overwrite)?;
    if Format::of(&args.output)? != Format::Spz && explicit.contains("spz_version") {
        bail!("{}: --spz-version is of .spz files; leave it out, or write .spz", args.output.display());
    }
    let source = SceneSource::open(&args.scene, &console)?;
    let mut plan = plan(args, &source.scene)?;
    let dataset = source.dataset(DataRequest { data: args.data.as_deref(), load: &args.load, explicit }, &console)?;
    let mut engine = engine::engine(&args.device)?.engine;
    let mut scene = source.scene;
    let before = scene.splats.len();
    prune::crop(&mut scene, args.crop);
    prune::limit(&mut scene, args.max_splats, dataset.as_ref(), engine.as_mut(), &console)?;
    if scene.splats.is_empty() {
        bail!("no splats are left of {}; give a larger --crop", text::plural(before, "splat"));
    }
    if let (Appearance::Display { exposure_ev, .. }, Some(dataset)) = (&mut plan.options.appearance, &dataset)
        && let Some(found) = exposure::of_views(&scene, dataset, engine.as_mut())?
    {
        *exposure_ev += (found / luxel_io::display_exposure(&scene)).log2();
    }
    let mut baked = Baked::new(&scene, &plan.options);
    if args.refine > 0 {
        let Some(dataset) = &dataset else { bail!("--refine needs views to compare with; give --data DATASET") };
        refine::refine(&mut baked, &scene, dataset, args.refine, (engine.as_mut(), &console))?;
    }
    let facts = finish(args, &plan, (scene, baked), dataset.as_ref(), engine.as_mut())?;
    console.result(&facts.event("finished"), facts.text().trim_end())
}

/// Measures, turns and writes.
fn finish(
    args: &ExportArgs,
    plan: &Plan,
    (mut scene, mut baked): (Scene, Baked),
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
) -> Result<Tree> {
    let error = dataset.map(|dataset| error::measure(&scene, &baked, dataset, engine)).transpose()?;
    let similarity = file_from_world(args.up, plan.format.target(), dataset, args.scale)?;
    baked.transform(&similarity);
    if plan.is_exact {
        similarity.apply(&mut scene.splats);
        scene.radiance_scale *= args.exposure.exp2();
    }
    let path = args.output.as_path();
    let written = match plan.format {
        Format::Ply if plan.is_exact => luxel_io::write_exact_ply(path, &scene, &baked),
        Format::Ply => luxel_io::write_baked_ply(path, &baked),
        Format::Usda => luxel_io::write_usda(path, &baked),
        Format::Glb => luxel_io::write_glb(path, &baked, plan.is_exact.then_some(&scene)),
        Format::Spz => luxel_io::write_spz(path, &baked, args.spz_version.into()),
    };
    written.context("cannot write the scene")?;
    let mut facts = Tree::default();
    facts.set("file", path.display().to_string()).set("splats", scene.splats.len());
    facts.set("file_bytes", std::fs::metadata(path).map_or(0, |m| m.len()));
    facts.set("bake", baked.description());
    facts.set(
        "color_space",
        match plan.options.appearance {
            Appearance::Linear { color_space, .. } => color_space.name().to_owned(),
            Appearance::Display { .. } => "sRGB, for a display".to_owned(),
        },
    );
    if plan.is_exact {
        facts.set("exact_model", format!("{}, {}", scene.splats.color_model.name(), scene.color_space.name()));
    }
    if plan.format == Format::Spz && luxel_io::spz_out_of_range(&baked) > 0 {
        facts.set("sizes_out_of_range", luxel_io::spz_out_of_range(&baked));
    }
    match error {
        Some(error) => facts.group("bake_error", error),
        None => facts.set("bake_error", "not measured: give --data DATASET for views to measure it on"),
    };
    Ok(facts)
}
