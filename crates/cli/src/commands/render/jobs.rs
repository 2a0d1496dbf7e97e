//! The images of `luxel render`: their names, what decides them, and which are to be made.

use std::path::PathBuf;

use anyhow::{Result, bail};
use luxel::preview::Curve;
use luxel_app::output::{self, FrameState, Recipe};
use luxel_app::run::evaluation::unique_stems;
use luxel_app::text;
use luxel_core::Camera;

use super::deep::DeepJob;
use super::making::Making;
use super::neighbours::Neighbours;
use super::photograph::{PhotographJob, photographs};
use super::plan::RenderPlan;
use super::shots::{Shot, Shots};
use crate::output::console::Console;

/// One image to render.
pub(super) struct Job {
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) exr: PathBuf,
    pub(super) png: Option<PathBuf>,
    pub(super) deep: Option<DeepJob>,
    pub(super) photograph: Option<PhotographJob>,
    pub(super) neighbours: Option<Neighbours>,
    /// Digest of what decides the image.
    pub(super) made_by: String,
    /// Digest of what decides the preview.
    pub(super) preview_made_by: String,
}

impl Job {
    fn new(
        making: &Making<'_>,
        exr: PathBuf,
        shot: Shot,
        photograph: Option<PhotographJob>,
        neighbours: Option<Neighbours>,
        recipe: &Recipe,
    ) -> Self {
        let images = making.images;
        let of_frame = recipe.clone().with_camera(&shot.camera);
        // Plain renders keep the recipe that they had before there were others.
        let of_frame = photograph.iter().fold(of_frame, |recipe, photograph| recipe.with("photograph", photograph.recipe()));
        let of_frame = neighbours.iter().fold(of_frame, |recipe, neighbours| recipe.with("motion", neighbours.recipe()));
        let preview = of_frame.clone().with("tonemap", format_args!("{:?}", images.tonemap)).with("exposure", images.exposure_ev);
        let preview = match &images.curve {
            Some(Curve::Ocio(display)) => preview.with("ocio", display.digest()),
            _ => preview,
        };
        Self {
            name: shot.name,
            camera: shot.camera,
            deep: images.deep.map(|most_samples| DeepJob::new(most_samples, &exr, &of_frame)),
            photograph,
            neighbours,
            png: images.curve.as_ref().map(|_| exr.with_extension("png")),
            exr,
            made_by: of_frame.digest(),
            preview_made_by: preview.digest(),
        }
    }
}

/// Returns the images of the frames and the shard asked for, of which `recipe` decides all but the
/// cameras. Names do not depend on the part that is rendered.
pub(super) fn jobs(plan: &RenderPlan<'_>, making: &Making<'_>, shots: Shots, recipe: &Recipe, console: &Console) -> Result<Vec<Job>> {
    let photographs = photographs(plan, making.scene, &shots)?;
    let neighbours = Neighbours::of_shots(plan, &shots)?;
    let count = shots.frames_len();
    let frames = plan.cameras.frames;
    match frames {
        Some(frames) if frames.first >= count => {
            bail!("--frames starts at {}, expected less than the number of frames, {count}: they are counted from 0", frames.first)
        }
        Some(frames) if frames.last >= count => {
            console.note(&format!("--frames ends at {}, the last of {} is {}", frames.last, text::plural(count, "frame"), count - 1));
        }
        _ => {}
    }
    let stems = unique_stems(shots.all.iter().map(|shot| shot.name.as_str()));
    // Both eyes of a pair are in the same part.
    let frame_of = |i: usize| i / shots.images_per_frame;
    let named = shots.all.into_iter().zip(stems).enumerate();
    let in_frames = named.filter(|(i, _)| frames.is_none_or(|frames| frames.contains(frame_of(*i))));
    let in_shard = in_frames.enumerate().filter(|(i, _)| plan.files.shard.is_none_or(|shard| frame_of(*i) % shard.count == shard.index));
    let job = |(i, (shot, stem)): (usize, (Shot, String))| {
        let (photograph, neighbours) = (photographs.as_ref().map(|all| all[i].clone()), neighbours.as_ref().map(|all| all[i].clone()));
        Job::new(making, plan.files.folder.join(format!("{stem}.exr")), shot, photograph, neighbours, recipe)
    };
    Ok(in_shard.map(|(_, named)| job(named)).collect())
}

/// Returns the jobs that are to be done: their images or previews are missing, or made by another
/// recipe and may be replaced.
pub(super) fn unmade(jobs: &[Job], overwrite: bool) -> Result<Vec<&Job>> {
    let (mut unmade, mut others) = (Vec::new(), Vec::new());
    for job in jobs {
        let image = output::frame_state(&job.exr, output::MADE_BY, &job.made_by);
        // The record of a preview is in its image.
        let preview = match &job.png {
            None => FrameState::Same,
            Some(png) if !png.exists() => FrameState::Missing,
            Some(_) if image == FrameState::Missing => FrameState::Other,
            Some(_) => output::frame_state(&job.exr, output::PREVIEW_MADE_BY, &job.preview_made_by),
        };
        let deep = job.deep.as_ref().map_or(FrameState::Same, |deep| deep.state(&job.exr, image));
        if [image, preview, deep] != [FrameState::Same; 3] {
            unmade.push(job);
        }
        let files = [(image, Some(&job.exr)), (preview, job.png.as_ref()), (deep, job.deep.as_ref().map(|deep| &deep.path))];
        others.extend(files.into_iter().filter(|(state, _)| *state == FrameState::Other).filter_map(|(_, path)| path.cloned()));
    }
    output::check_replaceable(&others, overwrite)?;
    Ok(unmade)
}
