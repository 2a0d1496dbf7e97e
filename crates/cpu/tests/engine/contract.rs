//! The contract of `Engine`: determinism, resuming, extremes, and errors on bad input.

use luxel_core::engine::{DensifyPlan, DensifyStats, PlanRow, PositionNoise, SavedPart, SplatArray, StatsCollection, StepConfig};
use luxel_core::{
    Activation, Antialias, ColorModel, Cutoffs, Distortion, Engine, EngineError, Image, Mask, Moments, Splats, StepReport, View,
};
use luxel_cpu::{CpuEngine, InstructionSet};

use crate::fixture;
use crate::oracle::flatten;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation: Activation::Softplus };

fn step(number: u32) -> StepConfig {
    let render = fixture::options(Cutoffs::HDR, Antialias::Off);
    let noise = PositionNoise { scale: 20.0, seed: 77 + u64::from(number) };
    StepConfig { position_noise: Some(noise), ..fixture::step(number, render) }
}

fn engine(threads: usize, splats: &Splats) -> CpuEngine {
    let mut engine = CpuEngine::new(threads).unwrap();
    engine.load(splats, None).unwrap();
    engine
}

/// Returns a plan that keeps, removes, clones and splits splats.
fn plan(count: u32) -> DensifyPlan {
    let mut rows = Vec::new();
    for source in 0..count {
        match source % 7 {
            0 => {}
            1 => rows.extend([PlanRow::keep(source), PlanRow { keep_moments: false, ..PlanRow::keep(source) }]),
            2 => rows.extend([[0.5, -1.0, 0.2], [-1.5, 0.3, 0.7]].map(|offset_sigma| PlanRow {
                source,
                offset_sigma,
                log_scale_shift: -(1.6f32.ln()),
                opacity_logit: None,
                keep_moments: false,
            })),
            3 => rows.push(PlanRow { opacity_logit: Some(-3.0), ..PlanRow::keep(source) }),
            _ => rows.push(PlanRow::keep(source)),
        }
    }
    DensifyPlan { rows, opacity_logit_cap: Some(1.5), smoothing: None }
}

/// The complete state of an engine, and its reports.
#[derive(Debug, PartialEq)]
struct State {
    splats: Splats,
    moments: Moments,
    stats: DensifyStats,
    reports: Vec<StepReport>,
}

fn state(engine: &mut CpuEngine, reports: Vec<StepReport>) -> State {
    let (splats, moments) = engine.save().unwrap();
    State { splats, moments, stats: engine.densify_stats().unwrap(), reports }
}

/// Returns the name of the first array that differs, for display.
fn assert_same_bits(found: &State, expected: &State, what: &str) {
    let pairs = [
        ("splats", &found.splats, &expected.splats),
        ("first moments", &found.moments.first, &expected.moments.first),
        ("second moments", &found.moments.second, &expected.moments.second),
    ];
    for (name, found, expected) in pairs {
        let (found, expected) = (flatten(found), flatten(expected));
        assert_eq!(found.len(), expected.len(), "{what}: {name}");
        let differing = found.iter().zip(&expected).position(|(a, b)| a.to_bits() != b.to_bits());
        if let Some(i) = differing {
            panic!("{what}: {name} differ at {i}: {:e}, expected {:e}", found[i], expected[i]);
        }
    }
    assert_eq!(found.stats, expected.stats, "{what}");
    assert_eq!(found.reports, expected.reports, "{what}");
}

fn train(engine: &mut CpuEngine, view: &View, steps: std::ops::RangeInclusive<u32>) -> Vec<StepReport> {
    steps
        .map(|number| {
            if number == 4 {
                let plan = plan(engine.len() as u32);
                engine.densify(&plan).unwrap();
            }
            engine.train_step(view, &step(number)).unwrap()
        })
        .collect()
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let camera = fixture::camera(83, 61);
    // More than two chunks of `bin`.
    let splats = fixture::splats(LCD, 5000, &camera, 31);
    let view = fixture::view(&camera, true, 32);
    let run = |threads: usize| {
        let mut engine = engine(threads, &splats);
        let reports = train(&mut engine, &view, 1..=7);
        state(&mut engine, reports)
    };
    let expected = run(1);
    for threads in [2, 3, 7] {
        assert_same_bits(&run(threads), &expected, &format!("{threads} threads"));
    }
}

#[test]
fn order_of_splats_does_not_matter_to_gradients() {
    let camera = fixture::camera(83, 61);
    let mut splats = fixture::splats(LCD, 5000, &camera, 33);
    // No two splats have the same depth: those would be ordered by their index.
    let mut rng = fixture::Rng::new(34);
    for (i, position) in splats.position.iter_mut().enumerate() {
        let px = [rng.uniform(0.0, 83.0), rng.uniform(0.0, 61.0)].map(f64::from);
        *position = fixture::unproject(&camera, px, 2.0 + 8e-4 * i as f64);
    }
    // Across the chunks of `bin`.
    let order = || (0..5000u32).map(|i| i * 37 % 5000);
    let view = fixture::view(&camera, true, 32);
    let run = |splats: &Splats| {
        let mut engine = engine(2, splats);
        let gradients = engine.gradients(&view, &step(1)).unwrap().1;
        (gradients, engine.densify_stats().unwrap())
    };
    let ((expected, expected_stats), (found, found_stats)) = (run(&splats), run(&splats.select(order())));
    let (found, expected) = (flatten(&found), flatten(&expected.select(order())));
    let differing = found.iter().zip(&expected).position(|(a, b)| a.to_bits() != b.to_bits());
    assert_eq!(differing.map(|i| (i, found[i], expected[i])), None);
    assert!(order().zip(&found_stats.gradient).all(|(i, found)| expected_stats.gradient[i as usize] == *found));
}

#[test]
fn a_saved_and_loaded_scene_trains_on_with_the_same_bits() {
    let camera = fixture::camera(47, 33);
    let mut splats = fixture::splats(LCD, 200, &camera, 41);
    splats.smoothing = fixture::smoothing(200);
    let view = fixture::view(&camera, false, 42);
    let mut unbroken = engine(2, &splats);
    let reports = train(&mut unbroken, &view, 1..=8);
    let expected = state(&mut unbroken, reports);
    for broken_after in [2, 3, 5] {
        let mut first = engine(2, &splats);
        let mut reports = train(&mut first, &view, 1..=broken_after);
        let saved = state(&mut first, Vec::new());
        let mut second = CpuEngine::new(1).unwrap();
        second.load(&saved.splats, Some(&saved.moments)).unwrap();
        second.set_densify_stats(&saved.stats).unwrap();
        reports.extend(train(&mut second, &view, broken_after + 1..=8));
        assert_same_bits(&state(&mut second, reports), &expected, &format!("broken after step {broken_after}"));
    }
}

/// A request to an engine, and its answer as text.
type Question = (&'static str, fn(&mut CpuEngine, &View) -> String);

/// Returns a step that uses the 3D filter.
fn filtered(number: u32) -> StepConfig {
    StepConfig { render: fixture::options(Cutoffs::HDR, Antialias::Mip), ..step(number) }
}

#[test]
fn whoever_asks_finds_steps_done() {
    let camera = fixture::camera(47, 33);
    let mut splats = fixture::splats(LCD, 300, &camera, 51);
    splats.smoothing = fixture::smoothing(300);
    // The next view has another size and another camera.
    let mut moved = fixture::camera(70, 40);
    moved.camera_from_world.translation.x += 0.3;
    let (view, next) = (fixture::view(&camera, false, 52), fixture::view(&moved, true, 53));
    let questions: [Question; 11] = [
        ("save", |engine, _| format!("{:?}", engine.save().unwrap())),
        ("render", |engine, view| format!("{:?}", engine.render(&view.camera, &filtered(1).render).unwrap())),
        ("render_layers", |engine, view| format!("{:?}", engine.render_layers(&view.camera, &filtered(1).render).unwrap())),
        ("contributions", |engine, view| {
            let mask = vec![1.0; view.image.pixels.len()];
            format!("{:?}", engine.contributions(&view.camera, &filtered(1).render, &mask).unwrap())
        }),
        ("evaluations", |engine, view| format!("{:?}", engine.evaluations(&view.camera, &filtered(1).render).unwrap())),
        ("train_step", |engine, view| format!("{:?}", engine.train_step(view, &filtered(3)).unwrap())),
        ("gradients", |engine, view| format!("{:?}", engine.gradients(view, &filtered(3)).unwrap())),
        ("densify_stats", |engine, _| format!("{:?}", engine.densify_stats().unwrap())),
        ("set_densify_stats", |engine, _| format!("{:?}", engine.set_densify_stats(&DensifyStats::zeros(300)).unwrap())),
        ("geometry", |engine, _| format!("{:?}", engine.geometry().unwrap())),
        ("densify", |engine, _| format!("{:?}", engine.densify(&plan(300)).unwrap())),
    ];
    for (name, ask) in questions {
        let run = |finish: fn(&mut CpuEngine)| {
            let mut engine = engine(2, &splats);
            for number in 1..=2 {
                engine.train_step(&view, &filtered(number)).unwrap();
                finish(&mut engine);
            }
            let answer = ask(&mut engine, &next);
            (answer, state(&mut engine, Vec::new()))
        };
        let (expected, found) = (run(|engine| engine.finish().unwrap()), run(|_| ()));
        assert!(found.0 == expected.0, "{name}");
        assert_same_bits(&found.1, &expected.1, name);
    }
}

#[test]
fn a_scene_that_is_loaded_is_not_changed_by_a_step_before() {
    let camera = fixture::camera(47, 33);
    let splats = fixture::splats(LCD, 300, &camera, 51);
    let mut engine = engine(2, &splats);
    engine.train_step(&fixture::view(&camera, false, 52), &step(1)).unwrap();
    engine.load(&splats, None).unwrap();
    assert_eq!(state(&mut engine, Vec::new()).splats, splats);
}

/// Asserts that arrays saved seven splats at a time are those of the whole.
fn assert_saved_by_pieces(engine: &mut CpuEngine, splats: &Splats, moments: &Moments) {
    let parts = [(SavedPart::Parameters, splats), (SavedPart::FirstMoments, &moments.first), (SavedPart::SecondMoments, &moments.second)];
    for ((part, expected), array) in parts.into_iter().flat_map(|part| SplatArray::ALL.map(|array| (part, array))) {
        let mut found = Vec::new();
        for first in (0..splats.len()).step_by(7) {
            found.extend(engine.save_array(part, array, first..splats.len().min(first + 7)).unwrap());
        }
        assert_eq!(found, expected.array(array), "{part:?} {array:?}");
        assert!(engine.save_array(part, array, 0..splats.len() + 1).is_err());
    }
}

#[test]
fn parameters_that_are_replaced_leave_moments_and_statistics() {
    let camera = fixture::camera(47, 33);
    let splats = fixture::splats(LCD, 300, &camera, 51);
    let mut engine = engine(2, &splats);
    engine.train_step(&fixture::view(&camera, false, 52), &step(1)).unwrap();
    let (_, moments) = engine.save().unwrap();
    let stats = engine.densify_stats().unwrap();
    let other = fixture::splats(LCD, 300, &camera, 53);
    engine.replace_parameters(&other).unwrap();
    assert_eq!(engine.save().unwrap(), (other, moments));
    assert_eq!(engine.densify_stats().unwrap(), stats);
    for wrong in [fixture::splats(LCD, 299, &camera, 1), fixture::splats(ColorModel::Sh { degree: 3 }, 300, &camera, 1)] {
        assert!(engine.replace_parameters(&wrong).unwrap_err().to_string().contains("the scene has 300"));
    }
}

#[test]
fn what_was_loaded_is_saved() {
    let camera = fixture::camera(20, 20);
    for count in [0, 1, 15, 16, 17, 40] {
        let mut splats = fixture::splats(LCD, count, &camera, 1);
        splats.smoothing = fixture::smoothing(count);
        let moments = Moments { first: fixture::splats(LCD, count, &camera, 2), second: fixture::splats(LCD, count, &camera, 3) };
        let mut engine = CpuEngine::new(1).unwrap();
        engine.load(&splats, Some(&moments)).unwrap();
        assert_saved_by_pieces(&mut engine, &splats, &moments);
        assert_eq!(engine.save().unwrap(), (splats.clone(), moments));
        let geometry = engine.geometry().unwrap();
        assert_eq!((geometry.position, geometry.log_scale), (splats.position, splats.log_scale));
        assert_eq!(geometry.opacity_logit, splats.opacity_logit);
        assert_eq!((engine.len(), engine.is_empty()), (count, count == 0));
        assert_eq!(engine.densify_stats().unwrap(), DensifyStats::zeros(count));
    }
}

#[test]
fn a_splat_without_a_rotation_splits_along_the_axes() {
    let mut splats = fixture::splats(LCD, 3, &fixture::camera(20, 20), 1);
    splats.rotation[1] = [0.0; 4];
    let mut engine = engine(1, &splats);
    let row = PlanRow { offset_sigma: [0.5, -1.0, 2.0], ..PlanRow::keep(1) };
    engine.densify(&DensifyPlan { rows: vec![row], ..DensifyPlan::default() }).unwrap();
    let moved = engine.save().unwrap().0.position[0];
    for (i, offset) in row.offset_sigma.iter().enumerate() {
        let expected = splats.position[1][i] + offset * splats.log_scale[1][i].exp();
        assert!((moved[i] - expected).abs() < 1e-6, "{i}: {} expected {expected}", moved[i]);
    }
}

#[test]
fn statistics_add_up_over_steps() {
    let camera = fixture::camera(31, 23);
    let splats = fixture::splats(LCD, 50, &camera, 1);
    let view = fixture::view(&camera, false, 2);
    let mut engine = engine(1, &splats);
    let config = StepConfig { position_noise: None, ..step(1) };
    engine.gradients(&view, &config).unwrap();
    let once = engine.densify_stats().unwrap();
    engine.gradients(&view, &StepConfig { stats: StatsCollection::Off, ..config }).unwrap();
    assert_eq!(engine.densify_stats().unwrap(), once);
    engine.gradients(&view, &config).unwrap();
    let twice = engine.densify_stats().unwrap();
    for i in 0..50 {
        assert_eq!(
            (twice.gradient[i], twice.abs_gradient[i], twice.views[i]),
            (2.0 * once.gradient[i], 2.0 * once.abs_gradient[i], 2 * once.views[i])
        );
    }
    assert!(once.views.iter().sum::<u32>() > 10);
}

fn assert_finite(splats: &Splats, what: &str) {
    let found = splats.validate();
    assert_eq!(found, Ok(()), "{what}");
}

#[test]
fn extreme_splats_give_finite_images_and_gradients() {
    let camera = fixture::camera(29, 23);
    let view = fixture::view(&camera, false, 2);
    let seed = |model| fixture::splats(model, 20, &camera, 8);
    type Change = fn(&mut Splats, usize);
    let extremes: [(&str, Change); 14] = [
        ("scale 1e-6", |s, i| s.log_scale[i] = [1e-6f32.ln(); 3]),
        ("scale 1e-30", |s, i| s.log_scale[i] = [1e-30f32.ln(); 3]),
        ("scale 1e3", |s, i| s.log_scale[i] = [1e3f32.ln(); 3]),
        ("scale e^80", |s, i| s.log_scale[i] = [80.0; 3]),
        ("needle", |s, i| s.log_scale[i] = [1e-6f32.ln(), 1e-6f32.ln(), 1e3f32.ln()]),
        ("disc", |s, i| s.log_scale[i] = [1e-6f32.ln(), 1e3f32.ln(), 1e3f32.ln()]),
        ("opacity 1", |s, i| s.opacity_logit[i] = 100.0),
        ("opacity 0", |s, i| s.opacity_logit[i] = -100.0),
        ("tiny quaternion", |s, i| s.rotation[i] = [1e-18, 0.0, -1e-18, 0.0]),
        ("huge quaternion", |s, i| s.rotation[i] = [1e18, 0.0, -1e18, 1e17]),
        ("zero quaternion", |s, i| s.rotation[i] = [0.0; 4]),
        ("far away", |s, i| s.position[i] = s.position[i].map(|p| 1e12 * p)),
        ("huge harmonics", |s, i| {
            let k = 3 * s.color_model.sh_coefficients();
            s.sh[i * k..(i + 1) * k].iter_mut().for_each(|v| *v *= 1e20);
        }),
        ("huge luminance", |s, i| {
            let m = s.color_model.luminance_coefficients();
            s.raw_luminance[i * m..(i + 1) * m].iter_mut().for_each(|v| *v = 1e6);
        }),
    ];
    for activation in [Activation::Softplus, Activation::Exp, Activation::Relu] {
        for model in [ColorModel::Sh { degree: 2 }, ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation }] {
            for (label, change) in &extremes {
                for antialias in [Antialias::Off, Antialias::Pixel, Antialias::Mip] {
                    let what = format!("{label}, {}, {antialias:?}", model.name());
                    let mut splats = seed(model);
                    (0..20).step_by(2).for_each(|i| change(&mut splats, i));
                    let config = fixture::step(1, fixture::options(Cutoffs::HDR, antialias));
                    let mut engine = engine(1, &splats);
                    let image = engine.render(&camera, &config.render).unwrap();
                    assert!(image.pixels.as_flattened().iter().all(|v| v.is_finite()), "{what}: image");
                    let (report, gradient) = engine.gradients(&view, &config).unwrap();
                    assert!(report.loss.is_finite(), "{what}: {report:?}");
                    assert_finite(&gradient, &what);
                    let stats = engine.densify_stats().unwrap();
                    assert!(stats.gradient.iter().chain(&stats.abs_gradient).all(|v| v.is_finite()), "{what}: statistics");
                    engine.train_step(&view, &config).unwrap();
                    assert_finite(&engine.save().unwrap().0, &what);
                }
            }
        }
    }
}

#[test]
fn training_an_empty_scene_reports_a_loss_and_nothing_else() {
    let camera = fixture::camera(29, 23);
    let mut engine = engine(1, &Splats::empty(LCD));
    let report = engine.train_step(&fixture::view(&camera, false, 2), &step(1)).unwrap();
    assert!(report.loss > 0.0 && report.loss.is_finite());
    assert_eq!((report.visible, engine.len()), (0, 0));
}

#[test]
fn a_view_without_valid_pixels_moves_nothing() {
    let camera = fixture::camera(29, 23);
    let mut view = fixture::view(&camera, false, 2);
    view.mask = Some(Mask::from_valid(vec![false; 29 * 23]).into());
    let mut config = step(1);
    config.loss.opacity_weight = 0.0;
    config.loss.scale_weight = 0.0;
    let splats = fixture::splats(LCD, 40, &camera, 8);
    let (report, gradient) = engine(1, &splats).gradients(&view, &config).unwrap();
    assert_eq!(report.l1, 0.0);
    assert!((report.ssim - 1.0).abs() < 1e-6, "{report:?}");
    // At SSIM's maximum its derivative is only rounding, which is masked, too.
    assert_eq!(flatten(&gradient).iter().position(|g| *g != 0.0), None);
}

#[test]
fn a_masked_pixel_of_the_view_does_not_pull() {
    // Valid columns on the left, the splat far to their right.
    let camera = fixture::camera(64, 64);
    let mut view = fixture::view(&camera, false, 2);
    view.mask = Some(Mask::from_valid((0..64 * 64).map(|i| i % 64 < 20)).into());
    let mut splats = fixture::splats(LCD, 1, &camera, 8);
    splats.position[0] = fixture::unproject(&camera, [48.0, 32.0], 3.0);
    splats.log_scale[0] = [-3.0; 3];
    let mut config = step(1);
    config.loss.opacity_weight = 0.0;
    config.loss.scale_weight = 0.0;
    let (_, gradient) = engine(1, &splats).gradients(&view, &config).unwrap();
    assert_eq!(flatten(&gradient).iter().position(|g| *g != 0.0), None);
}

#[test]
fn instruction_sets_agree_on_gradients() {
    let camera = fixture::camera(47, 33);
    let splats = fixture::splats(LCD, 60, &camera, 41);
    let view = fixture::view(&camera, false, 42);
    let gradient = |set: InstructionSet| {
        let mut engine = engine(1, &splats);
        let best = engine.instruction_set();
        match engine.set_instruction_set(set) {
            Ok(()) => Some(flatten(&engine.gradients(&view, &step(1)).unwrap().1)),
            // A processor without it returns an error, and the engine is unchanged.
            Err(error) => {
                assert!(set == InstructionSet::Avx2 && error.to_string().contains(&best) && engine.instruction_set() == best, "{error}");
                None
            }
        }
    };
    let best = gradient(InstructionSet::Best).unwrap();
    let largest = best.iter().fold(0f64, |a, b| a.max(b.abs()));
    for set in [InstructionSet::Avx2, InstructionSet::Baseline] {
        for (i, (a, b)) in best.iter().zip(gradient(set).iter().flatten()).enumerate() {
            assert!((a - b).abs() < 1e-5 * largest, "gradient {i}: {a:e} with the best set, {b:e} with {set:?}");
        }
    }
}

fn assert_refused<T: std::fmt::Debug>(result: Result<T, EngineError>, wording: &str) {
    let error = result.unwrap_err();
    assert!(error.to_string().contains(wording), "{error}");
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let camera = fixture::camera(16, 12);
    let splats = fixture::splats(LCD, 20, &camera, 1);
    let mut engine = engine(1, &splats);
    let before = engine.save().unwrap();
    let view = fixture::view(&camera, false, 1);
    let options = step(1).render;

    let mut nan = camera.clone();
    nan.camera_from_world.translation.x = f64::NAN;
    assert_refused(engine.render(&nan, &options), "not finite");
    let mut distorted = camera.clone();
    distorted.distortion = Distortion { k1: 0.1, ..Distortion::default() };
    assert_refused(engine.render(&distorted, &options), "distortion");
    let mut empty = camera.clone();
    empty.size_px = [0, 12];
    assert_refused(engine.render(&empty, &options), "0 x 12");

    let small = View { image: Image::filled(15, 12, [0.0; 3]).into(), ..view.clone() };
    assert_refused(engine.train_step(&small, &step(1)), "15 x 12");
    let truncated = View { image: Image { width: 16, height: 12, pixels: vec![[0.0; 3]; 5] }.into(), ..view.clone() };
    assert_refused(engine.train_step(&truncated, &step(1)), "pixels");
    let masked = View { mask: Some(Mask::from_valid(vec![true; 7]).into()), ..view.clone() };
    assert_refused(engine.train_step(&masked, &step(1)), "mask");

    assert_refused(engine.set_densify_stats(&DensifyStats::zeros(19)), "19");
    assert_refused(engine.densify(&DensifyPlan { rows: vec![PlanRow::keep(20)], ..DensifyPlan::default() }), "20");
    let unequal = DensifyPlan { rows: vec![PlanRow::keep(2)], smoothing: Some(vec![0.1; 2]), ..DensifyPlan::default() };
    assert_refused(engine.densify(&unequal), "smoothing");

    let mut short = splats.clone();
    short.rotation.pop();
    assert_refused(engine.load(&short, None), "rotation");
    let mut infinite = splats.clone();
    infinite.log_scale[7][1] = f32::INFINITY;
    assert_refused(engine.load(&infinite, None), "log_scale of splat 7");
    let other = fixture::splats(LCD, 25, &camera, 2);
    assert_refused(engine.load(&other, Some(&Moments::zeros(LCD, 3))), "moments");
    assert_refused(engine.load(&other, Some(&Moments::zeros(ColorModel::Sh { degree: 1 }, 25))), "moments");
    let mut odd = Moments::zeros(LCD, 25);
    odd.second.opacity_logit[4] = f32::NAN;
    assert_refused(engine.load(&other, Some(&odd)), "opacity_logit of splat 4");

    assert_eq!(engine.save().unwrap(), before);
}
