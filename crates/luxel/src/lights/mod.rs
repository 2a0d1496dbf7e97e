//! The lamps of a scene, for programs that light with lamps: place, shape, power; and the rest of
//! its light as an environment map without them, so that nothing counts twice.
//!
//! In: a scene, the cameras of its training views, and an engine. Out: balls, discs and rectangles
//! in world coordinates and the units of the data set. A lamp is a group of splats whose pixels are
//! brighter than [`LightOptions::medians`] times the scene's median. Its power is fitted to what
//! all cameras that see it get from it, not read off one map: cameras measure light in directions
//! that training knows, and Lambert's law takes it to the others. What has no clear shape, or is so
//! far that the cameras see it from one side only, stays in the map.
//!
//! Degenerate: a scene of even light has no lamps; its map holds all of its light. Mirrors show
//! lamps that are not there, where they seem to be.

mod emitters;
mod fit;
mod measure;
mod table;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Engine, Scene, View};
use luxel_io::{ExrSample, IoError, LightShape, StageDome, StageLight, StageLights, write_atomically, write_lights};

use self::emitters::{Emitter, SeenView};
use self::fit::{Distribution, Fit, Sample};
pub use self::table::{lights_csv, lights_json};
use crate::error::{Context, ensure};
use crate::export::{Up, UpAxis, file_from_world, with_at_most};
use crate::probe::{Probe, ProbeOptions, Surroundings, probe_in};
use crate::run::FrameProgress;
use crate::{Observer, Result, text};

/// Views that are looked at, at an even stride, and pixels of each.
const MOST_VIEWS: usize = 64;
const MOST_PIXELS: u64 = 1 << 18;
/// Relative error of a fit from which on a lamp has no clear shape.
const UNCLEAR: f64 = 0.5;
/// Least number of cameras that must see a lamp.
const LEAST_CAMERAS: usize = 2;
/// A lamp that all cameras see within this angle is too far to be placed.
const LEAST_PARALLAX_DEG: f64 = 2.0;
/// Length over width from which on a flat lamp is a rectangle.
const LEAST_ASPECT: f64 = 1.6;
/// Weaker lamps than this part of the strongest stay in the map.
const LEAST_PART: f64 = 1e-3;

/// How lamps are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightOptions {
    /// A pixel shows a lamp if it is this many times as bright as the median.
    pub medians: f64,
    /// Most lamps; weaker ones stay in the map.
    pub most: usize,
    /// Primaries of radiance, linear.
    pub color_space: ColorSpace,
    /// The map of all other light; `None` for none.
    pub dome: Option<DomeOptions>,
}

impl Default for LightOptions {
    fn default() -> Self {
        Self { medians: 100.0, most: 32, color_space: ColorSpace::LinearRec709, dome: Some(DomeOptions::default()) }
    }
}

/// The map of all other light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DomeOptions {
    /// Its point, world; `None` for one between the cameras and what they look at.
    pub at: Option<[f64; 3]>,
    /// Width, pixels.
    pub width_px: usize,
    /// Whether directions that no splat covers get the median radiance of the training
    /// views.
    pub fill: bool,
    /// Direction of the scene that is up.
    pub up: Up,
}

impl Default for DomeOptions {
    fn default() -> Self {
        Self { at: None, width_px: 1024, fill: true, up: Up::Default }
    }
}

/// A lamp in the world.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AreaLight {
    /// Its middle.
    pub middle: [f64; 3],
    /// Its shape, lengths in units of the world.
    pub shape: LightShape,
    /// Radiance of its surface in the units of the data set.
    pub radiance: [f64; 3],
    /// Radiant intensity towards its normal, of a ball in any direction: radiance times squared
    /// length.
    pub intensity: [f64; 3],
    /// Radiant power: radiance times squared length times steradian.
    pub power: [f64; 3],
    /// Root mean square error of the intensity over its mean, among the cameras that see it.
    pub error: f64,
    /// Number of these cameras.
    pub cameras: usize,
    /// Number of its splats.
    pub splats: usize,
}

/// The light of a scene.
#[derive(Debug)]
#[non_exhaustive]
pub struct SceneLights {
    /// Its lamps, strongest first.
    pub lights: Vec<AreaLight>,
    /// All other light, if it was asked for.
    pub dome: Option<Probe>,
    /// Part of the map's directions that no splat covers, solid angle over 4 pi.
    pub unseen_share: f64,
    /// Bright groups that stay in the map, with the reason.
    pub left_in_map: Vec<String>,
    /// Primaries of radiance.
    pub color_space: ColorSpace,
    /// Luminance of a unit of radiance, cd/m2; `None` where the data set is not calibrated. It is
    /// stated in files and changes no number.
    pub cd_m2_per_unit: Option<f64>,
}

/// Finds the lamps of a scene and renders the rest of its light.
///
/// # Errors
/// A scene of display colours, no cameras, a device that gave up.
pub fn scene_lights(
    scene: Scene,
    dataset: &Dataset,
    options: &LightOptions,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<SceneLights> {
    let local = dataset.in_frame(scene.world_from_local);
    let views: &[View] = if local.train.is_empty() { &local.test } else { &local.train };
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
    let surroundings = Surroundings::new(options.dome.map_or(Up::Default, |dome| dome.up), Some(dataset))?;
    lights_seen_by(scene, &cameras, surroundings, options, engine, observer)
}

/// Finds the lamps that cameras see, and renders the rest of the light. Cameras are in the scene's
/// local coordinates; the surroundings decide over the map in place of its own up direction.
///
/// # Errors
/// Those of [`scene_lights`].
pub fn lights_seen_by(
    mut scene: Scene,
    cameras: &[Camera],
    surroundings: Surroundings,
    options: &LightOptions,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<SceneLights> {
    ensure!(
        scene.color_space.is_linear(),
        "the scene has colours of a display and not radiance: its lamps are cut off at white; take a scene that Luxel trained on HDR images"
    );
    let cameras = reduced(cameras);
    ensure!(!cameras.is_empty(), "no cameras: lamps are measured from the views of a data set");
    let views = rendered(&scene, &cameras, engine)?;
    let (found, left_in_map) = find(&scene, &views, options, engine, observer)?;
    let lights = found.iter().map(|found| in_world(found, &scene, options.color_space)).collect();
    let mut result =
        SceneLights { lights, dome: None, unseen_share: 0.0, left_in_map, color_space: options.color_space, cd_m2_per_unit: None };
    if let Some(dome) = &options.dome {
        for i in found.iter().flat_map(|found| &found.emitter.splats) {
            scene.splats.scale_gain(*i as usize, 0.0);
        }
        let at = dome.at.unwrap_or_else(|| scene.world_from_local.point(between(&cameras)).to_array());
        let map = ProbeOptions {
            width_px: dome.width_px,
            up: dome.up,
            color_space: Some(options.color_space),
            alpha: dome.fill,
            ..ProbeOptions::at(at)
        };
        let conversion = Conversion::between(scene.color_space, options.color_space);
        let typical = conversion.apply(scene.radiance_scale.restored(emitters::typical(&views)));
        let mut map = probe_in(scene, &map, surroundings, engine, observer)?;
        if dome.fill {
            result.unseen_share = map.fill_unseen(typical);
        }
        result.dome = Some(map);
    }
    Ok(result)
}

/// Extensions of files of lamps.
pub const EXTENSIONS: [&str; 4] = ["usda", "glb", "json", "csv"];

/// Returns the path of the map beside a file of lamps.
pub fn map_path(output: &Path) -> PathBuf {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!("{stem}_dome.exr"))
}

impl SceneLights {
    /// Writes the lamps; the extension is the format, one of [`EXTENSIONS`]. A map goes beside it,
    /// to [`map_path`]. `up` is the direction of the scene that is up.
    ///
    /// # Errors
    /// Another extension; an axis that is no unit vector; the file system's refusal.
    pub fn save(&self, path: impl AsRef<Path>, up: Up, dataset: &Dataset) -> Result<()> {
        let path = path.as_ref();
        crate::output::check_extension(path, &EXTENSIONS)?;
        let map = map_path(path);
        if let Some(dome) = &self.dome {
            dome.save_exr(&map, ExrSample::Float)?;
        }
        let text = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => format!("{:#}\n", lights_json(self)),
            Some("csv") => lights_csv(self),
            _ => {
                let texture = self.dome.as_ref().and(map.file_name()).map(|name| format!("./{}", name.to_string_lossy()));
                return Ok(write_lights(path, &self.stage(texture.as_deref(), up, dataset)?)?);
            }
        };
        write_atomically(path, |file| file.write_all(text.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))?;
        Ok(())
    }

    /// Returns the lights in the stage that `luxel export` puts the scene into: +y is up, lengths
    /// are the data set's. `dome` is the path of the map from the layer's folder.
    ///
    /// # Errors
    /// An axis that is no unit vector.
    pub fn stage(&self, dome: Option<&str>, up: Up, dataset: &Dataset) -> Result<StageLights> {
        let stage_from_world = file_from_world(up, UpAxis::PlusY, Some(dataset), 1.0)?.rotation();
        let lights = self.lights.iter().map(|light| StageLight {
            middle: stage_from_world * DVec3::from_array(light.middle),
            shape: light.shape.turned(stage_from_world),
            radiance: light.radiance,
        });
        Ok(StageLights {
            lights: lights.collect(),
            dome: dome.map(|texture| StageDome { texture: texture.to_owned() }),
            metres_per_unit: dataset.metres_per_unit,
            cd_m2_per_unit: self.cd_m2_per_unit,
            color_space: self.color_space,
        })
    }
}

/// A lamp as it is found, local coordinates of the scene and normalised radiance.
struct Found {
    emitter: Emitter,
    fit: Fit,
    cameras: usize,
}

/// Returns cameras at an even stride, reduced to a size that lamps are measured at.
fn reduced(cameras: &[Camera]) -> Vec<Camera> {
    let stride = cameras.len().div_ceil(MOST_VIEWS).max(1);
    cameras.iter().step_by(stride).map(|camera| with_at_most(camera, MOST_PIXELS)).collect()
}

/// Renders the views; the engine then holds the scene.
fn rendered(scene: &Scene, cameras: &[Camera], engine: &mut dyn Engine) -> Result<Vec<SeenView>> {
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    let seen = |camera: &Camera| {
        let image = engine.render(camera, &options).context("cannot render a view")?;
        Ok(SeenView { camera: camera.clone(), image })
    };
    cameras.iter().map(seen).collect()
}

/// Finds lamps, strongest first, and what stays in the map; `engine` holds the scene.
fn find(
    scene: &Scene,
    views: &[SeenView],
    options: &LightOptions,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<(Vec<Found>, Vec<String>)> {
    let render = scene.render_options();
    let threshold = emitters::threshold(views, options.medians);
    let groups = emitters::emitters(scene, views, threshold, &render, engine)?;
    let black = luxel_core::RenderOptions { background: [0.0; 3], ..render };
    let (mut found, mut left) = (Vec::new(), Vec::new());
    let mut progress = FrameProgress { observer, done: 0, total: groups.len() as u32 };
    for emitter in groups {
        let samples = measure::samples(scene, &emitter, views, &black, engine)?;
        progress.add(&format!("lamp {}", progress.done + 1), Vec::new());
        match clear(&samples) {
            Ok(fit) => found.push(Found { cameras: samples.len(), emitter, fit }),
            Err(why) => left.push(format!("{} around {}: {why}", text::plural(emitter.splats.len(), "splat"), place(scene, &emitter))),
        }
    }
    let strength = |found: &Found| found.fit.intensity.iter().sum::<f64>();
    found.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    let least = LEAST_PART * found.first().map_or(0.0, strength);
    found.retain(|one| strength(one) >= least);
    found.truncate(options.most);
    Ok((found, left))
}

/// Returns a group's middle in words, world coordinates.
fn place(scene: &Scene, emitter: &Emitter) -> String {
    scene.world_from_local.point(emitter.middle).to_array().map(|v| format!("{v:.3}")).join(",")
}

/// Returns the fit of a lamp that can be placed and has a clear shape, or why it has none.
fn clear(samples: &[Sample]) -> std::result::Result<Fit, String> {
    if samples.len() < LEAST_CAMERAS {
        return Err(format!("seen whole by {} of the cameras, expected {LEAST_CAMERAS} or more", samples.len()));
    }
    let mean = samples.iter().map(|sample| sample.towards).sum::<DVec3>().normalize_or_zero();
    let angle = samples.iter().map(|sample| sample.towards.dot(mean).clamp(-1.0, 1.0).acos().to_degrees()).fold(0.0, f64::max);
    if angle < LEAST_PARALLAX_DEG {
        return Err(format!("all cameras see it within {angle:.1} degrees of one direction, too few to place it"));
    }
    match fit::fit(samples) {
        Some(fit) if fit.error <= UNCLEAR => Ok(fit),
        Some(fit) => Err(format!("its light differs from camera to camera by {:.0} %, as that of reflections does", 100.0 * fit.error)),
        None => Err("no light towards any camera".to_owned()),
    }
}

/// Returns a lamp in the world, in the units of the data set.
fn in_world(found: &Found, scene: &Scene, color_space: ColorSpace) -> AreaLight {
    let Found { emitter, fit, cameras } = found;
    let frame = &scene.world_from_local;
    let area = fit.area * frame.scale() * frame.scale();
    let conversion = Conversion::between(scene.color_space, color_space);
    let radiance = fit.intensity.map(|i| (i / fit.area) as f32);
    let radiance = conversion.apply(scene.radiance_scale.restored(radiance)).map(f64::from);
    let shape = match fit.distribution {
        Distribution::Ball => LightShape::Sphere { radius: (area / std::f64::consts::PI).sqrt() },
        Distribution::Flat(normal) => flat_shape(emitter, scene, normal, area),
    };
    let intensity = radiance.map(|l| l * area);
    let solid_angle = match shape {
        LightShape::Sphere { .. } => 4.0 * std::f64::consts::PI,
        _ => std::f64::consts::PI,
    };
    AreaLight {
        middle: frame.point(emitter.middle).to_array(),
        shape,
        radiance,
        intensity,
        power: intensity.map(|i| solid_angle * i),
        error: fit.error,
        cameras: *cameras,
        splats: emitter.splats.len(),
    }
}

/// Returns the disc of an area (world), or the rectangle of it along the group's longer axis.
fn flat_shape(emitter: &Emitter, scene: &Scene, normal: DVec3, area: f64) -> LightShape {
    let side = normal.any_orthonormal_vector();
    let other = normal.cross(side);
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for (p, weight) in emitter.placed(scene) {
        let (x, y) = ((p - emitter.middle).dot(side), (p - emitter.middle).dot(other));
        (xx, xy, yy) = (xx + weight * x * x, xy + weight * x * y, yy + weight * y * y);
    }
    let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    let aspect = ((mean + half) / (mean - half).max(1e-6 * mean)).sqrt();
    let turn = scene.world_from_local.rotation();
    let normal = turn * normal;
    if !(LEAST_ASPECT..1e3).contains(&aspect) {
        return LightShape::Disk { radius: (area / std::f64::consts::PI).sqrt(), normal };
    }
    let (sin, cos) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
    let along = turn * (cos * side + sin * other);
    LightShape::Rect { size: [(area * aspect).sqrt(), (area / aspect).sqrt()], normal, along }
}

/// Returns a point halfway between the cameras and what they look at: the point nearest to all of
/// their axes.
fn between(cameras: &[Camera]) -> DVec3 {
    let middle = cameras.iter().map(Camera::eye).sum::<DVec3>() / cameras.len().max(1) as f64;
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let axis = camera.forward();
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        matrix += across;
        right += across * (camera.eye() - middle);
    }
    // Parallel axes meet nowhere.
    let aim = if matrix.determinant() > 1e-6 * (cameras.len() as f64).powi(3) { matrix.inverse() * right } else { DVec3::ZERO };
    middle + 0.5 * aim
}
