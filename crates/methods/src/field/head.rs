//! From raw colours to the channels of a sample that are composited.
//!
//! In: three raw numbers of the colour network. Out: radiance, and for [`ColorHead::Lifted`] the
//! captured value beside it, whose radiance [`Lifts`] make. Degenerate: the exponential of a
//! logarithm is limited to [`MAX_LOG_RADIANCE`].

use luxel_core::{sigmoid, softplus};
use luxel_lanes::LANES;
use serde::{Deserialize, Serialize};

use crate::field::lift::{LIFT, Lifts, UNITS};
use crate::field::raw::{ColoredSamples, RAW};
use crate::networks::{Activations, Network};

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

    /// Returns the lifts of the channels with these weights of the head, as tables; `None` for a
    /// head that lifts nothing.
    pub(crate) fn lifts(&self, weights: &[f32]) -> Option<Lifts> {
        (self.kind == ColorHead::Lifted).then(|| Lifts::new(weights))
    }

    /// Computes the channels of samples, `[samples, channels]`, of their raw colours, `[samples,
    /// 3]`. `lifts` are those of the head, `pieces` what [`Self::backward`] needs of them.
    pub(crate) fn forward(&self, lifts: Option<&Lifts>, raw: &[f32], pieces: &mut Vec<usize>, channels: &mut Vec<f32>) {
        channels.clear();
        pieces.clear();
        match (self.kind, lifts) {
            (ColorHead::Lifted, Some(lifts)) => {
                channels.resize(2 * raw.len(), 0.0);
                pieces.resize(raw.len(), 0);
                lifts.forward(raw, pieces, channels);
            }
            (ColorHead::Log, _) => channels.extend(raw.iter().map(|raw| raw.min(MAX_LOG_RADIANCE).exp())),
            _ => channels.extend(raw.iter().map(|raw| softplus(*raw))),
        }
    }

    /// Writes the gradient by raw colours, `[samples, 3]`, given that by the channels, and adds
    /// that by the weights.
    pub(crate) fn backward(&self, lifts: Option<&Lifts>, samples: ColoredSamples<'_>, by_raw: &mut Vec<f32>, gradient: &mut [f32]) {
        let ColoredSamples { raw, by_channels, .. } = samples;
        by_raw.clear();
        match (self.kind, lifts) {
            (ColorHead::Lifted, Some(lifts)) => {
                by_raw.resize(raw.len(), 0.0);
                lifts.backward(samples, by_raw, gradient);
            }
            // Behind the limit there is no gradient but that of the limit itself, so that radiance
            // can come back.
            (ColorHead::Log, _) => by_raw.extend(by_channels.iter().zip(raw).map(|(by, raw)| by * raw.min(MAX_LOG_RADIANCE).exp())),
            _ => by_raw.extend(by_channels.iter().zip(raw).map(|(by, raw)| by * sigmoid(*raw))),
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
