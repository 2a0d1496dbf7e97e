//! Training on images that are read when they are needed: the same bits as from memory.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use common::{config, dataset, engine};
use luxel_core::{Dataset, Image, Mask, NoiseModel, Observation, OnDemand, PixelValues, ReadError, Scene, Source, View, unreadable_image};
use luxel_train::{ExposureCompensation, NoiseChoice, ScaleRule, TrainConfig, TrainError, Trainer};

/// An image that is copied each time it is read, until a number of reads.
#[derive(Debug)]
struct Copied {
    image: Image,
    reads: Arc<AtomicUsize>,
    until: usize,
}

impl Source<Image> for Copied {
    fn read(&self) -> Result<Image, ReadError> {
        if self.reads.fetch_add(1, Ordering::Relaxed) < self.until {
            Ok(self.image.clone())
        } else {
            Err(ReadError { message: "images/3.exr: gone".into(), remedy: None })
        }
    }

    fn stand_in(&self) -> Image {
        unreadable_image(self.image.width, self.image.height)
    }
}

/// An image of which is known how many are being read at the same time.
#[derive(Debug)]
struct Watched {
    image: Image,
    now: Arc<AtomicUsize>,
    most: Arc<AtomicUsize>,
}

impl Source<Image> for Watched {
    fn read(&self) -> Result<Image, ReadError> {
        self.most.fetch_max(self.now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
        let image = self.image.clone();
        self.now.fetch_sub(1, Ordering::SeqCst);
        Ok(image)
    }

    fn stand_in(&self) -> Image {
        unreadable_image(self.image.width, self.image.height)
    }
}

/// The data set with its images on demand; `until` reads succeed.
fn on_demand(data: &Dataset, until: usize) -> (Dataset, Arc<AtomicUsize>) {
    let reads = Arc::new(AtomicUsize::new(0));
    let source = |image: &Image| Copied { image: image.clone(), reads: Arc::clone(&reads), until };
    let view = |view: &View| View { image: OnDemand::from_source(Arc::new(source(&view.image))), ..view.clone() };
    (Dataset { train: data.train.iter().map(view).collect(), ..data.clone() }, reads)
}

fn trained(data: &Dataset, config: &TrainConfig) -> Scene {
    let mut trainer = Trainer::new(data, config.clone(), engine()).unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer.scene().unwrap()
}

#[test]
fn a_run_on_demand_has_the_bits_of_one_in_memory() {
    let mut data = dataset();
    data.train[1].mask = Some(Mask::from_valid((0..48 * 48).map(|i| i % 7 != 0)).into());
    let base = config(24);
    let noise = NoiseChoice::Given(NoiseModel { read: 0.01, shot: 0.02 });
    let configs = [
        base.clone(),
        TrainConfig { resolution_schedule: "4@0,2@8,1@16".parse().unwrap(), noise_model: noise, ..base.clone() },
        TrainConfig { exposure_compensation: ExposureCompensation::Color, ..base },
    ];
    for config in configs {
        let (later, _) = on_demand(&data, usize::MAX);
        assert!(trained(&data, &config) == trained(&later, &config), "{config:?}");
        assert!(later.train.iter().all(|view| !view.image.is_in_memory()));
    }
}

#[test]
fn captured_images_on_demand_have_the_same_bits_too() {
    let mut data = dataset();
    for (i, view) in data.train.iter_mut().enumerate() {
        let exposure_s = [0.5, 2.0][i % 2];
        let code = |p: f32| ((p * exposure_s / (p * exposure_s + 1.0)).powf(1.0 / 2.2) * 255.0).round() / 255.0;
        let pixels = view.image.pixels.iter().map(|rgb| rgb.map(code)).collect();
        view.image = Image::from_pixels(view.image.width, view.image.height, pixels).unwrap().into();
        view.values = PixelValues::Recorded { exposure_s };
    }
    let (later, _) = on_demand(&data, usize::MAX);
    assert!(trained(&data, &config(12)) == trained(&later, &config(12)));
}

#[test]
fn a_resumed_run_on_demand_has_the_bits_of_an_unbroken_one() {
    let (data, _) = on_demand(&dataset(), usize::MAX);
    let unbroken = trained(&data, &config(20));
    let mut trainer = Trainer::new(&data, config(20), engine()).unwrap();
    for _ in 0..9 {
        trainer.step().unwrap();
    }
    let snapshot = trainer.snapshot().unwrap();
    let mut trainer = Trainer::resume(&data, snapshot, engine()).unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    assert!(trainer.scene().unwrap() == unbroken);
}

#[test]
fn an_image_that_is_gone_stops_the_run_with_its_name() {
    let (data, reads) = on_demand(&dataset(), usize::MAX);
    let mut trainer = Trainer::new(&data, config(40), engine()).unwrap();
    let at_start = reads.load(Ordering::Relaxed);
    trainer.step().unwrap();
    let (data, _) = on_demand(&dataset(), at_start + 5);
    let mut trainer = Trainer::new(&data, config(40), engine()).unwrap();
    let error = (0..40).find_map(|_| trainer.step().err()).unwrap();
    assert!(matches!(&error, TrainError::Read(_)), "{error}");
    assert_eq!(error.to_string(), "images/3.exr: gone");
}

#[test]
fn the_start_reads_each_image_once_and_once_for_stereo_whatever_it_has_to_know() {
    let mut captured = dataset();
    for view in &mut captured.train {
        view.image = Image::filled(view.image.width, view.image.height, [0.4, 0.5, 0.6]).into();
        view.values = PixelValues::Recorded { exposure_s: 0.5 };
    }
    let mut with_tracks = dataset();
    for point in &mut with_tracks.points {
        point.observations = vec![Observation { view: 1, pixel_px: [20.0, 30.0] }, Observation { view: 4, pixel_px: [7.0, 9.0] }];
    }
    let without_points = Dataset { points: Vec::new(), ..dataset() };
    for data in [dataset(), with_tracks, without_points, captured] {
        for (rule, scale) in [(ScaleRule::Median20, None), (ScaleRule::Max, None), (ScaleRule::Raw, None), (ScaleRule::P99, Some(2.0))] {
            for (stereo_points, times) in [(Some(0), 1), (Some(100), 2)] {
                let config = TrainConfig { scale_rule: rule, radiance_scale: scale, stereo_points, ..config(8) };
                let first = |data: &Dataset| Trainer::new(data, config.clone(), engine()).unwrap().scene().unwrap();
                let in_memory = first(&data);
                for readers in [1, 2, 5] {
                    let (later, reads) = on_demand(&data, usize::MAX);
                    let later = Dataset { readers, ..later };
                    assert!(first(&later) == in_memory, "{rule:?} {readers}");
                    assert_eq!(reads.load(Ordering::Relaxed), times * data.train.len(), "{rule:?} {readers} {stereo_points:?}");
                }
            }
        }
    }
}

#[test]
fn no_more_images_than_there_is_room_for_are_in_memory_at_the_start() {
    let data = dataset();
    for readers in [1, 3] {
        let (now, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let source = |image: &Image| Watched { image: image.clone(), now: Arc::clone(&now), most: Arc::clone(&most) };
        let view = |view: &View| View { image: OnDemand::from_source(Arc::new(source(&view.image))), ..view.clone() };
        let later = Dataset { train: data.train.iter().map(view).collect(), readers, ..data.clone() };
        Trainer::new(&later, config(8), engine()).unwrap();
        assert!((1..=readers).contains(&most.load(Ordering::Relaxed)), "{readers}");
    }
}

#[test]
fn each_step_reads_one_image() {
    let (data, reads) = on_demand(&dataset(), usize::MAX);
    let mut trainer = Trainer::new(&data, config(24), engine()).unwrap();
    let at_start = reads.load(Ordering::Relaxed);
    for _ in 0..24 {
        trainer.step().unwrap();
    }
    drop(trainer);
    // One more may be read ahead, and one in vain at the end of each of four epochs.
    let in_steps = reads.load(Ordering::Relaxed) - at_start;
    assert!((24..=29).contains(&in_steps), "{in_steps}");
}
