//! The images of splats in f64, written from the mathematics: every pixel evaluates every splat.
//! Shares no formula with the engines or with the methods.
//!
//! In: the numbers of a scene ([`Point`]), a pinhole at the origin that looks along +z. Out: the
//! weights with which splats are blended at each pixel, and their colours.

use luxel_core::engine::{MIN_AREA_RATIO, ParameterRows};
use luxel_core::{Camera, LossWeights, RasterConfig, SQUARED_KNEE, Splats};

/// Rows of a splat with harmonics of degree 1.
pub(crate) const ROWS: usize = ParameterRows::SH + 12;

/// The numbers that a method trains.
#[derive(Clone)]
pub(crate) struct Point {
    /// Position 3, rotation 4, log scale 3, opacity logit 1, harmonics 12.
    pub(crate) splats: Vec<[f64; ROWS]>,
    /// Numbers of the networks, one after another.
    pub(crate) shared: Vec<f64>,
    /// Context features.
    pub(crate) features: Vec<[f64; 4]>,
}

/// For each pixel, the splats that it sees and their weights.
pub(crate) type Weights = Vec<Vec<(usize, f64)>>;

/// An image of three channels, `[H*W]`.
pub(crate) type Pixels = Vec<[f64; 3]>;

/// Returns numbers in f64.
pub(crate) fn exact(numbers: &[f32]) -> Vec<f64> {
    numbers.iter().map(|v| f64::from(*v)).collect()
}

impl Point {
    pub(crate) fn new(splats: &Splats, shared: Vec<f64>, features: &[f32]) -> Self {
        let row = |i: usize, row: usize| match row {
            0..3 => splats.position[i][row],
            3..7 => splats.rotation[i][row - 3],
            7..10 => splats.log_scale[i][row - 7],
            ParameterRows::OPACITY => splats.opacity_logit[i],
            _ => splats.sh[12 * i + row - ParameterRows::SH],
        };
        let splats = (0..splats.len()).map(|i| std::array::from_fn(|r| f64::from(row(i, r)))).collect();
        let features = features.as_chunks::<4>().0.iter().map(|f| f.map(f64::from)).collect();
        Self { splats, shared, features }
    }

    /// Returns 1/2 plus the harmonics of each splat towards the camera.
    pub(crate) fn responses(&self) -> Pixels {
        let response = |splat: &[f64; ROWS]| {
            let [x, y, z] = [splat[0], splat[1], splat[2]];
            let length = (x * x + y * y + z * z).sqrt();
            let (zeroth, first) = ((1.0 / std::f64::consts::PI).sqrt() / 2.0, (3.0 / std::f64::consts::PI).sqrt() / 2.0);
            let basis = [zeroth, -first * y / length, first * z / length, -first * x / length];
            [0, 1, 2].map(|c| 0.5 + (0..4).map(|m| basis[m] * splat[ParameterRows::SH + 3 * m + c]).sum::<f64>())
        };
        self.splats.iter().map(response).collect()
    }

    /// Returns the weights of the splats at each pixel.
    pub(crate) fn weights(&self, camera: &Camera, raster: &RasterConfig) -> Weights {
        let mut ellipses: Vec<(usize, Ellipse)> = self.splats.iter().map(|splat| Ellipse::new(splat, camera, raster)).enumerate().collect();
        ellipses.sort_by(|(_, a), (_, b)| a.depth.total_cmp(&b.depth));
        let [width, height] = camera.size_px;
        let pixel = |x: u32, y: u32| {
            let (mut transmittance, mut seen) = (1.0, Vec::new());
            for (i, ellipse) in &ellipses {
                let alpha = ellipse.alpha([f64::from(x) + 0.5, f64::from(y) + 0.5]);
                if alpha < f64::from(raster.cutoffs.min_alpha) {
                    continue;
                }
                let alpha = alpha.min(raster.cutoffs.max_alpha.into());
                let behind = transmittance * (1.0 - alpha);
                if behind < f64::from(raster.cutoffs.min_transmittance) {
                    break;
                }
                seen.push((*i, transmittance * alpha));
                transmittance = behind;
            }
            seen
        };
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| pixel(x, y)).collect()
    }
}

/// A splat on the screen.
struct Ellipse {
    mean_px: [f64; 2],
    /// Inverse covariance: xx, xy, yy.
    conic: [f64; 3],
    opacity: f64,
    depth: f64,
}

impl Ellipse {
    fn new(splat: &[f64; ROWS], camera: &Camera, raster: &RasterConfig) -> Self {
        let [x, y, z] = [splat[0], splat[1], splat[2]];
        let norm = splat[3..7].iter().map(|q| q * q).sum::<f64>().sqrt();
        let [qw, qx, qy, qz] = [0, 1, 2, 3].map(|k| splat[3 + k] / norm);
        let rotation = [
            [1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)],
            [2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)],
            [2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)],
        ];
        let (focal, center) = (camera.focal_px.to_array(), camera.center_px.to_array());
        let jacobian = [[focal[0] / z, 0.0, -focal[0] * x / (z * z)], [0.0, focal[1] / z, -focal[1] * y / (z * z)]];
        let axes = jacobian.map(|row| [0, 1, 2].map(|k| (0..3).map(|j| row[j] * rotation[j][k]).sum::<f64>()));
        let covariance = |a: usize, b: usize| (0..3).map(|k| axes[a][k] * axes[b][k] * (2.0 * splat[7 + k]).exp()).sum::<f64>();
        let (xx, xy, yy) = (covariance(0, 0), covariance(0, 1), covariance(1, 1));
        let dilation = f64::from(raster.antialias.dilation_px2());
        let (wide_xx, wide_yy) = (xx + dilation, yy + dilation);
        let determinant = wide_xx * wide_yy - xy * xy;
        let ratio = ((xx * yy - xy * xy) / determinant).max(MIN_AREA_RATIO.into());
        let compensation = if raster.antialias.compensates_opacity() { ratio.sqrt() } else { 1.0 };
        Self {
            mean_px: [focal[0] * x / z + center[0], focal[1] * y / z + center[1]],
            conic: [wide_yy / determinant, -xy / determinant, wide_xx / determinant],
            opacity: sigmoid(splat[ParameterRows::OPACITY]) * compensation,
            depth: z,
        }
    }

    fn alpha(&self, at: [f64; 2]) -> f64 {
        let [dx, dy] = [at[0] - self.mean_px[0], at[1] - self.mean_px[1]];
        let [xx, xy, yy] = self.conic;
        self.opacity * (-0.5 * (xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy)).exp()
    }
}

pub(crate) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

pub(crate) fn softplus(x: f64) -> f64 {
    (1.0 + x.exp()).ln()
}

/// Blends numbers of splats over 0.
pub(crate) fn blend<const N: usize>(weights: &Weights, numbers: &[[f64; N]]) -> Vec<[f64; N]> {
    weights.iter().map(|seen| std::array::from_fn(|k| seen.iter().map(|(i, w)| w * numbers[*i][k]).sum())).collect()
}

/// Sums under the window of SSIM, 11 x 11 with a standard deviation of 1.5, around each pixel;
/// zeros lie beyond the image.
fn window_sums<const N: usize>(width: usize, values: &[[f64; N]]) -> Vec<[f64; N]> {
    let taps: [f64; 11] = std::array::from_fn(|k| (-(k as f64 - 5.0).powi(2) / 4.5).exp());
    let total: f64 = taps.iter().sum();
    // Along one axis: numbers `stride` apart, `length` of them, of which this is number `place`.
    let along = |values: &[[f64; N]], i: usize, place: usize, stride: usize, length: usize| -> [f64; N] {
        let inside = (0..11).filter(|k| (5..length + 5).contains(&(place + k)));
        inside.fold([0.0; N], |sum, k| {
            let from = values[(i + k * stride) - 5 * stride];
            std::array::from_fn(|n| sum[n] + taps[k] / total * from[n])
        })
    };
    let rows: Vec<[f64; N]> = (0..values.len()).map(|i| along(values, i, i % width, 1, width)).collect();
    (0..values.len()).map(|i| along(&rows, i, i / width, width, values.len() / width)).collect()
}

/// 1 - SSIM of the window around each value.
pub(crate) fn dissimilarity(width: usize, x: &Pixels, y: &Pixels) -> Pixels {
    let products: Vec<[f64; 15]> = x
        .iter()
        .zip(y)
        .map(|(x, y)| {
            std::array::from_fn(|k| {
                let (a, b) = (x[k / 5], y[k / 5]);
                [a, b, a * a, b * b, a * b][k % 5]
            })
        })
        .collect();
    let (c1, c2) = (1e-4, 9e-4);
    let value = |sums: &[f64; 15], c: usize| {
        let [mx, my, xx, yy, xy] = std::array::from_fn(|k| sums[5 * c + k]);
        1.0 - (2.0 * mx * my + c1) * (2.0 * (xy - mx * my) + c2) / ((mx * mx + my * my + c1) * (xx - mx * mx + yy - my * my + c2))
    };
    window_sums(width, &products).iter().map(|sums| [0, 1, 2].map(|c| value(sums, c))).collect()
}

/// The loss of an image, whose values count as much as `counts` says.
pub(crate) fn image_loss(width: usize, x: &Pixels, y: &Pixels, counts: &Pixels, weights: &LossWeights) -> f64 {
    let (knee, squared, ssim) = (f64::from(SQUARED_KNEE), f64::from(weights.squared_share), f64::from(weights.ssim_weight));
    let d = dissimilarity(width, x, y);
    let value = |i: usize, c: usize| {
        let difference = x[i][c] - y[i][c];
        let distance = (1.0 - squared) * difference.abs() + squared * difference * difference / (2.0 * knee);
        counts[i][c] * ((1.0 - ssim) * distance + ssim * d[i][c])
    };
    (0..x.len()).flat_map(|i| (0..3).map(move |c| (i, c))).map(|(i, c)| value(i, c)).sum::<f64>() / (3 * x.len()) as f64
}

/// Weights of 1.
pub(crate) fn all(len: usize) -> Pixels {
    vec![[1.0; 3]; len]
}

/// A network of one input, ReLU units and some outputs; `numbers` are weights and biases of the
/// units, and for each output their outgoing weights and a bias.
pub(crate) fn relu_network<const OUTPUTS: usize>(numbers: &[f64], s: f64) -> [f64; OUTPUTS] {
    let units = (numbers.len() - OUTPUTS) / (2 + OUTPUTS);
    let hidden = |j: usize| (numbers[j] * s + numbers[units + j]).max(0.0);
    std::array::from_fn(|o| {
        let own = &numbers[2 * units + o * (units + 1)..][..units + 1];
        own[units] + (0..units).map(|j| own[j] * hidden(j)).sum::<f64>()
    })
}
