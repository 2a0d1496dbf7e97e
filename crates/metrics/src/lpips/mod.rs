//! LPIPS: the distance of two images in the features of a network trained to recognise objects.
//!
//! In: weights, which the user provides, by the names of the state dict of the package `lpips` 0.1
//! (`net.slice1.0.weight`, `lin0.model.1.weight`), and two display images with values in `[0, 1]`.
//! Out: the sum over five layers of the mean over pixels of the weighted squared difference of
//! features of unit length. Source: Zhang et al., "The Unreasonable Effectiveness of Deep Features
//! as a Perceptual Metric", CVPR 2018.
//!
//! The network is AlexNet or VGG16; distances of the two are not comparable. Features are single
//! precision, sums over pixels and lengths double precision. Memory: a few times the planes of the
//! widest layer, which for VGG16 are 64 of the image's size.
//!
//! [`Lpips::of_radiance`] first maps radiance to a display by the mu-law and protocol `gtmax`, in
//! linear Rec.709. In masked pixels both images have the target's value.

mod layers;

use std::collections::BTreeMap;

use luxel_core::tone::{MuLaw, rec709_of};
use luxel_core::{ColorSpace, Image, Mask};

use crate::{FieldMetrics, MetricsError};
use layers::{Convolution, Features, Layer};

/// Tensors by name, each with shape and values.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Mean of the images that the networks were trained on, in `[-1, 1]`.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// Standard deviation of the images that the networks were trained on.
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Added to lengths to avoid a division by 0 for features that are all 0.
const LENGTH_FLOOR: f64 = 1e-10;

/// The network that provides the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LpipsNetwork {
    /// AlexNet: the faster one, and the usual choice for evaluation.
    Alex,
    /// VGG16, without batch normalisation.
    Vgg,
}

/// A step of a slice: a convolution with its index and geometry, followed by a ReLU, or a pooling.
enum Step {
    Convolve { index: usize, channels: [usize; 2], kernel: usize, stride: usize, padding: usize },
    Pool { window: usize, stride: usize },
}

const fn conv3(index: usize, input: usize, output: usize) -> Step {
    Step::Convolve { index, channels: [input, output], kernel: 3, stride: 1, padding: 1 }
}

const ALEX_POOL: Step = Step::Pool { window: 3, stride: 2 };
const VGG_POOL: Step = Step::Pool { window: 2, stride: 2 };

/// The steps of AlexNet, in slices that end where features are compared.
const ALEX: [&[Step]; 5] = [
    &[Step::Convolve { index: 0, channels: [3, 64], kernel: 11, stride: 4, padding: 2 }],
    &[ALEX_POOL, Step::Convolve { index: 3, channels: [64, 192], kernel: 5, stride: 1, padding: 2 }],
    &[ALEX_POOL, conv3(6, 192, 384)],
    &[conv3(8, 384, 256)],
    &[conv3(10, 256, 256)],
];
/// The steps of VGG16, like [`ALEX`].
const VGG: [&[Step]; 5] = [
    &[conv3(0, 3, 64), conv3(2, 64, 64)],
    &[VGG_POOL, conv3(5, 64, 128), conv3(7, 128, 128)],
    &[VGG_POOL, conv3(10, 128, 256), conv3(12, 256, 256), conv3(14, 256, 256)],
    &[VGG_POOL, conv3(17, 256, 512), conv3(19, 512, 512), conv3(21, 512, 512)],
    &[VGG_POOL, conv3(24, 512, 512), conv3(26, 512, 512), conv3(28, 512, 512)],
];

impl LpipsNetwork {
    /// Returns the name, such as `alex`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    /// Returns the side of the smallest image for which every layer has at least one pixel.
    pub fn min_side_px(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Vgg => 16,
        }
    }

    fn slices(self) -> &'static [&'static [Step]; 5] {
        match self {
            Self::Alex => &ALEX,
            Self::Vgg => &VGG,
        }
    }
}

/// The reasons for which there is no distance.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LpipsError {
    /// The weights are of another network.
    #[error(
        "no tensor \"net.slice1.0.weight\" of AlexNet's shape [64, 3, 11, 11] or VGG16's [64, 3, 3, 3]; found {found}; expected the state dict of lpips.LPIPS(net='alex' or 'vgg')"
    )]
    UnknownNetwork {
        /// Shape of the first tensor, or that it is missing.
        found: String,
    },
    /// A tensor is missing, has another shape or is not finite.
    #[error("tensor \"{name}\" is {found}, expected the shape {expected:?} and finite values")]
    Tensor {
        /// Name of the tensor.
        name: String,
        /// The problem that was found.
        found: String,
        /// Expected shape.
        expected: Vec<usize>,
    },
    /// The image is smaller than the network can process.
    #[error("image is {width}x{height}, LPIPS with {network} needs at least {min} pixels a side")]
    TooSmall {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
        /// Name of the network.
        network: &'static str,
        /// Least side, pixels.
        min: usize,
    },
    /// Features are beyond the range of f32.
    #[error("features of {network} are beyond the range of 32-bit floats, so the weights are not those of a trained network")]
    Overflow {
        /// Name of the network.
        network: &'static str,
    },
    /// The images cannot be compared by any metric.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
}

/// A network with its weights.
#[derive(Clone, Debug)]
pub struct Lpips {
    network: LpipsNetwork,
    slices: Vec<Slice>,
}

/// The layers up to a comparison, and the weight of each channel in it.
#[derive(Clone, Debug)]
struct Slice {
    layers: Vec<Layer>,
    channel_weights: Vec<f32>,
}

impl Lpips {
    /// Builds the network to which the tensors belong. Tensors that it does not use are ignored.
    ///
    /// # Errors
    /// [`LpipsError::UnknownNetwork`] or [`LpipsError::Tensor`].
    pub fn from_tensors(tensors: &Tensors) -> Result<Self, LpipsError> {
        let first = tensors.get("net.slice1.0.weight").map(|(shape, _)| shape.as_slice());
        let network = match first {
            Some([64, 3, 11, 11]) => LpipsNetwork::Alex,
            Some([64, 3, 3, 3]) => LpipsNetwork::Vgg,
            found => {
                return Err(LpipsError::UnknownNetwork { found: found.map_or("none".into(), |shape| format!("the shape {shape:?}")) });
            }
        };
        let slices = network.slices().iter().enumerate().map(|(i, steps)| Slice::from_tensors(i, steps, tensors));
        Ok(Self { network, slices: slices.collect::<Result<_, _>>()? })
    }

    /// Returns the network that provides the features.
    pub fn network(&self) -> LpipsNetwork {
        self.network
    }

    /// Computes the distance of two display images with values in `[0, 1]`.
    ///
    /// # Errors
    /// [`LpipsError::TooSmall`], or [`MetricsError::Size`] if the images differ in size.
    pub fn distance(&self, first: &Image, second: &Image) -> Result<f64, LpipsError> {
        let (width, height, min) = (second.width, second.height, self.network.min_side_px());
        if (first.width, first.height) != (width, height) {
            return Err(MetricsError::Size { prediction: (first.width, first.height), target: (width, height) }.into());
        }
        if width.min(height) < min {
            return Err(LpipsError::TooSmall { width, height, network: self.network.name(), min });
        }
        let (mut first, mut second) = (input(first), input(second));
        let mut distance = 0.0;
        for slice in &self.slices {
            first = slice.apply(first);
            second = slice.apply(second);
            if !first.is_finite() || !second.is_finite() {
                return Err(LpipsError::Overflow { network: self.network.name() });
            }
            distance += first.distance(&second, &slice.channel_weights, LENGTH_FLOOR);
        }
        Ok(distance)
    }

    /// Computes the distance of radiance in any unit with the primaries of `color_space`, both
    /// divided by the target's maximum and under the mu-law.
    ///
    /// # Errors
    /// The same as of [`Lpips::distance`].
    pub fn radiance_distance(
        &self,
        prediction: &Image,
        target: &Image,
        mask: Option<&Mask>,
        mu: f32,
        color_space: ColorSpace,
    ) -> Result<f64, LpipsError> {
        let valid = |i: usize| mask.is_none_or(|mask| mask.is_valid(i));
        let light = |rgb: [f32; 3]| rec709_of(color_space, rgb).map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        let brightest = target.pixels.iter().enumerate().filter(|(i, _)| valid(*i)).flat_map(|(_, &rgb)| light(rgb)).fold(0.0, f32::max);
        let (divisor, curve) = (if brightest > 0.0 { brightest } else { 1.0 }, MuLaw::new(mu));
        let shown = |rgb: [f32; 3]| light(rgb).map(|v| curve.apply((v / divisor).min(1.0)));
        let of_target: Vec<[f32; 3]> = target.pixels.iter().map(|&rgb| shown(rgb)).collect();
        let pixels = prediction.pixels.iter().zip(&of_target).enumerate();
        let of_prediction = pixels.map(|(i, (&rgb, &target))| if valid(i) { shown(rgb) } else { target }).collect();
        let image = |pixels, like: &Image| Image { width: like.width, height: like.height, pixels };
        self.distance(&image(of_prediction, prediction), &image(of_target, target))
    }
}

impl Lpips {
    /// Stores a distance in the field for this network.
    pub fn record(&self, distance: f64, metrics: &mut FieldMetrics) {
        match self.network {
            LpipsNetwork::Alex => metrics.lpips_alex = Some(distance),
            LpipsNetwork::Vgg => metrics.lpips_vgg = Some(distance),
        }
    }
}

/// Returns the network's input for an image.
fn input(image: &Image) -> Features {
    Features::from_fn([3, image.width, image.height], |c, x, y| (2.0 * image.at(x, y)[c] - 1.0 - SHIFT[c]) / SCALE[c])
}

impl Slice {
    fn from_tensors(i: usize, steps: &[Step], tensors: &Tensors) -> Result<Self, LpipsError> {
        let mut layers = Vec::with_capacity(steps.len());
        let mut channels = 0;
        for step in steps {
            layers.push(match *step {
                Step::Pool { window, stride } => Layer::Pool { window, stride },
                Step::Convolve { index, channels: [input, output], kernel, stride, padding } => {
                    let name = format!("net.slice{}.{index}", i + 1);
                    channels = output;
                    Layer::Convolve(Convolution {
                        channels: [input, output],
                        kernel,
                        stride,
                        padding,
                        weights: tensor(tensors, &format!("{name}.weight"), &[output, input, kernel, kernel])?,
                        bias: tensor(tensors, &format!("{name}.bias"), &[output])?,
                    })
                }
            });
        }
        let channel_weights = tensor(tensors, &format!("lin{i}.model.1.weight"), &[1, channels, 1, 1])?;
        Ok(Self { layers, channel_weights })
    }

    fn apply(&self, features: Features) -> Features {
        self.layers.iter().fold(features, |features, layer| layer.apply(&features))
    }
}

fn tensor(tensors: &Tensors, name: &str, expected: &[usize]) -> Result<Vec<f32>, LpipsError> {
    let wrong = |found: String| LpipsError::Tensor { name: name.into(), found, expected: expected.to_vec() };
    let (shape, values) = tensors.get(name).ok_or_else(|| wrong("missing".into()))?;
    if shape != expected || values.len() != expected.iter().product::<usize>() {
        return Err(wrong(format!("of the shape {shape:?} with {} values", values.len())));
    }
    if values.iter().any(|v| !v.is_finite()) {
        return Err(wrong("not finite".into()));
    }
    Ok(values.clone())
}
