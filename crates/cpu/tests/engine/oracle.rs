//! The oracle: the image, the loss and its gradient, written directly from the mathematics in f64
//! and without tiles: every pixel evaluates every splat, sorted by depth. It is deliberately slow
//! and simple, and shares no formula with the engine (only the spherical harmonics of core, which
//! core proves orthonormal).
//!
//! Generic over [`Number`]: on `f64` it gives values and, by [`central_differences`], numerical
//! derivatives; on the tape it gives exact ones. Every decision (skip, cap, stop, clamp, rectifier,
//! sign, order) goes into [`Trace`]: two evaluations with equal traces lie on one smooth piece of
//! the function, and only between such are differences taken.

use luxel_core::engine::PixelAngle;
use luxel_core::{
    Activation, Antialias, Camera, ColorModel, DEAD_CHROMA_FLOOR, LossWeights, RESPONSE_KNOTS, RenderOptions, SH_OFFSET, Splats, ToneCurve,
    VIGNETTING_TERMS, View, sh,
};

use crate::number::{Gradient, Number, Var, gradient, variables};

/// Decisions taken, as a hash.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Trace(u64);

impl Trace {
    fn note(&mut self, value: u64) {
        self.0 = (self.0 ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29) ^ 0x55;
    }

    fn decide(&mut self, decision: bool) -> bool {
        self.note(1 + u64::from(decision));
        decision
    }
}

/// Guard of Mip-splatting's opacity compensation: the ratio of areas is taken to be at least this.
const MIN_AREA_RATIO: f64 = 1e-6;

/// The scene's parameters, one after the other, in the order of [`ARRAYS`].
pub struct Parameters<N> {
    pub splats: Splats,
    pub flat: Vec<N>,
}

/// Parameter arrays; harmonics and luminance apart by degree 0 and above.
pub const ARRAYS: [&str; 8] = ["position", "rotation", "log_scale", "opacity_logit", "sh_dc", "sh_rest", "luminance_dc", "luminance_rest"];

/// Parameters of `splats` (any of: scene, gradients, moments), one after the other.
pub fn flatten(splats: &Splats) -> Vec<f64> {
    let arrays: [&[f32]; 6] = [
        splats.position.as_flattened(),
        splats.rotation.as_flattened(),
        splats.log_scale.as_flattened(),
        &splats.opacity_logit,
        &splats.sh,
        &splats.raw_luminance,
    ];
    arrays.concat().into_iter().map(f64::from).collect()
}

/// Index into [`ARRAYS`] of each parameter of [`flatten`].
pub fn array_of_parameters(splats: &Splats) -> Vec<usize> {
    let n = splats.len();
    let (k, m) = (3 * splats.color_model.sh_coefficients(), splats.color_model.luminance_coefficients());
    let mut arrays = Vec::new();
    for (array, width) in [3, 4, 3, 1].into_iter().enumerate() {
        arrays.extend(std::iter::repeat_n(array, n * width));
    }
    for _ in 0..n {
        arrays.extend((0..k).map(|i| if i < 3 { 4 } else { 5 }));
    }
    for _ in 0..n {
        arrays.extend((0..m).map(|i| if i == 0 { 6 } else { 7 }));
    }
    arrays
}

impl<N: Number> Parameters<N> {
    fn position(&self, i: usize) -> [N; 3] {
        std::array::from_fn(|a| self.flat[3 * i + a])
    }
    fn rotation(&self, i: usize) -> [N; 4] {
        std::array::from_fn(|a| self.flat[3 * self.splats.len() + 4 * i + a])
    }
    fn log_scale(&self, i: usize) -> [N; 3] {
        std::array::from_fn(|a| self.flat[7 * self.splats.len() + 3 * i + a])
    }
    fn opacity_logit(&self, i: usize) -> N {
        self.flat[10 * self.splats.len() + i]
    }
    fn sh(&self, i: usize, m: usize, channel: usize) -> N {
        let k = self.splats.color_model.sh_coefficients();
        self.flat[11 * self.splats.len() + 3 * (k * i + m) + channel]
    }
    fn raw_luminance(&self, i: usize, m: usize) -> N {
        let (k, width) = (self.splats.color_model.sh_coefficients(), self.splats.color_model.luminance_coefficients());
        self.flat[(11 + 3 * k) * self.splats.len() + width * i + m]
    }
}

/// A splat on the screen.
pub struct Ellipse<N> {
    pub splat: usize,
    pub depth: f64,
    pub mean_px: [N; 2],
    pub conic: [N; 3],
    pub opacity: N,
    pub radiance: [N; 3],
    pub threshold: f64,
    /// Two directions of the plane and the splat's own, camera space, if pixels are rays. The mean
    /// is then the plane's origin.
    pub plane: Option<[[N; 3]; 3]>,
}

/// A splat's plane, the variance that a pixel adds there, and the rows that map offsets in the
/// world to it.
struct Plane<N> {
    axes: [[N; 3]; 3],
    dilation: N,
    jacobian: [[N; 3]; 2],
}

impl<N: Number> Plane<N> {
    /// The plane across the direction of a point in camera space.
    fn new(at: [N; 3], camera: &Camera, camera_rotation: [[N; 3]; 3], dilation_px2: f64) -> Self {
        let distance = dot(at, at).sqrt();
        let unit = at.map(|c| c / distance);
        // Any direction that is not the splat's, made orthogonal.
        let helper = if unit[0].value().abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }.map(N::of);
        let along = dot(helper, unit);
        let first: [N; 3] = std::array::from_fn(|a| helper[a] - along * unit[a]);
        let length = dot(first, first).sqrt();
        let first = first.map(|c| c / length);
        let second =
            [unit[1] * first[2] - unit[2] * first[1], unit[2] * first[0] - unit[0] * first[2], unit[0] * first[1] - unit[1] * first[0]];
        let size = PixelAngle::new(camera);
        let t = (unit[2] - N::of(size.middle)) / N::of(size.half_range);
        let t = if t.value().abs() < 1.0 { t } else { N::of(t.value().clamp(-1.0, 1.0)) };
        let squared = size.coefficients.iter().rev().fold(N::of(0.0), |sum, c| sum * t + N::of(*c));
        let row = |axis: [N; 3]| std::array::from_fn(|column| dot(axis, [0, 1, 2].map(|k| camera_rotation[k][column])) / distance);
        Self { axes: [first, second, unit], dilation: N::of(dilation_px2) * squared, jacobian: [row(first), row(second)] }
    }

    /// Coordinates of a pixel's ray on a splat's plane, and the cosine between the ray and the
    /// splat's direction.
    fn coordinates(axes: &[[N; 3]; 3], ray: [f64; 3]) -> ([N; 2], f64) {
        let ray = ray.map(N::of);
        ([dot(axes[0], ray), dot(axes[1], ray)], dot(axes[2], ray).value())
    }
}

fn sigmoid<N: Number>(x: N) -> N {
    N::of(1.0) / (N::of(1.0) + (-x).exp())
}

fn rotation_matrix<N: Number>(q: [N; 4]) -> [[N; 3]; 3] {
    let norm = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    let [w, x, y, z] = q.map(|c| c / norm);
    let (one, two) = (N::of(1.0), N::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

fn dot<N: Number>(a: [N; 3], b: [N; 3]) -> N {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the radiance of splat `i` from `direction`.
fn radiance<N: Number>(p: &Parameters<N>, i: usize, direction: [N; 3], active_degree: usize, trace: &mut Trace) -> [N; 3] {
    let zero = N::of(0.0);
    let degree = p.splats.color_model.max_degree();
    let mut basis = [zero; sh::MAX_COEFFICIENTS];
    sh::basis(degree, direction, &mut basis);
    let active = |degree: u8| sh::coefficients(active_degree.min(degree.into()));
    let response = |degree: u8| [0, 1, 2].map(|c| (0..active(degree)).fold(zero, |sum, m| sum + p.sh(i, m, c) * basis[m]));
    let mut rectified = |x: N| if trace.decide(x.value() > 0.0) { x } else { zero };
    match p.splats.color_model {
        ColorModel::Sh { degree } => response(degree).map(|s| rectified(s + N::of(SH_OFFSET.into()))),
        ColorModel::LogSh { degree } => response(degree).map(|s| (s + N::of(SH_OFFSET.into())).exp()),
        ColorModel::Lcd { chroma_degree, luminance_degree, activation } => {
            let r = response(chroma_degree).map(|s| rectified(s) + N::of(DEAD_CHROMA_FLOOR.into()));
            let raw = (1..active(luminance_degree)).fold(p.raw_luminance(i, 0), |sum, m| sum + p.raw_luminance(i, m) * basis[m]);
            let luminance = match activation {
                // ln(1 + e^l) = l + ln(1 + e^-l)
                Activation::Softplus if raw.value() > 0.0 => raw + (-raw).exp().ln_1p(),
                Activation::Softplus => raw.exp().ln_1p(),
                Activation::Exp => raw.exp(),
                Activation::Relu => rectified(raw),
            };
            let sum = r[0] + r[1] + r[2];
            r.map(|q| luminance * q / sum)
        }
        ColorModel::Mix(_) => unreachable!("mixes are compared with sums of renders"),
    }
}

/// Projects splat `i`; `None` if it is culled.
fn project<N: Number>(p: &Parameters<N>, i: usize, camera: &Camera, options: &RenderOptions, trace: &mut Trace) -> Option<Ellipse<N>> {
    let cutoffs = options.raster.cutoffs;
    let (c, t) = (camera.camera_from_world.matrix3, camera.camera_from_world.translation);
    let camera_rotation: [[N; 3]; 3] = [0, 1, 2].map(|row| c.row(row).to_array().map(N::of));
    let position = p.position(i);
    let at: [N; 3] = std::array::from_fn(|row| dot(camera_rotation[row], position) + N::of(t[row]));
    let distance = dot(at, at).sqrt().value();
    let depth = if camera.projection.is_pinhole() { at[2].value() } else { distance };
    if trace.decide(depth < f64::from(cutoffs.near)) {
        return None;
    }
    let plane =
        (!camera.projection.is_pinhole()).then(|| Plane::new(at, camera, camera_rotation, options.raster.antialias.dilation_px2().into()));

    // Shape: squared standard deviations, smoothed.
    let mut variance = p.log_scale(i).map(|s| s.exp() * s.exp());
    let mut opacity = sigmoid(p.opacity_logit(i));
    if let (Antialias::Mip, Some(&filter)) = (options.raster.antialias, p.splats.smoothing.get(i)) {
        let filter = N::of(f64::from(filter) * f64::from(filter));
        for v in &mut variance {
            opacity = opacity * (*v / (*v + filter)).sqrt();
            *v = *v + filter;
        }
    }

    // J R_c R(q): each row a screen axis, each column a principal axis.
    let rotation = rotation_matrix(p.rotation(i));
    let mut slope = [at[0] / at[2], at[1] / at[2]];
    let mut mean_px = [0, 1].map(|a| N::of(camera.focal_px[a]) * slope[a] + N::of(camera.center_px[a]));
    if plane.is_some() {
        mean_px = [N::of(0.0); 2];
    }
    for (a, slope) in slope.iter_mut().enumerate().filter(|_| plane.is_none()) {
        let (focal, size) = (camera.focal_px[a], f64::from(camera.size_px[a]));
        let margin = 0.3 * size / (2.0 * focal);
        let (low, high) = (-(camera.center_px[a] / focal + margin), (size - camera.center_px[a]) / focal + margin);
        if trace.decide(slope.value() < low) {
            *slope = N::of(low);
        } else if trace.decide(slope.value() > high) {
            *slope = N::of(high);
        }
    }
    let axes: [[N; 3]; 2] = std::array::from_fn(|a| {
        let (j, jz) = (N::of(camera.focal_px[a]) / at[2], -(N::of(camera.focal_px[a]) * slope[a] / at[2]));
        let row: [N; 3] = match &plane {
            None => std::array::from_fn(|column| j * camera_rotation[a][column] + jz * camera_rotation[2][column]),
            Some(plane) => plane.jacobian[a],
        };
        std::array::from_fn(|column| dot(row, [0, 1, 2].map(|k| rotation[k][column])))
    });
    let covariance = |a: usize, b: usize| (0..3).fold(N::of(0.0), |sum, k| sum + axes[a][k] * axes[b][k] * variance[k]);
    let (xx, xy, yy) = (covariance(0, 0), covariance(0, 1), covariance(1, 1));
    let dilation = plane.as_ref().map_or(N::of(options.raster.antialias.dilation_px2().into()), |plane| plane.dilation);
    let (dilated_xx, dilated_yy) = (xx + dilation, yy + dilation);
    let determinant = dilated_xx * dilated_yy - xy * xy;
    if options.raster.antialias != Antialias::Off {
        let ratio = (xx * yy - xy * xy) / determinant;
        opacity = opacity * if trace.decide(ratio.value() > MIN_AREA_RATIO) { ratio } else { N::of(MIN_AREA_RATIO) }.sqrt();
    }

    let eye = camera.eye();
    let ray: [N; 3] = std::array::from_fn(|a| position[a] - N::of(eye[a]));
    let length = dot(ray, ray).sqrt();
    let radiance = radiance(p, i, ray.map(|r| r / length), options.active_degree, trace);
    let brightest = radiance.iter().fold(0.0, |m: f64, c| m.max(c.value()));
    let by_contribution = f64::from(cutoffs.min_contribution) / brightest;
    Some(Ellipse {
        splat: i,
        depth,
        mean_px,
        conic: [dilated_yy / determinant, -xy / determinant, dilated_xx / determinant],
        opacity,
        radiance: radiance.map(|c| c * N::of(p.splats.gain_of(i).into())),
        threshold: f64::from(cutoffs.min_alpha).min(by_contribution).max(cutoffs.alpha_floor.into()),
        plane: plane.map(|plane| plane.axes),
    })
}

/// The result of a rendering.
pub struct Rendered<N> {
    /// [H*W], row-major.
    pub pixels: Vec<[N; 3]>,
    /// Splats on the screen in front-to-back order.
    pub ellipses: Vec<Ellipse<N>>,
    /// Splat and offset from its mean for every evaluation that was blended: for per-pixel
    /// gradients.
    pub offsets: Vec<(usize, [N; 2])>,
    pub trace: Trace,
    /// [H*W] how near a decision of the pixel is to the other side: relative distance of an alpha
    /// or a transmittance to its threshold.
    pub margin: Vec<f64>,
    /// [H*W] how near the pixel is to the edge at which a splat that still covers it ends: cosine
    /// between ray and splat.
    pub edge: Vec<f64>,
}

/// Renders the image: each pixel is the mean of its samples.
pub fn render<N: Number>(p: &Parameters<N>, camera: &Camera, options: &RenderOptions) -> Rendered<N> {
    let samples = usize::from(options.raster.samples);
    let rendered = render_samples(p, &camera.upscaled(samples as u32), options);
    let [width, height] = camera.size_px.map(|side| side as usize);
    let of_pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        (0..samples * samples).map(move |n| (y * samples + n / samples) * width * samples + x * samples + n % samples)
    };
    let share = N::of(1.0 / (samples * samples) as f64);
    let mean =
        |i: usize| -> [N; 3] { std::array::from_fn(|c| of_pixel(i).fold(N::of(0.0), |sum, at| sum + share * rendered.pixels[at][c])) };
    let least =
        |of_samples: &[f64]| (0..width * height).map(|i| of_pixel(i).map(|at| of_samples[at]).fold(f64::INFINITY, f64::min)).collect();
    let pixels = (0..width * height).map(mean).collect();
    Rendered { pixels, margin: least(&rendered.margin), edge: least(&rendered.edge), ..rendered }
}

/// Renders the image without supersampling.
fn render_samples<N: Number>(p: &Parameters<N>, camera: &Camera, options: &RenderOptions) -> Rendered<N> {
    let mut trace = Trace::default();
    let mut ellipses: Vec<_> = (0..p.splats.len()).filter_map(|i| project(p, i, camera, options, &mut trace)).collect();
    ellipses.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.splat.cmp(&b.splat)));
    ellipses.iter().for_each(|e| trace.note(e.splat as u64));

    let cutoffs = options.raster.cutoffs;
    let max_alpha = N::of(cutoffs.max_alpha.into());
    let [width, height] = camera.size_px;
    let mut pixels = Vec::new();
    let mut offsets = Vec::new();
    let (mut margins, mut edges) = (Vec::new(), Vec::new());
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let center = [f64::from(x) + 0.5, f64::from(y) + 0.5];
        let ray = camera.unproject(center.into());
        let mut transmittance = N::of(1.0);
        let mut pixel = [N::of(0.0); 3];
        let (mut margin, mut edge) = (f64::INFINITY, f64::INFINITY);
        for e in &ellipses {
            let (d, cosine): ([N; 2], f64) = match (&e.plane, ray) {
                (None, _) => (std::array::from_fn(|a| N::of(center[a]) - e.mean_px[a]), 1.0),
                (Some(axes), Some(ray)) => Plane::coordinates(axes, ray.to_array()),
                (Some(_), None) => break,
            };
            let power = e.conic[0] * d[0] * d[0] + N::of(2.0) * e.conic[1] * d[0] * d[1] + e.conic[2] * d[1] * d[1];
            let alpha = e.opacity * (N::of(-0.5) * power).exp();
            let looks_away = cosine <= 0.0;
            if !looks_away {
                margin = margin.min((alpha.value() / e.threshold - 1.0).abs());
            }
            if trace.decide(alpha.value() < e.threshold) {
                continue;
            }
            // A splat ends at a right angle to its direction, however opaque it is there.
            edge = edge.min(cosine.abs());
            if trace.decide(looks_away) {
                continue;
            }
            let alpha = if trace.decide(alpha.value() > max_alpha.value()) { max_alpha } else { alpha };
            let behind = transmittance * (N::of(1.0) - alpha);
            margin = margin.min((behind.value() / f64::from(cutoffs.min_transmittance) - 1.0).abs());
            if trace.decide(behind.value() < f64::from(cutoffs.min_transmittance)) {
                break;
            }
            for (channel, radiance) in pixel.iter_mut().zip(e.radiance) {
                *channel = *channel + transmittance * alpha * radiance;
            }
            transmittance = behind;
            offsets.push((e.splat, d));
        }
        margins.push(margin);
        edges.push(edge);
        pixels.push(std::array::from_fn(|c| pixel[c] + transmittance * N::of(options.background[c].into())));
    }
    Rendered { pixels, ellipses, offsets, trace, margin: margins, edge: edges }
}

/// The loss and its parts.
#[derive(Clone, Copy)]
pub struct Loss<N> {
    pub total: N,
    pub l1: N,
    pub ssim: N,
}

/// The tone curve of a loss, with its knots as numbers.
pub enum Curve<N> {
    MuLaw(f64),
    Response { knots: [Vec<N>; 3], exposure: [f32; 3] },
}

impl<N: Number> Curve<N> {
    pub fn of(curve: &ToneCurve) -> Self {
        match curve {
            ToneCurve::MuLaw { mu } => Self::MuLaw((*mu).into()),
            ToneCurve::Response(r) => {
                Self::Response { knots: r.knots.map(|k| k.iter().map(|v| N::of((*v).into())).collect()), exposure: r.exposure }
            }
        }
    }

    /// Returns the values of a predicted and a recorded number in channel `c`.
    fn apply(&self, c: usize, p: N, recorded: f32, trace: &mut Trace) -> [N; 2] {
        match self {
            Self::MuLaw(mu) => [p, N::of(recorded.into())]
                .map(|p| if trace.decide(p.value() > 0.0) { (N::of(*mu) * p).ln_1p() / N::of(mu.ln_1p()) } else { N::of(0.0) }),
            Self::Response { knots, exposure } => {
                let x = if trace.decide(p.value() > 0.0) { p * N::of(exposure[c].into()) } else { N::of(0.0) };
                // Twenty pieces up to x = 1.
                let u = N::of(20.0) * (N::of(1023.0) * x).ln_1p() / N::of(1023f64.ln_1p());
                let k = (u.value().floor() as usize).min(RESPONSE_KNOTS - 2);
                trace.note(k as u64);
                let value = knots[c][k] + (u - N::of(k as f64)) * (knots[c][k + 1] - knots[c][k]);
                let recorded = f64::from(recorded);
                let is_beyond =
                    (recorded >= 254.5 / 255.0 && value.value() > recorded) || (recorded <= 0.5 / 255.0 && value.value() < recorded);
                [if trace.decide(is_beyond) { N::of(recorded) } else { value }, N::of(recorded)]
            }
        }
    }
}

/// Returns the pixels as the view shows them: times the gain of its vignetting, with these
/// coefficients of ln gain.
fn vignetted<N: Number>(pixels: &[[N; 3]], view: &View, log_gain: [N; VIGNETTING_TERMS]) -> Vec<[N; 3]> {
    let Some(vignetting) = view.target.vignetting else { return pixels.to_vec() };
    let [axis_x, axis_y] = vignetting.axis_px.map(f64::from);
    let gain = |i: usize| {
        let (x, y) = ((i % view.image.width) as f64 + 0.5 - axis_x, (i / view.image.width) as f64 + 0.5 - axis_y);
        let r2 = ((x * x + y * y) / f64::from(vignetting.unit_px).powi(2)).min(1.0);
        (0..VIGNETTING_TERMS).fold(N::of(0.0), |sum, k| sum + log_gain[k] * N::of(r2.powi(k as i32))).exp()
    };
    pixels.iter().enumerate().map(|(i, pixel)| pixel.map(|value| value * gain(i))).collect()
}

/// Computes the loss of an image compared with `view`.
pub fn loss<N: Number>(pixels: &[[N; 3]], view: &View, curve: &Curve<N>, config: &LossWeights, trace: &mut Trace) -> Loss<N> {
    let weight = |i: usize| view.mask.as_ref().map_or(1.0, |mask| f64::from(mask.weights[i]));
    let mut predicted = vec![Vec::new(); 3];
    let mut target = vec![Vec::new(); 3];
    for (i, pixel) in pixels.iter().enumerate() {
        for c in 0..3 {
            let [value, goal] = curve.apply(c, pixel[c], view.image.pixels[i][c] * view.target.scale[c], trace);
            target[c].push(goal);
            let mixed = N::of(weight(i)) * value + N::of(1.0 - weight(i)) * goal;
            predicted[c].push(if view.is_valid(i) { mixed } else { goal });
        }
    }
    let (mut sum, mut squares, mut total) = (N::of(0.0), N::of(0.0), 0.0);
    for i in (0..pixels.len()).filter(|&i| view.is_valid(i)) {
        for c in 0..3 {
            let difference = predicted[c][i] - target[c][i];
            sum = if trace.decide(difference.value() < 0.0) { sum - difference } else { sum + difference };
            squares = squares + difference * difference;
            total += weight(i);
        }
    }
    let [l1, l2] = [sum, squares].map(|sum| if total == 0.0 { N::of(0.0) } else { sum / N::of(total) });
    let ssim = (0..3).fold(N::of(0.0), |sum, c| sum + mean_ssim(&predicted[c], &target[c], view.image.width)) / N::of(3.0);
    let (weight, squared) = (f64::from(config.ssim_weight), f64::from(config.squared_share));
    // The same slope as L1 where the difference is 0.03.
    let difference = N::of(1.0 - squared) * l1 + N::of(squared / 0.06) * l2;
    Loss { total: N::of(1.0 - weight) * difference + N::of(weight) * (N::of(1.0) - ssim), l1, ssim }
}

/// Gaussian window of 11 x 11 pixels and standard deviation 1.5 over one channel, zeros outside.
fn blur<N: Number>(channel: &[N], width: usize) -> Vec<N> {
    let weights: Vec<f64> = (-5..=5).map(|d| (-f64::from(d * d) / (2.0 * 1.5 * 1.5)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let height = channel.len() / width;
    let pass = |from: &[N], dx: isize, dy: isize| -> Vec<N> {
        let at = |x: usize, y: usize, step: isize| {
            let (x, y) = (x.checked_add_signed(dx * step)?, y.checked_add_signed(dy * step)?);
            (x < width && y < height).then(|| from[y * width + x])
        };
        (0..from.len())
            .map(|i| {
                let taps = (-5isize..=5).zip(&weights).filter_map(|(step, w)| Some(at(i % width, i / width, step)? * N::of(w / total)));
                taps.fold(N::of(0.0), |sum, tap| sum + tap)
            })
            .collect()
    };
    pass(&pass(channel, 1, 0), 0, 1)
}

/// Mean structural similarity of one channel (Wang et al. 2004, as 3DGS evaluates it).
fn mean_ssim<N: Number>(a: &[N], b: &[N], width: usize) -> N {
    let product = |p: &[N], q: &[N]| blur(&p.iter().zip(q).map(|(&x, &y)| x * y).collect::<Vec<_>>(), width);
    let (mean_a, mean_b) = (blur(a, width), blur(b, width));
    let (aa, bb, ab) = (product(a, a), product(b, b), product(a, b));
    let (c1, c2, two) = (N::of(1e-4), N::of(9e-4), N::of(2.0));
    let mut sum = N::of(0.0);
    for i in 0..a.len() {
        let (ma, mb) = (mean_a[i], mean_b[i]);
        let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
        sum = sum + (two * ma * mb + c1) * (two * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
    }
    sum / N::of(a.len() as f64)
}

/// The function whose gradient training follows: the loss with its regularisers.
pub fn objective<N: Number>(p: &Parameters<N>, view: &View, options: &RenderOptions, config: &LossWeights) -> (N, Loss<N>, Rendered<N>) {
    let mut rendered = render(p, &view.camera, options);
    let log_gain = view.target.vignetting.map_or([0.0; VIGNETTING_TERMS], |vignetting| vignetting.log_gain);
    let seen = vignetted(&rendered.pixels, view, log_gain.map(|c| N::of(c.into())));
    let loss = loss(&seen, view, &Curve::of(&view.target.curve), config, &mut rendered.trace);
    let count = p.splats.len() as f64;
    let mut total = loss.total;
    for i in 0..p.splats.len() {
        total = total + N::of(f64::from(config.opacity_weight) / count) * sigmoid(p.opacity_logit(i));
        for s in p.log_scale(i) {
            total = total + N::of(f64::from(config.scale_weight) / (3.0 * count)) * s.exp();
        }
    }
    (total, loss, rendered)
}

/// A scene rendered in f64.
pub fn image(splats: &Splats, camera: &Camera, options: &RenderOptions) -> Rendered<f64> {
    render(&Parameters { splats: splats.clone(), flat: flatten(splats) }, camera, options)
}

/// Exact derivatives.
pub struct Exact {
    /// In the order of [`flatten`].
    pub gradient: Vec<f64>,
    pub loss: Loss<f64>,
    /// |dL/dmean| in NDC, [N].
    pub mean_gradient: Vec<f64>,
    /// The same of absolute values summed over pixels, [N].
    pub abs_mean_gradient: Vec<f64>,
}

/// Exact derivatives of the objective, from the tape.
pub fn differentiate(splats: &Splats, view: &View, options: &RenderOptions, config: &LossWeights) -> Exact {
    let p = Parameters { splats: splats.clone(), flat: variables(&flatten(splats)) };
    let (total, loss, rendered) = objective(&p, view, options, config);
    let gradient: Gradient = gradient(total);
    let half_size = view.camera.size_px.map(|s| f64::from(s) * f64::from(options.raster.samples) / 2.0);
    let norm = |v: [f64; 2]| (v[0] * half_size[0]).hypot(v[1] * half_size[1]);
    let mut mean_gradient = vec![0.0; splats.len()];
    for e in &rendered.ellipses {
        mean_gradient[e.splat] = norm(e.mean_px.map(|m| gradient.by(m)));
    }
    let mut absolute = vec![[0.0; 2]; splats.len()];
    for (splat, d) in &rendered.offsets {
        for a in 0..2 {
            absolute[*splat][a] += gradient.by(d[a]).abs();
        }
    }
    Exact {
        gradient: p.flat.iter().map(|&v| gradient.by(v)).collect(),
        loss: Loss { total: loss.total.value(), l1: loss.l1.value(), ssim: loss.ssim.value() },
        mean_gradient,
        abs_mean_gradient: absolute.into_iter().map(norm).collect(),
    }
}

/// Exact derivatives of the loss by the knots of its response.
pub fn differentiate_by_knots(splats: &Splats, view: &View, options: &RenderOptions, config: &LossWeights) -> Vec<f64> {
    let ToneCurve::Response(response) = view.target.curve else { return Vec::new() };
    let pixels: Vec<[Var; 3]> = image(splats, &view.camera, options).pixels.iter().map(|pixel| pixel.map(Var::of)).collect();
    let values: Vec<f64> = response.knots.as_flattened().iter().map(|v| f64::from(*v)).collect();
    let knots = variables(&values);
    let channels: [Vec<Var>; 3] = std::array::from_fn(|c| knots[c * RESPONSE_KNOTS..][..RESPONSE_KNOTS].to_vec());
    let curve = Curve::Response { knots: channels, exposure: response.exposure };
    let gradient = gradient(loss(&pixels, view, &curve, config, &mut Trace::default()).total);
    knots.iter().map(|&knot| gradient.by(knot)).collect()
}

/// Exact derivatives of the loss by the coefficients of ln gain of the view's vignetting.
pub fn differentiate_by_vignetting(splats: &Splats, view: &View, options: &RenderOptions, config: &LossWeights) -> Vec<f64> {
    let Some(vignetting) = view.target.vignetting else { return Vec::new() };
    let pixels: Vec<[Var; 3]> = image(splats, &view.camera, options).pixels.iter().map(|pixel| pixel.map(Var::of)).collect();
    let log_gain = variables(&vignetting.log_gain.map(f64::from));
    let seen = vignetted(&pixels, view, std::array::from_fn(|k| log_gain[k]));
    let gradient = gradient(loss(&seen, view, &Curve::of(&view.target.curve), config, &mut Trace::default()).total);
    log_gain.iter().map(|&coefficient| gradient.by(coefficient)).collect()
}

/// Derivatives of the objective by central differences, in the order of [`flatten`]; `None` where a
/// decision changes within the smallest step.
pub fn central_differences(splats: &Splats, view: &View, options: &RenderOptions, config: &LossWeights) -> Vec<Option<f64>> {
    let mut p = Parameters { splats: splats.clone(), flat: flatten(splats) };
    let mut evaluate = |i: usize, value: f64| {
        let at = std::mem::replace(&mut p.flat[i], value);
        let (total, _, rendered) = objective(&p, view, options, config);
        p.flat[i] = at;
        (total, rendered.trace)
    };
    let start = flatten(splats);
    (0..start.len())
        .map(|i| {
            // The best step balances h^2 against 1e-16 / h; smaller ones are for parameters next to
            // a decision.
            [1e-5, 1e-6].iter().find_map(|h| {
                let h = h * start[i].abs().max(1.0);
                let ((above, above_trace), (below, below_trace)) = (evaluate(i, start[i] + h), evaluate(i, start[i] - h));
                (above_trace == below_trace).then_some((above - below) / (2.0 * h))
            })
        })
        .collect()
}
