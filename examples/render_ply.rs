//! Renders a scene file from the cameras of a file.
//!
//! ```text
//! cargo run --release -p luxel --example render_ply -- SCENE.ply CAMERAS.json FOLDER
//! ```
//!
//! SCENE.ply: a scene of `luxel train`, or any 3D Gaussian splatting file. CAMERAS.json: a
//! `transforms.json` (its images are not needed) or a camera path of nerfstudio, with image size
//! and focal length. FOLDER gets an OpenEXR file per camera.

use std::path::PathBuf;

use luxel::{Device, Error, Renderer, Result, Scene, read_cameras};

fn main() -> Result<()> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [scene, cameras, folder] = arguments.as_slice() else {
        return Err(Error::new("usage: render_ply SCENE.ply CAMERAS.json FOLDER"));
    };
    let scene = Scene::open(scene)?;
    let mut renderer = Renderer::new(&scene, Device::Auto)?;
    for named in read_cameras(cameras)? {
        // The scene brings its raster settings, its scale and its colour space: the file is in the
        // units of the images.
        let path = folder.join(format!("{}.exr", named.name));
        renderer.render(&named.camera)?.save_exr(&path)?;
        println!("{}", path.display());
    }
    Ok(())
}
