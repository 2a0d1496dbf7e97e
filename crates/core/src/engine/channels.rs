//! Steps whose caller owns channels and loss: methods that blend several images of the same splats.
//!
//! In: from the engine, the radiance of the splats that a view shows; blended images of the
//! caller's channels. Out: channels of the splats, the loss, and gradients by channels and
//! radiance.
//! The engine keeps its scene, its passes and its update; the caller sees no other parameter.
//!
//! Channels have the same weights in blending, those of the splats' geometry. Degenerate: no
//! threshold of the rasteriser depends on channels, so scenes with cut-offs that depend on radiance
//! are refused.

use super::{Cutoffs, EngineError};

/// Least number of channels.
pub const LEAST_CHANNELS: usize = 3;

/// The splats of a scene as a view shows them.
#[derive(Clone, Copy, Debug)]
pub struct SeenSplats<'a> {
    /// Radiance towards the camera by the colour model, normalised units, `[N]`; 0 where the view
    /// does not show the splat.
    pub radiance: &'a [[f32; 3]],
    /// Whether the view shows the splat, `[N]`.
    pub visible: &'a [bool],
}

/// Channels of splats: numbers of the caller's, `[N, K]`.
pub trait ChannelSource: Send {
    /// Returns the number of channels K, at least [`LEAST_CHANNELS`].
    fn count(&self) -> usize;

    /// Writes the channels of the splats that the view shows. Other rows of `out`, `[N, K]`, may
    /// hold anything.
    fn fill(&mut self, splats: &SeenSplats<'_>, out: &mut [f32]);
}

/// The channels whose gradient by the splats' centres the densification statistics are of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MeasuredChannels {
    /// All that have a gradient by geometry.
    #[default]
    All,
    /// The first three.
    FirstThree,
}

/// How channels take part in gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelRoles {
    /// Number of channels, from the first on, whose gradient reaches the splats' geometry, at least
    /// [`LEAST_CHANNELS`]. Of the others only the channels themselves have a gradient.
    pub shaping: usize,
    /// Channels that statistics are of.
    pub measured: MeasuredChannels,
}

/// The loss of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelLoss {
    /// Loss that the gradient is of.
    pub loss: f32,
    /// Mean absolute difference, for reports.
    pub l1: f32,
    /// Mean structural similarity, for reports.
    pub ssim: f32,
}

/// A step of a method that owns channels and loss.
pub trait ChannelStep: ChannelSource {
    /// Returns how the channels take part in gradients.
    fn roles(&self) -> ChannelRoles;

    /// Compares the blended image, `[K, H, W]` over black, and writes the gradient of the loss by
    /// it to `gradient`, of the same shape, whose contents are arbitrary.
    fn compare(&mut self, image: &[f32], gradient: &mut [f32]) -> ChannelLoss;

    /// Writes the gradient of the loss by the radiance of the splats that the view shows, from that
    /// by their channels, `[N, K]`. `out`, `[N]`, holds zeros.
    fn backward(&mut self, splats: &SeenSplats<'_>, by_channels: &[f32], out: &mut [[f32; 3]]);
}

/// Checks the number of channels, and that no threshold depends on radiance.
///
/// # Errors
/// [`EngineError::Invalid`] says what was expected and found.
pub fn check_channels(source: &dyn ChannelSource, cutoffs: &Cutoffs) -> Result<(), EngineError> {
    if source.count() < LEAST_CHANNELS {
        return Err(EngineError::invalid(format!("channels: expected at least {LEAST_CHANNELS}, found {}", source.count())));
    }
    if cutoffs.min_contribution.is_finite() {
        let message =
            format!("cut-offs: expected none that depends on radiance, found a least contribution of {}", cutoffs.min_contribution);
        return Err(EngineError::invalid(message));
    }
    Ok(())
}
