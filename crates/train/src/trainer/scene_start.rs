//! The start of a run from a scene.
//!
//! In: a scene, the data set, options. Out: the splats of the first step, in the scene's order.
//! Degenerate: a scene of other coordinates, units or colours than the data set and the options ask
//! for is an error.

use luxel_core::{ColorModel, Cutoffs, Dataset, Knots, RasterConfig, Remedy, Scene};

use crate::config::CutoffPreset;
use crate::init::{Initial, radiance_scale_of, recolored};
use crate::{Method, NamedChoice, TrainConfig, TrainError};

/// Relative difference of lengths of a unit that counts as rounding.
const UNIT_TOLERANCE: f64 = 1e-6;

/// Returns the options with the rasteriser's settings of a scene whose geometry is kept.
pub(super) fn with_raster(config: TrainConfig, raster: &RasterConfig) -> Result<TrainConfig, TrainError> {
    let RasterConfig { cutoffs, antialias, samples } = *raster;
    let presets = [(Cutoffs::HDR, CutoffPreset::Hdr), (Cutoffs::PARITY, CutoffPreset::Parity)];
    let Some((_, cutoffs)) = presets.into_iter().find(|(values, _)| *values == cutoffs) else {
        let reason = format!(
            "the scene is rendered with cut-offs of another program (min_alpha {}, max_alpha {}), expected those of hdr or parity",
            cutoffs.min_alpha, cutoffs.max_alpha
        );
        return Err(TrainError::config("freeze", reason));
    };
    Ok(TrainConfig { cutoffs, antialias, samples: Some(samples), ..config })
}

/// Checks that a run on the data set can start from the scene.
pub(super) fn check_scene(dataset: &Dataset, scene: &Scene, config: &TrainConfig) -> Result<(), TrainError> {
    let refused = |reason: String, remedy: Option<Remedy>| Err(TrainError::Scene { reason, remedy });
    if scene.splats.is_empty() {
        return refused("it has no splats".to_owned(), None);
    }
    scene.splats.validate().map_err(|error| TrainError::Scene { reason: error.to_string(), remedy: None })?;
    if let (Some(of_scene), Some(of_data)) = (scene.metres_per_unit, dataset.metres_per_unit)
        && (of_scene / of_data - 1.0).abs() > UNIT_TOLERANCE
    {
        let reason = format!("a unit of it is {of_scene} m, one of the data set {of_data} m, so they have other coordinates");
        return refused(reason, Some(Remedy::advice("give the data set that has the scene's cameras")));
    }
    if config.method.lifts_colors() {
        let reason = format!("its colours are radiance, and those of method {} captured values", config.method.name());
        return refused(reason, Some(Remedy::leave_out("from")));
    }
    if config.freezes_geometry() {
        if scene.world_from_local != dataset.world_from_local {
            let reason = "its local coordinates are not those of the data set, whose positions would have to be rounded".to_owned();
            return refused(reason, Some(Remedy::advice("give the data set that has the scene's cameras")));
        }
        return Ok(());
    }
    // The colours of a display are a start like any other: training makes light of them.
    if scene.color_space.linear() != dataset.color_space {
        let reason = format!("it is {}, the data set {}", scene.color_space.name(), dataset.color_space.name());
        return refused(reason, Some(Remedy::set("freeze", "geometry").or(Remedy::advice("convert the scene with luxel export"))));
    }
    let (had, wanted) = (scene.splats.color_model, config.color_model());
    let converts = match had {
        ColorModel::Sh { .. } => true,
        ColorModel::LogSh { .. } => matches!(wanted, ColorModel::LogSh { .. }),
        ColorModel::Lcd { .. } => had == wanted,
        ColorModel::Mix(_) => false,
    };
    if converts {
        return Ok(());
    }
    let remedy = if had.single().is_some() && config.method != Method::default() {
        Remedy::set("method", Method::default().name())
    } else {
        Remedy::set("freeze", "geometry")
    };
    refused(format!("its colours are {}, and do not become {}", had.name(), wanted.name()), Some(remedy))
}

/// Returns the splats of the first step, in the data set's own radiance scale. Captured values
/// become radiance by `knots`.
pub(super) fn start_of_scene(scene: &Scene, dataset: &Dataset, config: &TrainConfig, knots: Option<Knots>) -> Result<Initial, TrainError> {
    if config.freezes_geometry() {
        return recolored(&scene.splats, dataset, config, knots);
    }
    let radiance_scale = radiance_scale_of(dataset, config, knots)?;
    let mut scene = scene.clone();
    scene.move_to(dataset.world_from_local);
    let model = config.color_model();
    let Some(mut splats) = scene.splats.with_color_model(model) else {
        let reason = format!("its colours are {}, and do not become {}", scene.splats.color_model.name(), model.name());
        return Err(TrainError::Scene { reason, remedy: None });
    };
    // Radiance stays; the units that it is held in become those of the data set.
    let factor = scene.radiance_scale.get() / radiance_scale.get();
    let (k, m) = (3 * model.sh_coefficients(), model.luminance_coefficients());
    for i in 0..splats.len() {
        let (sh, raw) = (&mut splats.sh[i * k..(i + 1) * k], &mut splats.raw_luminance[i * m..(i + 1) * m]);
        model.scale_radiance(sh, raw, factor);
    }
    // Training owns its cut-offs: they follow the light that it starts with.
    splats.fold_gains();
    // It depends on the cameras, and is computed where the options ask for it.
    splats.smoothing = Vec::new();
    Ok(Initial { splats, radiance_scale })
}
