//! The choice of the splats to export: those in a box, and of those the ones that contribute most
//! to the views.

use luxel_core::{Dataset, Engine, Scene, sigmoid, text};
use luxel_train::add_contribution;

use super::CropBox;
use crate::error::Context;
use crate::{Observer, Result};

/// Keeps the splats whose centre is in the box.
pub(super) fn crop(scene: &mut Scene, bounds: Option<CropBox>) {
    let Some(bounds) = bounds else { return };
    // In 32 bits, as positions are: a box that is written as they are holds what is on its faces.
    let local_from_world = scene.world_from_local.inverse();
    let corner = |world: [f64; 3]| local_from_world.point(world.into()).as_vec3().to_array().map(f64::from);
    let bounds = CropBox { low: corner(bounds.low), high: corner(bounds.high) };
    let is_inside = |i: &u32| bounds.contains(scene.splats.position[*i as usize].map(f64::from));
    let kept: Vec<u32> = (0..scene.splats.len() as u32).filter(is_inside).collect();
    scene.splats = scene.splats.select(kept);
}

/// Keeps the `most` splats that contribute most, in their order.
pub(super) fn limit(
    scene: &mut Scene,
    most: Option<u64>,
    dataset: Option<&Dataset>,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<()> {
    let Some(most) = most.and_then(|most| usize::try_from(most).ok()).filter(|most| *most < scene.splats.len()) else { return Ok(()) };
    let contribution = match dataset {
        Some(dataset) => contributions_to_views(scene, dataset, engine)?,
        None => {
            observer.note("no data set: splats are pruned by opacity and size, not by their contribution to views");
            (0..scene.splats.len()).map(|i| estimated_contribution(scene, i)).collect()
        }
    };
    let total: f64 = contribution.iter().sum();
    let mut order: Vec<u32> = (0..scene.splats.len() as u32).collect();
    // Stable: of equal splats the first are kept.
    order.sort_by(|a, b| contribution[*b as usize].total_cmp(&contribution[*a as usize]));
    order.truncate(most);
    let kept: f64 = order.iter().map(|i| contribution[*i as usize]).sum();
    order.sort_unstable();
    observer.note(&format!(
        "{} of {} kept, with {} % of their contribution",
        text::count(most),
        text::plural(scene.splats.len(), "splat"),
        text::number(100.0 * kept / total.max(f64::MIN_POSITIVE))
    ));
    scene.splats = scene.splats.select(order);
    Ok(())
}

/// Returns each splat's contribution to the training views.
fn contributions_to_views(scene: &Scene, dataset: &Dataset, engine: &mut dyn Engine) -> Result<Vec<f64>> {
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    let mut sums = vec![0.0; scene.splats.len()];
    let views = if dataset.train.is_empty() { &dataset.test } else { &dataset.train };
    for view in views {
        add_contribution(engine, view, &options, &mut sums).context("cannot measure the splats' contributions")?;
    }
    Ok(sums.into_iter().map(f64::from).collect())
}

/// Returns opacity times the area of the larger cross-section.
fn estimated_contribution(scene: &Scene, i: usize) -> f64 {
    let log_scale = scene.splats.log_scale[i].map(f64::from);
    let smallest = log_scale.iter().copied().fold(f64::INFINITY, f64::min);
    f64::from(sigmoid(scene.splats.opacity_logit[i])) * (log_scale.iter().sum::<f64>() - smallest).clamp(-300.0, 300.0).exp()
}
