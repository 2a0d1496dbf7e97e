//! Light of a scene's splats, and the summary of a selection of them.

use super::select::percentile;
use crate::{Scene, luminance_sum};

impl Scene {
    /// Returns the luminance (R + G + B) of splat `i` from its degree-0 term, in the units of the
    /// data set.
    pub fn luminance(&self, i: usize) -> f32 {
        self.radiance_scale.restored_value(self.splats.base_luminance(i))
    }

    /// Returns the median of [`Self::luminance`] over all splats that are not black; 1 if all are
    /// black.
    pub fn median_luminance(&self) -> f32 {
        let values = (0..self.splats.len()).map(|i| self.luminance(i)).filter(|l| *l > 0.0).collect();
        percentile(values, 50.0).unwrap_or(1.0)
    }

    /// Returns a measure of the light that splat `i` emits: luminance times opacity times the
    /// product of its two larger standard deviations.
    ///
    /// Occlusion is ignored.
    pub fn light(&self, i: usize) -> f64 {
        let splats = &self.splats;
        let log_scale = splats.log_scale[i].map(f64::from);
        let smallest = log_scale.into_iter().fold(f64::INFINITY, f64::min);
        // Bounds that keep sums from underflow and overflow.
        let area = (log_scale.iter().sum::<f64>() - smallest).clamp(-200.0, 200.0).exp();
        f64::from(self.radiance_scale.restored_value(luminance_sum(splats.base_radiance(i))))
            * f64::from(crate::sigmoid(splats.opacity_logit[i]))
            * area
    }
}

/// A summary of a selection.
#[derive(Clone, Debug, PartialEq)]
pub struct SelectionSummary {
    /// Number of splats with a weight above 0.
    pub count: usize,
    /// Number of those with a weight below 1.
    pub partial: usize,
    /// Share of the scene's light ([`Scene::light`]) that the selection holds, by weight; 0 to 1.
    pub light_share: f64,
    /// Corners of the box around the selected centres, world coordinates; `None` if nothing is
    /// selected.
    pub bounds: Option<[[f64; 3]; 2]>,
}

impl SelectionSummary {
    /// Returns the summary of the selection `weights [N]` in `scene`.
    pub fn new(scene: &Scene, weights: &[f32]) -> Self {
        let mut summary = Self { count: 0, partial: 0, light_share: 0.0, bounds: None };
        let (mut selected, mut total) = (0.0, 0.0);
        for (i, weight) in weights.iter().enumerate().take(scene.splats.len()) {
            let light = scene.light(i);
            total += light;
            if *weight > 0.0 {
                selected += light * f64::from(*weight);
                summary.count += 1;
                summary.partial += usize::from(*weight < 1.0);
                let position = scene.world_position(i).to_array();
                let [min, max] = summary.bounds.unwrap_or([position; 2]);
                summary.bounds = Some([[0, 1, 2].map(|c| min[c].min(position[c])), [0, 1, 2].map(|c| max[c].max(position[c]))]);
            }
        }
        summary.light_share = if total > 0.0 { selected / total } else { 0.0 };
        summary
    }
}
