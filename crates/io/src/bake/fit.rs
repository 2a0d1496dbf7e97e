//! Harmonics of a splat's baked colour.
//!
//! In: a scene, and what its bake shall look like. Out, per splat: harmonics [K,3] of a colour d(v)
//! = 1/2 + sum_m k_m Y_m(v). d is the splat's radiance times one exposure, in the bake's colour
//! space, under a curve if it is for a display, fitted by least squares over [`DIRECTIONS`] viewing
//! directions to harmonics of degree min(3, the model's). Radiance harmonics in a linear bake need
//! no fit: all operations on them are linear. Where a fit undershoots, it is drawn towards its mean
//! until it does not.

use luxel_core::tone::{Tonemap, exposed_rec709};
use luxel_core::{ColorBasis, ColorModel, ColorSpace, Conversion, SH_OFFSET, Scene, Splats, least_squares, sh};

use super::exposure::{MIDDLE_GREY, display_exposure};
use super::{Appearance, BakeOptions, bounded};

/// Directions that the fit is made over: four for each harmonic of degree 3.
const DIRECTIONS: usize = 64;
/// Directions in which the result is held to be >= 0.
const CHECKED_DIRECTIONS: usize = 256;
/// No direction is further than h = 0.13 from a checked one, and near its minimum a harmonic sum of
/// degree 3 and depth A rises by at most about A l (l + 1) / 4 h^2 = 0.05 A over that distance: the
/// true minimum is at most this many times as deep as the checked one.
const BETWEEN_CHECKS: f32 = 1.05;
/// Harmonics of a channel at the highest degree that ordinary viewers read.
pub(crate) const MAX_BAKED: usize = sh::coefficients(3);

/// The treatment of a radiance.
enum Look {
    /// Colours that are a display's stay what they are.
    Kept,
    Display {
        tonemap: Tonemap,
        color_space: ColorSpace,
    },
    Linear {
        conversion: Conversion,
    },
}

/// The bake of one scene.
pub(crate) struct Bake {
    /// Degree of the result.
    degree: usize,
    /// Factor on normalised radiance.
    exposure: f32,
    look: Look,
    /// Space of the scene's colours.
    space: ColorSpace,
    /// The model's basis in each of [`DIRECTIONS`] directions.
    views: Vec<ColorBasis<f32>>,
    /// Pseudo-inverse of the basis, transposed: [DIRECTIONS, K].
    fit: Vec<[f32; MAX_BAKED]>,
    lift: Lift,
}

/// Keeps harmonics from being negative.
pub(super) struct Lift {
    /// Basis values in the checked directions: [K, CHECKED_DIRECTIONS].
    checks: Vec<[f32; CHECKED_DIRECTIONS]>,
}

impl Lift {
    pub(super) fn new(degree: usize) -> Self {
        let mut checks = vec![[0.0; CHECKED_DIRECTIONS]; sh::coefficients(degree)];
        for (v, direction) in sh::lattice(CHECKED_DIRECTIONS).into_iter().enumerate() {
            checks.iter_mut().zip(low_basis(direction)).for_each(|(row, y)| row[v] = y);
        }
        Self { checks }
    }

    /// Draws a channel's higher harmonics towards 0 until no checked direction is negative.
    pub(super) fn apply(&self, channel: &mut [f32; MAX_BAKED]) {
        let mean = (SH_OFFSET + sh::C0 * channel[0]).max(0.0);
        channel[0] = (mean - SH_OFFSET) / sh::C0;
        let mut varying = [0f32; CHECKED_DIRECTIONS];
        for (k, values) in channel.iter().zip(&self.checks).skip(1) {
            varying.iter_mut().zip(values).for_each(|(sum, y)| *sum += k * y);
        }
        let lowest = BETWEEN_CHECKS * varying.into_iter().fold(0.0, f32::min);
        if mean + lowest < 0.0 {
            let factor = mean / -lowest;
            channel[1..].iter_mut().for_each(|k| *k *= factor);
        }
    }
}

impl Bake {
    pub(crate) fn new(scene: &Scene, options: &BakeOptions) -> Self {
        let model = scene.splats.color_model;
        let degree = model.max_degree().min(3).min(options.max_degree.into());
        let directions = sh::lattice(DIRECTIONS);
        let views = directions.iter().map(|v| ColorBasis::new(model.max_degree(), *v)).collect();
        let fit = pseudo_inverse(&directions, sh::coefficients(degree));
        let (exposure, look) = match options.appearance {
            Appearance::Display { tonemap, exposure_ev } => {
                let look = match options.appearance.keeps(scene.color_space) {
                    true => Look::Kept,
                    false => Look::Display { tonemap, color_space: scene.color_space },
                };
                (display_exposure(scene) * exposure_ev.exp2(), look)
            }
            Appearance::Linear { color_space, exposure_ev } => {
                let conversion = Conversion::between(scene.color_space, color_space);
                (scene.radiance_scale.get() * exposure_ev.exp2(), Look::Linear { conversion })
            }
        };
        // The smallest and largest exposures are those of scenes that can be read, times 2^EV:
        // the result may be neither 0 nor infinity.
        Self {
            degree,
            exposure: exposure.clamp(f32::MIN_POSITIVE, f32::MAX),
            look,
            space: scene.color_space,
            views,
            fit,
            lift: Lift::new(degree),
        }
    }

    /// Returns the degree of the result.
    pub(crate) fn degree(&self) -> usize {
        self.degree
    }

    /// Returns the number of coefficients K of the result.
    pub(crate) fn coefficients(&self) -> usize {
        sh::coefficients(self.degree)
    }

    /// Returns the factor from normalised radiance to baked values, before any curve.
    pub(crate) fn exposure(&self) -> f32 {
        self.exposure
    }

    /// Describes the bake, for the file's header.
    pub(crate) fn description(&self) -> String {
        match &self.look {
            Look::Display { tonemap, .. } => format!(
                "exposure {:?} of normalised radiance (log-average luminance to {MIDDLE_GREY}), curve {tonemap} with its display encoding, \
                 harmonics of degree {} by least squares over {DIRECTIONS} directions",
                self.exposure, self.degree
            ),
            Look::Kept => format!("sRGB colours of a display as they are, harmonics of degree {}", self.degree),
            Look::Linear { .. } => format!("linear, {:?} of normalised radiance, harmonics of degree {}", self.exposure, self.degree),
        }
    }

    /// Returns the harmonics of splat `i`'s colour, by channel; entries from K on are 0.
    pub(crate) fn splat(&self, splats: &Splats, i: usize) -> [[f32; MAX_BAKED]; 3] {
        match (&self.look, splats.color_model) {
            (Look::Linear { conversion }, ColorModel::Sh { .. }) if self.space.is_linear() => {
                return self.linear_harmonics(splats.sh_of(i), splats.gain_of(i), conversion);
            }
            (Look::Kept, ColorModel::Sh { .. }) if splats.gain_of(i) == 1.0 => return self.by_channel(splats.sh_of(i)),
            _ => {}
        }
        let (sh, raw, gain) = (splats.sh_of(i), splats.raw_luminance_of(i), splats.gain_of(i));
        let mut channels = [[0.0; MAX_BAKED]; 3];
        for (basis, fit) in self.views.iter().zip(&self.fit) {
            let radiance = splats.color_model.radiance(basis, |m, c| sh[3 * m + c], |m| raw[m]).map(|c| c * gain);
            for (channel, color) in channels.iter_mut().zip(self.color(radiance)) {
                for (k, fit) in channel.iter_mut().zip(fit) {
                    *k += fit * (color - SH_OFFSET);
                }
            }
        }
        channels.iter_mut().for_each(|channel| self.lift.apply(channel));
        channels
    }

    /// Computes k' = f M k, and moves the offset of 1/2 into the DC: no fit, no lift.
    fn linear_harmonics(&self, from: &[f32], gain: f32, conversion: &Conversion) -> [[f32; MAX_BAKED]; 3] {
        let factor = self.exposure * gain;
        let mut sh = [0f32; 3 * MAX_BAKED];
        let kept = 3 * self.coefficients();
        for (to, from) in sh.iter_mut().zip(from).take(kept) {
            *to = factor * from;
        }
        for dc in sh.iter_mut().take(3) {
            *dc += (factor - 1.0) * (SH_OFFSET / sh::C0);
        }
        conversion.apply_to_sh(&mut sh[..kept]);
        self.by_channel(&sh)
    }

    /// Returns harmonics `[K,3]` by channel, up to the degree of the result.
    fn by_channel(&self, sh: &[f32]) -> [[f32; MAX_BAKED]; 3] {
        let mut channels = [[0.0; MAX_BAKED]; 3];
        for (m, rgb) in sh.chunks_exact(3).enumerate().take(self.coefficients()) {
            channels.iter_mut().zip(rgb).for_each(|(channel, value)| channel[m] = *value);
        }
        channels
    }

    /// Returns the baked colour of a radiance.
    fn color(&self, radiance: [f32; 3]) -> [f32; 3] {
        match &self.look {
            Look::Kept => radiance.map(bounded),
            Look::Display { tonemap, color_space } if color_space.is_linear() => {
                tonemap.encode(exposed_rec709(*color_space, radiance.map(|c| bounded(c * self.exposure)), 1.0))
            }
            Look::Display { tonemap, color_space } => tonemap.encode(exposed_rec709(*color_space, radiance.map(bounded), self.exposure)),
            Look::Linear { conversion } => conversion.apply(self.space.light(radiance.map(bounded)).map(|c| bounded(c * self.exposure))),
        }
    }
}

fn low_basis(direction: [f32; 3]) -> [f32; MAX_BAKED] {
    let mut all = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(3, direction, &mut all);
    let mut low = [0.0; MAX_BAKED];
    low.copy_from_slice(&all[..MAX_BAKED]);
    low
}

/// Returns the transpose of (A^T A)^-1 A^T of the basis values A `[DIRECTIONS, count]`.
fn pseudo_inverse(directions: &[[f32; 3]], count: usize) -> Vec<[f32; MAX_BAKED]> {
    let a: Vec<[f64; MAX_BAKED]> = directions.iter().map(|v| low_basis(*v).map(f64::from)).collect();
    let a = a.as_slice();
    let gram = |i: usize| (0..count).map(move |j| a.iter().map(|y| y[i] * y[j]).sum::<f64>());
    let rows = (0..count).map(|i| gram(i).chain(a.iter().map(|y| y[i])).collect()).collect();
    let mut columns = vec![[0f32; MAX_BAKED]; DIRECTIONS];
    for (i, row) in least_squares::solve(rows).iter().enumerate() {
        columns.iter_mut().zip(row).for_each(|(column, v)| column[i] = *v as f32);
    }
    columns
}
