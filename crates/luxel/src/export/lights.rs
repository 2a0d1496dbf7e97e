//! The lamps of a scene, and the map of its other light, in an exported file.
//!
//! In: the scene before splats are chosen, so that what is cropped still lights. Out: lights in the
//! coordinates of the file, and in the units of its radiance: those of the data set, times the
//! exposure of a linear or exact bake. The axes of the map are the file's. Degenerate: formats that
//! hold no lights, and scenes without views, are errors.

use std::path::{Path, PathBuf};

use luxel_core::{ColorSpace, Dataset, Engine, Scene, Similarity};
use luxel_io::{Appearance, ExrSample, PackagedFile, StageLights};

use super::bake::Plan;
use super::format::Format;
use crate::lights::{LightOptions, SceneLights, lights_seen_by, map_path, measuring_cameras, no_cameras};
use crate::probe::Surroundings;
use crate::{Error, Observer, Remedy, Result};

/// Name of the map in a package.
const PACKAGED_MAP: &str = "lights_dome.exr";

/// Description of the lights in an exported file.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ExportedLights {
    /// Number of lamps.
    pub lamps: usize,
    /// The map beside the file; `None` if there is none, or if it is in the package.
    pub map: Option<PathBuf>,
    /// Part of the map's directions that no splat covers, solid angle over 4 pi.
    pub unseen_share: f64,
    /// Bright groups that stay in the map, with the reason.
    pub left_in_map: Vec<String>,
}

/// Checks whether the format of a path holds lights. [`super::export`] does so, too.
///
/// # Errors
/// A format that holds none.
pub fn check_lights(path: &Path) -> Result<()> {
    let format = Format::from_path(path)?;
    if format.is_usd() || format == Format::Glb {
        return Ok(());
    }
    let message = format!("{}: files of this format hold no lights, expected .usda, .usd, .usdc, .usdz or .glb", path.display());
    let remedy = Remedy::leave_out("lights").or(Remedy::advice("write the lights to a file of their own with luxel lights"));
    Err(Error::new(message).with_remedy(remedy))
}

/// Returns the place of the map beside a file; `None` for packages, which hold it.
pub fn exported_map(path: &Path) -> Option<PathBuf> {
    (Format::from_path(path).ok()? != Format::Usdz).then(|| map_path(path))
}

/// The lights of a file, and their map.
pub(super) struct FileLights {
    found: SceneLights,
    stage: StageLights,
}

impl FileLights {
    /// Finds the lights of a scene. The data set is in the scene's frame.
    ///
    /// # Errors
    /// A format that holds none; no views; a scene of display colours; a device that gave up.
    pub(super) fn find(
        file: (&Path, &Plan),
        options: &LightOptions,
        scene: &Scene,
        dataset: Option<&Dataset>,
        file_from_world: &Similarity,
        engine: &mut dyn Engine,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let (path, plan) = file;
        check_lights(path)?;
        let dataset = dataset.ok_or_else(no_cameras)?;
        let (color_space, exposure) = match plan.options.appearance {
            Appearance::Linear { color_space, exposure_ev } => (color_space, exposure_ev.exp2()),
            Appearance::Display { exposure_ev, .. } => (ColorSpace::LinearRec709, if plan.is_exact { exposure_ev.exp2() } else { 1.0 }),
        };
        let cd_m2_per_unit = options.cd_m2_per_unit.map(|nits| nits / f64::from(exposure));
        let options = LightOptions { color_space, cd_m2_per_unit, ..*options };
        let out_of_range = || Error::new("the exposure leaves no radiance scale that f32 holds");
        let radiance_scale = scene.radiance_scale.times(exposure).ok_or_else(out_of_range)?;
        let exposed = Scene { radiance_scale, ..scene.clone() };
        let surroundings = Surroundings::turned(file_from_world.rotation(), Some(dataset));
        let found = lights_seen_by(exposed, &measuring_cameras(dataset), surroundings, &options, engine, observer)?;
        let map = exported_map(path).map_or(Some(PACKAGED_MAP.to_owned()), |map| Some(map.file_name()?.to_string_lossy().into_owned()));
        let texture = found.dome.as_ref().and(map).map(|name| format!("./{name}"));
        let metres_per_unit = scene.metres_per_unit.map(|metres| metres / file_from_world.scale());
        let stage = found.stage(texture.as_deref(), file_from_world, metres_per_unit);
        Ok(Self { found, stage })
    }

    /// Returns the lights as writers of files take them.
    pub(super) fn stage(&self) -> &StageLights {
        &self.stage
    }

    /// Returns the map as a package holds it.
    pub(super) fn packaged_map(&self) -> Result<Option<PackagedFile>> {
        let map = |dome: &crate::Probe| Ok(PackagedFile { name: PACKAGED_MAP.to_owned(), bytes: dome.encode_exr(ExrSample::Float)? });
        self.found.dome.as_ref().map(map).transpose()
    }

    /// Writes the map beside a file that holds none, and describes the lights.
    pub(super) fn save_map(self, path: &Path) -> Result<ExportedLights> {
        let Self { found, .. } = self;
        let map = found.dome.as_ref().and_then(|dome| Some((dome, exported_map(path)?)));
        if let Some((dome, map)) = &map {
            dome.save_exr(map, ExrSample::Float)?;
        }
        Ok(ExportedLights {
            lamps: found.lights.len(),
            map: map.map(|(_, path)| path),
            unseen_share: found.unseen_share,
            left_in_map: found.left_in_map,
        })
    }
}
