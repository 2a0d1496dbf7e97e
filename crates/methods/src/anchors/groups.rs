//! The trained numbers in groups, each with Adam's moments and a learning rate.
//!
//! In: gradients, the part of the run that is done. Out: updated anchors and networks. Rates are
//! those of Scaffold-GS, log-linear over the run, but for one thing: offsets have no factor of the
//! scene's extent, since they are in units of their anchor's scale.

use luxel_train::TrainError;

use super::decoders::NETWORKS;
use super::gradients::AnchorGradients;
use super::scene::AnchorScene;
use super::{FEATURE, OFFSETS, SCALES};
use crate::captured::Adam;

/// First and last rate.
type Rates = [f64; 2];

const OFFSET: Rates = [0.01, 1e-4];
const FEATURES: Rates = [0.0075, 0.0075];
const LOG_SCALE: Rates = [0.007, 0.007];
/// Rates of the networks of opacity, shape and colour.
const WEIGHTS: [Rates; NETWORKS] = [[0.002, 2e-5], [0.004, 0.004], [0.008, 5e-5]];
const CONTEXT: Rates = [0.008, 5e-5];

/// Number of groups: three of anchors, the networks, the context map.
pub(super) const GROUPS: usize = 4 + NETWORKS;
/// Names of the groups in files.
pub(super) const NAMES: [&str; GROUPS] =
    ["anchors.offset", "anchors.feature", "anchors.log_scale", "decoders.opacity", "decoders.shape", "decoders.color", "decoders.context"];

/// The moments of all groups.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Groups {
    pub(super) adam: [Adam; GROUPS],
}

fn rate([first, last]: Rates, progress: f64) -> f64 {
    (first.ln() + (last.ln() - first.ln()) * progress.clamp(0.0, 1.0)).exp()
}

/// Returns the numbers of each group.
pub(super) fn numbers(scene: &AnchorScene) -> [&[f32]; GROUPS] {
    let AnchorScene { anchors, decoders } = scene;
    let [opacity, shape, color] = &decoders.weights;
    [&anchors.offset, &anchors.feature, &anchors.log_scale, opacity, shape, color, &decoders.context]
}

/// Returns the numbers of each group, to be changed.
pub(super) fn numbers_mut(scene: &mut AnchorScene) -> [&mut [f32]; GROUPS] {
    let AnchorScene { anchors, decoders } = scene;
    let [opacity, shape, color] = &mut decoders.weights;
    [&mut anchors.offset, &mut anchors.feature, &mut anchors.log_scale, opacity, shape, color, &mut decoders.context]
}

impl Groups {
    /// Returns moments of zero.
    pub(super) fn new(scene: &AnchorScene) -> Self {
        Self { adam: numbers(scene).map(|numbers| Adam::new(numbers.len())) }
    }

    /// Updates all numbers; `progress` is the part of the run that is done.
    pub(super) fn update(&mut self, scene: &mut AnchorScene, gradients: &AnchorGradients, progress: f64) {
        let AnchorGradients { by_offset, by_feature, by_log_scale, by_weights, by_context } = gradients;
        let [offset, feature, log_scale, networks @ .., context] = numbers_mut(scene);
        let [of_offset, of_feature, of_log_scale, of_networks @ .., of_context] = &mut self.adam;
        of_offset.step(offset, by_offset, rate(OFFSET, progress));
        of_feature.step(feature, by_feature, rate(FEATURES, progress));
        of_log_scale.step(log_scale, by_log_scale, rate(LOG_SCALE, progress));
        for (n, (adam, numbers)) in of_networks.iter_mut().zip(networks).enumerate() {
            adam.step(numbers, &by_weights[n], rate(WEIGHTS[n], progress));
        }
        of_context.step(context, by_context, rate(CONTEXT, progress));
    }

    /// Takes the moments of anchors to new places: those of the given old ones, 0 where there is
    /// none.
    pub(super) fn rearrange(&mut self, from: &[Option<usize>]) {
        for (adam, width) in self.adam.iter_mut().zip([OFFSETS, FEATURE, SCALES]) {
            adam.rearrange(from.iter().flat_map(|from| (0..width).map(move |k| from.map(|from| from * width + k))));
        }
    }

    /// Checks moments read from a file.
    pub(super) fn validate(&self, scene: &AnchorScene) -> Result<(), TrainError> {
        self.adam.iter().zip(numbers(scene)).try_for_each(|(adam, numbers)| adam.validate(numbers.len()))
    }
}
