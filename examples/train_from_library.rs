//! Trains a scene from a data set, measures it on the held-out views and writes it.
//!
//! ```text
//! cargo run --release -p luxel --example train_from_library -- my-images scene.ply 1000
//! ```
//!
//! Arguments: data set (any that `luxel train` reads), scene to write, steps.

use luxel::{Dataset, Device, Error, Renderer, Result, Training};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, scene, steps] = arguments.as_slice() else {
        return Err(Error::new("usage: train_from_library DATASET SCENE.ply STEPS"));
    };
    let steps = steps.parse().map_err(|_| Error::new(format!("{steps}: expected a number of steps")))?;
    train(dataset, scene, steps)
}

fn train(dataset: &str, path: &str, steps: u32) -> Result<()> {
    let dataset = Dataset::open(dataset)?;
    for warning in dataset.warnings() {
        eprintln!("{warning}");
    }
    println!("{}: {} views to train on, {} to test", dataset.format, dataset.train.len(), dataset.test.len());

    // Defaults are the command line's: the method lcd, seed 42, schedules in proportion to the
    // steps.
    let mut training = Training::builder(&dataset).steps(steps).device(Device::Auto).start()?;
    for step in training.by_ref() {
        let step = step?;
        if step.number % 100 == 0 {
            println!("step {:>6}  loss {:.4}  {} splats", step.number, step.loss, step.splats);
        }
    }

    let metrics = training.evaluate(&dataset.test)?;
    for view in &metrics.views {
        println!("{}  {:.2} dB (scene), {:.2} dB (gtmax)", view.name, view.metrics.psnr_scene, view.metrics.psnr_gtmax);
    }
    println!("mean of {}: {:.2} dB (scene)", metrics.views.len(), metrics.mean.psnr_scene);

    let scene = training.into_scene()?;
    scene.save(path)?;
    println!("{path}");

    // What the scene file renders to, in the units of the data set.
    if let Some(view) = dataset.test.first() {
        let image = Renderer::new(&scene, Device::Auto)?.render(&view.camera)?;
        let name = format!("{}.exr", view.stem());
        image.save_exr(&name)?;
        println!("{name}");
    }
    Ok(())
}
