//! Trains a scene from a data set, measures it on the held-out views and writes it, with the library alone.
//!
//! ```text
//! cargo run --release --example train_from_library -- data/desk-lamp-200 desk-lamp.ply 1000
//! ```
//!
//! Arguments: data set (any that `luxel train` reads), scene to write, steps.

use std::error::Error;
use std::path::{Path, PathBuf};

use luxel_cpu::CpuEngine;
use luxel_io::{LoadOptions, load_dataset, write_scene_ply};
use luxel_train::{Measures, TrainConfig, Trainer, evaluate};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, scene, steps] = arguments.as_slice() else {
        return Err("usage: train_from_library DATASET SCENE.ply STEPS".into());
    };
    train(Path::new(dataset), &PathBuf::from(scene), steps.parse()?)
}

fn train(dataset: &Path, scene: &Path, iterations: u32) -> Result<(), Box<dyn Error>> {
    let dataset = load_dataset(dataset, &LoadOptions::default())?;
    for warning in &dataset.warnings {
        eprintln!("{warning}");
    }
    println!("{}: {} views to train on, {} to test", dataset.format, dataset.train.len(), dataset.test.len());

    // Defaults are the command line's: the method lcd, seed 42, windows in proportion to the steps.
    let config = TrainConfig { iterations, ..TrainConfig::default() };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut trainer = Trainer::new(&dataset, config, Box::new(CpuEngine::new(threads)?))?;
    while !trainer.is_finished() {
        let report = trainer.step()?;
        if trainer.iteration().is_multiple_of(100) {
            println!("step {:>6}  loss {:.4}  {} splats", trainer.iteration(), report.loss, trainer.splats_len());
        }
    }

    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let figures = evaluate(trainer.engine(), &options, &Measures::new(scale, mu), &dataset.test, &mut |view, _render, metrics| {
        println!("{}  {:.2} dB by protocol scene, {:.2} by gtmax", view.name, metrics.psnr_scene, metrics.psnr_gtmax);
    })?;
    println!("mean of {}: {:.2} dB by protocol scene", figures.views.len(), figures.mean.psnr_scene);

    write_scene_ply(scene, &trainer.scene()?)?;
    println!("{}", scene.display());
    Ok(())
}
