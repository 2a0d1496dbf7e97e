//! Writes small valid scenes of every format as seeds of the corpora: `cargo run --release
//! --example scene_seeds`.

use std::error::Error;
use std::path::{Path, PathBuf};

use luxel_core::{Activation, ColorModel, ColorSpace, RadianceScale, RasterConfig, Scene, synthetic};
use luxel_io::{
    Appearance, BakeOptions, Baked, SpzVersion, encode_baked_ply, encode_glb, encode_scene_ply, encode_sog, encode_spz, encode_usda, encode_usdc,
};

fn main() -> Result<(), Box<dyn Error>> {
    let lcd = ColorModel::Lcd { chroma_degree: 1, luminance_degree: 0, activation: Activation::Softplus };
    let splats = synthetic::room(3, 7).with_color_model(lcd).ok_or("a room of harmonics has every model")?;
    let scene = Scene {
        splats,
        radiance_scale: RadianceScale::new(2.0).unwrap(),
        color_space: ColorSpace::AcesCg,
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    };
    let bake = |appearance, max_degree| Baked::new(&scene, &BakeOptions { appearance, max_degree });
    let display = bake(Appearance::PREVIEW, 1);
    let linear = bake(Appearance::Linear { color_space: ColorSpace::LinearRec709, exposure_ev: 0.0 }, 0);
    let name = Path::new("seed");
    write("ply", "exact.ply", &encode_scene_ply(name, &scene)?)?;
    write("ply", "baked.ply", &encode_baked_ply(name, &linear)?)?;
    write("ply", "compressed.ply", COMPRESSED.as_bytes())?;
    write("usd", "linear.usda", &encode_usda(name, &linear)?)?;
    write("usd", "display.usda", &encode_usda(name, &display)?)?;
    write("usd_binary", "linear.usdc", &encode_usdc(name, &linear)?)?;
    write("usd_binary", "display.usdc", &encode_usdc(name, &display)?)?;
    write("gltf", "exact.glb", &encode_glb(name, &display, Some(&scene))?)?;
    write("gltf", "linear.glb", &encode_glb(name, &linear, None)?)?;
    write("sog", "display.sog", &encode_sog(name, &display)?)?;
    for (version, file) in [(SpzVersion::V2, "v2.spz"), (SpzVersion::V3, "v3.spz"), (SpzVersion::V4, "v4.spz")] {
        write("spz", file, &encode_spz(name, &display, version)?)?;
    }
    Ok(())
}

fn write(target: &str, file: &str, bytes: &[u8]) -> std::io::Result<()> {
    let folder = PathBuf::from("corpus").join(target);
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join(file), bytes)
}

/// Splats as PlayCanvas packs them, in text.
const COMPRESSED: &str = "ply
format ascii 1.0
element chunk 1
property float min_x
property float min_y
property float min_z
property float max_x
property float max_y
property float max_z
property float min_scale_x
property float min_scale_y
property float min_scale_z
property float max_scale_x
property float max_scale_y
property float max_scale_z
element vertex 1
property uint packed_position
property uint packed_rotation
property uint packed_scale
property uint packed_color
end_header
-1 -2 -3 1 2 3 -6 -6 -6 0 0 0
4294967295 3757571583 4294967295 4294967295
";
