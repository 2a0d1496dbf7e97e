//! Vignetting in the loss: gradients compared with the oracle and with differences, and no effect
//! of a gain of 1.

use luxel_core::engine::StepConfig;
use luxel_core::{Activation, Antialias, Cutoffs, Engine, StepReport, VIGNETTING_TERMS, Vignetting};
use luxel_cpu::CpuEngine;

use crate::gradients::{Case, ENGINE_TOLERANCE, against_oracle, case, check, engine_gradient, lcd, sampled};
use crate::oracle::{Parameters, differentiate, differentiate_by_vignetting, flatten, objective};
use crate::{curves, fixture, wide};

/// Numbers of few bits, so that steps of differences are exact. The frame's corners are beyond
/// r = 1.
const VIGNETTING: Vignetting = Vignetting { axis_px: [9.5, 7.25], unit_px: 12.0, log_gain: [0.25, -0.5, 0.375, -0.625] };

fn plain(masked: bool, seed: u64) -> Case {
    let antialias = if masked { Antialias::Mip } else { Antialias::Pixel };
    case(lcd(2, 1, Activation::Softplus), antialias, ("hdr", Cutoffs::HDR), masked, seed)
}

fn vignetted(mut case: Case) -> Case {
    case.view.target.vignetting = Some(VIGNETTING);
    case.name += " vignetting";
    case
}

fn cases() -> Vec<Case> {
    let fisheye = wide::cases().swap_remove(0);
    vec![
        vignetted(plain(false, 51)),
        vignetted(curves::weighted(plain(true, 52), 1)),
        vignetted(curves::weighted(curves::recorded(plain(false, 53), 2), 3)),
        vignetted(sampled(plain(true, 54), 2)),
        vignetted(fisheye),
    ]
}

#[test]
fn engine_gradient_with_vignetting_is_the_oracles() {
    for case in cases() {
        check(&case, &against_oracle(&case), ENGINE_TOLERANCE, "by the engine");
        let exact = differentiate(&case.splats, &case.view, &case.options, &case.loss).loss;
        let report = engine_gradient(&case).0;
        assert!((f64::from(report.loss) - exact.total).abs() < 2e-6, "{}: {} {}", case.name, report.loss, exact.total);
    }
}

#[test]
fn gradient_by_vignetting_is_the_oracles_and_that_of_differences() {
    for case in cases() {
        let exact = differentiate_by_vignetting(&case.splats, &case.view, &case.options, &case.loss);
        let largest = exact.iter().fold(0.0, |most: f64, by| most.max(by.abs()));
        let found = engine_gradient(&case).0.by_vignetting.unwrap();
        let mut measured = 0;
        for k in 0..VIGNETTING_TERMS {
            let error = (f64::from(found[k]) - exact[k]).abs() / largest;
            assert!(error < ENGINE_TOLERANCE, "{} {k}: {:e}, expected {:e}", case.name, found[k], exact[k]);
            let value = |h: f64| {
                let p = Parameters { splats: case.splats.clone(), flat: flatten(&case.splats) };
                let mut vignetting = VIGNETTING;
                vignetting.log_gain[k] += h as f32;
                let mut view = case.view.clone();
                view.target.vignetting = Some(vignetting);
                let (total, _, rendered) = objective(&p, &view, &case.options, &case.loss);
                (total, rendered.trace)
            };
            // A step across a change of sign of L1 measures something else.
            let difference = [14, 17, 20].into_iter().find_map(|power| {
                let h = 0.5f64.powi(power);
                let [above, below] = [value(h), value(-h)];
                (above.1 == below.1).then_some((above.0 - below.0) / (2.0 * h))
            });
            let Some(difference) = difference else { continue };
            measured += 1;
            assert!((difference - exact[k]).abs() / largest < 1e-5, "{} {k}: {difference:e} {:e}", case.name, exact[k]);
        }
        assert!(measured >= 3, "{}: {measured}", case.name);
    }
}

#[test]
fn a_gain_of_one_changes_nothing_to_the_bit() {
    let mut case = plain(false, 55);
    let without = engine_gradient(&case);
    assert_eq!(without.0.by_vignetting, None);
    case.view.target.vignetting = Some(Vignetting { log_gain: [0.0; VIGNETTING_TERMS], ..VIGNETTING });
    let with = engine_gradient(&case);
    assert!(with.0.by_vignetting.is_some_and(|by| by.iter().all(|by| *by != 0.0)));
    assert_eq!((StepReport { by_vignetting: None, ..with.0 }, with.1, with.2), without);
}

#[test]
fn gradient_by_vignetting_is_the_same_bits_for_any_number_of_threads() {
    let camera = fixture::camera(70, 131);
    let base = vignetted(plain(false, 56));
    let splats = fixture::splats(lcd(2, 1, Activation::Softplus), 200, &camera, 9);
    let view = luxel_core::View { target: base.view.target, ..fixture::view(&camera, false, 10) };
    let step = StepConfig { loss: base.loss, ..fixture::step(1, base.options) };
    let report = |threads: usize| {
        let mut engine = CpuEngine::new(threads).unwrap();
        engine.load(&splats, None).unwrap();
        engine.train_step(&view, &step).unwrap()
    };
    assert_eq!((report(2), report(5)), (report(1), report(1)));
}
