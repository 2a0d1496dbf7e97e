//! The updates of parameters: Adam, the noise of MCMC, and densification plans, against plain host
//! computations.

use glam::{DMat3, DQuat, DVec3};
use luxel_core::engine::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, DensifyPlan, DensifyStats, PlanRow, PositionNoise, StepConfig};
use luxel_core::{Activation, Antialias, ColorModel, Cutoffs, Engine, Moments, Splats, random};
use luxel_cpu::CpuEngine;

use crate::fixture::{self, LEARNING_RATES};
use crate::oracle::{array_of_parameters, flatten};

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 2, activation: Activation::Softplus };

fn step(number: u32) -> StepConfig {
    fixture::step(number, fixture::options(Cutoffs::HDR, Antialias::Off))
}

#[test]
fn adam_is_that_of_a_scalar_reference() {
    let r = LEARNING_RATES;
    // In the order of the oracle's arrays.
    let rates = [r.position, r.rotation, r.log_scale, r.opacity_logit, r.sh_dc, r.sh_rest, r.luminance_dc, r.luminance_rest].map(f64::from);
    let [beta1, beta2, epsilon] = [ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON].map(f64::from);
    let camera = fixture::camera(40, 30);
    for model in [LCD, ColorModel::Sh { degree: 3 }] {
        let splats = fixture::splats_with_special_cases(model, &camera, 3);
        let view = fixture::view(&camera, false, 4);
        let arrays = array_of_parameters(&splats);
        let mut engine = CpuEngine::new(2).unwrap();
        engine.load(&splats, None).unwrap();
        let mut first = vec![0.0; arrays.len()];
        let mut second = vec![0.0; arrays.len()];
        for number in 1..=5 {
            let before = flatten(&engine.save().unwrap().0);
            let gradient = flatten(&engine.gradients(&view, &step(number)).unwrap().1);
            engine.train_step(&view, &step(number)).unwrap();
            let (after, moments) = engine.save().unwrap();
            let (after, moment1, moment2) = (flatten(&after), flatten(&moments.first), flatten(&moments.second));
            for i in 0..arrays.len() {
                first[i] = beta1 * first[i] + (1.0 - beta1) * gradient[i];
                second[i] = beta2 * second[i] + (1.0 - beta2) * gradient[i] * gradient[i];
                let corrected = [(first[i], beta1), (second[i], beta2)].map(|(m, beta)| m / (1.0 - beta.powi(number as i32)));
                let expected = before[i] - rates[arrays[i]] * corrected[0] / (corrected[1].sqrt() + epsilon);
                // The step is the rate times a number of order 1, in f32; the parameter is rounded
                // to f32.
                let tolerance = 2e-5 * rates[arrays[i]] + 1.2e-7 * expected.abs();
                let found = after[i];
                assert!((found - expected).abs() <= tolerance, "step {number}, parameter {i}: {found:e}, expected {expected:e}");
                assert!((moment1[i] - first[i]).abs() <= 1e-5 * first[i].abs() + 1e-12, "first moment {i}: {} {}", moment1[i], first[i]);
                assert!((moment2[i] - second[i]).abs() <= 1e-5 * second[i] + 1e-18, "second moment {i}: {} {}", moment2[i], second[i]);
            }
        }
    }
}

#[test]
fn training_lowers_the_loss() {
    let camera = fixture::camera(40, 30);
    let view = fixture::view(&camera, true, 4);
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&fixture::splats(LCD, 120, &camera, 3), None).unwrap();
    let losses: Vec<f32> = (1..=60).map(|number| engine.train_step(&view, &step(number)).unwrap().loss).collect();
    assert!(losses[59] < 0.7 * losses[0], "from {} to {}", losses[0], losses[59]);
}

/// Returns the positions after one step with `noise` minus those without it.
fn displacements(splats: &Splats, noise: PositionNoise) -> Vec<DVec3> {
    let camera = fixture::camera(30, 20);
    let view = fixture::view(&camera, false, 4);
    let moved = |position_noise: Option<PositionNoise>| {
        let mut engine = CpuEngine::new(2).unwrap();
        engine.load(splats, None).unwrap();
        engine.train_step(&view, &StepConfig { position_noise, ..step(1) }).unwrap();
        engine.save().unwrap().0
    };
    let (with, without) = (moved(Some(noise)), moved(None));
    assert_eq!((&with.rotation, &with.log_scale, &with.sh), (&without.rotation, &without.log_scale, &without.sh));
    with.position.iter().zip(&without.position).map(|(a, b)| DVec3::from(a.map(f64::from)) - DVec3::from(b.map(f64::from))).collect()
}

#[test]
fn noise_moves_faint_splats_along_their_shape() {
    let camera = fixture::camera(30, 20);
    let mut splats = fixture::splats(LCD, 37, &camera, 3);
    for (i, logit) in splats.opacity_logit.iter_mut().enumerate() {
        *logit = luxel_core::logit([0.002, 0.005, 0.01, 0.05, 0.9][i % 5]);
    }
    let noise = PositionNoise { scale: 0.8, seed: 9 };
    let found = displacements(&splats, noise);
    // The noise is added after the update: take the updated shape.
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&splats, None).unwrap();
    engine.train_step(&fixture::view(&camera, false, 4), &step(1)).unwrap();
    let updated = engine.save().unwrap().0;
    for (i, found) in found.into_iter().enumerate() {
        let [w, x, y, z] = updated.rotation[i].map(f64::from);
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let variance = DVec3::from(updated.log_scale[i].map(|s| (2.0 * f64::from(s)).exp()));
        let covariance = rotation * DMat3::from_diagonal(variance) * rotation.transpose();
        let opacity = 1.0 / (1.0 + (-f64::from(updated.opacity_logit[i])).exp());
        // 3DGS-MCMC: sigmoid(100 ((1 - o) - 0.995)): only nearly transparent splats move.
        let gate = 1.0 / (1.0 + (-100.0 * ((1.0 - opacity) - 0.995)).exp());
        let normal = DVec3::from(random::standard_normal(noise.seed, i as u64).map(f64::from));
        let expected = covariance * normal * gate * f64::from(noise.scale);
        // Positions of order 5 are rounded to f32.
        assert!(
            (found - expected).length() < 2e-5 * expected.length() + 3e-6,
            "splat {i}, opacity {opacity}: {found}, expected {expected}"
        );
    }
}

#[test]
fn noise_depends_on_its_seed_alone() {
    let splats = fixture::splats(LCD, 37, &fixture::camera(30, 20), 3);
    let noise = PositionNoise { scale: 50.0, seed: 9 };
    assert_eq!(displacements(&splats, noise), displacements(&splats, noise));
    assert_ne!(displacements(&splats, noise), displacements(&splats, PositionNoise { seed: 10, ..noise }));
}

/// Applies a plan on the host.
fn applied(splats: &Splats, moments: &Moments, plan: &DensifyPlan) -> (Splats, Moments) {
    let pick = |from: &Splats, row: &PlanRow, into: &mut Splats, keep: bool| {
        let i = row.source as usize;
        let factor = f32::from(u8::from(keep));
        into.position.push(from.position[i].map(|v| factor * v));
        into.rotation.push(from.rotation[i].map(|v| factor * v));
        into.log_scale.push(from.log_scale[i].map(|v| factor * v));
        into.opacity_logit.push(factor * from.opacity_logit[i]);
        into.sh.extend(from.sh_of(i).iter().map(|v| factor * v));
        into.raw_luminance.extend(from.raw_luminance_of(i).iter().map(|v| factor * v));
    };
    let model = splats.color_model;
    let mut out = Splats::empty(model);
    let mut out_moments = Moments { first: Splats::empty(model), second: Splats::empty(model) };
    for (new, row) in plan.rows.iter().enumerate() {
        pick(splats, row, &mut out, true);
        pick(&moments.first, row, &mut out_moments.first, row.keep_moments);
        pick(&moments.second, row, &mut out_moments.second, row.keep_moments);
        let [w, x, y, z] = out.rotation[new].map(f64::from);
        let sigma = DVec3::from(out.log_scale[new].map(|s| f64::from(s).exp()));
        let offset = DQuat::from_xyzw(x, y, z, w).normalize() * (sigma * DVec3::from(row.offset_sigma.map(f64::from)));
        for a in 0..3 {
            out.position[new][a] = (f64::from(out.position[new][a]) + offset[a]) as f32;
            out.log_scale[new][a] += row.log_scale_shift;
        }
        if let Some(logit) = row.opacity_logit {
            out.opacity_logit[new] = logit;
        }
        if let Some(cap) = plan.opacity_logit_cap.filter(|cap| out.opacity_logit[new] > *cap) {
            out.opacity_logit[new] = cap;
            out_moments.first.opacity_logit[new] = 0.0;
            out_moments.second.opacity_logit[new] = 0.0;
        }
        if !splats.smoothing.is_empty() {
            out.smoothing.push(splats.smoothing[row.source as usize]);
        }
    }
    if let Some(smoothing) = &plan.smoothing {
        out.smoothing = smoothing.clone();
    }
    (out, out_moments)
}

/// Returns rows of every kind, from 41 sources to 47 splats.
fn rows() -> Vec<PlanRow> {
    (0..47u32)
        .map(|i| PlanRow {
            source: i * 29 % 41,
            offset_sigma: if i % 3 == 0 { [0.0; 3] } else { [0.1 * i as f32, -1.0, 0.5] },
            log_scale_shift: if i % 2 == 0 { 0.0 } else { -0.47 },
            opacity_logit: (i % 5 == 0).then_some(0.2 * i as f32 - 4.0),
            keep_moments: i % 4 != 0,
        })
        .collect()
}

#[test]
fn plan_is_applied_as_on_the_host() {
    let camera = fixture::camera(30, 20);
    for smoothed in [false, true] {
        let mut splats = fixture::splats(LCD, 41, &camera, 3);
        if smoothed {
            splats.smoothing = fixture::smoothing(41);
        }
        let moments = Moments { first: fixture::splats(LCD, 41, &camera, 4), second: fixture::splats(LCD, 41, &camera, 5) };
        let filters = (0..47).map(|i| 0.001 * i as f32).collect::<Vec<_>>();
        for (cap, smoothing) in [(None, None), (Some(-0.3), None), (None, Some(filters.clone())), (Some(0.5), Some(filters))] {
            let plan = DensifyPlan { rows: rows(), opacity_logit_cap: cap, smoothing };
            let mut engine = CpuEngine::new(2).unwrap();
            engine.load(&splats, Some(&moments)).unwrap();
            engine.densify(&plan).unwrap();
            let (found, found_moments) = engine.save().unwrap();
            let (expected, expected_moments) = applied(&splats, &moments, &plan);
            assert_eq!(found_moments, expected_moments);
            for (i, (a, b)) in flatten(&found).iter().zip(flatten(&expected)).enumerate() {
                // Offsets are computed in f32 here, in f64 there.
                assert!((a - b).abs() <= 1e-6 * b.abs().max(5.0), "parameter {i}: {a:e}, expected {b:e}");
            }
            assert_eq!(Splats { position: found.position.clone(), ..expected }, found);
            assert_eq!(engine.densify_stats().unwrap(), DensifyStats::zeros(47));
        }
    }
}

#[test]
fn an_empty_plan_empties_the_scene() {
    let camera = fixture::camera(30, 20);
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&fixture::splats(LCD, 41, &camera, 3), None).unwrap();
    engine.densify(&DensifyPlan::default()).unwrap();
    assert_eq!(engine.save().unwrap(), (Splats::empty(LCD), Moments::zeros(LCD, 0)));
    assert_eq!(engine.train_step(&fixture::view(&camera, false, 4), &step(1)).unwrap().visible, 0);
}
