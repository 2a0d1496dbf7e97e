//! Raw colours of samples.

/// Raw colours of a sample.
pub(crate) const RAW: usize = 3;

/// Samples with what was computed of them, and the gradient by their channels.
#[derive(Clone, Copy)]
pub(crate) struct ColoredSamples<'a> {
    /// Raw colours, `[samples, 3]`.
    pub(crate) raw: &'a [f32],
    /// Pieces of the lifts' tables, `[samples, 3]`; none without lifts.
    pub(crate) pieces: &'a [usize],
    /// `[samples, channels]`.
    pub(crate) channels: &'a [f32],
    /// Gradient by the channels, of their shape.
    pub(crate) by_channels: &'a [f32],
}
