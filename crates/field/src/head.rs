//! From raw colours to the channels of a sample that are composited.
//!
//! In: three raw numbers of the colour network. Out: radiance, and for [`ColorHead::Lifted`] the
//! captured value beside it. The lift of a channel is a network of one hidden layer from the
//! captured value l to (X, R, Y), with radiance softplus(l + max(X, 0) max(R, 0) + Y) (Mono-HDR-GS,
//! Mono-HDR-NeRF). Degenerate: the exponential of a logarithm is limited to [`MAX_LOG_RADIANCE`].

use fearless_simd::Simd;
use serde::{Deserialize, Serialize};

use luxel_networks::LANES;
use luxel_networks::{Activations, Network};

/// Raw colours of a sample.
pub(crate) const RAW: usize = 3;
/// Hidden units of a network of one channel, of the lift and of the tone mapper.
const UNITS: usize = 128;
/// Outputs of a lift.
const LIFT: usize = 3;
/// Largest logarithm of radiance: the exponential and its gradient stay in range.
const MAX_LOG_RADIANCE: f32 = 20.0;
/// Most channels that a sample has.
pub(crate) const MAX_CHANNELS: usize = 2 * RAW;

/// The meaning of the raw colours of a field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorHead {
    /// Radiance is their softplus: never negative, unbounded above, with a gradient everywhere.
    #[default]
    Softplus,
    /// They are the logarithm of radiance; beside it there is a tone mapper for each channel.
    Log,
    /// Their logistic is a captured value, of which a network for each channel makes radiance.
    Lifted,
}

/// A head with the networks that belong to it, one for each channel.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Head {
    pub(crate) kind: ColorHead,
    network: Option<Network>,
}

impl ColorHead {
    /// Returns the channels of a sample: radiance, then captured values.
    pub(crate) fn channels(self) -> usize {
        match self {
            Self::Softplus | Self::Log => RAW,
            Self::Lifted => 2 * RAW,
        }
    }
}

impl Head {
    pub(crate) fn new(kind: ColorHead) -> Self {
        let network = match kind {
            ColorHead::Softplus => None,
            ColorHead::Log => Some(Network::new(&[1, UNITS, 1])),
            ColorHead::Lifted => Some(Network::new(&[1, UNITS, LIFT])),
        };
        Self { kind, network }
    }

    /// Returns the number of weights and biases of the three networks.
    pub(crate) fn len(&self) -> usize {
        RAW * self.of_channel()
    }

    /// Returns the number of weights and biases of one network.
    pub(crate) fn of_channel(&self) -> usize {
        self.network.as_ref().map_or(0, Network::len)
    }

    /// Returns the network of a channel.
    pub(crate) fn network(&self) -> Option<&Network> {
        self.network.as_ref()
    }

    pub(crate) fn initial(&self, seed: u64) -> Vec<f32> {
        let of_channel = |network: &Network| (0..RAW as u64).flat_map(|c| network.initial(seed ^ c)).collect();
        self.network.as_ref().map(of_channel).unwrap_or_default()
    }

    /// Computes the channels of samples, `[samples, channels]`, of their raw colours, `[samples,
    /// 3]`. `weights` are those of the head.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(&self, simd: S, weights: &[f32], raw: &[f32], room: &mut [Activations; RAW], channels: &mut Vec<f32>) {
        channels.clear();
        match (self.kind, &self.network) {
            (ColorHead::Lifted, Some(lift)) => {
                channels.resize(2 * raw.len(), 0.0);
                for c in 0..RAW {
                    let values = || raw.iter().skip(c).step_by(RAW).map(|raw| logistic(*raw));
                    let (own, room) = (&weights[c * lift.len()..][..lift.len()], &mut room[c]);
                    fill_inputs(lift, values(), room);
                    lift.forward(simd, own, room);
                    let samples = channels.chunks_exact_mut(2 * RAW).zip(values());
                    for (sample, (channels, value)) in samples.enumerate() {
                        channels[c] = softplus(exponent(value, lift_of(room, sample)));
                        channels[RAW + c] = value;
                    }
                }
            }
            (ColorHead::Log, _) => channels.extend(raw.iter().map(|raw| raw.min(MAX_LOG_RADIANCE).exp())),
            _ => channels.extend(raw.iter().map(|raw| softplus(*raw))),
        }
    }

    /// Writes the gradient by raw colours, `[samples, 3]`, given that by the channels, and adds
    /// that by the weights. `room` is as [`Self::forward`] left it.
    #[expect(clippy::too_many_arguments, reason = "what was computed before, and the places of two gradients")]
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(
        &self,
        simd: S,
        weights: &[f32],
        raw: &[f32],
        room: &mut [Activations; RAW],
        by_channels: &[f32],
        by_raw: &mut Vec<f32>,
        gradient: &mut [f32],
    ) {
        by_raw.clear();
        match (self.kind, &self.network) {
            (ColorHead::Lifted, Some(lift)) => {
                by_raw.resize(raw.len(), 0.0);
                for (c, room) in room.iter_mut().enumerate() {
                    let at = c * lift.len()..(c + 1) * lift.len();
                    self.backward_lift(simd, lift, &weights[at.clone()], [raw, by_channels], c, room, by_raw, &mut gradient[at]);
                }
            }
            // Behind the limit there is no gradient but that of the limit itself, so that radiance
            // can come back.
            (ColorHead::Log, _) => by_raw.extend(by_channels.iter().zip(raw).map(|(by, raw)| by * raw.min(MAX_LOG_RADIANCE).exp())),
            _ => by_raw.extend(by_channels.iter().zip(raw).map(|(by, raw)| by * logistic(*raw))),
        }
    }

    #[expect(clippy::too_many_arguments, reason = "one loop of backward, apart for its length")]
    #[inline(always)]
    fn backward_lift<S: Simd>(
        &self,
        simd: S,
        lift: &Network,
        weights: &[f32],
        [raw, by_channels]: [&[f32]; 2],
        c: usize,
        room: &mut Activations,
        by_raw: &mut [f32],
        gradient: &mut [f32],
    ) {
        let samples = raw.len() / RAW;
        let of_sample = |room: &Activations, sample: usize| {
            let value = logistic(raw[RAW * sample + c]);
            let outputs = lift_of(room, sample);
            (value, outputs, by_channels[2 * RAW * sample + c] * logistic(exponent(value, outputs)))
        };
        for sample in 0..samples.next_multiple_of(LANES) {
            let by_outputs = if sample < samples {
                let (_, [x, r, _], by) = of_sample(room, sample);
                [if x > 0.0 { by * r.max(0.0) } else { 0.0 }, if r > 0.0 { by * x.max(0.0) } else { 0.0 }, by]
            } else {
                [0.0; LIFT]
            };
            let rows = &mut room.by_outputs()[sample / LANES * LIFT..][..LIFT];
            rows.iter_mut().zip(by_outputs).for_each(|(row, by)| row.0[sample % LANES] = by);
        }
        lift.backward(simd, weights, room, gradient);
        for sample in 0..samples {
            let (value, _, by_exponent) = of_sample(room, sample);
            let by_input = room.by_inputs()[sample / LANES].0[sample % LANES];
            let by_value = by_exponent + by_input + by_channels[2 * RAW * sample + RAW + c];
            by_raw[RAW * sample + c] = by_value * value * (1.0 - value);
        }
    }
}

/// Writes the inputs of a network of one input; those that fill the last block are 0.
pub(crate) fn fill_inputs(network: &Network, values: impl ExactSizeIterator<Item = f32>, room: &mut Activations) {
    let inputs = network.inputs(values.len().div_ceil(LANES), room);
    if let Some(last) = inputs.last_mut() {
        last.0.fill(0.0);
    }
    values.enumerate().for_each(|(i, value)| inputs[i / LANES].0[i % LANES] = value);
}

/// Returns the outputs of a lift for a sample.
fn lift_of(room: &Activations, sample: usize) -> [f32; LIFT] {
    let rows = &room.outputs()[sample / LANES * LIFT..][..LIFT];
    [0, 1, 2].map(|k| rows[k].0[sample % LANES])
}

/// Returns the number whose softplus is a lifted radiance.
fn exponent(value: f32, [x, r, y]: [f32; LIFT]) -> f32 {
    value + x.max(0.0) * r.max(0.0) + y
}

/// Returns ln(1 + e^x).
#[inline]
pub(crate) fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Returns the derivative of [`softplus`]: 1 / (1 + e^-x).
#[inline]
pub(crate) fn logistic(x: f32) -> f32 {
    (1.0 + (-x).exp()).recip()
}
