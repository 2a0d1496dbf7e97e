//! `luxel mesh`: a proxy mesh of a scene.

use std::path::Path;

use anyhow::{Result, bail};
use luxel::export::Up;
use luxel::mesh::{EXTENSIONS, SceneMesh, mesh};
use luxel::{Device, output};
use luxel_app::run::ExplicitArgs;
use luxel_app::usd_space::{UsdSpace, is_usd_file};
use luxel_core::{Camera, Dataset};
use luxel_io::StageChoice;

use crate::args::MeshArgs;
use crate::commands::render::camera_file;
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Makes and writes the mesh; `explicit` names the options that were given.
pub(crate) fn run(args: &MeshArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    output::check_extension(&args.output, &EXTENSIONS)?;
    output::check_free(&args.output, args.overwrite)?;
    let source = SceneSource::open(&args.input.scene, &console)?;
    let dataset = source.dataset(DataRequest::new(&args.input, explicit), &console)?;
    let cameras = cameras(args, &source, dataset.as_ref())?;
    let mut device = args.input.device.clone();
    // Only the CPU engine has surface images.
    if device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    let mut engine = engine::engine(&device)?.engine;
    let mesh = mesh(&source.scene, &cameras, &args.options(), dataset.as_ref(), engine.as_mut(), &console)?;
    mesh.save(&args.output)?;
    warn_of_scale(args, &mesh, &console);
    let tree = describe(args, &mesh);
    console.finish(tree.json(), tree.text().trim_end())
}

/// Returns the cameras that look at the scene, in its coordinates.
fn cameras(args: &MeshArgs, source: &SceneSource, dataset: Option<&Dataset>) -> Result<Vec<Camera>> {
    let Some(file) = &args.cameras else {
        let Some(dataset) = dataset else {
            bail!("{}: a scene file has no cameras; give --data DATASET or --cameras FILE", args.input.scene.display())
        };
        return Ok(dataset.train.iter().map(|view| view.camera.clone()).collect());
    };
    let first = dataset.and_then(|dataset| dataset.train.first().or(dataset.test.first()));
    let in_world = if is_usd_file(file) {
        let stage = UsdSpace::new(source.scene.metres_per_unit, Up::Default, dataset)?;
        let choice = StageChoice { camera: None, size_px: first.map(|view| view.camera.size_px) };
        stage.read_cameras(file, choice)?.cameras
    } else {
        camera_file(file, args.input.data.is_some(), || Ok(dataset.cloned()), || Ok(()))?
    };
    Ok(in_world.iter().map(|named| source.scene.local_camera(&named.camera)).collect())
}

/// Says where lengths are not those that the format takes them for.
fn warn_of_scale(args: &MeshArgs, mesh: &SceneMesh, console: &Console) {
    let is_glb = Path::new(&args.output).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("glb"));
    if let Some(metres) = mesh.metres_per_unit().filter(|metres| is_glb && (metres - 1.0).abs() > 1e-6) {
        console.warn(&format!("glTF takes a unit for a metre, and one of this file is {metres} m"));
    }
}

fn describe(args: &MeshArgs, mesh: &SceneMesh) -> Tree {
    let lengths = mesh.report.lengths;
    let mut tree = Tree::default();
    tree.set("file", args.output.display().to_string()).set("file_bytes", std::fs::metadata(&args.output).map_or(0, |file| file.len()));
    tree.set("triangles", mesh.triangles()).set("vertices", mesh.vertices());
    tree.set("triangles_before", mesh.report.triangles_before).set("islands_removed", mesh.report.islands_removed);
    tree.set("holes_filled", mesh.report.holes_filled);
    tree.set("views", mesh.views).set("color_space", mesh.color_space().name());
    tree.set_f32("voxel", lengths.voxel as f32).set_f32("truncation", lengths.truncation as f32);
    tree.set_f32("max_depth", lengths.max_depth as f32).set_f32("diagonal", lengths.extent as f32);
    tree.set("volume_bytes", mesh.report.volume_bytes);
    tree
}
