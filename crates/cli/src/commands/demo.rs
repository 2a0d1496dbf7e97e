//! `luxel demo`: training, evaluation and rendering of a small scene that is part of the program.
//! The data set is unpacked into the results, so that other commands can be tried on it afterwards.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use include_dir::{Dir, include_dir};
use luxel::LoadOptions;
use luxel::preview::{self, Look};
use luxel_app::run::{Launch, MadeBy, Outcome, PathContents, RunConfig, RunFolder, RunLock, RunOptions, TrainedRun, fresh};
use luxel_app::{files, output};
use luxel_core::tone::Tonemap;
use luxel_core::{Dataset, RadianceScale, View, luminance_rec709};
use luxel_train::{LateViews, NamedChoice, Reconstruction, TrainConfig};
use serde_json::json;

use crate::args::DemoArgs;
use crate::inputs::engine::training_engine;
use crate::interrupt;
use crate::output::console::Console;

/// 35 half-float EXR images of 200x200, poses, points, licences: 3.6 MB.
static DATASET: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/data/desk-lamp-200");

/// Folder within the results that the data set is unpacked to.
const DATASET_FOLDER: &str = "dataset";

/// Folder within the results for the pictures.
const PICTURES_FOLDER: &str = "pictures";

/// Folder within the data set for its images.
const IMAGES_FOLDER: &str = "images";

/// Number of test views to make pictures of.
const PICTURES: usize = 3;

/// Ends of the pictures' names: render and ground truth, exposed for the shadows and for the
/// highlights.
const PICTURE_ENDINGS: [[&str; 2]; 2] = [["shadows", "shadows_photograph"], ["highlights", "highlights_photograph"]];

/// Trains, evaluates, renders, and reports where the results are.
pub(crate) fn run(args: &DemoArgs) -> Result<Outcome> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    if !args.method.stores_splats() {
        let trained = args.method.spec().representation.noun();
        bail!("--method {}: the demo trains splats; train {trained} with luxel train", args.method.name());
    }
    output::check_folder_name(&args.output, &output::RESULT_EXTENSIONS)?;
    let folder = RunFolder::at(&args.output);
    may_replace(&folder)?;
    if args.method.has_own_steps() {
        bail!("--method {}: the demo's data set has no captured images beside its radiance; choose another method", args.method.name());
    }
    let config = config(args);
    // A missing device must not cost the results of an earlier demo.
    let engine = training_engine(&config)?;
    let lock = make_room(&folder)?;
    // The mark first: should the unpacking be interrupted, the next demo may still replace it.
    folder.write_config(&config)?;
    unpack(&DATASET, &folder.root().join(DATASET_FOLDER))?;
    console.note("training on a desk at night: 18 HDR images of 200x200 pixels, from a lit bulb to the shadows under the table");
    let launch = Launch { folder: &folder, observer: &console, stop: interrupt::stop() };
    let TrainedRun { outcome, mut trainer, dataset, .. } = fresh(config, engine, launch, |_| Ok(lock))?;
    if outcome == Outcome::Interrupted {
        console.interrupted(&format!("saved; continue with: luxel train --resume -o {}", folder.root().display()));
        return Ok(outcome);
    }
    let pictures = pictures(&folder, &dataset, &mut *trainer)?;
    report_results(args, &folder, &pictures, &console)?;
    Ok(outcome)
}

/// Locks the folder and removes what an earlier demo left.
fn make_room(folder: &RunFolder) -> Result<RunLock> {
    let lock = folder.lock()?;
    // Again: another luxel may have put something else there in the meantime.
    may_replace(folder)?;
    // The data set's files are replaced.
    remove_pictures(folder)?;
    folder.clear()?;
    Ok(lock)
}

/// Removes the files that [`pictures`] writes, and no others.
pub(super) fn remove_pictures(folder: &RunFolder) -> luxel::Result<()> {
    let place = folder.root().join(PICTURES_FOLDER);
    for image in DATASET.get_dir(IMAGES_FOLDER).into_iter().flat_map(Dir::files) {
        let Some(stem) = image.path().file_stem().map(|stem| stem.to_string_lossy()) else { continue };
        for ending in PICTURE_ENDINGS.as_flattened() {
            files::remove_if_there(&place.join(format!("{stem}_{ending}.png")))?;
        }
    }
    // It stays while something is in it.
    let _ = std::fs::remove_dir(place);
    Ok(())
}

/// Refuses to replace anything but the results of an earlier demo.
fn may_replace(folder: &RunFolder) -> Result<()> {
    let path = folder.root().display();
    match folder.contents()? {
        PathContents::Nothing => Ok(()),
        PathContents::Run(config) if config.made_by == MadeBy::Demo => Ok(()),
        PathContents::Run(_) => bail!("{path}: holds a training run that is not a demo; choose another folder with -o"),
        PathContents::Foreign => bail!("{path}: is not empty and not an earlier demo; choose another folder with -o"),
    }
}

/// Number of steps between rounds of densification, as in long runs: the scene is small.
const DENSIFY_INTERVAL: u32 = 100;

/// Number of splats: more take time and bring nothing.
const SPLATS: u32 = 50_000;

fn config(args: &DemoArgs) -> RunConfig {
    let train = TrainConfig { iterations: args.iterations, method: args.method, ..TrainConfig::default() };
    RunConfig {
        luxel_version: luxel::VERSION.into(),
        made_by: MadeBy::Demo,
        dataset: DATASET_FOLDER.into(),
        load: LoadOptions::default(),
        device: args.device.options(),
        run: RunOptions { checkpoint_every: 0, keep_checkpoints: 1, eval_at: Vec::new(), eval_every: None, ..RunOptions::default() },
        train: TrainConfig {
            densify_interval: Some(DENSIFY_INTERVAL),
            max_splats: Some(SPLATS),
            // In so few steps, halves of views would be too little.
            late_views: LateViews::Whole,
            ..train
        },
    }
}

fn unpack(from: &Dir<'_>, to: &Path) -> Result<()> {
    for file in from.files() {
        let name = file.path().file_name().context("an embedded file has no name")?;
        files::write_bytes(&to.join(name), file.contents())?;
    }
    for dir in from.dirs() {
        let name = dir.path().file_name().context("an embedded folder has no name")?;
        unpack(dir, &to.join(name))?;
    }
    Ok(())
}

/// Writes tone-mapped pictures of some test views and of their ground truth, exposed for the
/// shadows and for the highlights.
fn pictures(folder: &RunFolder, dataset: &Dataset, trainer: &mut dyn Reconstruction) -> Result<Vec<PathBuf>> {
    let (options, scale) = (trainer.render_options(), trainer.radiance_scale());
    let count = dataset.test.len();
    let chosen = (0..PICTURES.min(count)).filter_map(|i| dataset.test.get((2 * i + 1) * count / (2 * PICTURES.min(count))));
    let mut paths = Vec::new();
    for view in chosen {
        let render = trainer.engine().render(&view.camera, &options).with_context(|| format!("cannot render {}", view.name))?;
        let mut ground_truth = luxel_core::Image::clone(&view.image);
        scale.normalise(&mut ground_truth);
        let (shadows_ev, highlights_ev) = exposures(view, scale);
        for (endings, exposure_ev) in PICTURE_ENDINGS.into_iter().zip([shadows_ev, highlights_ev]) {
            let look = Look { curve: Tonemap::Agx.into(), exposure_ev };
            for (ending, image) in endings.into_iter().zip([&render, &ground_truth]) {
                let path = folder.root().join(PICTURES_FOLDER).join(format!("{}_{ending}.png", view.stem()));
                preview::write(&path, image, dataset.color_space, &look)?;
                paths.push(path);
            }
        }
    }
    Ok(paths)
}

/// Returns the exposures in stops that bring a view's median to middle grey, and its 99.9th
/// percentile to 1.
fn exposures(view: &View, scale: RadianceScale) -> (f32, f32) {
    let mut luminance: Vec<f32> = view.image.pixels.iter().map(|&p| scale.normalised_value(luminance_rec709(p))).collect();
    luminance.sort_unstable_by(f32::total_cmp);
    let at = |part: f64| luminance.get((part * luminance.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(1.0);
    let stops = |from: f32, to: f32| (to / from.max(1e-6)).log2();
    (stops(at(0.5), 0.18), stops(at(0.999), 1.0))
}

/// Reports where the results are, and commands to try next.
fn report_results(args: &DemoArgs, folder: &RunFolder, pictures: &[PathBuf], console: &Console) -> Result<()> {
    let root = folder.root().display();
    // As text: JSON has no form for a name that is not UTF-8.
    let pictures: Vec<String> = pictures.iter().map(|path| path.display().to_string()).collect();
    let picture = pictures.first().map_or("", String::as_str);
    let [images, report, scene] = [folder.evaluation(args.iterations).join("renders"), folder.report(), folder.scene(args.iterations)]
        .map(|path| path.display().to_string());
    let facts = json!({ "report": report, "pictures": pictures, "images": images, "scene": scene });
    let text = format!(
        "
report    {report}   <- open this in a browser
pictures  {picture} and {more} more
EXR       {images}
scene     {scene}

Try next:
{view}  luxel info {root}
  luxel render {root} --split all -o {root}/frames --tonemap agx --exposure 2
  luxel train {root}/{DATASET_FOLDER} -o desk-lamp
  luxel train YOUR_IMAGES -o my-scene",
        more = pictures.len().saturating_sub(1),
        view = if cfg!(feature = "view") { format!("  luxel view {root}   <- look around, in the browser\n") } else { String::new() },
    );
    console.finish(facts, &text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_data_set_is_complete_and_small() {
        let size = |dir: &Dir<'_>| -> usize {
            fn sum(dir: &Dir<'_>) -> usize {
                dir.files().map(|file| file.contents().len()).sum::<usize>() + dir.dirs().map(sum).sum::<usize>()
            }
            sum(dir)
        };
        assert!(size(&DATASET) <= 6 << 20, "{}", size(&DATASET));
        assert!(DATASET.get_file("LICENSES.txt").is_some());
        assert!(DATASET.get_file("transforms.json").is_some());
        assert_eq!(DATASET.get_dir(IMAGES_FOLDER).unwrap().files().count(), 35);
    }
}
