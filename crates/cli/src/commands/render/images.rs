//! Rendering and writing the images of `luxel render`.

use std::path::Path;

use anyhow::{Context, Result};
use luxel::preview::{self, Look};
use luxel::{FAR_DEPTH, FrameProgress, RADIANCE_SCALE};
use luxel_app::output;
use luxel_app::{files, text};
use luxel_core::{Conversion, Engine, Layers};
use luxel_io::ExrOptions;

use super::channels::{ChannelRenderer, Picture};
use super::deep;
use super::jobs::Job;
use super::making::Making;
use super::photograph::Photographer;
use crate::output::console::Console;

/// Renders and writes the images of all jobs.
pub(super) fn make(
    making: &Making<'_>,
    jobs: &[&Job],
    engine: &mut dyn Engine,
    mut channels: ChannelRenderer,
    console: &Console,
) -> Result<()> {
    let mut too_bright = 0usize;
    let mut photographer = Photographer::new(making.images.photograph);
    let mut progress = FrameProgress { observer: console, done: 0, total: u32::try_from(jobs.len()).unwrap_or(u32::MAX) };
    for job in jobs {
        let picture =
            channels.render(making, job, engine, &mut photographer).with_context(|| format!("cannot render {}", job.exr.display()))?;
        let is_cut = job.deep.as_ref().map_or(Ok(false), |deep| {
            deep.write(making, &job.camera, engine).with_context(|| format!("cannot render the deep image of {}", job.exr.display()))
        })?;
        too_bright += usize::from(write(making, job, picture)? || is_cut);
        let deep = job.deep.as_ref().map(|deep| &deep.path);
        progress.add(&job.name, std::iter::once(&job.exr).chain(&job.png).chain(deep).cloned().collect());
    }
    photographer.report(console);
    if too_bright > 0 {
        console.warn(&format!(
            "{} exceed 65504, the largest half float, and are cut there; leave --exr-type half out",
            text::plural(too_bright, "image")
        ));
    }
    Ok(())
}

/// Writes the files of a job; returns whether half floats could not hold the image.
fn write(making: &Making<'_>, job: &Job, picture: Picture) -> Result<bool> {
    let Making { images, scene, form, .. } = making;
    let Picture { layers: Layers { mut image, alpha, depth }, normals, planes, attributes: named } = picture;
    match (&job.png, &images.curve) {
        (Some(png), Some(curve)) => {
            preview::write(png, &image, scene.color_space, &Look { curve: curve.clone(), exposure_ev: images.exposure_ev })?;
        }
        // A preview of the image that is replaced would be out of date.
        _ => remove_outdated(&job.exr, output::PREVIEW_MADE_BY, &job.exr.with_extension("png"))?,
    }
    if job.deep.is_none() {
        remove_outdated(&job.exr, output::DEEP_MADE_BY, &deep::path_beside(&job.exr))?;
    }
    let unit = scene.world_from_local.scale() as f32;
    let conversion = Conversion::between(scene.color_space, form.color_space);
    for pixel in &mut image.pixels {
        *pixel = conversion.apply(scene.color_space.towards(form.color_space, scene.radiance_scale.restored(*pixel)));
    }
    let mut attributes = vec![(output::MADE_BY.to_owned(), job.made_by.clone())];
    if job.png.is_some() {
        attributes.push((output::PREVIEW_MADE_BY.to_owned(), job.preview_made_by.clone()));
    }
    if let Some(deep) = &job.deep {
        attributes.push((output::DEEP_MADE_BY.to_owned(), deep.made_by.clone()));
    }
    attributes.extend(named);
    let options = ExrOptions {
        sample: images.exr_type.sample(&image),
        color_space: form.color_space,
        attributes,
        numbers: vec![(RADIANCE_SCALE.into(), scene.radiance_scale.get()), (output::PREVIEW_EXPOSURE.into(), images.exposure_ev)],
        camera: Some(scene.world_camera(&job.camera)),
        frames_per_second: images.frames_per_second,
        alpha: form.alpha.then_some(alpha),
        depth: form.depth.then(|| depth.into_iter().map(|z| (z * unit).min(FAR_DEPTH)).collect()),
        normals: normals.map(|normals| scene.world_from_local.turned(&normals)),
        planes,
        ..ExrOptions::default()
    };
    let out_of_range = luxel_io::write_exr(&job.exr, &image, &options).context("cannot write an image")?;
    Ok(out_of_range > 0)
}

/// Removes the file beside an image that is replaced, if the image has a record of it.
fn remove_outdated(exr: &Path, record: &str, beside: &Path) -> Result<()> {
    if exr.is_file() && luxel_io::read_exr_attributes(exr).is_ok_and(|found| found.texts.contains_key(record)) {
        files::remove_if_there(beside)?;
    }
    Ok(())
}
