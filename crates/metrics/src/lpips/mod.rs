//! LPIPS: distance of two images by the features of a network trained to recognise objects.
//!
//! In: weights by the names of the state dict of the package `lpips` 0.1 (`net.slice1.0.weight`, `lin0.model.1.weight`), which are the user's; two images as a
//! display shows them, `[0, 1]`. Out: the sum over five layers of the mean over pixels of the weighted squared differences of features of
//! unit length (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", CVPR 2018). AlexNet and VGG16;
//! distances of one are not comparable with the other's. Single precision, sums of pixels and lengths in double. Memory: a few planes of
//! the widest layer, 64 of the image's size for VGG16.
//!
//! For radiance ([`Lpips::of_radiance`]) the display is the mu-law by protocol `gtmax`, in linear Rec.709; in masked pixels the target stands for both.

mod layers;

use std::collections::BTreeMap;

use luxel_core::tone::{MuLaw, rec709_of};
use luxel_core::{ColorSpace, Image, Mask};

use crate::{FieldMetrics, MetricsError};
use layers::{Convolution, Features, Layer};

/// Shape and values of tensors by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Mean of the images that the networks were trained with, in `[-1, 1]`.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// Their standard deviation.
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Added to lengths, so that features that are all 0 have no direction.
const LENGTH_FLOOR: f64 = 1e-10;

/// Whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LpipsNetwork {
    /// AlexNet: the fast one, and the usual choice for evaluation.
    Alex,
    /// VGG16, without batch normalisation.
    Vgg,
}

/// A step of a slice: a convolution with its name and geometry, followed by a rectifier, or a pooling.
enum Step {
    Convolve { index: usize, channels: [usize; 2], kernel: usize, stride: usize, padding: usize },
    Pool { window: usize, stride: usize },
}

const fn conv3(index: usize, input: usize, output: usize) -> Step {
    Step::Convolve { index, channels: [input, output], kernel: 3, stride: 1, padding: 1 }
}

const ALEX_POOL: Step = Step::Pool { window: 3, stride: 2 };
const VGG_POOL: Step = Step::Pool { window: 2, stride: 2 };

/// Steps between the layers that are compared.
const ALEX: [&[Step]; 5] = [
    &[Step::Convolve { index: 0, channels: [3, 64], kernel: 11, stride: 4, padding: 2 }],
    &[ALEX_POOL, Step::Convolve { index: 3, channels: [64, 192], kernel: 5, stride: 1, padding: 2 }],
    &[ALEX_POOL, conv3(6, 192, 384)],
    &[conv3(8, 384, 256)],
    &[conv3(10, 256, 256)],
];
/// As [`ALEX`].
const VGG: [&[Step]; 5] = [
    &[conv3(0, 3, 64), conv3(2, 64, 64)],
    &[VGG_POOL, conv3(5, 64, 128), conv3(7, 128, 128)],
    &[VGG_POOL, conv3(10, 128, 256), conv3(12, 256, 256), conv3(14, 256, 256)],
    &[VGG_POOL, conv3(17, 256, 512), conv3(19, 512, 512), conv3(21, 512, 512)],
    &[VGG_POOL, conv3(24, 512, 512), conv3(26, 512, 512), conv3(28, 512, 512)],
];

impl LpipsNetwork {
    /// `alex`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    /// Sides of the smallest image that every layer still has a pixel of.
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

/// Why there is no distance.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LpipsError {
    /// Weights of something else.
    #[error(
        "no tensor \"net.slice1.0.weight\" of AlexNet's shape [64, 3, 11, 11] or VGG16's [64, 3, 3, 3]; found {found}; expected the state dict of lpips.LPIPS(net='alex' or 'vgg')"
    )]
    UnknownNetwork {
        /// Its shape, or that there is none.
        found: String,
    },
    /// A tensor is missing or of another shape.
    #[error("tensor \"{name}\" is {found}, expected the shape {expected:?} and finite values")]
    Tensor {
        /// Its name.
        name: String,
        /// What is there.
        found: String,
        /// What should be.
        expected: Vec<usize>,
    },
    /// A side is shorter than the network reaches.
    #[error("image is {width}x{height}, LPIPS with {network} needs at least {min} pixels a side")]
    TooSmall {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Name of the network.
        network: &'static str,
        /// Pixels.
        min: usize,
    },
    /// Images that cannot be compared by anything.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
}

/// A network with its weights.
#[derive(Clone, Debug)]
pub struct Lpips {
    network: LpipsNetwork,
    slices: Vec<Slice>,
}

/// Layers up to a comparison, and the weight of each channel there.
#[derive(Clone, Debug)]
struct Slice {
    layers: Vec<Layer>,
    channel_weights: Vec<f32>,
}

impl Lpips {
    /// The network that the tensors are of; those that it does not know are not looked at.
    ///
    /// # Errors
    /// [`LpipsError::UnknownNetwork`], [`LpipsError::Tensor`].
    pub fn from_tensors(tensors: &Tensors) -> Result<Self, LpipsError> {
        let first = tensors.get("net.slice1.0.weight").map(|(shape, _)| shape.as_slice());
        let network = match first {
            Some([64, 3, 11, 11]) => LpipsNetwork::Alex,
            Some([64, 3, 3, 3]) => LpipsNetwork::Vgg,
            found => {
                return Err(LpipsError::UnknownNetwork { found: found.map_or("none".into(), |shape| format!("the shape {shape:?}")) });
            }
        };
        let slices = network.slices().iter().enumerate().map(|(i, steps)| Slice::of(i, steps, tensors));
        Ok(Self { network, slices: slices.collect::<Result<_, _>>()? })
    }

    /// Whose features are compared.
    pub fn network(&self) -> LpipsNetwork {
        self.network
    }

    /// Distance of two images in `[0, 1]`, as a display shows them.
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
            distance += first.distance(&second, &slice.channel_weights, LENGTH_FLOOR);
        }
        Ok(distance)
    }

    /// Distance of radiance in any unit with the primaries of `color_space`, both under the mu-law and divided by the target's maximum.
    ///
    /// # Errors
    /// As [`Lpips::distance`].
    pub fn of_radiance(
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
        let shown = |rgb: [f32; 3]| light(rgb).map(|v| curve.of((v / divisor).min(1.0)));
        let of_target: Vec<[f32; 3]> = target.pixels.iter().map(|&rgb| shown(rgb)).collect();
        let pixels = prediction.pixels.iter().zip(&of_target).enumerate();
        let of_prediction = pixels.map(|(i, (&rgb, &target))| if valid(i) { shown(rgb) } else { target }).collect();
        let image = |pixels, like: &Image| Image { width: like.width, height: like.height, pixels };
        self.distance(&image(of_prediction, prediction), &image(of_target, target))
    }
}

impl Lpips {
    /// Puts a distance where the figures of a view have this network's.
    pub fn record(&self, distance: f64, figures: &mut FieldMetrics) {
        match self.network {
            LpipsNetwork::Alex => figures.lpips_alex = Some(distance),
            LpipsNetwork::Vgg => figures.lpips_vgg = Some(distance),
        }
    }
}

/// What the network sees of an image.
fn input(image: &Image) -> Features {
    Features::from_fn([3, image.width, image.height], |c, x, y| (2.0 * image.at(x, y)[c] - 1.0 - SHIFT[c]) / SCALE[c])
}

impl Slice {
    fn of(i: usize, steps: &[Step], tensors: &Tensors) -> Result<Self, LpipsError> {
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
