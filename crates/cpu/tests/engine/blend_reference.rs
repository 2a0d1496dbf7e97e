//! The reference of differentiable blending: projection and compositing of splats with activated
//! parameters, written directly from the published formulas, in f64 and without tiles.
//!
//! Generic over [`Number`], as the oracle: on the tape it gives exact derivatives by every number.

use luxel_core::engine::{BlendOptions, MatrixCamera};

use crate::number::Number;

/// Everything that is differentiated, one number after the other.
#[derive(Clone)]
pub struct Inputs<N> {
    pub position: Vec<[N; 3]>,
    pub rotation: Vec<[N; 4]>,
    pub scale: Vec<[N; 3]>,
    pub opacity: Vec<N>,
    /// Rows of each camera's map.
    pub camera_from_world: Vec<[[N; 4]; 3]>,
    /// `[C, N, K]`.
    pub channels: Vec<Vec<Vec<N>>>,
    /// `[C, K]`.
    pub background: Vec<Vec<N>>,
}

/// A splat on a screen.
#[derive(Clone, Copy)]
pub struct Ellipse<N> {
    pub mean_px: [N; 2],
    pub covariance: [N; 3],
    pub conic: [N; 3],
    pub depth: N,
    pub opacity: N,
    pub radius_px: [f64; 2],
}

/// A blended image.
pub struct Blended<N> {
    /// `[H*W][K]`.
    pub channels: Vec<Vec<N>>,
    pub alpha: Vec<N>,
    /// How near a decision of the pixel is to the other side, relative.
    pub margin: Vec<f64>,
    /// Splat and its offset from the pixel, for every blended pair.
    pub offsets: Vec<(usize, [N; 2])>,
}

fn dot<N: Number, const L: usize>(a: [N; L], b: [N; L]) -> N {
    (0..L).fold(N::of(0.0), |sum, i| sum + a[i] * b[i])
}

pub fn rotation_matrix<N: Number>(q: [N; 4]) -> [[N; 3]; 3] {
    let norm = dot(q, q).sqrt();
    let [w, x, y, z] = q.map(|c| c / norm);
    let (one, two) = (N::of(1.0), N::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Projects all splats to a camera; `None` where gsplat's radii are zero.
pub fn project<N: Number>(inputs: &Inputs<N>, camera: usize, intrinsics: &MatrixCamera, options: &BlendOptions) -> Vec<Option<Ellipse<N>>> {
    let rows = inputs.camera_from_world[camera];
    let size = options.size_px.map(f64::from);
    let (focal, center) = (intrinsics.focal_px.map(f64::from), intrinsics.center_px.map(f64::from));
    let one = |i: usize| {
        let p = inputs.position[i];
        let at = rows.map(|[a, b, c, d]| dot([a, b, c], p) + d);
        let z = at[2];
        if z.value() < options.cutoffs.near.into() || z.value() > options.far.into() {
            return None;
        }
        let axes = rotation_matrix(inputs.rotation[i]);
        let mut jacobian = [[N::of(0.0); 3]; 2];
        let mut mean_px = [N::of(0.0); 2];
        for a in 0..2 {
            let f = N::of(focal[a]);
            mean_px[a] = f * at[a] / z + N::of(center[a]);
            let margin = 0.3 * 0.5 * size[a] / focal[a];
            let (low, high) = (-center[a] / focal[a] - margin, (size[a] - center[a]) / focal[a] + margin);
            let slope = at[a] / z;
            let slope = if slope.value() < low {
                N::of(low)
            } else if slope.value() > high {
                N::of(high)
            } else {
                slope
            };
            for k in 0..3 {
                jacobian[a][k] = f / z * rows[a][k] - f * slope / z * rows[2][k];
            }
        }
        let root: [[N; 3]; 2] = jacobian.map(|row| [0, 1, 2].map(|k| dot(row, [axes[0][k], axes[1][k], axes[2][k]]) * inputs.scale[i][k]));
        let [xx, xy, yy] = [dot(root[0], root[0]), dot(root[0], root[1]), dot(root[1], root[1])];
        let before = xx * yy - xy * xy;
        let dilation = N::of(options.dilation_px2.into());
        let (xx, yy) = (xx + dilation, yy + dilation);
        let determinant = xx * yy - xy * xy;
        let mut opacity = inputs.opacity[i];
        if options.compensates_opacity {
            opacity = opacity * (before / determinant).max(N::of(0.0)).sqrt();
        }
        let threshold = f64::from(options.cutoffs.min_alpha);
        if opacity.value() < threshold {
            return None;
        }
        let deviations = (2.0 * (opacity.value() / threshold).ln()).sqrt().min(3.33);
        let radius_px = [xx, yy].map(|v| (deviations * v.value().sqrt()).ceil());
        let is_inside = (0..2).all(|a| mean_px[a].value() + radius_px[a] > 0.0 && mean_px[a].value() - radius_px[a] < size[a]);
        let is_large = radius_px.iter().any(|radius| *radius > options.min_radius_px.into());
        (is_inside && is_large).then(|| Ellipse {
            mean_px,
            covariance: [xx, xy, yy],
            conic: [yy / determinant, -xy / determinant, xx / determinant],
            depth: z,
            opacity,
            radius_px,
        })
    };
    (0..inputs.opacity.len()).map(one).collect()
}

/// Blends a camera's ellipses.
pub fn blend<N: Number>(inputs: &Inputs<N>, camera: usize, ellipses: &[Option<Ellipse<N>>], options: &BlendOptions) -> Blended<N> {
    let mut order: Vec<usize> = (0..ellipses.len()).filter(|i| ellipses[*i].is_some()).collect();
    order.sort_by(|a, b| ellipses[*a].unwrap().depth.value().total_cmp(&ellipses[*b].unwrap().depth.value()));
    let cutoffs = options.cutoffs;
    let max_alpha = N::of(cutoffs.max_alpha.into());
    let [width, height] = options.size_px;
    let count = inputs.background[camera].len();
    let mut out = Blended { channels: Vec::new(), alpha: Vec::new(), margin: Vec::new(), offsets: Vec::new() };
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let at = [f64::from(x) + 0.5, f64::from(y) + 0.5];
        let (mut transmittance, mut sums, mut margin) = (N::of(1.0), vec![N::of(0.0); count], f64::INFINITY);
        for &i in &order {
            let e = ellipses[i].unwrap();
            let d = [0, 1].map(|a| N::of(at[a]) - e.mean_px[a]);
            let power = e.conic[0] * d[0] * d[0] + N::of(2.0) * e.conic[1] * d[0] * d[1] + e.conic[2] * d[1] * d[1];
            let alpha = e.opacity * (N::of(-0.5) * power).exp();
            margin = margin.min((alpha.value() / f64::from(cutoffs.min_alpha) - 1.0).abs());
            margin = margin.min((alpha.value() / f64::from(cutoffs.max_alpha) - 1.0).abs());
            if alpha.value() < cutoffs.min_alpha.into() {
                continue;
            }
            let alpha = if alpha.value() > max_alpha.value() { max_alpha } else { alpha };
            let behind = transmittance * (N::of(1.0) - alpha);
            margin = margin.min((behind.value() / f64::from(cutoffs.min_transmittance) - 1.0).abs());
            if behind.value() <= cutoffs.min_transmittance.into() {
                break;
            }
            for (sum, channel) in sums.iter_mut().zip(&inputs.channels[camera][i]) {
                *sum = *sum + transmittance * alpha * *channel;
            }
            transmittance = behind;
            out.offsets.push((i, d));
        }
        let with_background = sums.iter().zip(&inputs.background[camera]).map(|(sum, b)| *sum + transmittance * *b);
        out.channels.push(with_background.collect());
        out.alpha.push(N::of(1.0) - transmittance);
        out.margin.push(margin);
    }
    out
}
