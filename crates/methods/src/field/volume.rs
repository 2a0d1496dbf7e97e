//! Volume rendering of one ray, and its exact gradient.
//!
//! In: densities and lengths of a ray's intervals, front to back, and K channels of colour each.
//! Out: `C = sum w_i c_i + (1 - sum w_i) background` with `w_i = T_i alpha_i`, `alpha_i = 1 -
//! exp(-sigma_i delta_i)` and T_i the transmittance in front of interval i (Max 1995). Lengths are
//! in units of the field's cube. Degenerate: a ray without intervals shows the background.

/// The intervals of one ray. All slices have one entry per interval; `colors` has K.
#[derive(Clone, Copy)]
pub(crate) struct Intervals<'a> {
    pub(crate) density: &'a [f32],
    pub(crate) length: &'a [f32],
    /// Distance of the middle from the ray's origin.
    pub(crate) middle: &'a [f32],
    pub(crate) colors: &'a [f32],
}

/// Computes the weights of a ray's intervals and the transmittance behind each, and adds the
/// channels to `color`, over `background`.
#[inline(always)]
pub(crate) fn composite(intervals: Intervals<'_>, background: &[f32], weights: &mut [f32], transmittance: &mut [f32], color: &mut [f32]) {
    let channels = color.len();
    color.fill(0.0);
    let (mut in_front, mut opacity) = (1.0, 0.0);
    for i in 0..weights.len() {
        let alpha = -(-intervals.density[i] * intervals.length[i]).exp_m1();
        let weight = in_front * alpha;
        in_front *= 1.0 - alpha;
        weights[i] = weight;
        transmittance[i] = in_front;
        opacity += weight;
        for (sum, value) in color.iter_mut().zip(&intervals.colors[i * channels..]) {
            *sum += weight * value;
        }
    }
    for (sum, background) in color.iter_mut().zip(background) {
        *sum += (1.0 - opacity) * background;
    }
}

/// A composited ray on its way back.
#[derive(Clone, Copy)]
pub(crate) struct Composited<'a> {
    pub(crate) intervals: Intervals<'a>,
    pub(crate) background: &'a [f32],
    pub(crate) weights: &'a [f32],
    /// Transmittance behind each interval.
    pub(crate) transmittance: &'a [f32],
}

impl Composited<'_> {
    /// Writes the gradient by densities and colours, given that by the ray's colour, and adds that
    /// of the distortion loss (Barron et al. 2022), which draws what a ray meets to one place,
    /// times `distortion_weight`. Returns the distortion loss times its weight.
    #[inline(always)]
    pub(crate) fn backward(self, by_color: &[f32], distortion_weight: f32, by_density: &mut [f32], by_colors: &mut [f32]) -> f32 {
        let Self { intervals, background, weights, transmittance } = self;
        let channels = by_color.len();
        let mut value = 0.0;
        // Sums of w and w m over the intervals in front of, and behind the current one.
        let count = weights.len();
        let (mut front, mut front_moment) = (0.0, 0.0);
        let total: f32 = weights.iter().sum();
        let moment: f32 = weights.iter().zip(intervals.middle).map(|(w, m)| w * m).sum();
        for i in 0..count {
            let (w, m) = (weights[i], intervals.middle[i]);
            let (behind, behind_moment) = (total - front - w, moment - front_moment - w * m);
            let spread = (m * front - front_moment) + (behind_moment - m * behind);
            value += distortion_weight * (w * spread + w * w * intervals.length[i] / 3.0);
            let mut by_weight = distortion_weight * (2.0 * spread + 2.0 / 3.0 * w * intervals.length[i]);
            (front, front_moment) = (front + w, front_moment + w * m);
            let colors = &intervals.colors[i * channels..][..channels];
            for c in 0..channels {
                by_weight += by_color[c] * (colors[c] - background[c]);
                by_colors[i * channels + c] = w * by_color[c];
            }
            // The gradient by w_i, of which the next loop makes that by the density.
            by_density[i] = by_weight;
        }
        // A denser interval takes light from all behind it.
        let mut hidden = 0.0;
        for i in (0..count).rev() {
            let by_weight = by_density[i];
            by_density[i] = intervals.length[i] * (transmittance[i] * by_weight - hidden);
            hidden += weights[i] * by_weight;
        }
        value
    }
}
