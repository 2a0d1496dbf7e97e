//! Renders a scene file from the cameras of a file, with the library alone.
//!
//! ```text
//! cargo run --release --example render_ply -- SCENE.ply CAMERAS.json FOLDER
//! ```
//!
//! SCENE.ply: a scene of `luxel train`, or any 3D Gaussian splatting file. CAMERAS.json: a `transforms.json` (its images are not
//! needed) or a camera path of nerfstudio, with image size and focal length. FOLDER gets an OpenEXR file per camera.

use std::error::Error;
use std::path::{Path, PathBuf};

use luxel_core::{Engine, RenderOptions};
use luxel_cpu::CpuEngine;
use luxel_io::{ExrOptions, read_camera_path, read_scene_ply, write_exr};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [scene, cameras, folder] = arguments.as_slice() else {
        return Err("usage: render_ply SCENE.ply CAMERAS.json FOLDER".into());
    };
    render(scene, cameras, folder)
}

fn render(scene: &Path, cameras: &Path, folder: &Path) -> Result<(), Box<dyn Error>> {
    let scene = read_scene_ply(scene)?;
    let cameras = read_camera_path(cameras, None)?;
    std::fs::create_dir_all(folder)?;

    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut engine = CpuEngine::new(threads)?;
    engine.load(&scene.splats, None)?;
    // The scene says how it was rasterised when it was trained; rendered otherwise, it looks otherwise.
    let options = RenderOptions { raster: scene.raster, ..RenderOptions::default() };

    for named in cameras {
        let mut image = engine.render(&named.camera, &options)?;
        // Splats hold normalised radiance; the scale takes it back to the units of the photographs.
        image.scale(scene.radiance_scale);
        let path = folder.join(format!("{}.exr", named.name));
        let out_of_range = write_exr(&path, &image, &ExrOptions { color_space: scene.color_space, ..ExrOptions::default() })?;
        println!("{}", path.display());
        if out_of_range > 0 {
            eprintln!("{}: {out_of_range} values exceed 65504 and are cut there; ExrSample::Float holds them", path.display());
        }
    }
    Ok(())
}
