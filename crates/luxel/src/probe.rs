//! A light probe: the radiance that arrives at a point of a scene, as an environment map.
//!
//! In: a scene, a point, and the data set for the up direction and the resolution of training. Out:
//! a map in the units of the data set, with its light summed up. Axes are those of OpenEXR: +y is
//! up, and a latitude-longitude map looks along +z in its middle. Degenerate: without a data set
//! the map's own resolution is rendered, at which small lights may be off.

use std::path::Path;

use glam::DVec3;
use luxel_core::environment::{MapSize, Projection, Rig, Summary};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Engine, Image, RadianceScale, RenderOptions, Scene};
use luxel_io::{ExrOptions, ExrSample};

use crate::error::Context;
use crate::export::{Up, UpAxis, file_from_world};
use crate::radiance::RADIANCE_SCALE;
use crate::run::FrameProgress;
use crate::{Observer, Result, output};

/// Options of a probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeOptions {
    /// The point, world coordinates.
    pub at: [f64; 3],
    /// Kind of map.
    pub projection: Projection,
    /// Width of a latitude-longitude map, or of a face of a cube; pixels.
    pub width_px: usize,
    /// Splats whose centre is nearer to the point than this are left out, world units.
    pub near: Option<f32>,
    /// Direction of the scene that is up.
    pub up: Up,
    /// Colour space of the map; `None` for that of the scene.
    pub color_space: Option<ColorSpace>,
    /// Radiance of the background in normalised units.
    pub background: [f32; 3],
}

impl ProbeOptions {
    /// Returns a latitude-longitude map of 2048 pixels at a point, with a black background.
    pub fn at(at: [f64; 3]) -> Self {
        let (projection, up) = (Projection::LatitudeLongitude, Up::Default);
        Self { at, projection, width_px: 2048, near: None, up, color_space: None, background: [0.0; 3] }
    }
}

/// An environment map in the units of the data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// The map.
    image: Image,
    at: [f64; 3],
    projection: Projection,
    color_space: ColorSpace,
    radiance_scale: RadianceScale,
    /// Its light: means, peak, irradiance.
    pub summary: Summary,
    /// Number of splats left out near the point.
    pub left_out: usize,
    /// Whether the map was rendered at the resolution of training.
    pub has_training_resolution: bool,
}

impl Probe {
    /// Returns the width in pixels.
    pub fn width(&self) -> usize {
        self.image.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> usize {
        self.image.height
    }

    /// Returns the map, `[H,W,3]` in the units of the data set.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Returns the pixels `[H*W]`, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.image.pixels
    }

    /// Returns the colour space of the pixels.
    pub fn color_space(&self) -> ColorSpace {
        self.color_space
    }

    /// Writes an OpenEXR file that names its projection, colour space and point. Returns how many
    /// values exceed the range of the samples.
    ///
    /// # Errors
    /// The file system's refusal.
    pub fn save_exr(&self, path: impl AsRef<Path>, sample: ExrSample) -> Result<usize> {
        output::check_extension(path.as_ref(), &["exr"])?;
        let [x, y, z] = self.at;
        let options = ExrOptions {
            sample,
            color_space: self.color_space,
            environment: Some(self.projection),
            numbers: vec![(RADIANCE_SCALE.into(), self.radiance_scale.get())],
            attributes: vec![("luxel:at".into(), format!("{x}, {y}, {z}"))],
            ..ExrOptions::default()
        };
        luxel_io::write_exr(path.as_ref(), &self.image, &options).context("cannot write the probe")
    }
}

/// Memory for a pixel of the map: its sums in double precision, the image, and the file.
const BYTES_PER_PIXEL: u64 = 60;

/// Renders the probe of a scene.
///
/// # Errors
/// A device that gave up; a point at which nothing can be rendered.
pub fn probe(
    mut scene: Scene,
    options: &ProbeOptions,
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<Probe> {
    let pixels = options.width_px * options.projection.height(options.width_px);
    let work = format!("a probe {} pixels wide", options.width_px);
    crate::memory::check(&work, pixels as u64 * BYTES_PER_PIXEL, "make a smaller map")?;
    let environment_from_world = file_from_world(options.up, UpAxis::PlusY, dataset, 1.0)?.rotation();
    let focal_px = dataset.and_then(median_focal_px);
    let local_from_world = scene.world_from_local.inverse();
    let left_out = leave_out_near(&mut scene, options);
    let (projection, width) = (options.projection, options.width_px);
    let rig =
        Rig::new(local_from_world.point(DVec3::from_array(options.at)), environment_from_world, MapSize { projection, width }, focal_px);
    let mut image = render(&rig, &scene, options.background, engine, observer)?;
    let color_space = options.color_space.unwrap_or(scene.color_space);
    let conversion = Conversion::between(scene.color_space, color_space);
    for pixel in &mut image.pixels {
        *pixel = conversion.apply(scene.radiance_scale.restored(*pixel));
    }
    let summary = Summary::new(&image, projection);
    let has_training_resolution = focal_px.is_some();
    Ok(Probe {
        image,
        at: options.at,
        projection,
        color_space,
        radiance_scale: scene.radiance_scale,
        summary,
        left_out,
        has_training_resolution,
    })
}

/// Returns the median focal length of the training views in pixels.
fn median_focal_px(dataset: &Dataset) -> Option<f64> {
    let mut focal: Vec<f64> = dataset.train.iter().map(|view| view.camera.focal_px.x).collect();
    focal.sort_unstable_by(f64::total_cmp);
    focal.get(focal.len() / 2).copied()
}

/// Removes splats whose centre is near, and counts them.
fn leave_out_near(scene: &mut Scene, options: &ProbeOptions) -> usize {
    let Some(radius) = options.near else { return 0 };
    let local_from_world = scene.world_from_local.inverse();
    let (at, radius) = (local_from_world.point(DVec3::from_array(options.at)), f64::from(radius) * local_from_world.scale());
    let is_far = |p: [f32; 3]| DVec3::from_array(p.map(f64::from)).distance(at) >= radius;
    let before = scene.splats.len();
    let kept: Vec<u32> = (0..before as u32).filter(|i| is_far(scene.splats.position[*i as usize])).collect();
    scene.splats = scene.splats.select(kept);
    before - scene.splats.len()
}

/// Renders a map in normalised units, face by face.
fn render(rig: &Rig, scene: &Scene, background: [f32; 3], engine: &mut dyn Engine, observer: &dyn Observer) -> Result<Image> {
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = RenderOptions { background, ..scene.render_options() };
    let mut map = rig.empty_map();
    let total = rig.faces().map(<[_]>::len).sum::<usize>();
    let mut progress = FrameProgress { observer, done: 0, total: u32::try_from(total).unwrap_or(u32::MAX) };
    for (face, cameras) in rig.faces().enumerate() {
        let mut render = |camera: &Camera| {
            let image = engine.render(camera, &options).context("cannot render the probe")?;
            progress.add(&format!("face {}", face + 1), Vec::new());
            Ok(image)
        };
        let renders: Result<Vec<Image>> = cameras.iter().map(&mut render).collect();
        map.add_face(rig, face, &renders?);
    }
    Ok(map.into_image(rig))
}
