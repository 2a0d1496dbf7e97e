//! Statistics of anchors and their splats over the steps since the last rounds.
//!
//! In: decoded splats and their gradients, view by view. Out: sums and counts, by splat (ten of an
//! anchor) and by anchor. Counts are whole numbers in f32, exact up to 2^24.

use luxel_core::sigmoid;

use super::SPLATS_PER_ANCHOR;
use super::decode::Decoded;
use super::gradients::SplatGradients;

/// The statistics.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Statistics {
    /// Sum of the norms of the gradient by a splat's centre, NDC units, `[N,10]`.
    pub(super) gradient: Vec<f32>,
    /// Number of views that showed a splat, `[N,10]`.
    pub(super) draws: Vec<f32>,
    /// Sum over views of the opacities of an anchor's splats, `[N]`.
    pub(super) opacity: Vec<f32>,
    /// Number of views that an anchor was decoded for, `[N]`.
    pub(super) views: Vec<f32>,
}

impl Statistics {
    /// Returns statistics of `anchors` anchors, all zero.
    pub(super) fn zeros(anchors: usize) -> Self {
        let (splats, anchors) = (vec![0.0; anchors * SPLATS_PER_ANCHOR], vec![0.0; anchors]);
        Self { gradient: splats.clone(), draws: splats, opacity: anchors.clone(), views: anchors }
    }

    /// Adds a view.
    pub(super) fn add(&mut self, decoded: &Decoded, gradients: &SplatGradients) {
        decoded.visible.iter().for_each(|anchor| self.views[*anchor as usize] += 1.0);
        for (splat, slot) in decoded.slots.iter().map(|slot| *slot as usize).enumerate() {
            let anchor = decoded.visible[slot / SPLATS_PER_ANCHOR] as usize;
            self.opacity[anchor] += sigmoid(decoded.splats.opacity_logit[splat]);
            let (gradient, is_shown) = gradients.statistics(splat);
            if is_shown {
                let at = anchor * SPLATS_PER_ANCHOR + slot % SPLATS_PER_ANCHOR;
                self.gradient[at] += gradient;
                self.draws[at] += 1.0;
            }
        }
    }

    /// Returns the mean gradient of a splat that was shown.
    pub(super) fn mean_gradient(&self, splat: usize) -> f32 {
        self.gradient[splat] / self.draws[splat].max(1.0)
    }

    /// Returns the statistics of anchors that come from these: from the anchor of an index, or new.
    pub(super) fn rearranged(&self, from: &[Option<usize>]) -> Self {
        let mut out = Self::zeros(from.len());
        for (to, from) in from.iter().enumerate().filter_map(|(to, from)| Some((to, (*from)?))) {
            let (to_splats, from_splats) = (to * SPLATS_PER_ANCHOR, from * SPLATS_PER_ANCHOR);
            for k in 0..SPLATS_PER_ANCHOR {
                out.gradient[to_splats + k] = self.gradient[from_splats + k];
                out.draws[to_splats + k] = self.draws[from_splats + k];
            }
            (out.opacity[to], out.views[to]) = (self.opacity[from], self.views[from]);
        }
        out
    }

    /// Starts anew for the splats shown more than `draws` times, and the anchors decoded more than
    /// `views` times.
    pub(super) fn restart(&mut self, draws: f32, views: f32) {
        for (gradient, count) in self.gradient.iter_mut().zip(&mut self.draws).filter(|(_, count)| **count > draws) {
            (*gradient, *count) = (0.0, 0.0);
        }
        for (opacity, count) in self.opacity.iter_mut().zip(&mut self.views).filter(|(_, count)| **count > views) {
            (*opacity, *count) = (0.0, 0.0);
        }
    }
}
