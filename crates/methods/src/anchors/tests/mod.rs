//! Decoders and whole steps against a plain version in f64, and runs of small scenes.

mod decoding;
mod growth;
mod oracle;
mod step;
mod training;

use luxel_core::random::standard_normal;
use luxel_core::{Activation, ColorModel};

use super::FEATURE;
use super::decoders::Decoders;
use super::scene::{AnchorScene, Anchors};

/// The colour models of the two methods.
const MODELS: [ColorModel; 2] =
    [ColorModel::Lcd { chroma_degree: 0, luminance_degree: 0, activation: Activation::Exp }, ColorModel::LogSh { degree: 0 }];

/// Returns numbers of a normal distribution.
fn normals(seed: u64, count: usize) -> Vec<f32> {
    (0..count as u64).map(|i| standard_normal(seed, i)[0]).collect()
}

/// Makes anchors in front of a camera at the origin, with features, offsets and sizes of their own.
fn scene(color_model: ColorModel, has_context: bool, count: usize) -> AnchorScene {
    let mut anchors = Anchors::default();
    for i in 0..count as u64 {
        let [x, y, z] = standard_normal(1, i);
        let mut feature = [0.0; FEATURE];
        feature.copy_from_slice(&normals(100 + i, FEATURE));
        anchors.push([0.5 * x, 0.5 * y, 4.0 + 0.4 * z], 0.5, feature.map(|v| 0.5 * v));
    }
    let (offsets, scales) = (normals(2, anchors.offset.len()), normals(3, anchors.log_scale.len()));
    anchors.offset.iter_mut().zip(offsets).for_each(|(offset, v)| *offset = 0.4 * v);
    anchors.log_scale.iter_mut().zip(scales).for_each(|(scale, v)| *scale += 0.2 * v);
    AnchorScene { anchors, decoders: Decoders::new(color_model, has_context, [0.4, 0.5, 0.3], 5) }
}
