//! Export of a scene as a file for other programs.
//!
//! In: a scene, and views of a data set if there are any. Splats are chosen, exposed for a display,
//! baked, refined if asked for, and measured in the world of the data set. Out: a file in the world
//! of its format, and an [`Exported`] that describes it.

mod bake;
mod error;
mod exposure;
mod format;
mod gain;
mod lights;
mod prune;
mod refine;
#[cfg(test)]
mod tests;
mod world;

use std::path::Path;

use glam::{DMat3, DVec3};
use luxel_core::{ColorSpace, Dataset, Engine, Scene, Similarity, text};
use luxel_io::{Appearance, Baked, SpzPositions, SpzVersion};

use self::bake::Plan;
pub use self::bake::{Bake, BakeKind};
pub use self::error::{BakeError, BakeErrorValues};
pub use self::format::Format;
use self::lights::FileLights;
pub use self::lights::{ExportedLights, check_lights, exported_map};
use self::refine::Refinement;
pub use self::refine::{DEFAULT_REFINE_STEPS, check_refinement_room, write_with_refined_display};
pub use self::world::FileScale;
use self::world::placement;
use crate::error::{Context, bail};
use crate::lights::LightOptions;
pub use crate::up::{Up, UpAxis, file_from_world, up_of_cameras};
use crate::{Error, Observer, Remedy, Result};

/// A box along the axes, corners included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CropBox {
    /// Lower corner, world.
    pub low: [f64; 3],
    /// Upper corner, world.
    pub high: [f64; 3],
}

impl CropBox {
    /// Returns the box between two opposite corners.
    pub fn between(a: [f64; 3], b: [f64; 3]) -> Self {
        Self { low: [0, 1, 2].map(|i| f64::min(a[i], b[i])), high: [0, 1, 2].map(|i| f64::max(a[i], b[i])) }
    }

    /// Returns whether a point is inside.
    pub fn contains(self, point: [f64; 3]) -> bool {
        (0..3).all(|axis| self.low[axis] <= point[axis] && point[axis] <= self.high[axis])
    }
}

/// Options of an export.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExportOptions {
    /// Colours.
    pub bake: Bake,
    /// Only splats whose centre is in this box, world.
    pub crop: Option<CropBox>,
    /// Only this many splats: those that contribute most to the views, or without views by opacity
    /// and size.
    pub max_splats: Option<u64>,
    /// Splats that are longer than this times their width are shortened to it.
    pub max_aspect: Option<f32>,
    /// Point that becomes the origin of the file, world; `None` for the world's.
    pub origin: Option<[f64; 3]>,
    /// Rotation of the scene about the origin, before [`Self::up`].
    pub rotation: DMat3,
    /// Direction of the turned scene that is up.
    pub up: Up,
    /// Lengths of the file.
    pub scale: FileScale,
    /// Length of a unit of the scene, metres; `None` for what its data set states.
    pub metres_per_unit: Option<f64>,
    /// Version of an SPZ file.
    pub spz_version: SpzVersion,
    /// The scene's lights, which OpenUSD and glTF hold beside the splats; their colour space is
    /// that of the file, the axes of the map are, too.
    pub lights: Option<LightOptions>,
}

impl Default for ExportOptions {
    fn default() -> Self {
        let (bake, up) = (Bake::default(), Up::default());
        Self {
            bake,
            crop: None,
            max_splats: None,
            max_aspect: None,
            origin: None,
            rotation: DMat3::IDENTITY,
            up,
            scale: FileScale::Factor(1.0),
            metres_per_unit: None,
            spz_version: SpzVersion::default(),
            lights: None,
        }
    }
}

/// Description of an exported file.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Exported {
    /// Number of splats.
    pub splats: usize,
    /// Size of the file.
    pub file_bytes: u64,
    /// The bake in words.
    pub bake: String,
    /// Colour space of a linear bake; `None` for sRGB of a display.
    pub color_space: Option<ColorSpace>,
    /// Name of the exact model beside the bake and its colour space.
    pub exact_model: Option<(String, ColorSpace)>,
    /// Number of splats whose size an SPZ file cannot hold.
    pub sizes_out_of_range: usize,
    /// The effect of the grid of positions of an SPZ or SOG file on the splats.
    pub positions: Option<SpzPositions>,
    /// Error of the bake on the views; `None` without a data set.
    pub error: Option<BakeError>,
    /// The place that positions in the file are relative to, world; `None` if it is the world's
    /// origin.
    pub origin: Option<[f64; 3]>,
    /// From the world of the data set to that of the file.
    pub file_from_world: Similarity,
    /// Length of a unit of the file, metres; `None` if it is unknown.
    pub metres_per_unit: Option<f64>,
    /// The lights in it, if they were asked for.
    pub lights: Option<ExportedLights>,
}

/// Exports `scene` to `path`. The data set's views measure the bake, and refine and prune it if
/// asked for.
///
/// # Errors
/// Options that contradict each other or the format; a box without splats; a device that gave up;
/// the file system's refusal.
pub fn export(
    mut scene: Scene,
    path: &Path,
    options: &ExportOptions,
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<Exported> {
    let mut plan = options.bake.plan(path, &scene)?;
    scene.metres_per_unit = options.metres_per_unit.or(scene.metres_per_unit);
    world::move_to_origin(&mut scene, options.origin)?;
    let dataset = dataset.map(|dataset| dataset.in_frame(scene.world_from_local));
    let dataset = dataset.as_deref();
    let similarity = placement(options, plan.format.up_axis(), dataset, scene.metres_per_unit)?;
    let find = |lights| FileLights::find((path, &plan), lights, &scene, dataset, &similarity, engine, observer);
    let lights = options.lights.as_ref().map(find).transpose()?;
    choose_splats(&mut scene, options, dataset, engine, observer)?;
    let is_kept = plan.options.appearance.keeps(scene.color_space);
    if is_kept {
        observer.note(
            "the colours of the scene are a display's (sRGB) and stay what they are; a tone curve, an exposure or a linear colour space changes them",
        );
    }
    if let (Appearance::Display { exposure_ev, .. }, Some(dataset), true) =
        (&mut plan.options.appearance, dataset, scene.color_space.is_linear())
        && let Some(found) = exposure::from_views(&scene, dataset, engine)?
    {
        *exposure_ev += (found / luxel_io::display_exposure(&scene)).log2();
    }
    let mut baked = Baked::new(&scene, &plan.options);
    let is_display = matches!(plan.options.appearance, Appearance::Display { .. });
    match (options.bake.refine_steps, dataset) {
        (Some(0), _) => {}
        (Some(steps), Some(dataset)) => refine::refine(&mut baked, &scene, dataset, Refinement::explicit(steps), engine, observer)?,
        (None, _) if is_kept => {}
        (Some(_), None) => return Err(Error::new("refinement needs views to compare with").with_remedy(Remedy::give("data"))),
        (None, Some(dataset)) if is_display => refine::refine(&mut baked, &scene, dataset, Refinement::DEFAULT, engine, observer)?,
        (None, None) if is_display => observer.note("no data set: the display bake is not refined, for which views are needed"),
        (None, _) => {}
    }
    let error = dataset.map(|dataset| error::measure(&scene, &baked, dataset, engine)).transpose()?;
    baked.transform(&similarity);
    if plan.is_exact {
        Similarity::scaling(scene.world_from_local.scale()).then(&similarity.linear()).apply(&mut scene.splats);
        let shifted = scene.radiance_scale.times(options.bake.exposure_ev.exp2());
        scene.radiance_scale = shifted.ok_or_else(|| Error::new("the exposure leaves no radiance scale that f32 holds"))?;
    }
    let kept = if plan.is_exact { Some(&scene) } else { None };
    let mut cut_off_as_trained = if kept.is_none() { linear_with_gains(&plan, &scene, &similarity) } else { None };
    if plan.format.is_usd() {
        // Which holds both in one scene.
        baked.scene = cut_off_as_trained.take().unwrap_or(baked.scene);
    }
    write(path, &plan, kept.or(cut_off_as_trained.as_ref()), &baked, options.spz_version, lights.as_ref())?;
    let lights = lights.map(|lights| lights.save_map(path)).transpose()?;
    Ok(Exported { lights, ..describe(path, &plan, &scene, &baked, error) })
}

/// Returns the linear bake of an edited scene before its gains, with them: beside the bake it keeps
/// the cut-offs of the scene for renders here.
fn linear_with_gains(plan: &Plan, scene: &Scene, similarity: &Similarity) -> Option<Scene> {
    let is_linear = matches!(plan.options.appearance, Appearance::Linear { .. });
    if !is_linear || scene.splats.gain.is_empty() {
        return None;
    }
    let mut trained = scene.clone();
    let gain = std::mem::take(&mut trained.splats.gain);
    let mut baked = Baked::new(&trained, &plan.options);
    baked.transform(similarity);
    let splats = &mut baked.scene.splats;
    splats.gain = gain;
    if plan.format == Format::Glb {
        // As glTF holds them: with gains and without, the splats are the same.
        splats.log_scale.as_flattened_mut().iter_mut().for_each(|s| *s = s.exp().max(f32::MIN_POSITIVE).ln());
        splats.opacity_logit.iter_mut().for_each(|o| *o = luxel_core::logit(luxel_core::sigmoid(*o)));
    }
    Some(baked.scene)
}

/// Keeps the splats of `scene` that the options choose: `crop`, `max_splats`, `max_aspect`. The
/// data set, in the frame of the scene, tells what its views see most of.
///
/// # Errors
/// A box without splats; a device that gave up.
pub fn choose_splats(
    scene: &mut Scene,
    options: &ExportOptions,
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<()> {
    let before = scene.splats.len();
    prune::crop(scene, options.crop);
    if let Some(most) = options.max_aspect {
        let count = scene.splats.limit_aspect(most);
        observer.note(&format!("{} longer than {most} times their width, shortened to that", text::plural(count, "splat")));
    }
    prune::limit(scene, options.max_splats, dataset, engine, observer)?;
    if scene.splats.is_empty() {
        if before == 0 {
            bail!("the scene has no splats, so there is nothing to export");
        }
        let error = Error::new(format!("no splats are left of {}", text::plural(before, "splat")));
        return Err(error.with_remedy(Remedy::advice("take a larger box").or(Remedy::leave_out("crop"))));
    }
    Ok(())
}

fn write(
    path: &Path,
    plan: &Plan,
    exact: Option<&Scene>,
    baked: &Baked,
    spz_version: SpzVersion,
    lights: Option<&FileLights>,
) -> Result<()> {
    let stage = lights.map(FileLights::stage);
    let written = match plan.format {
        Format::Ply => match exact {
            Some(scene) => luxel_io::write_exact_ply(path, scene, baked),
            None => luxel_io::write_baked_ply(path, baked),
        },
        Format::Usda => luxel_io::write_usda(path, baked, stage),
        Format::Usdc => luxel_io::write_usdc(path, baked, stage),
        Format::Usdz => {
            let map = lights.map(FileLights::packaged_map).transpose()?.flatten();
            luxel_io::write_usdz(path, baked, stage, map.as_ref())
        }
        Format::Glb => luxel_io::write_glb(path, baked, exact, stage),
        Format::Spz => luxel_io::write_spz(path, baked, spz_version),
        Format::Sog => luxel_io::write_sog(path, baked),
    };
    written.context("cannot write the scene")
}

fn describe(path: &Path, plan: &Plan, scene: &Scene, baked: &Baked, error: Option<BakeError>) -> Exported {
    let origin = scene.world_from_local.translation();
    let positions = match plan.format {
        Format::Spz => Some(luxel_io::spz_positions(baked)),
        Format::Sog => Some(luxel_io::sog_positions(baked)),
        _ => None,
    };
    Exported {
        splats: scene.splats.len() - positions.map_or(0, |positions| positions.left_out),
        positions,
        file_bytes: std::fs::metadata(path).map_or(0, |m| m.len()),
        bake: baked.description(),
        color_space: match plan.options.appearance {
            Appearance::Linear { color_space, .. } => Some(color_space),
            Appearance::Display { .. } => None,
        },
        exact_model: plan.is_exact.then(|| (scene.splats.color_model.name(), scene.color_space)),
        sizes_out_of_range: if plan.format == Format::Spz { luxel_io::spz_out_of_range(baked) } else { 0 },
        error,
        origin: (origin != DVec3::ZERO).then(|| origin.to_array()),
        file_from_world: baked.file_from_world,
        metres_per_unit: baked.metres_per_unit(),
        lights: None,
    }
}
