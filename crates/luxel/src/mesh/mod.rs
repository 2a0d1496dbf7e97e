//! A proxy mesh of a scene: a shadow catcher, holdout or collider for other programs.
//!
//! In: a scene, cameras that saw it, options. Out: a [`SceneMesh`] with linear radiance and normals
//! at its vertices, and its file. Each camera's depths are the median of what its pixels are
//! blended from, weighted by how far that is spread out; [`luxel_mesh`] fuses them. Files are in
//! the world that [`crate::export`] writes splats in by default. Degenerate: what no camera saw is
//! not in the mesh; fewer than three cameras, and views without a surface, are errors.

mod views;

use std::path::Path;

use glam::{DMat3, DVec2, Vec3};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Engine, RasterConfig, RenderOptions, Scene, Similarity};
use luxel_io::{MeshFile, MeshFormat};
use luxel_mesh::{DepthFrame, FusionOptions, fuse};
pub use luxel_mesh::{FusionReport, Lengths, MeshError, TriangleMesh};

use self::views::{SurfaceView, views};
use crate::error::Context;
use crate::up::{Up, UpAxis, file_from_world};
use crate::{Error, FrameProgress, Observer, Remedy, Result};

/// Options of a mesh. Lengths are in the world of the data set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshOptions {
    /// Side of a voxel; `None` for 1/256 of the scene's diagonal, or what the images resolve.
    pub voxel: Option<f64>,
    /// Number of triangles to simplify the mesh to; `None` for all.
    pub triangles: Option<usize>,
    /// Islands whose bounding box has a shorter diagonal are removed; `None` for 16 voxels.
    pub min_island: Option<f64>,
    /// Flat holes whose bounding box has a shorter diagonal are filled; `None` for 32 voxels.
    pub max_hole: Option<f64>,
    /// Depth up to which pixels count; `None` for where a pixel is as wide as four voxels.
    pub max_depth: Option<f64>,
    /// Longest side of the depth images, pixels.
    pub image_size: u32,
    /// Cameras that are rendered; of more, evenly spread ones.
    pub max_views: usize,
    /// Direction of the scene that is up.
    pub up: Up,
    /// Length of a unit of the scene, metres; `None` for what its data set states.
    pub metres_per_unit: Option<f64>,
    /// Colour space of the radiance; `None` for that of the scene.
    pub color_space: Option<ColorSpace>,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self {
            voxel: None,
            triangles: None,
            min_island: None,
            max_hole: None,
            max_depth: None,
            image_size: 400,
            max_views: 200,
            up: Up::Default,
            metres_per_unit: None,
            color_space: None,
        }
    }
}

/// Formats of meshes, by their extensions.
pub const EXTENSIONS: [&str; 7] = ["usdc", "usda", "usd", "usdz", "glb", "ply", "obj"];

/// A mesh of a scene.
#[derive(Clone, Debug)]
pub struct SceneMesh {
    /// In the local coordinates of the scene.
    mesh: TriangleMesh,
    /// How it was made. Lengths are in the world of the data set.
    pub report: FusionReport,
    /// Depth images that were fused.
    pub views: usize,
    world_from_local: Similarity,
    /// Rotations to files whose up axis is -y, and +y.
    file_from_world: [DMat3; 2],
    metres_per_unit: Option<f64>,
    color_space: ColorSpace,
}

/// Bytes of a pixel of a depth image while it is made, and fused.
const PIXEL_BYTES: u64 = 56;

/// Makes a mesh of a scene. Cameras are in the scene's local coordinates; the data set tells where
/// up is.
///
/// # Errors
/// Too few cameras; a device without surface images, such as a GPU; lengths that are not above 0;
/// more memory than reading a file may take; views that agree on no surface.
pub fn mesh(
    scene: &Scene,
    cameras: &[Camera],
    options: &MeshOptions,
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<SceneMesh> {
    let views = views(cameras, options.image_size, options.max_views);
    let bytes: u64 = views.iter().map(|view| view.camera.size_px.iter().map(|side| u64::from(*side)).product::<u64>() * PIXEL_BYTES).sum();
    crate::memory::check(&format!("{} depth images", views.len()), bytes, "make smaller images, or of fewer views")?;
    let unit = scene.world_from_local.scale();
    let to_local = |length: Option<f64>| length.map(|length| length / unit);
    let fusion = FusionOptions {
        voxel: to_local(options.voxel),
        max_depth: to_local(options.max_depth),
        min_island: to_local(options.min_island),
        max_hole: to_local(options.max_hole),
        triangles: options.triangles,
        max_bytes: luxel_io::memory_limit().saturating_sub(bytes),
    };
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let mut progress = FrameProgress { observer, done: 0, total: u32::try_from(views.len()).unwrap_or(u32::MAX) };
    let mut frames = Vec::with_capacity(views.len());
    for view in &views {
        frames.push(frame(scene, view, options.color_space, engine)?);
        progress.add(&format!("depth {}", frames.len()), Vec::new());
    }
    let (mesh, mut report) = fuse(frames, &fusion).map_err(|error| advised(error.scaled(unit)))?;
    report.lengths = report.lengths.scaled(unit);
    let turn = |axis: UpAxis| Ok::<_, Error>(file_from_world(options.up, axis, dataset, 1.0)?.rotation());
    Ok(SceneMesh {
        mesh,
        report,
        views: views.len(),
        world_from_local: scene.world_from_local,
        file_from_world: [turn(UpAxis::MinusY)?, turn(UpAxis::PlusY)?],
        metres_per_unit: options.metres_per_unit.or(scene.metres_per_unit),
        color_space: options.color_space.unwrap_or(scene.color_space),
    })
}

/// Renders the depths and radiance of a view.
fn frame(scene: &Scene, view: &SurfaceView, space: Option<ColorSpace>, engine: &mut dyn Engine) -> Result<DepthFrame> {
    let options = RenderOptions { background: [0.0; 3], ..scene.render_options() };
    let image = engine.render(&view.camera, &options).context("cannot render a view")?;
    let once = RenderOptions { raster: RasterConfig { samples: 1, ..options.raster }, ..options };
    let surface = engine.render_surface(&view.camera, &once).context("cannot render the depths of a view")?;
    let space = space.unwrap_or(scene.color_space);
    let conversion = Conversion::between(scene.color_space, space);
    let width = surface.width;
    let count = surface.pixels.len();
    let mut frame = DepthFrame {
        camera: view.camera.clone(),
        depth: Vec::with_capacity(count),
        spread: Vec::with_capacity(count),
        alpha: Vec::with_capacity(count),
        radiance: Vec::with_capacity(count),
    };
    for (n, (pixel, radiance)) in surface.pixels.iter().zip(&image.pixels).enumerate() {
        let is_shown = view.is_shown(DVec2::new((n % width) as f64 + 0.5, (n / width) as f64 + 0.5));
        frame.depth.push(pixel.median_depth());
        frame.spread.push(pixel.spread());
        frame.alpha.push(if is_shown { pixel.alpha } else { 0.0 });
        // What is left of the background is no part of the surface.
        let whole = radiance.map(|c| c / pixel.alpha.max(luxel_mesh::LEAST_ALPHA));
        frame.radiance.push(conversion.apply(scene.color_space.towards(space, scene.radiance_scale.restored(whole))));
    }
    Ok(frame)
}

/// Returns an error of the fusion with what to do about it.
fn advised(error: MeshError) -> Error {
    let remedy = match &error {
        MeshError::TooFewFrames { .. } => Remedy::give("data").or(Remedy::give("cameras")),
        MeshError::NoSurface { .. } => Remedy::advice("give cameras that look at the scene").or(Remedy::raise("max_depth")),
        MeshError::TooLarge { .. } => Remedy::raise("voxel").or(Remedy::lower("max_depth")).or(Remedy::raise("memory")),
        MeshError::Empty { .. } => {
            Remedy::raise("voxel").or(Remedy::advice("give cameras whose views overlap")).or(Remedy::advice("train for longer"))
        }
        MeshError::OnlyIslands { .. } => Remedy::lower("min_island"),
        _ => return Error::wrap(error).context("cannot make a mesh"),
    };
    Error::wrap(error).context("cannot make a mesh").with_remedy(remedy)
}

impl SceneMesh {
    /// Returns the mesh in the world of the data set, and the colour space of its radiance.
    pub fn in_world(&self) -> (TriangleMesh, ColorSpace) {
        let mut mesh = self.turned(DMat3::IDENTITY);
        let translation = self.world_from_local.translation();
        mesh.positions.iter_mut().for_each(|p| *p = (Vec3::from(*p).as_dvec3() + translation).as_vec3().to_array());
        (mesh, self.color_space)
    }

    /// Returns the number of vertices.
    pub fn vertices(&self) -> usize {
        self.mesh.positions.len()
    }

    /// Returns the number of triangles.
    pub fn triangles(&self) -> usize {
        self.mesh.triangles.len()
    }

    /// Returns the colour space of the radiance.
    pub fn color_space(&self) -> ColorSpace {
        self.color_space
    }

    /// Returns the length of a unit of the files, metres; `None` if it is unknown.
    pub fn metres_per_unit(&self) -> Option<f64> {
        self.metres_per_unit
    }

    /// Writes a file; its extension is the format, one of [`EXTENSIONS`].
    ///
    /// # Errors
    /// Another extension; a mesh that the format cannot hold; the file system's refusal.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        crate::output::check_extension(path, &EXTENSIONS)?;
        let format = MeshFormat::from_path(path).unwrap_or(MeshFormat::Usda);
        let [minus_y, plus_y] = self.file_from_world;
        // As splats in PLY, whose axes are those of 3D Gaussian splatting.
        let rotation = if format == MeshFormat::Ply { minus_y } else { plus_y };
        let mesh = self.turned(rotation);
        let file = MeshFile {
            positions: &mesh.positions,
            normals: &mesh.normals,
            radiance: &mesh.radiance,
            triangles: &mesh.triangles,
            translation: (rotation * self.world_from_local.translation()).to_array(),
            metres_per_unit: self.metres_per_unit,
            color_space: self.color_space,
        };
        luxel_io::write_mesh(path, &file, format).context("cannot write the mesh")
    }

    /// Returns the mesh in the world's size and a file's axes, relative to the scene's own origin.
    fn turned(&self, file_from_world: DMat3) -> TriangleMesh {
        let turn = file_from_world * self.world_from_local.rotation();
        let rows = |rows: &[[f32; 3]], scale: f64| -> Vec<[f32; 3]> {
            rows.iter().map(|row| (scale * (turn * Vec3::from(*row).as_dvec3())).as_vec3().to_array()).collect()
        };
        TriangleMesh {
            positions: rows(&self.mesh.positions, self.world_from_local.scale()),
            normals: rows(&self.mesh.normals, 1.0),
            radiance: self.mesh.radiance.clone(),
            triangles: self.mesh.triangles.clone(),
        }
    }
}
