//! Runs that start from a scene: frozen geometry keeps its bits, and colours learn other light.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic as they do")]

mod common;

use common::{config, dataset, engine};
use luxel_core::{Antialias, Dataset, Scene, Similarity, Splats};
use luxel_train::{Freeze, Method, Strategy, TrainConfig, Trainer};

fn finished(mut trainer: Trainer) -> Scene {
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer.scene().unwrap()
}

/// The room under other light: dimmer, with red and blue exchanged.
fn other_light() -> Dataset {
    let mut data = dataset();
    for view in data.train.iter_mut().chain(&mut data.test) {
        let mut image = (*view.image).clone();
        image.pixels.iter_mut().for_each(|[r, g, b]| (*r, *g, *b) = (0.3 * *b, 0.3 * *g, 0.3 * *r));
        view.image = image.into();
    }
    data.fingerprint = "room, other light".to_owned();
    data
}

fn room(antialias: Antialias) -> Scene {
    finished(Trainer::new(&dataset(), TrainConfig { antialias, ..config(60) }, engine()).unwrap())
}

fn frozen(iterations: u32) -> TrainConfig {
    TrainConfig { freeze: Freeze::Geometry, max_aspect: 1.0, ..config(iterations) }
}

fn assert_same_geometry(a: &Splats, b: &Splats) {
    assert_eq!((&a.position, &a.rotation), (&b.position, &b.rotation));
    assert_eq!((&a.log_scale, &a.opacity_logit, &a.smoothing), (&b.log_scale, &b.opacity_logit, &b.smoothing));
}

#[test]
fn frozen_geometry_keeps_its_bits_and_learns_the_light() {
    let data = other_light();
    for (antialias, config) in [
        (Antialias::Pixel, frozen(120)),
        (Antialias::Mip, TrainConfig { method: Method::Sh3, ..frozen(400) }),
        (Antialias::Pixel, TrainConfig { strategy: Strategy::Mcmc, antialias: Antialias::Off, ..frozen(120) }),
    ] {
        let from = room(antialias);
        let mut trainer = Trainer::from_scene(&data, &from, config, engine()).unwrap();
        let mut losses = Vec::new();
        while !trainer.is_finished() {
            losses.push(trainer.step().unwrap().loss);
        }
        let scene = trainer.scene().unwrap();
        assert_same_geometry(&scene.splats, &from.splats);
        assert_eq!(scene.raster, from.raster);
        // An epoch has six views.
        let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
        let (first, last) = (mean(&losses[..6]), mean(&losses[losses.len() - 6..]));
        assert!(last < 0.9 * first, "{first} {last}");
        assert!(scene.radiance_scale.get() < 0.9 * from.radiance_scale.get());
    }
}

#[test]
fn a_frozen_run_resumes_bit_for_bit() {
    let (data, from) = (other_light(), room(Antialias::Pixel));
    let whole = finished(Trainer::from_scene(&data, &from, frozen(40), engine()).unwrap());
    let mut part = Trainer::from_scene(&data, &from, frozen(40), engine()).unwrap();
    (0..17).for_each(|_| {
        part.step().unwrap();
    });
    let snapshot = part.snapshot().unwrap();
    assert_eq!(finished(Trainer::resume(&data, snapshot, engine()).unwrap()), whole);
    assert_same_geometry(&whole.splats, &from.splats);
}

#[test]
fn without_freezing_a_run_starts_with_the_colours_of_the_scene() {
    let (data, from) = (dataset(), room(Antialias::Pixel));
    let mut trainer = Trainer::from_scene(&data, &from, config(40), engine()).unwrap();
    let start = trainer.scene().unwrap();
    assert_same_geometry(&start.splats, &from.splats);
    for i in 0..start.splats.len() {
        let (a, b) = (start.luminance(i), from.luminance(i));
        assert!((a - b).abs() <= 1e-4 * b + 1e-6, "{a} {b}");
    }
    trainer.step().unwrap();
    assert_ne!(trainer.scene().unwrap().splats.position, from.splats.position);
}

#[test]
fn scenes_that_do_not_go_with_the_run_are_refused() {
    let (data, from) = (other_light(), room(Antialias::Pixel));
    let refused = |scene: &Scene, config: TrainConfig| Trainer::from_scene(&data, scene, config, engine()).err().unwrap().to_string();
    let no_scene = Trainer::new(&data, frozen(10), engine()).err().unwrap().to_string();
    assert!(no_scene.contains("no scene whose geometry"), "{no_scene}");
    let poses = refused(&from, TrainConfig { refine_poses: true, ..frozen(10) });
    assert!(poses.contains("refine_poses"), "{poses}");
    let elsewhere = Scene { world_from_local: Similarity::scaling(2.0), ..from.clone() };
    assert!(refused(&elsewhere, frozen(10)).contains("local coordinates"));
    let mut measured = data.clone();
    measured.metres_per_unit = Some(1.0);
    let in_feet = Scene { metres_per_unit: Some(0.3048), ..from.clone() };
    let units = Trainer::from_scene(&measured, &in_feet, frozen(10), engine()).err().unwrap().to_string();
    assert!(units.contains("0.3048 m"), "{units}");
    let no_harmonics = refused(&from, TrainConfig { method: Method::Sh3, ..config(10) });
    assert!(no_harmonics.contains("lcd") && no_harmonics.contains("sh3"), "{no_harmonics}");
    let nothing = Scene { splats: Splats::empty(from.splats.color_model), ..from };
    assert!(refused(&nothing, frozen(10)).contains("no splats"));
}

#[test]
fn what_starts_from_a_scene_keeps_its_colour_model_also_on_developed_photographs() {
    let developed = Dataset { is_developed: true, ..dataset() };
    let of = |trainer: Result<Trainer, _>| finished(trainer.unwrap()).splats.color_model.name();
    let from_photographs = finished(Trainer::new(&developed, config(20), engine()).unwrap());
    assert_eq!(from_photographs.splats.color_model.name(), "lcd-c1-l2");
    assert_eq!(of(Trainer::from_scene(&dataset(), &from_photographs, config(20), engine())), "lcd-c1-l2");
    assert_eq!(of(Trainer::from_scene(&developed, &room(Antialias::Pixel), config(20), engine())), "lcd");
    // Colours that begin anew are those of the new images.
    assert_eq!(of(Trainer::from_scene(&developed, &room(Antialias::Pixel), frozen(20), engine())), "lcd-c1-l2");
}
