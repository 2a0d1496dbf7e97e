//! A light probe: the radiance that arrives at a point of a scene, as an environment map.
//!
//! In: a scene, a point, and the data set for the up direction and the resolution of training. Out:
//! a map in the units of the data set, with its light summed up. Axes are those of OpenEXR: +y is
//! up, and a latitude-longitude map looks along +z in its middle. Degenerate: without a data set
//! the map's own resolution is rendered, at which small lights may be off.

use std::path::Path;

use glam::{DMat3, DVec3};
use luxel_core::environment::{Light, MapSize, PanoramaRig, PartialPanorama, Projection, Summary, lights};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Engine, Image, Layers, RadianceScale, RenderOptions, Scene, text};
use luxel_io::{ExrOptions, ExrSample};

use crate::error::Context;
use crate::preview::{self, Look};
use crate::radiance::RADIANCE_SCALE;
use crate::up::{Up, UpAxis, file_from_world};
use crate::visibility::visibility_of;
use crate::{FrameProgress, Observer, Renderer, Result, output};

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
    /// Whether the coverage of each pixel is computed, too; the CPU engine can.
    pub alpha: bool,
}

impl ProbeOptions {
    /// Returns a latitude-longitude map of 2048 pixels at a point, with a black background.
    pub fn at(at: [f64; 3]) -> Self {
        let (projection, up) = (Projection::LatitudeLongitude, Up::Default);
        Self { at, projection, width_px: 2048, near: None, up, color_space: None, background: [0.0; 3], alpha: false }
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
    /// Coverage of each pixel by splats `[H*W]`, if it was asked for.
    alpha: Option<Vec<f32>>,
    /// Its light: means, peak, irradiance.
    pub summary: Summary,
    /// Its lamps, strongest first.
    pub lights: Vec<Light>,
    /// Number of splats left out near the point.
    pub left_out: usize,
    /// Whether the map was rendered at the resolution of training.
    pub has_training_resolution: bool,
    /// Rotation from directions of the world to the axes of the map.
    pub map_from_world: DMat3,
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

    /// Returns the coverage of each pixel by splats `[H*W]`, if it was asked for.
    pub fn alpha(&self) -> Option<&[f32]> {
        self.alpha.as_deref()
    }

    /// Returns the pixels `[H*W]`, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.image.pixels
    }

    /// Writes a tone-mapped preview: the scene's radiance scale is shown as 1 at exposure 0.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save_preview(&self, path: &Path, look: &Look) -> Result<()> {
        let mut image = self.image.clone();
        image.pixels.iter_mut().for_each(|pixel| *pixel = self.radiance_scale.normalised(*pixel));
        preview::write(path, &image, self.color_space, look)
    }

    /// Gives directions that no splat covers this radiance, and returns their part of the sphere.
    /// Without coverage nothing changes.
    pub(crate) fn fill_unseen(&mut self, radiance: [f32; 3]) -> f64 {
        let Some(alpha) = &self.alpha else { return 0.0 };
        let (width, mut open) = (self.image.width, 0.0);
        for (i, (pixel, alpha)) in self.image.pixels.iter_mut().zip(alpha).enumerate() {
            let part = 1.0 - alpha.clamp(0.0, 1.0);
            open += f64::from(part) * self.projection.solid_angle([i % width, i / width], width);
            pixel.iter_mut().zip(radiance).for_each(|(value, fill)| *value += part * fill);
        }
        self.summary = Summary::new(&self.image, self.projection);
        open / (4.0 * std::f64::consts::PI)
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
        luxel_io::write_exr(path.as_ref(), &self.image, &self.exr_options(sample)).context("cannot write the probe")
    }

    /// Encodes the file that [`Self::save_exr`] writes, into memory.
    ///
    /// # Errors
    /// A map without pixels.
    pub fn encode_exr(&self, sample: ExrSample) -> Result<Vec<u8>> {
        luxel_io::encode_exr(Path::new("probe.exr"), &self.image, &self.exr_options(sample)).context("cannot encode the probe")
    }

    fn exr_options(&self, sample: ExrSample) -> ExrOptions {
        let [x, y, z] = self.at;
        ExrOptions {
            sample,
            color_space: self.color_space,
            alpha: self.alpha.clone(),
            environment: Some(self.projection),
            numbers: vec![(RADIANCE_SCALE.into(), self.radiance_scale.get())],
            attributes: vec![("luxel:at".into(), format!("{x}, {y}, {z}"))],
            ..ExrOptions::default()
        }
    }
}

/// Memory for a pixel of the map: its sums in double precision, the image, and the file.
const BYTES_PER_PIXEL: u64 = 60;

/// Returns a light as JSON documents have it.
pub fn light_json(light: &Light) -> serde_json::Value {
    serde_json::json!({
        "direction": light.direction, "solid_angle_sr": light.solid_angle, "radiance": light.radiance,
        "peak_radiance": light.peak_radiance, "irradiance": light.irradiance,
    })
}

/// Renders the probe of a scene.
///
/// # Errors
/// A device that gave up; a point at which nothing can be rendered.
pub fn probe(
    scene: Scene,
    options: &ProbeOptions,
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<Probe> {
    probe_in(scene, options, Surroundings::new(options.up, dataset)?, engine, observer)
}

/// Renders a probe in surroundings that are known.
pub(crate) fn probe_in(
    mut scene: Scene,
    options: &ProbeOptions,
    surroundings: Surroundings,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<Probe> {
    let left_out = leave_out_near(&mut scene, options);
    let mut work = ProbeWork { left_out, ..ProbeWork::new(&scene, options, surroundings)? };
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let render_options = RenderOptions { background: options.background, ..scene.render_options() };
    let mut progress = FrameProgress { observer, done: 0, total: u32::try_from(work.cameras()).unwrap_or(u32::MAX) };
    while !work.is_done() {
        let name = format!("part {}", work.cameras_done() + 1);
        work.render_camera(|camera| {
            let layers = match options.alpha {
                true => engine.render_layers(camera, &render_options),
                false => engine.render(camera, &render_options).map(|image| Layers { image, ..Layers::default() }),
            };
            layers.context("cannot render the probe")
        })?;
        progress.add(&name, Vec::new());
    }
    Ok(work.finish())
}

/// Returns what is wrong with a point (world) that none of the cameras (local coordinates of the
/// scene) saw: the map would show what is behind what was photographed. `None` for one in sight,
/// and without cameras.
pub fn unseen(scene: &Scene, cameras: &[&Camera], at: [f64; 3]) -> Option<String> {
    let frame = &scene.world_from_local;
    let found = visibility_of(scene, cameras, frame.inverse().point(DVec3::from_array(at)))?;
    if found.seen > 0 {
        return None;
    }
    let [x, y, z] = frame.point(found.nearest_camera).to_array().map(|v| (1e6 * v).round() / 1e6);
    let why = match found.in_view {
        0 => "is in no image of the data set".to_owned(),
        n => format!("is hidden in {} that it is in", text::plural(n, "image")),
    };
    Some(format!(
        "the point {why}: the map shows the scene from where no camera saw it; choose a point in sight of the cameras, of which the nearest is \
         at {x},{y},{z}"
    ))
}

/// Facts of a data set that decide a probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    environment_from_world: DMat3,
    /// Median focal length of the training views, pixels.
    focal_px: Option<f64>,
}

impl Surroundings {
    /// Returns the up direction and the resolution of training.
    ///
    /// # Errors
    /// An up direction that cannot be used.
    pub fn new(up: Up, dataset: Option<&Dataset>) -> Result<Self> {
        let environment_from_world = file_from_world(up, UpAxis::PlusY, dataset, 1.0)?.rotation();
        Ok(Self::turned(environment_from_world, dataset))
    }

    /// Returns the resolution of training, with a rotation from the world to the axes of the map.
    pub(crate) fn turned(environment_from_world: DMat3, dataset: Option<&Dataset>) -> Self {
        Self { environment_from_world, focal_px: dataset.and_then(median_focal_px) }
    }
}

/// A probe under way: a panorama, rendered band by band, so that other work is possible in between.
#[derive(Debug)]
pub struct ProbeWork {
    rig: PanoramaRig,
    map: PartialPanorama,
    /// Number of bands that are rendered.
    done: usize,
    options: ProbeOptions,
    space: ColorSpace,
    radiance_scale: RadianceScale,
    left_out: usize,
    has_training_resolution: bool,
    map_from_world: DMat3,
}

impl ProbeWork {
    /// Begins a probe of a scene; `near` of the options is not looked at.
    ///
    /// # Errors
    /// A map that does not fit into memory.
    pub fn new(scene: &Scene, options: &ProbeOptions, surroundings: Surroundings) -> Result<Self> {
        let (projection, width) = (options.projection, options.width_px);
        let bytes = (width * projection.height(width)) as u64 * BYTES_PER_PIXEL;
        crate::memory::check(&format!("a probe {width} pixels wide"), bytes, "make a smaller map")?;
        let Surroundings { environment_from_world, focal_px } = surroundings;
        let at = scene.world_from_local.inverse().point(DVec3::from_array(options.at));
        let rig = PanoramaRig::new(at, environment_from_world, MapSize { projection, width }, focal_px);
        Ok(Self {
            map: rig.empty_map(),
            rig,
            done: 0,
            options: *options,
            space: scene.color_space,
            radiance_scale: scene.radiance_scale,
            left_out: 0,
            has_training_resolution: focal_px.is_some(),
            map_from_world: environment_from_world,
        })
    }

    /// Returns the number of cameras of the whole probe.
    pub fn cameras(&self) -> usize {
        self.rig.cameras.len()
    }

    /// Returns the number of cameras that are rendered.
    pub fn cameras_done(&self) -> usize {
        self.done
    }

    /// Returns whether all cameras are rendered.
    pub fn is_done(&self) -> bool {
        self.done >= self.cameras()
    }

    /// Renders the next camera with the renderer of the scene that the probe was begun for.
    ///
    /// # Errors
    /// A device that gave up.
    pub fn render_next(&mut self, renderer: &mut Renderer) -> Result<()> {
        self.render_camera(|camera| Ok(Layers { image: renderer.render_normalised(camera)?, ..Layers::default() }))
    }

    /// Renders the next camera; `render` returns layers in normalised units, with an empty alpha
    /// where none is needed.
    fn render_camera(&mut self, render: impl FnOnce(&Camera) -> Result<Layers>) -> Result<()> {
        if let Some(camera) = self.rig.cameras.get(self.done) {
            let Layers { image, alpha, .. } = render(camera)?;
            self.map.add_band(&self.rig, self.done, &image, (!alpha.is_empty()).then_some(&alpha));
            self.done += 1;
        }
        Ok(())
    }

    /// Returns the probe in the units of the data set.
    pub fn finish(self) -> Probe {
        let Self { rig, map, options, space, radiance_scale, left_out, has_training_resolution, map_from_world, .. } = self;
        let (projection, at) = (options.projection, options.at);
        let (mut image, alpha) = map.into_map(&rig);
        let alpha = options.alpha.then_some(alpha);
        // Maps are of light, whatever the scene is of.
        let color_space = options.color_space.unwrap_or(space.linear());
        let conversion = Conversion::between(space, color_space);
        for pixel in &mut image.pixels {
            *pixel = conversion.apply(space.towards(color_space, radiance_scale.restored(*pixel)));
        }
        let (summary, lights) = (Summary::new(&image, projection), lights(&image, projection));
        Probe {
            image,
            alpha,
            at,
            projection,
            color_space,
            radiance_scale,
            summary,
            lights,
            left_out,
            has_training_resolution,
            map_from_world,
        }
    }
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
