//! Errors of training: each states what is wrong and how to solve it.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic as they do")]

mod common;

use std::ops::Range;

use common::{black, config, dataset, engine};
use luxel_core::edit::Contributions;
use luxel_core::engine::{DensifyPlan, DensifyStats, Geometry, PassTime, SavedPart, SplatArray, StepConfig};
use luxel_core::{Camera, Engine, EngineError, Image, Mask, Moments, RenderOptions, Snapshot, Splats, StepReport, View};
use luxel_train::{Method, NoMethods, TrainConfig, TrainError, Trainer, snapshot_response};

/// An engine with steps that change nothing and report a preset loss.
struct Puppet {
    splats: Splats,
    loss: f32,
    opacity_logit: f32,
}

impl Engine for Puppet {
    fn load(&mut self, splats: &Splats, _: Option<&Moments>) -> Result<(), EngineError> {
        self.splats = splats.clone();
        Ok(())
    }
    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        Ok((self.splats.clone(), Moments::zeros(self.splats.color_model, self.splats.len())))
    }
    fn save_array(&mut self, part: SavedPart, array: SplatArray, splats: Range<usize>) -> Result<Vec<f32>, EngineError> {
        let width = array.width(self.splats.color_model);
        let values = match part {
            SavedPart::Parameters => self.splats.array(array).to_vec(),
            SavedPart::FirstMoments | SavedPart::SecondMoments => vec![0.0; width * self.splats.len()],
        };
        Ok(values.get(splats.start * width..splats.end * width).unwrap_or_default().to_vec())
    }
    fn render(&mut self, camera: &Camera, _: &RenderOptions) -> Result<Image, EngineError> {
        Ok(Image::filled(camera.size_px[0] as usize, camera.size_px[1] as usize, [0.0; 3]))
    }
    fn contributions(&mut self, _: &Camera, _: &RenderOptions, _: &[f32]) -> Result<Contributions, EngineError> {
        Ok(Contributions::default())
    }
    fn train_step(&mut self, _: &View, _: &StepConfig) -> Result<StepReport, EngineError> {
        Ok(StepReport { loss: self.loss, ..StepReport::default() })
    }
    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        Ok(DensifyStats::zeros(self.splats.len()))
    }
    fn set_densify_stats(&mut self, _: &DensifyStats) -> Result<(), EngineError> {
        Ok(())
    }
    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        let opacity_logit = vec![self.opacity_logit; self.splats.len()];
        Ok(Geometry { position: self.splats.position.clone(), log_scale: self.splats.log_scale.clone(), opacity_logit })
    }
    fn densify(&mut self, _: &DensifyPlan) -> Result<(), EngineError> {
        Ok(())
    }
    fn len(&self) -> usize {
        self.splats.len()
    }
    fn timings(&self) -> &[PassTime] {
        &[]
    }
}

fn puppet(loss: f32, opacity_logit: f32) -> Box<Puppet> {
    Box::new(Puppet { splats: Splats::empty(luxel_core::ColorModel::Sh { degree: 0 }), loss, opacity_logit })
}

fn message(result: Result<Trainer, TrainError>) -> String {
    result.err().expect("an error").to_string()
}

#[test]
fn diverging_loss_names_step_view_and_remedy() {
    let mut trainer = Trainer::new(&dataset(), config(10), puppet(f32::NAN, 0.0)).unwrap();
    let error = trainer.step().unwrap_err();
    assert!(error.to_string().starts_with("step 1: the loss on view train/"), "{error}");
    assert!(error.remedy().unwrap().options().any(|option| option == "luminance_lr"), "{error}");
    assert_eq!(trainer.iteration(), 0);
}

#[test]
fn a_parameter_that_diverges_is_an_error_with_step_and_view_at_the_next_log_line() {
    let config = TrainConfig { position_lr: 3e38, ..config(300) };
    let mut trainer = Trainer::new(&dataset(), config, engine()).unwrap();
    let error = (0..300).find_map(|_| trainer.step().err()).expect("an error");
    assert_eq!(trainer.iteration(), 99, "{error}");
    assert!(error.to_string().starts_with("step 100: after training on view train/"), "{error}");
    assert!(error.to_string().contains("position of splat") && error.remedy().unwrap().options().any(|o| o == "position_lr"), "{error}");
}

#[test]
fn pruning_everything_is_an_error() {
    let mut trainer = Trainer::new(&dataset(), config(100), puppet(1.0, -20.0)).unwrap();
    let error = (0..100).find_map(|_| trainer.step().err()).expect("an error").to_string();
    assert!(error.starts_with("step 10: every splat was pruned"), "{error}");
}

#[test]
fn data_sets_that_cannot_be_trained_on_are_refused() {
    let good = dataset();
    let mut none = good.clone();
    none.train.clear();
    assert!(message(Trainer::new(&none, config(10), engine())).contains("no training views"));
    let mut dark = good.clone();
    dark.train.iter_mut().for_each(|view| view.image = black());
    assert!(message(Trainer::new(&dark, config(10), engine())).contains("black"));
    let mut masked = good.clone();
    masked.train.iter_mut().for_each(|view| view.mask = Some(Mask::from_valid(vec![false; 48 * 48]).into()));
    assert!(message(Trainer::new(&masked, config(10), engine())).contains("masked"));
    let mut small = good.clone();
    small.train[2].image = Image::filled(47, 48, [1.0; 3]).into();
    assert!(message(Trainer::new(&small, config(10), engine())).starts_with("view train/2: image is 47 x 48"));
    let mut bent = good;
    bent.train[1].camera.focal_px.x = 0.0;
    assert!(message(Trainer::new(&bent, config(10), engine())).starts_with("view train/1: camera: focal length 0"));
}

#[test]
fn black_images_are_trained_on_where_the_scale_is_given() {
    let mut dark = dataset();
    dark.train.iter_mut().for_each(|view| view.image = black());
    let mut trainer = Trainer::new(&dark, TrainConfig { radiance_scale: Some(1.0), ..config(4) }, engine()).unwrap();
    for _ in 0..4 {
        assert!(trainer.step().unwrap().loss.is_finite());
    }
}

#[test]
fn a_view_without_valid_pixels_among_others_does_no_harm() {
    let mut data = dataset();
    data.train[3].mask = Some(Mask::from_valid(vec![false; 48 * 48]).into());
    let mut trainer = Trainer::new(&data, config(12), engine()).unwrap();
    for _ in 0..12 {
        assert!(trainer.step().unwrap().loss.is_finite());
    }
    let split = luxel_metrics::evaluate(
        trainer.engine(),
        &RenderOptions::default(),
        &luxel_metrics::Measures::new(luxel_core::RadianceScale::ONE, 5000.0),
        &data.train,
        &mut |_, _, _| (),
    )
    .unwrap();
    assert_eq!(split.views.len(), 5);
}

fn snapshot() -> Snapshot {
    let mut trainer = Trainer::new(&dataset(), config(10), engine()).unwrap();
    trainer.step().unwrap();
    trainer.snapshot().unwrap()
}

#[test]
fn checkpoint_of_another_data_set_is_refused_with_both_names() {
    let mut other = dataset();
    other.fingerprint = "kitchen".to_owned();
    let error = message(Trainer::resume(&other, snapshot(), engine()));
    assert!(error.contains("room") && error.contains("kitchen"), "{error}");
}

#[test]
fn checkpoint_of_another_color_model_is_refused_with_both_names() {
    let mut other = snapshot();
    let sh3 = Trainer::new(&dataset(), TrainConfig { method: Method::Sh3, ..config(10) }, engine()).unwrap().scene().unwrap();
    other.scene = sh3;
    let error = message(Trainer::resume(&dataset(), other, engine()));
    assert!(error.contains("sh3") && error.contains("lcd"), "{error}");
}

#[test]
fn damaged_trainer_state_is_an_error_wherever_it_is_cut_or_changed() {
    let data = dataset();
    let good = snapshot();
    for cut in 0..good.state_json.len() {
        let damaged = Snapshot { state_json: good.state_json[..cut].to_owned(), ..good.clone() };
        assert!(snapshot_response(&damaged, &NoMethods).is_err(), "cut at {cut}");
    }
    let changes = [
        ("\"version\":3", "\"version\":9", "version 9, expected 3"),
        ("\"order\":[", "\"order\":[7,", "order of views"),
        ("\"cursor\":[1", "\"cursor\":[100", "order of views"),
        ("\"iterations\":10", "\"iterations\":0", "iterations"),
        ("\"radiance_scale\":null", "\"radiance_scale\":-1.0", "radiance_scale"),
        ("\"extent\":", "\"extent\":-", "extent"),
        ("\"averaged\":0", "\"averaged\":1", "average of the parameters is missing"),
        ("\"average_share\":", "\"average_share\":1", "average_share"),
    ];
    for (from, to, expected) in changes {
        let state_json = good.state_json.replacen(from, to, 1);
        assert_ne!(state_json, good.state_json, "{from} is not in {state_json}");
        let error = message(Trainer::resume(&data, Snapshot { state_json, ..good.clone() }, engine()));
        assert!(error.contains(expected), "{to}: {error}");
    }
}

#[test]
fn damaged_arrays_are_an_error() {
    let data = dataset();
    let good = snapshot();
    let mut scene = good.clone();
    scene.scene.splats.position[3] = [f32::NAN; 3];
    assert!(message(Trainer::resume(&data, scene, engine())).contains("scene: position of splat 3"));
    let mut moments = good.clone();
    moments.moments.first = Splats::empty(good.scene.splats.color_model);
    assert!(Trainer::resume(&data, moments, engine()).is_err());
    let mut average = good.clone();
    average.average = Some(Splats::empty(good.scene.splats.color_model));
    average.state_json = average.state_json.replacen("\"averaged\":0", "\"averaged\":1", 1);
    assert!(message(Trainer::resume(&data, average, engine())).contains("of other splats than the scene's"));
    let mut stats = good;
    stats.stats.views.pop();
    assert!(Trainer::resume(&data, stats, engine()).is_err());
}
