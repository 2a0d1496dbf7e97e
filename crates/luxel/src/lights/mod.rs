//! The lamps of a scene, for programs that light with lamps: place, shape, power; and the rest of
//! its light as an environment map without them, so that nothing counts twice.
//!
//! In: a scene, the cameras of its training views, and an engine. Out: balls, discs, rectangles and
//! meshes in world coordinates and the units of the data set. A lamp is a group of splats whose
//! pixels are brighter than [`LightOptions::medians`] times the scene's median. Its power is fitted
//! to what all cameras that see it get from it, not read off one map: cameras measure light in
//! directions that training knows, and Lambert's law takes it to the others. Long and bent lamps
//! become meshes. Groups whose light no shape explains, and those so far that the cameras see them
//! from one side only, stay in the map. Windows are fainter and larger, and found by their own
//! threshold; they become rectangles, or portals of the map.
//!
//! Degenerate: a scene of even light has no lamps; its map holds all of its light. Mirrors show
//! lamps that are not there, where they seem to be.

mod emitters;
mod find;
mod fit;
mod measure;
mod mesh_light;
mod placing;
mod table;
#[cfg(test)]
pub(crate) mod tests;
mod windows;

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Engine, Remedy, Scene, Similarity, View};
use luxel_io::{ExrSample, IoError, LightShape, StageDome, StageLight, StageLights, StagePortal, write_atomically, write_lights};

use self::emitters::SeenView;
use self::find::{Lamps, find};
pub use self::table::{lights_csv, lights_json};
use crate::camera_path::with_at_most;
use crate::error::{Context, ensure};
use crate::probe::{Probe, ProbeOptions, Surroundings, probe_in};
use crate::up::{Up, UpAxis, file_from_world};
use crate::{Error, Observer, Result};

/// Views that are looked at, at an even stride, and pixels of each.
const MOST_VIEWS: usize = 64;
const MOST_PIXELS: u64 = 1 << 18;

/// How lamps are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightOptions {
    /// A pixel shows a lamp if it is this many times as bright as the median.
    pub medians: f64,
    /// Windows and other large flat parts of the scene are found if they are this many times as
    /// bright as the median; `None` for none.
    pub windows: Option<WindowOptions>,
    /// Most lamps; weaker ones stay in the map.
    pub most: usize,
    /// Primaries of radiance, linear.
    pub color_space: ColorSpace,
    /// The map of all other light; `None` for none.
    pub dome: Option<DomeOptions>,
    /// Luminance of a unit of radiance, cd/m2; `None` where the data set is not calibrated. It is
    /// stated in files and changes no number.
    pub cd_m2_per_unit: Option<f64>,
}

impl Default for LightOptions {
    fn default() -> Self {
        let dome = Some(DomeOptions::default());
        let windows = Some(WindowOptions { medians: 30.0, are_portals: false });
        Self { medians: 100.0, windows, most: 32, color_space: ColorSpace::LinearRec709, dome, cd_m2_per_unit: None }
    }
}

/// How windows are found, and what they become.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowOptions {
    /// A pixel shows a window if it is this many times as bright as the median.
    pub medians: f64,
    /// Whether their light stays in the map, whose portals they are; else they are lamps.
    pub are_portals: bool,
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
    /// Radiant intensity towards its normal, of a ball in any direction, of a mesh in the mean of
    /// all directions: radiance times squared length.
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

/// An opening through which light of the map falls: a rectangle in the world, which helps a
/// renderer to find that light.
#[derive(Clone, Debug, PartialEq)]
pub struct Portal {
    /// Its middle.
    pub middle: [f64; 3],
    /// Its rectangle, whose normal is where the light goes; lengths in units of the world.
    pub shape: LightShape,
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
    /// Openings through which light of the map falls.
    pub portals: Vec<Portal>,
    /// Bright groups that stay in the map, with the reason.
    pub left_in_map: Vec<String>,
    /// Primaries of radiance.
    pub color_space: ColorSpace,
    /// [`LightOptions::cd_m2_per_unit`].
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
    let surroundings = Surroundings::new(options.dome.map_or(Up::Default, |dome| dome.up), Some(dataset))?;
    let local = dataset.in_frame(scene.world_from_local);
    lights_seen_by(scene, &measuring_cameras(&local), surroundings, options, engine, observer)
}

/// Returns the cameras of a data set that lamps are measured from: those of its training views.
pub(crate) fn measuring_cameras(dataset: &Dataset) -> Vec<Camera> {
    let views: &[View] = if dataset.train.is_empty() { &dataset.test } else { &dataset.train };
    views.iter().map(|view| view.camera.clone()).collect()
}

/// Returns the error of a scene without views.
pub fn no_cameras() -> Error {
    Error::new("no cameras: lamps are measured from the views of a data set").with_remedy(Remedy::give("data"))
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
    if cameras.is_empty() {
        return Err(no_cameras());
    }
    let views = rendered(&scene, &cameras, engine)?;
    let Lamps { lights, splats, portals, left_in_map } = find(&scene, &views, options, engine, observer)?;
    let LightOptions { color_space, cd_m2_per_unit, .. } = *options;
    let mut result = SceneLights { lights, dome: None, unseen_share: 0.0, portals, left_in_map, color_space, cd_m2_per_unit };
    if let Some(dome) = &options.dome {
        for i in splats {
            scene.splats.scale_gain(i as usize, 0.0);
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
                let stage_from_world = file_from_world(up, UpAxis::PlusY, Some(dataset), 1.0)?;
                return Ok(write_lights(path, &self.stage(texture.as_deref(), &stage_from_world, dataset.metres_per_unit))?);
            }
        };
        write_atomically(path, |file| file.write_all(text.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))?;
        Ok(())
    }

    /// Returns the lights in the coordinates of a file in which +y is up and a unit has
    /// `metres_per_unit`. `dome` is the path of the map, whose axes are the file's, from the file's
    /// folder.
    pub fn stage(&self, dome: Option<&str>, file_from_world: &Similarity, metres_per_unit: Option<f64>) -> StageLights {
        let (rotation, scale) = (file_from_world.rotation(), file_from_world.scale());
        let point = |middle: [f64; 3]| file_from_world.point(DVec3::from_array(middle));
        let placed = |shape: &LightShape| shape.clone().turned(rotation).scaled(scale);
        let light = |light: &AreaLight| StageLight { middle: point(light.middle), shape: placed(&light.shape), radiance: light.radiance };
        let portal = |portal: &Portal| StagePortal { middle: point(portal.middle), shape: placed(&portal.shape) };
        StageLights {
            lights: self.lights.iter().map(light).collect(),
            dome: dome.map(|texture| StageDome { texture: texture.to_owned() }),
            portals: self.portals.iter().map(portal).collect(),
            metres_per_unit,
            cd_m2_per_unit: self.cd_m2_per_unit,
            color_space: self.color_space,
        }
    }
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
