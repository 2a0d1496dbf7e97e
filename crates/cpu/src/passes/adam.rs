//! Pass `adam`: updates every parameter (Kingma and Ba 2015), then adds 3DGS-MCMC's noise to
//! positions.
//!
//! In: gradient `[rows, 16]` of a block of splats, learning rates. Degenerate: without a gradient
//! it counts as zero, and the moments decay all the same, as in 3DGS. With a learning rate of 0
//! parameters and moments keep their bits. In, out: parameters, moments. A radiance field of the
//! published methods updates its numbers with other betas, leaves what has no gradient, and rounds
//! differently, so it has code of its own.

use fearless_simd::Simd;
use luxel_core::engine::{ADAM_EPSILON, AdamBetas, LearningRates, ParameterRows, PositionNoise, StepConfig};
use luxel_core::{Real, each, random};

use super::project::rotation_matrix;
use crate::lanes::{LANES, Lanes, V};
use crate::moments::{MomentRows, MomentStore};
use crate::store::{Store, StoreShape};

/// Adam's state: running means of the gradient and of its square, in the parameters' layout.
pub(crate) struct Optimizer<'a> {
    pub(crate) parameters: &'a mut Store,
    pub(crate) moments: &'a mut MomentStore,
}

/// A parameter row of a block and its moments.
struct AdamRow<'a> {
    parameter: &'a mut Lanes,
    first: &'a mut Lanes,
    second: &'a mut Lanes,
}

/// The factors of a step, for all parameters.
pub(crate) struct Step {
    /// Learning rates over 1 - beta1^t.
    rates: Vec<f32>,
    /// 1 / (1 - beta2^t).
    correction2: f32,
    betas: AdamBetas,
    noise: Option<PositionNoise>,
    count: usize,
    /// Number of the step, from which the rounding of moments in sixteen bits follows.
    number: u32,
}

/// Returns the learning rate of each row.
fn row_rates(layout: ParameterRows, rates: &LearningRates) -> Vec<f32> {
    (0..layout.count())
        .map(|row| match row {
            ParameterRows::POSITION..ParameterRows::ROTATION => rates.position,
            ParameterRows::ROTATION..ParameterRows::LOG_SCALE => rates.rotation,
            ParameterRows::LOG_SCALE..ParameterRows::OPACITY => rates.log_scale,
            ParameterRows::OPACITY => rates.opacity_logit,
            row if row < ParameterRows::SH + 3 => rates.sh_dc,
            row if row < layout.luminance() => rates.sh_rest,
            row if row == layout.luminance() => rates.luminance_dc,
            _ => rates.luminance_rest,
        })
        .collect()
}

impl Step {
    /// Computes the factors from the step's configuration.
    pub(crate) fn new(StoreShape { layout, count }: StoreShape, config: &StepConfig) -> Self {
        let [correction1, correction2] = config.betas.corrections(config.step).map(|correction| (1.0 / correction) as f32);
        Self {
            rates: row_rates(layout, &config.learning_rates).into_iter().map(|rate| rate * correction1).collect(),
            correction2,
            betas: config.betas,
            noise: config.position_noise,
            count,
            number: config.step,
        }
    }
}

/// Updates the parameters and moments of block number `block`.
#[inline(always)]
pub(crate) fn update<S: Simd>(
    simd: S,
    step: &Step,
    block: usize,
    parameters: &mut [Lanes],
    moments: MomentRows<'_>,
    gradient: Option<&[Lanes]>,
) {
    match moments {
        MomentRows::Full { first, second } => move_parameters(simd, step, parameters, [first, second], gradient),
        MomentRows::Packed(both) => move_packed(simd, step, block, parameters, both, gradient),
    }
    if let Some(noise) = step.noise {
        add_noise(simd, step, noise, block, parameters);
    }
}

/// Moves the parameters of a block against the gradient.
#[inline(always)]
fn move_parameters<S: Simd>(
    simd: S,
    step: &Step,
    parameters: &mut [Lanes],
    [first, second]: [&mut [Lanes]; 2],
    gradient: Option<&[Lanes]>,
) {
    // sqrt(v correction2) = sqrt(v) sqrt(correction2).
    let root2 = V::splat(simd, step.correction2.sqrt());
    let factors = |rate: f32| RowFactors { rate, root2, betas: step.betas };
    let rows = parameters.iter_mut().zip(first).zip(second).zip(&step.rates);
    match gradient {
        Some(gradient) => {
            for ((((parameter, first), second), rate), gradient) in rows.zip(gradient) {
                move_row(simd, factors(*rate), AdamRow { parameter, first, second }, Some(gradient));
            }
        }
        None => {
            for (((parameter, first), second), rate) in rows {
                move_row(simd, factors(*rate), AdamRow { parameter, first, second }, None);
            }
        }
    }
}

/// The factors of a row in a step.
struct RowFactors<S: Simd> {
    /// Learning rate over 1 - beta1^t.
    rate: f32,
    /// Root of the second moment's correction.
    root2: V<S>,
    betas: AdamBetas,
}

/// Moves one row.
#[inline(always)]
fn move_row<S: Simd>(
    simd: S,
    RowFactors { rate, root2, betas }: RowFactors<S>,
    AdamRow { parameter, first, second }: AdamRow<'_>,
    gradient: Option<&Lanes>,
) {
    if rate == 0.0 {
        return;
    }
    let c = |value: f32| V::splat(simd, value);
    // All loads before the stores: the three rows lie at equal offsets of their pages, so the
    // processor would take each load for one that depends on the store before it.
    let before = V::load(simd, parameter);
    let (mut m, mut v) = (V::load(simd, first) * betas.first, V::load(simd, second) * betas.second);
    if let Some(gradient) = gradient {
        let g = V::load(simd, gradient);
        m = g.mul_add(c(1.0 - betas.first), m);
        v = (g * g).mul_add(c(1.0 - betas.second), v);
    }
    let after = before - m * rate / v.sqrt().mul_add(root2, c(ADAM_EPSILON));
    m.store(first);
    v.store(second);
    after.store(parameter);
}

/// Moves the parameters of a block whose moments are packed.
#[inline(always)]
fn move_packed<S: Simd>(simd: S, step: &Step, block: usize, parameters: &mut [Lanes], both: &mut [Lanes], gradient: Option<&[Lanes]>) {
    let root2 = V::splat(simd, step.correction2.sqrt());
    let seed = random::bits(u64::from(step.number), block as u64);
    for (row, ((parameter, both), rate)) in parameters.iter_mut().zip(both).zip(&step.rates).enumerate() {
        if *rate == 0.0 {
            continue;
        }
        let (mut first, mut second) = (Lanes::ZERO, Lanes::ZERO);
        let (m, v) = V::load(simd, both).unpack_moments();
        m.store(&mut first);
        v.store(&mut second);
        let factors = RowFactors { rate: *rate, root2, betas: step.betas };
        let adam = AdamRow { parameter, first: &mut first, second: &mut second };
        match gradient {
            Some(gradient) => move_row(simd, factors, adam, gradient.get(row)),
            None => move_row(simd, factors, adam, None),
        }
        // Weyl's sequence: another number for each row.
        let seed = (seed as u32).wrapping_add((row as u32).wrapping_mul(0x9e37_79b9));
        V::pack_moments(V::load(simd, &first), V::load(simd, &second), seed).store(both);
    }
}

/// Adds Sigma n sigmoid(100 (0.005 - opacity)) scale to the positions, with Sigma the covariance
/// and n standard normal (Kheradmand et al. 2024, eq. 9).
#[inline(always)]
fn add_noise<S: Simd>(simd: S, step: &Step, noise: PositionNoise, block: usize, parameters: &mut [Lanes]) {
    let mut normal = [Lanes::ZERO; 3];
    for lane in 0..LANES.min(step.count - block * LANES) {
        let n = random::standard_normal(noise.seed, (block * LANES + lane) as u64);
        for (lanes, value) in normal.iter_mut().zip(n) {
            lanes.0[lane] = value;
        }
    }
    let load = |row: usize| V::load(simd, &parameters[row]);
    let one = V::splat(simd, 1.0);
    let raw: [V<S>; 4] = each!([0, 1, 2, 3] i => load(ParameterRows::ROTATION + i));
    let length2 = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3];
    let inverse = one / length2.max(one.lift(1e-30)).sqrt();
    let axes = rotation_matrix(each!([0, 1, 2, 3] i => { let v = raw[i]; v * inverse }));
    let variance = each!([0, 1, 2] i => (load(ParameterRows::LOG_SCALE + i) * 2.0).exp());
    let opacity = one / (one + (-load(ParameterRows::OPACITY)).exp());
    let gate = one / (one + ((opacity - 0.005) * 100.0).exp()) * noise.scale;
    let n = each!([0, 1, 2] i => { let lanes = &normal[i]; V::load(simd, lanes) });
    // R diag(variance) R^T n.
    let local = each!([0, 1, 2] k => (axes[0][k] * n[0] + axes[1][k] * n[1] + axes[2][k] * n[2]) * variance[k]);
    for (row, axis) in parameters[ParameterRows::POSITION..].iter_mut().zip(axes) {
        let moved = axis[0] * local[0] + axis[1] * local[1] + axis[2] * local[2];
        moved.mul_add(gate, V::load(simd, row)).store(row);
    }
}
