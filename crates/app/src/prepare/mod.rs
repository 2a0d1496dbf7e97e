//! From a folder of photographs to a data set that training reads.
//!
//! In: [`PrepareOptions`]: a folder of DNG, JPEG, PNG, TIFF, OpenEXR or Radiance HDR files, or a
//! video. Out: a data set in COLMAP's layout with images in scene-linear radiance, `prepare.json`
//! and `prepare.html`. Degenerate: without COLMAP, radiance, pictures for structure from motion,
//! and a script with COLMAP's commands.
//!
//! The steps are: scan headers; plan cameras, exposures, brackets, white balance and response
//! curve; develop each view to radiance and a proxy; find poses with COLMAP; write undistorted
//! images, pinhole cameras and points; report. Each step takes over what an earlier call finished.

mod colmap;
mod dataset;
mod develop;
mod exposures;
mod folders;
mod markers;
mod motion;
mod options;
mod panoramas;
mod pictures;
mod report;
mod response;
mod scan;
mod state;
mod steps;
mod video;
mod views;
mod world;

use std::path::Path;
use std::time::Instant;

use luxel::error::{Context, bail};
use luxel::{Error, Observer, Remedy, Result};
use luxel_capture::prepare::{
    AdviceInput, Plan, PrepareNote, Registration, Selection, SetCurve, ViewRecord, advice, check_options, choose_response, plan,
    range_stops,
};
use luxel_io::{OcioSpace, PhotoKind};

use self::colmap::Colmap;
use self::develop::Developer;
use self::folders::Folders;
use self::motion::{Motion, Poses};
pub use self::options::{CameraModel, Features, Mapper, MarkerFamily, Markers, Matching, OcioChoice, PrepareOptions, StructureFromMotion};
pub use self::report::{PrepareReport, cd_m2_per_unit, metres_per_unit};
use self::state::{State, key};
use self::video::Frames;
pub use self::world::WorldReport;
use crate::run::RunFolder;
use crate::text::plural;

pub use luxel_capture::BracketRule;
pub use luxel_capture::prepare::{ProjectionChoice, ResponseChoice, SetProjection, WhiteBalance};
pub use luxel_capture::world::KnownDistance;

/// The version of the way in which pixels are made; views of another version are made anew.
const PIXELS_VERSION: &str = "2";

/// The outcome of [`prepare`].
#[derive(Clone, Debug)]
pub enum Prepared {
    /// Nothing was left to do.
    UpToDate,
    /// The data set was written, or as much of it as is possible without poses.
    Written {
        /// The content of `prepare.json`.
        report: Box<PrepareReport>,
    },
}

/// Prepares a data set from a folder of photographs. Stopped at any time, the same call continues.
///
/// In: photographs as DNG, JPEG, PNG, TIFF, or OpenEXR and Radiance HDR, or a video. Out, in the
/// output folder: `images/`, `sparse/0`, `prepare.json`, `prepare.html`; `proxies/` and `work/` are
/// for COLMAP and for later calls. Without COLMAP, `colmap.sh` has the commands to run instead of
/// `images/`.
///
/// # Errors
/// No photographs, options that do not fit them, an output folder that holds something else, a
/// COLMAP that fails or finds no poses, and what the system refuses.
pub fn prepare(options: &PrepareOptions, observer: &dyn Observer) -> Result<Prepared> {
    let started = Instant::now();
    let colmap = find_colmap(options)?;
    let folders = Folders::new(&options.output);
    folders.check(&options.photos)?;
    let Frames { folder, transfer } = folder_of_photos(options, &folders, observer)?;
    let options = &PrepareOptions { transfer: options.transfer.or(transfer), ..options.clone() };
    check_primaries(options)?;
    let mut scan = scan::scan(&folder, options.transfer)?;
    check_options(&options.plan(), &scan.photos)?;
    let _lock = RunFolder::at(&folders.output).lock()?;
    let mut state = begin(options, &folders)?;
    for left_out in &scan.left_out {
        observer.warn(&format!("{} is left out: {}", left_out.file, left_out.reason));
    }
    let (plan, curve) = make_plan(options, &mut scan)?;
    let photographs = scan.photos.len();
    let notes = noted(&plan, options, photographs, observer);

    let ocio = ocio_space(options, plan.kind)?;
    let developer = Developer {
        plan: &plan,
        photos: &scan.photos,
        folders: &folders,
        tables: curve.as_ref().map(|curve| &curve.tables),
        space: options.color_space,
        input_space: options.input_space,
        ocio: ocio.as_ref(),
        transfer: options.transfer,
        layer: options.layer.as_deref(),
        downscale: options.downscale,
        settings_key: settings_key(options, &plan, curve.as_ref(), ocio.as_ref()),
    };
    let motion = Motion { options, installed: colmap.as_ref(), developer: &developer };
    motion.check()?;
    let finished_key = finished_key(&developer, &motion);
    if state.finished_key.as_ref() == Some(&finished_key) && dataset::is_complete(&folders) {
        return Ok(Prepared::UpToDate);
    }
    // Before a file is overwritten: a call that is stopped leaves a mixed set.
    state.finished_key = None;
    state.save()?;
    let (records, failed) = views::develop_all(&developer, &mut state, options.memory_bytes, observer)?;
    grouped_notes(&records).iter().for_each(|line| observer.warn(line));
    let of_views = records.iter().flat_map(|record| record.left_out.iter().cloned());
    let left_out = std::mem::take(&mut scan.left_out).into_iter().chain(failed).chain(of_views).collect();
    if records.is_empty() {
        bail!("no view could be made of {}", plural(photographs, "photograph"));
    }
    let Poses { registration, origin, world } = motion.run(&records, &mut state, observer)?;
    let scale_note = world.as_ref().and_then(world::scale_note).as_ref().map(options.word_note);
    let report = PrepareReport {
        luxel: luxel::VERSION,
        photos: options.photos.display().to_string(),
        photographs,
        color_space: options.color_space.name(),
        projection: plan.projection.name(),
        units: if plan.is_absolute { report::ABSOLUTE_UNITS } else { "relative" },
        brackets: plan.brackets.to_owned(),
        response: curve.as_ref().map(|curve| curve.name.clone()),
        white_balance: plan.cameras.iter().filter_map(|c| Some((c.name.clone(), c.color?.0))).collect(),
        structure_from_motion: origin,
        range_stops: range_stops(&records),
        advice: worded_advice(options, &records, registration.as_ref(), curve.as_ref()),
        notes: notes.into_iter().chain(view_notes(&records)).chain(scale_note).collect(),
        left_out,
        registration,
        world,
        views: records,
        peak_memory_bytes: crate::process::peak_resident_bytes(),
        seconds: started.elapsed().as_secs_f64(),
    };
    report::write(&folders, &report)?;
    // Last: it says that nothing is left to do.
    if report.registration.is_some() {
        state.finished_key = Some(finished_key);
        state.save()?;
    }
    Ok(Prepared::Written { report: Box::new(report) })
}

/// Returns the folder of photographs: that of the frames, of a video, with the curve it states.
fn folder_of_photos(options: &PrepareOptions, folders: &Folders, observer: &dyn Observer) -> Result<Frames> {
    check_unused(options)?;
    if !video::is_video(&options.photos) {
        return Ok(Frames { folder: options.photos.clone(), transfer: None });
    }
    let _lock = RunFolder::at(&folders.output).lock()?;
    begin(options, folders)?;
    video::extract(options, folders, observer)
}

/// Tells and returns what is noted about a plan.
fn noted(plan: &Plan, options: &PrepareOptions, photographs: usize, observer: &dyn Observer) -> Vec<String> {
    let notes: Vec<String> = plan.notes.iter().map(options.word_note).collect();
    notes.iter().for_each(|note| observer.note(note));
    observer.note(&format!("{} in {}: {}", plural(photographs, "photograph"), plural(plan.views.len(), "view"), plan.brackets));
    notes
}

/// Refuses primaries where the curve of a plate has its own.
fn check_primaries(options: &PrepareOptions) -> Result<()> {
    let usual = PrepareOptions::new(&options.photos, &options.output);
    match options.transfer.filter(|transfer| transfer.plate_primaries().is_some()) {
        Some(transfer) if options.input_space != usual.input_space => {
            let message = format!("the curve {transfer} has primaries of its own");
            Err(Error::new(message).with_remedy(Remedy::leave_out("input_color_space")))
        }
        _ => Ok(()),
    }
}

/// Refuses options that only a video has a use for.
fn check_unused(options: &PrepareOptions) -> Result<()> {
    check_primaries(options)?;
    let usual = PrepareOptions::new(&options.photos, &options.output);
    if video::is_video(&options.photos) {
        return Ok(());
    }
    let given = [("frames", options.frames != usual.frames), ("ffmpeg", options.ffmpeg != usual.ffmpeg)];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        Some((name, _)) => {
            let message = format!("{}: is no video, whose frames alone are chosen and decoded", options.photos.display());
            Err(Error::new(message).with_remedy(Remedy::leave_out(name)))
        }
        None => Ok(()),
    }
}

/// Returns the COLMAP to use, if any.
fn find_colmap(options: &PrepareOptions) -> Result<Option<Colmap>> {
    // A program that was named is not replaced by another.
    let is_named = options.colmap != Path::new("colmap");
    let installed = match options.structure_from_motion {
        StructureFromMotion::Off => None,
        StructureFromMotion::Auto | StructureFromMotion::Colmap => {
            Colmap::find(&options.colmap).or_else(|| (!is_named).then(|| Colmap::find(Path::new("pycolmap"))).flatten())
        }
    };
    let is_needed = match options.structure_from_motion {
        StructureFromMotion::Off => false,
        StructureFromMotion::Auto => is_named,
        StructureFromMotion::Colmap => true,
    };
    if installed.is_none() && is_needed {
        let remedy =
            Remedy::advice("install COLMAP (Debian: apt-get install colmap; any system: pip install pycolmap)").or(Remedy::give("colmap"));
        return Err(Error::new(format!("{}: no such program", options.colmap.display())).with_remedy(remedy));
    }
    Ok(installed)
}

/// Takes the locked output folder into use and returns the state that an earlier call left.
fn begin(options: &PrepareOptions, folders: &Folders) -> Result<State> {
    // Another process may have worked there while this one looked at the photographs.
    folders.check(&options.photos)?;
    std::fs::create_dir_all(&folders.work).with_context(|| format!("{}: cannot create", folders.work.display()))?;
    let mut state = State::open(&folders.work);
    // A saved state marks the folder as a data set in preparation.
    state.save()?;
    Ok(state)
}

/// Plans the views and chooses the response curve of developed pictures.
fn make_plan(options: &PrepareOptions, scan: &mut Selection) -> Result<(Plan, Option<SetCurve>)> {
    let unused_lines = options.exposures.as_ref().map(|list| exposures::apply(list, &mut scan.photos)).transpose()?.flatten();
    let mut plan = plan(&mut scan.photos, &options.plan())?;
    plan.notes.extend(unused_lines.map(PrepareNote::new));
    let curve = choose_response(&mut plan, &scan.photos, options.response, |views| response::thinned_brackets(views, &scan.photos))?;
    Ok((plan, curve))
}

/// Opens the OpenColorIO space of radiance files, if one is chosen.
fn ocio_space(options: &PrepareOptions, kind: PhotoKind) -> Result<Option<OcioSpace>> {
    match &options.ocio {
        Some(choice) if kind == PhotoKind::Radiance => Ok(Some(OcioSpace::open(&choice.config, &choice.space)?)),
        Some(choice) => Err(Error::new(format!(
            "the OpenColorIO space {} is for OpenEXR, HDR and float TIFF files; photographs have their colours from the camera",
            choice.space
        ))
        .with_remedy(Remedy::leave_out("ocio_space"))),
        None => Ok(None),
    }
}

/// Returns the digest of all that pixels depend on besides their files.
fn settings_key(options: &PrepareOptions, plan: &Plan, curve: Option<&SetCurve>, ocio: Option<&OcioSpace>) -> String {
    let colors: Vec<String> = plan.cameras.iter().map(|c| format!("{:?}", c.color)).collect();
    let plates = options.transfer.map(|transfer| format!(" {transfer}")).unwrap_or_default();
    // As other photographs have had it.
    let panoramas = if plan.projection == SetProjection::Equirectangular { " panoramas" } else { "" };
    let given = format!("{:?} {:?} {}{plates}{panoramas}", options.color_space, options.input_space, options.downscale);
    let tables = curve.map(|curve| format!("{:?}", curve.tables)).unwrap_or_default();
    let ocio = ocio.map_or("", OcioSpace::digest);
    let own = [PIXELS_VERSION, &given, &tables, ocio, &plan.is_absolute.to_string()];
    key(own.into_iter().chain(options.layer.as_deref()).chain(colors.iter().map(String::as_str)))
}

/// Returns the digest of all views and of the options of structure from motion.
fn finished_key(developer: &Developer<'_>, motion: &Motion<'_>) -> String {
    let views = developer.plan.views.iter().map(|view| developer.key(view));
    let parts: Vec<String> = views.chain([motion.settings(), world::settings(motion.options)]).collect();
    key(parts.iter().map(String::as_str))
}

/// Returns the advice on what to photograph again.
fn worded_advice(
    options: &PrepareOptions,
    records: &[ViewRecord],
    registration: Option<&Registration>,
    curve: Option<&SetCurve>,
) -> Vec<String> {
    let input = AdviceInput { records, registration, curve: curve.map(|curve| curve.origin), downscale: options.downscale };
    advice(&input).iter().map(options.word_note).collect()
}

/// Returns each note on views once, with the views that have it.
fn grouped_notes(records: &[ViewRecord]) -> Vec<String> {
    let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
    for (record, note) in records.iter().flat_map(|r| r.notes.iter().map(move |note| (r, note))) {
        match groups.iter_mut().find(|(text, _)| text == note) {
            Some((_, names)) => names.push(&record.name),
            None => groups.push((note, vec![&record.name])),
        }
    }
    let line = |(note, names): &(&str, Vec<&str>)| match names.as_slice() {
        [name] => format!("view {name}: {note}"),
        names => format!("{} of {}: {note}", names.len(), plural(records.len(), "view")),
    };
    groups.iter().map(line).collect()
}

/// Returns the notes on single views.
fn view_notes(records: &[ViewRecord]) -> Vec<String> {
    records.iter().flat_map(|r| r.notes.iter().map(move |note| format!("view {}: {note}", r.name))).collect()
}
