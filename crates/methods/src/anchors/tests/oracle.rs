//! Anchors in f64, written from the formulas: the splats that a camera at the origin sees, with the
//! parameters of the engines, and images of them.
//!
//! In: all trained numbers, one group after another. Out: rows of splats. Shares no formula with
//! the decoders.

use luxel_core::ColorModel;
use luxel_core::engine::ParameterRows;

use super::super::groups::{GROUPS, numbers};
use super::super::scene::AnchorScene;

/// A scene in f64.
#[derive(Clone)]
pub(super) struct Point {
    color_model: ColorModel,
    pub(super) position: Vec<[f64; 3]>,
    /// Offsets, features, log scales, networks of opacity, shape and colour, context map.
    pub(super) groups: [Vec<f64>; GROUPS],
}

/// A splat of an anchor.
pub(super) struct Decoded {
    /// Position 3, rotation 4, log scale 3, opacity logit 1, harmonics 3, raw luminance if the
    /// colour model has one.
    pub(super) row: Vec<f64>,
    pub(super) radiance: [f64; 3],
    pub(super) context: [f64; 4],
}

/// A network of 35 inputs and 32 ReLU units: weights `[inputs, outputs]` of each layer before its
/// biases.
fn network(weights: &[f64], inputs: &[f64]) -> Vec<f64> {
    let (first, second) = weights.split_at(36 * 32);
    let hidden: Vec<f64> = (0..32)
        .map(|j| (inputs.iter().enumerate().map(|(i, x)| x * first[i * 32 + j]).sum::<f64>() + first[35 * 32 + j]).max(0.0))
        .collect();
    let outputs = second.len() / 33;
    (0..outputs)
        .map(|j| hidden.iter().enumerate().map(|(i, h)| h * second[i * outputs + j]).sum::<f64>() + second[32 * outputs + j])
        .collect()
}

impl Point {
    pub(super) fn new(scene: &AnchorScene) -> Self {
        let exact = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect();
        Self {
            color_model: scene.color_model(),
            position: scene.anchors.position.iter().map(|p| p.map(f64::from)).collect(),
            groups: numbers(scene).map(exact),
        }
    }

    /// Returns the splats that a camera at the origin sees.
    pub(super) fn splats(&self) -> Vec<Decoded> {
        let [offsets, features, scales, of_opacity, of_shape, of_color, of_context] = &self.groups;
        let mut all = Vec::new();
        for (anchor, at) in self.position.iter().enumerate() {
            let feature = &features[anchor * 32..(anchor + 1) * 32];
            let length = at.iter().map(|v| v * v).sum::<f64>().sqrt();
            let inputs: Vec<f64> = feature.iter().copied().chain(at.iter().map(|v| v / length)).collect();
            let [opacities, shapes, colors] = [of_opacity, of_shape, of_color].map(|weights| network(weights, &inputs));
            let context = [0, 1, 2, 3].map(|k| of_context.iter().skip(32 * k).take(32).zip(feature).map(|(w, f)| w * f).sum());
            let scale = |c: usize| scales[anchor * 6 + c];
            for k in 0..10 {
                let opacity = opacities[k].tanh();
                if opacity <= 0.0 {
                    continue;
                }
                let shape = &shapes[7 * k..7 * (k + 1)];
                let mut row: Vec<f64> = (0..3).map(|c| at[c] + offsets[anchor * 30 + 3 * k + c] * scale(c).exp()).collect();
                row.extend(&shape[3..]);
                row.extend((0..3).map(|c| scale(3 + c) - (1.0 + (-shape[c]).exp()).ln()));
                row.push((opacity / (1.0 - opacity)).ln());
                let zeroth = (1.0 / std::f64::consts::PI).sqrt() / 2.0;
                let radiance = match self.color_model {
                    ColorModel::LogSh { .. } => {
                        let logs = [0, 1, 2].map(|c| colors[3 * k + c]);
                        row.extend(logs.map(|s| (s - 0.5) / zeroth));
                        logs.map(f64::exp)
                    }
                    _ => {
                        let (raw, chroma) = (colors[4 * k], [1, 2, 3].map(|c| colors[4 * k + c]));
                        row.extend(chroma.map(|q| q / zeroth));
                        row.push(raw);
                        let above = chroma.map(|q| q.max(0.0) + 1e-3);
                        let sum: f64 = above.iter().sum();
                        above.map(|q| raw.exp() * q / sum)
                    }
                };
                assert_eq!(row.len(), ParameterRows { color_model: self.color_model }.count());
                all.push(Decoded { row, radiance, context });
            }
        }
        all
    }
}
