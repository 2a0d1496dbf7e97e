//! The field in f64, written plainly: no blocks, no tables of corners, no gradients.

use crate::field::{GridShape, PixelLoss};

/// Features of a position.
pub(super) fn encode(shape: GridShape, table: &[f64], position: [f64; 3]) -> Vec<f64> {
    let growth = (f64::from(shape.finest) / f64::from(shape.coarsest)).powf(1.0 / f64::from(shape.levels - 1));
    let (mut features, mut start) = (Vec::new(), 0);
    for level in 0..shape.levels {
        // The kernels keep the scale in f32.
        let scale = f64::from((f64::from(shape.coarsest) * growth.powi(level as i32) - 1.0) as f32);
        let side = (scale - 1e-5).ceil() as u64 + 1;
        let is_dense = side.pow(3) <= 1 << shape.log2_entries;
        let count = if is_dense { side.pow(3).next_multiple_of(8) } else { 1 << shape.log2_entries };
        let scaled = position.map(|p| p.clamp(0.0, 1.0) * scale + 0.5);
        let mut sums = [0.0; 2];
        for corner in 0..8u32 {
            let mut weight = 1.0;
            let mut at = [0u64; 3];
            for axis in 0..3 {
                let is_high = corner >> axis & 1 == 1;
                let fraction = scaled[axis].fract();
                weight *= if is_high { fraction } else { 1.0 - fraction };
                at[axis] = (scaled[axis].floor() as u64 + u64::from(is_high)).min(side - 1);
            }
            let [x, y, z] = at;
            let hashed = (x as u32) ^ (y as u32).wrapping_mul(2_654_435_761) ^ (z as u32).wrapping_mul(805_459_861);
            let entry = if is_dense { x + side * (y + side * z) } else { u64::from(hashed) % count };
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum += weight * table[2 * (start + entry) as usize + k];
            }
        }
        features.extend(sums);
        start += count;
    }
    features
}

/// Outputs of a network.
pub(super) fn network(sizes: &[usize], weights: &[f64], inputs: &[f64]) -> Vec<f64> {
    let (mut values, mut weights) = (inputs.to_vec(), weights);
    for (k, pair) in sizes.windows(2).enumerate() {
        let [inputs, outputs] = [pair[0], pair[1]];
        let (own, rest) = weights.split_at((inputs + 1) * outputs);
        weights = rest;
        let is_hidden = k + 2 < sizes.len();
        let output = |j: usize| {
            let sum = own[inputs * outputs + j] + (0..inputs).map(|i| values[i] * own[i * outputs + j]).sum::<f64>();
            if is_hidden { sum.max(0.0) } else { sum }
        };
        values = (0..outputs).map(output).collect();
    }
    values
}

/// Intervals of a ray, front to back.
#[derive(Clone)]
pub(super) struct Ray {
    pub(super) density: Vec<f64>,
    pub(super) length: Vec<f64>,
    pub(super) middle: Vec<f64>,
    pub(super) colors: Vec<[f64; 3]>,
}

impl Ray {
    /// Colour over a background, and the distortion loss.
    pub(super) fn composite(&self, background: [f32; 3]) -> ([f64; 3], f64) {
        let mut transmittance = 1.0;
        let weights: Vec<f64> = (0..self.density.len())
            .map(|i| {
                let alpha = 1.0 - (-self.density[i] * self.length[i]).exp();
                let weight = transmittance * alpha;
                transmittance *= 1.0 - alpha;
                weight
            })
            .collect();
        let mut color = background.map(|b| f64::from(b) * transmittance);
        let mut distortion = 0.0;
        for (i, w) in weights.iter().enumerate() {
            for (sum, color) in color.iter_mut().zip(self.colors[i]) {
                *sum += w * color;
            }
            distortion += w * w * self.length[i] / 3.0;
            distortion += weights.iter().zip(&self.middle).map(|(v, m)| w * v * (self.middle[i] - m).abs()).sum::<f64>();
        }
        (color, distortion)
    }
}

/// Mean squared difference of a pixel.
pub(super) fn pixel_loss(loss: PixelLoss, prediction: [f64; 3], target: [f32; 3], mu: f64) -> f64 {
    let value = |x: f64| match loss {
        PixelLoss::Linear => x,
        PixelLoss::Mulaw => (mu * x).ln_1p() / mu.ln_1p(),
    };
    (0..3).map(|c| (value(prediction[c]) - value(f64::from(target[c]))).powi(2)).sum::<f64>() / 3.0
}

/// Derivative of `f` at `values` by number `index`.
pub(super) fn difference(values: &[f64], index: usize, f: impl Fn(&[f64]) -> f64) -> f64 {
    let step = 1e-6 * values[index].abs().max(1.0);
    let at = |shift: f64| {
        let mut moved = values.to_vec();
        moved[index] += shift;
        f(&moved)
    };
    (at(step) - at(-step)) / (2.0 * step)
}
