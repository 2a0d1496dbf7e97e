//! The workload: a scene in the engine, and a view of it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use luxel::{Silent, output};
use luxel_app::run::open_scene;
use luxel_core::{
    Camera, ColorModel, ColorSpace, Cutoffs, Engine, Image, RadianceScale, RasterConfig, RenderOptions, Scene, Similarity, Splats, View,
    spatial_order, synthetic,
};
use luxel_io::ReadOptions;
use luxel_train::{Method, NamedChoice, Representation, TrainConfig};

use crate::args::BenchArgs;
use crate::args::values::OrderArg;

/// Size of the room's image by default.
const DEFAULT_SIZE_PX: [u32; 2] = [400, 400];

/// Near plane of both presets, so that they see the same splats: that of [`Cutoffs::HDR`].
const NEAR: f32 = Cutoffs::HDR.near;

/// Facts about the scene loaded into the engine, and its view.
pub(super) struct Workload {
    /// The file or the room.
    pub(super) name: String,
    /// Colour model.
    pub(super) method: String,
    /// Splats in the scene.
    pub(super) splats: usize,
    /// The target of the loss.
    pub(super) target: String,
    /// Camera and target, normalised units.
    pub(super) view: View,
    /// Settings of rendering.
    pub(super) render: RenderOptions,
}

/// A scene before it is in the engine.
struct Source {
    name: String,
    splats: Splats,
    radiance_scale: RadianceScale,
    raster: RasterConfig,
    world_from_local: Similarity,
}

impl Workload {
    /// Reads or makes everything and loads the scene.
    pub(super) fn prepare(args: &BenchArgs, engine: &mut dyn Engine) -> Result<Self> {
        let mut camera = camera(args)?;
        let source = source(args)?;
        source.world_from_local.inverse().apply_to_camera(&mut camera);
        let mut splats = in_method(source.splats, args.method, &source.name)?;
        let cutoffs = Cutoffs { near: NEAR, ..TrainConfig { cutoffs: args.cutoffs, ..TrainConfig::default() }.raster().cutoffs };
        let render = RenderOptions { raster: RasterConfig { cutoffs, ..source.raster }, ..RenderOptions::default() };
        let (target, image) = match &args.target {
            Some(path) => (path.display().to_string(), read_target(path, args, &camera, source.radiance_scale)?),
            None => {
                engine.load(&splats, None).context("cannot load the workload")?;
                let image = engine.render(&camera, &render).context("cannot render the workload")?;
                synthetic::perturb(&mut splats, args.seed);
                ("render of the workload before its parameters were perturbed".to_owned(), image)
            }
        };
        // Last, so that both orders are of the same splats.
        if args.order == OrderArg::Spatial {
            splats = splats.select(spatial_order(&splats.position));
        }
        engine.load(&splats, None).context("cannot load the workload")?;
        let view = View::of_radiance(source.name.clone(), camera, image);
        Ok(Self { name: source.name, method: splats.color_model.name(), splats: splats.len(), target, view, render })
    }
}

fn camera(args: &BenchArgs) -> Result<Camera> {
    let camera = match &args.camera {
        Some(path) => luxel_io::read_pinhole_camera(path).context("cannot read the camera")?,
        None => synthetic::room_camera(args.size.unwrap_or(DEFAULT_SIZE_PX)),
    };
    luxel::memory::check_render(camera.size_px, 1)?;
    Ok(camera)
}

/// Memory for a splat: the room, its copies in other methods, and the engine's parameters with
/// their moments and gradients.
const SPLAT_BYTES: u64 = 1300;

fn source(args: &BenchArgs) -> Result<Source> {
    match (&args.workload, args.generate) {
        (Some(path), _) => {
            let scene = open_scene(path, &Silent)?.into_core();
            if scene.splats.is_empty() {
                bail!("{}: no splats, expected a scene with some to measure on", path.display());
            }
            Ok(Source {
                name: path.display().to_string(),
                splats: scene.splats,
                radiance_scale: scene.radiance_scale,
                raster: scene.raster,
                world_from_local: scene.world_from_local,
            })
        }
        (None, Some(count)) => {
            luxel::memory::check(&format!("a room of {count} splats"), u64::from(count) * SPLAT_BYTES, "generate fewer splats")?;
            Ok(Source {
                name: format!("room of {count} splats, seed {}", args.seed),
                splats: synthetic::room(count as usize, args.seed),
                radiance_scale: RadianceScale::ONE,
                raster: RasterConfig::default(),
                world_from_local: Similarity::IDENTITY,
            })
        }
        (None, None) => bail!("nothing to measure on; give --workload SCENE.ply or --generate N"),
    }
}

/// Writes the room as a scene.
pub(super) fn save(args: &BenchArgs, path: &Path) -> Result<()> {
    output::check_extension(path, &["ply"])?;
    output::check_free(path, args.overwrite)?;
    let source = source(args)?;
    let splats = in_method(source.splats, args.method, &source.name)?;
    let cutoffs = TrainConfig { cutoffs: args.cutoffs, ..TrainConfig::default() }.raster().cutoffs;
    let raster = RasterConfig { cutoffs, ..source.raster };
    let scene = Scene {
        splats,
        radiance_scale: source.radiance_scale,
        color_space: ColorSpace::default(),
        raster,
        edits: Vec::new(),
        world_from_local: source.world_from_local,
        metres_per_unit: None,
    };
    luxel_io::write_scene_ply(path, &scene).context("cannot write the room")
}

/// Returns the splats in the colour model asked for.
fn in_method(splats: Splats, method: Option<Method>, name: &str) -> Result<Splats> {
    let Some(method) = method else { return Ok(splats) };
    let refused = match method.spec().representation {
        Representation::Splats => None,
        Representation::Anchors => Some("anchors decode theirs"),
        Representation::Field => Some("a radiance field has none"),
    };
    if let Some(found) = refused {
        bail!("--method {}: the workload is splats, and {found}", method.name());
    }
    if method.has_own_steps() {
        bail!(
            "--method {}: its steps train on captured images, which bench has none of; use --method logsh3, its colour model",
            method.name()
        );
    }
    let model: ColorModel = TrainConfig { method, ..TrainConfig::default() }.color_model();
    if model == splats.color_model {
        return Ok(splats);
    }
    let found = splats.color_model.name();
    let Some(splats) = splats.with_color_model(model) else {
        bail!("{name}: colour model {found} cannot become {}; leave --method out, or take a scene of harmonics", model.name())
    };
    Ok(splats)
}

/// Reads an image of the camera's size into normalised units.
fn read_target(path: &Path, args: &BenchArgs, camera: &Camera, radiance_scale: RadianceScale) -> Result<Image> {
    let options = ReadOptions { transfer: args.transfer.map(Into::into), layer: args.layer.clone() };
    let mut decoded = luxel_io::read_image(path, &options).context("cannot read the target")?;
    decoded.composite_over_black();
    let mut image = decoded.image;
    let [width, height] = camera.size_px.map(|side| side as usize);
    if (image.width, image.height) != (width, height) {
        bail!(
            "{}: {} x {} pixels, the camera expects {width} x {height}; take the target that belongs to the camera",
            path.display(),
            image.width,
            image.height
        );
    }
    if let Some(at) = image.pixels.iter().position(|rgb| rgb.iter().any(|v| !v.is_finite())) {
        bail!(
            "{}: pixel {}, {} (column, row) is not finite, expected radiance; take another target, or leave --target out",
            path.display(),
            at % width,
            at / width
        );
    }
    radiance_scale.normalise(&mut image);
    Ok(image)
}
