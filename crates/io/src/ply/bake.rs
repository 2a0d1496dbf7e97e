//! Display bake: what ordinary 3D Gaussian splatting viewers show of a radiance scene.
//!
//! In: a scene. Out, per splat: harmonics [K,3] of a display colour d(v) = 1/2 + sum_m k_m Y_m(v), channel values 0..1 for an sRGB
//! screen. d is the splat's radiance, times one exposure, in Rec.709 primaries, under a filmic curve, fitted by
//! least squares over [`DIRECTIONS`] viewing directions to harmonics of degree min(3, the model's). Viewers that do not clamp show
//! negative colours as rainbow speckle, so where the fit undershoots it is drawn towards its mean until it does not.
//!
//! Exposure: the log-average luminance of the splats, weighted by opacity and size, comes to middle grey (Reinhard et al. 2002).
//! Curve: [`CURVE`], the previews' own. Tone mapping per splat does not commute with blending: the bake is a preview, and the exact
//! model stands beside it.

use luxel_core::tone::{Tonemap, rec709_of};
use luxel_core::{ColorBasis, ColorSpace, SH_OFFSET, Scene, Splats, luminance_rec709, sh, sigmoid};
use rayon::prelude::*;

/// Directions that the fit is made over: four for each harmonic of degree 3.
const DIRECTIONS: usize = 64;
/// Directions in which the result is held to be >= 0.
const CHECKED_DIRECTIONS: usize = 256;
/// No direction is further than h = 0.13 from a checked one, and near its minimum a harmonic sum of degree 3 and depth A rises by at most about
/// A l (l + 1) / 4 h^2 = 0.05 A over that distance: the true minimum is at most this many times as deep as the checked one.
const BETWEEN_CHECKS: f32 = 1.05;
/// Harmonics of a channel at the highest degree that ordinary viewers read.
const MAX_BAKED: usize = sh::coefficients(3);
/// Middle grey.
const KEY: f64 = 0.18;
/// Luminance below this part of the weighted median counts as this much, so that black splats do not pull the average to 0.
const DARKEST: f64 = 1e-3;
/// Area above this many times the median counts as this much: a few huge splats (sky, backdrop) do not set the exposure.
const LARGEST: f64 = 16.0;
/// What previews look like by default, too.
const CURVE: Tonemap = Tonemap::Agx;

/// The bake of one scene.
pub(super) struct DisplayBake {
    /// Degree of the result.
    degree: usize,
    exposure: f32,
    color_space: ColorSpace,
    /// The model's basis in each of [`DIRECTIONS`] directions.
    views: Vec<ColorBasis<f32>>,
    /// Pseudo-inverse of the basis, transposed: [DIRECTIONS, K].
    fit: Vec<[f32; MAX_BAKED]>,
    /// Basis values in the checked directions: [K, CHECKED_DIRECTIONS].
    checks: Vec<[f32; CHECKED_DIRECTIONS]>,
}

impl DisplayBake {
    pub(super) fn new(scene: &Scene) -> Self {
        let model = scene.splats.color_model;
        let degree = model.max_degree().min(3);
        let directions = sh::lattice(DIRECTIONS);
        let views = directions.iter().map(|v| ColorBasis::new(model.max_degree(), *v)).collect();
        let mut checks = vec![[0.0; CHECKED_DIRECTIONS]; sh::coefficients(degree)];
        for (v, direction) in sh::lattice(CHECKED_DIRECTIONS).into_iter().enumerate() {
            checks.iter_mut().zip(low_basis(direction)).for_each(|(row, y)| row[v] = y);
        }
        let fit = pseudo_inverse(&directions, sh::coefficients(degree));
        Self { degree, exposure: exposure(scene), color_space: scene.color_space, views, fit, checks }
    }

    /// K of the result.
    pub(super) fn coefficients(&self) -> usize {
        sh::coefficients(self.degree)
    }

    /// What was done, for the file's header.
    pub(super) fn description(&self) -> String {
        format!(
            "exposure {:e} of normalised radiance (log-average luminance to {KEY}), curve {CURVE} with its display encoding, \
             harmonics of degree {} by least squares over {DIRECTIONS} directions",
            self.exposure, self.degree
        )
    }

    /// Harmonics of splat `i`'s display colour, by channel; entries from K on are 0.
    pub(super) fn bake(&self, splats: &Splats, i: usize) -> [[f32; MAX_BAKED]; 3] {
        let (sh, raw) = (splats.sh_of(i), splats.raw_luminance_of(i));
        let mut channels = [[0.0; MAX_BAKED]; 3];
        for (basis, fit) in self.views.iter().zip(&self.fit) {
            let radiance = splats.color_model.radiance(basis, |m, c| sh[3 * m + c], |m| raw[m]);
            for (channel, color) in channels.iter_mut().zip(self.display(radiance)) {
                for (k, fit) in channel.iter_mut().zip(fit) {
                    *k += fit * (color - SH_OFFSET);
                }
            }
        }
        channels.iter_mut().for_each(|channel| self.lift(channel));
        channels
    }

    /// Display colour of a radiance.
    fn display(&self, radiance: [f32; 3]) -> [f32; 3] {
        CURVE.encode(rec709_of(self.color_space, radiance.map(|c| bounded(c * self.exposure))))
    }

    /// Draws a channel's higher harmonics towards 0 until no checked direction is negative.
    fn lift(&self, channel: &mut [f32; MAX_BAKED]) {
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

/// A radiance of which sums are finite; NaN, which a sum of infinities of both signs gives, counts as 0.
fn bounded(radiance: f32) -> f32 {
    if radiance > 0.0 { radiance.min(f32::MAX / 16.0) } else { 0.0 }
}

fn low_basis(direction: [f32; 3]) -> [f32; MAX_BAKED] {
    let mut all = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(3, direction, &mut all);
    let mut low = [0.0; MAX_BAKED];
    low.copy_from_slice(&all[..MAX_BAKED]);
    low
}

/// Transpose of (A^T A)^-1 A^T of the basis values A [DIRECTIONS, count], by Gauss-Jordan elimination: A^T A is nearly a multiple of the identity,
/// as the directions are nearly even, and needs no pivoting.
fn pseudo_inverse(directions: &[[f32; 3]], count: usize) -> Vec<[f32; MAX_BAKED]> {
    let a: Vec<[f64; MAX_BAKED]> = directions.iter().map(|v| low_basis(*v).map(f64::from)).collect();
    let mut gram = [[0f64; MAX_BAKED]; MAX_BAKED];
    let mut rows = vec![[0f64; DIRECTIONS]; count];
    for i in 0..count {
        for j in 0..count {
            gram[i][j] = a.iter().map(|y| y[i] * y[j]).sum();
        }
        for (to, y) in rows[i].iter_mut().zip(&a) {
            *to = y[i];
        }
    }
    for pivot in 0..count {
        let inverse = 1.0 / gram[pivot][pivot];
        gram[pivot].iter_mut().for_each(|v| *v *= inverse);
        rows[pivot].iter_mut().for_each(|v| *v *= inverse);
        let (pivot_gram, pivot_row) = (gram[pivot], rows[pivot]);
        for i in (0..count).filter(|i| *i != pivot) {
            let factor = gram[i][pivot];
            gram[i].iter_mut().zip(pivot_gram).for_each(|(v, p)| *v -= factor * p);
            rows[i].iter_mut().zip(pivot_row).for_each(|(v, p)| *v -= factor * p);
        }
    }
    let mut columns = vec![[0f32; MAX_BAKED]; DIRECTIONS];
    for (i, row) in rows.iter().enumerate() {
        columns.iter_mut().zip(row).for_each(|(column, v)| column[i] = *v as f32);
    }
    columns
}

/// Factor that brings the scene's log-average luminance to middle grey; 1 for a black or empty scene.
fn exposure(scene: &Scene) -> f32 {
    let splats = &scene.splats;
    let views = sh::lattice(6);
    let to_luminance = |rgb: [f32; 3]| f64::from(luminance_rec709(rgb.map(bounded)));
    let luminance_of = |i: usize| views.iter().map(|v| to_luminance(splats.radiance(i, *v))).sum::<f64>() / views.len() as f64;
    let luminance: Vec<f64> = (0..splats.len()).into_par_iter().map(luminance_of).collect();
    let area: Vec<f64> = splats.log_scale.iter().map(|s| cross_section(*s)).collect();
    let largest = LARGEST * median(area.iter().map(|a| (*a, 1.0)).collect());
    let weight: Vec<f64> = area.iter().zip(&splats.opacity_logit).map(|(a, o)| a.min(largest) * f64::from(sigmoid(*o))).collect();
    let darkest = DARKEST * median(luminance.iter().copied().zip(weight.iter().copied()).collect());
    let total: f64 = weight.iter().sum();
    let sum: f64 = luminance.iter().zip(&weight).map(|(l, w)| w * l.max(darkest).max(f64::MIN_POSITIVE).ln()).sum();
    let exposure = (KEY / (sum / total).exp()) as f32;
    if darkest > 0.0 && exposure.is_normal() { exposure } else { 1.0 }
}

/// Product of the two larger standard deviations.
fn cross_section(log_scale: [f32; 3]) -> f64 {
    let smallest = log_scale.into_iter().fold(f32::INFINITY, f32::min);
    let larger = log_scale.iter().map(|s| f64::from(*s)).sum::<f64>() - f64::from(smallest);
    larger.clamp(-200.0, 200.0).exp()
}

/// Value at half the total weight, of (value, weight); 0 for none.
fn median(mut values: Vec<(f64, f64)>) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|v| v.1).sum::<f64>();
    let mut sum = 0.0;
    let reached = values.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    reached.map_or(0.0, |v| v.0)
}
