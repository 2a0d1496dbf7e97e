//! `luxel prepare`: a folder of photographs to a data set.
//!
//! scan (headers) → plan (cameras, exposures, brackets, white balance, response) → develop (radiance and proxies, view by view) → structure from
//! motion (COLMAP) → data set (undistorted images, pinhole cameras, points) → report. Each step finds what an earlier run finished.

mod colmap;
mod dataset;
mod develop;
mod exposures;
mod report;
mod response;
mod scan;
mod state;
mod views;

use std::collections::BTreeMap;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use luxel::files::write_text;
use luxel::run::RunFolder;
use luxel::text::plural;
use luxel_capture::prepare::{
    AdviceInput, Plan, PlanOptions, PrepareNote, Registration, ViewRecord, advice, check_options, choose_response, plan, range_stops,
};
use luxel_core::ColorSpace;
use luxel_io::{OcioSpace, PhotoKind};
use serde_json::json;

use self::colmap::Colmap;
use self::develop::{Developer, Folders};
use self::report::PrepareReport;
use self::state::{State, key};
use crate::args::{PrepareArgs, SfmArg};
use crate::output::console::Console;
use crate::remedy::with_remedy;

/// Changes when pixels are made differently, so that views of an older version are made anew.
const PIXELS_VERSION: &str = "2";

/// Runs the command.
pub(crate) fn run(args: &PrepareArgs) -> Result<()> {
    let started = Instant::now();
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global().context("cannot start the threads")?;
    }
    let mut console = Console::new(args.console.log_format, args.console.quiet);
    let installed = match args.sfm {
        SfmArg::Off => None,
        SfmArg::Auto | SfmArg::Colmap => Colmap::find(&args.colmap),
    };
    if installed.is_none() && args.sfm == SfmArg::Colmap {
        bail!(
            "{}: no such program; install COLMAP (Debian: apt-get install colmap), or say where it is with --colmap",
            args.colmap.display()
        );
    }
    let folders = Folders::new(&args.output);
    folders.check(&args.photos)?;
    let mut scan = scan::scan(&args.photos)?;
    let options = plan_options(args);
    check_options(&options, &scan.photos)?;
    let _lock = RunFolder::at(&folders.output).lock()?;
    // Once more: another luxel may have been at work there while this one looked at the photographs.
    folders.check(&args.photos)?;
    std::fs::create_dir_all(&folders.work).with_context(|| format!("{}: cannot create", folders.work.display()))?;
    let mut state = State::open(&folders.work);
    // From here on the folder is this command's.
    state.save()?;
    for left_out in &scan.left_out {
        console.warn(&format!("{} is left out: {}", left_out.file, left_out.reason));
    }
    let odd_list = args.exposures.as_ref().map(|list| exposures::apply(list, &mut scan.photos)).transpose()?.flatten();
    let mut plan = plan(&mut scan.photos, &options)?;
    plan.notes.extend(odd_list.map(PrepareNote::new));
    let curve = choose_response(&mut plan, options.response, |views| response::thinned_brackets(views, &scan.photos))?;
    let notes: Vec<String> = plan.notes.iter().map(word_note).collect();
    notes.iter().for_each(|note| console.note(note));
    let photographs = scan.photos.len();
    console.note(&format!("{} in {}: {}", plural(photographs, "photograph"), plural(plan.views.len(), "view"), plan.brackets));

    let space = ColorSpace::from(args.color_space);
    let ocio = ocio_space(args, plan.kind)?;
    let developer = Developer {
        plan: &plan,
        photos: &scan.photos,
        folders: &folders,
        tables: curve.as_ref().map(|curve| &curve.tables),
        space,
        input_space: args.input_space.into(),
        ocio: ocio.as_ref(),
        downscale: args.downscale,
        settings_key: settings_key(args, &plan, curve.as_ref().map(|curve| format!("{:?}", curve.tables)), ocio.as_ref()),
    };
    let everything = key(plan
        .views
        .iter()
        .map(|v| developer.key(v))
        .chain([sfm_options(args, installed.as_ref())])
        .collect::<Vec<_>>()
        .iter()
        .map(String::as_str));
    if state.finished_key.as_ref() == Some(&everything) && dataset::is_whole(&folders) {
        return console.result(&json!({ "event": "finished", "output": args.output }), &format!("{} is up to date", args.output.display()));
    }
    // Before a file is written over: a run that is stopped leaves a mixed set.
    state.finished_key = None;
    state.save()?;
    let (records, failed) = views::develop_all(&developer, &mut state, u64::from(args.memory) << 30, &mut console)?;
    scan.left_out.extend(failed);
    scan.left_out.extend(records.iter().flat_map(|record| record.left_out.iter().cloned()));
    if records.is_empty() {
        bail!("no view could be made of {}", plural(photographs, "photograph"));
    }
    let motion = Motion { args, developer: &developer };
    let (registration, how) = motion.run(installed.as_ref(), &records, &mut state, &mut console)?;
    let is_whole = registration.is_some();
    let report = PrepareReport {
        luxel: luxel::VERSION,
        photos: args.photos.display().to_string(),
        photographs,
        color_space: space.name(),
        units: if plan.is_absolute { "cd/m2 as far as EXIF and ISO 12232 tell it" } else { "relative" },
        brackets: plan.brackets.to_owned(),
        response: curve.as_ref().map(|curve| curve.name.clone()),
        white_balance: plan.cameras.iter().filter_map(|c| Some((c.name.clone(), c.color?.0))).collect(),
        structure_from_motion: how,
        range_stops: range_stops(&records),
        advice: advice(&AdviceInput {
            records: &records,
            registration: registration.as_ref(),
            curve: curve.as_ref().map(|curve| curve.origin),
            downscale: args.downscale,
        })
        .iter()
        .map(word_note)
        .collect(),
        notes: notes.into_iter().chain(view_notes(&records)).collect(),
        left_out: scan.left_out,
        registration,
        views: records,
        peak_memory_bytes: luxel::memory::peak_resident_bytes(),
        seconds: started.elapsed().as_secs_f64(),
    };
    report::write(&folders, &report)?;
    // Last: it says that nothing is left to do.
    if is_whole {
        state.finished_key = Some(everything);
        state.save()?;
    }
    tell(args, &report, &console)
}

/// Returns the options of the plan from the command line's.
fn plan_options(args: &PrepareArgs) -> PlanOptions {
    PlanOptions {
        brackets: args.brackets.0,
        has_exposure_list: args.exposures.is_some(),
        response: args.response.into(),
        white_balance: args.white_balance.clone().into(),
        color_space: args.color_space.into(),
        input_space: args.input_space.into(),
    }
}

fn word_note(note: &PrepareNote) -> String {
    with_remedy(&note.text, note.remedy.as_ref())
}

fn view_notes(records: &[ViewRecord]) -> Vec<String> {
    records.iter().flat_map(|r| r.notes.iter().map(move |note| format!("view {}: {note}", r.name))).collect()
}

/// The space of a configuration, if one is asked for.
fn ocio_space(args: &PrepareArgs, kind: PhotoKind) -> Result<Option<OcioSpace>> {
    match (&args.ocio, &args.ocio_space) {
        (Some(config), Some(space)) if kind == PhotoKind::Radiance => Ok(Some(OcioSpace::open(config, space)?)),
        (Some(_), Some(space)) => {
            bail!("--ocio-space {space} is for OpenEXR, HDR and float TIFF files; photographs have their colours from the camera")
        }
        _ => Ok(None),
    }
}

/// All that pixels depend on beside their files.
fn settings_key(args: &PrepareArgs, plan: &Plan, tables: Option<String>, ocio: Option<&OcioSpace>) -> String {
    let colors: Vec<String> = plan.cameras.iter().map(|c| format!("{:?}", c.color)).collect();
    let options = format!("{:?} {:?} {}", args.color_space, args.input_space, args.downscale);
    let ocio = ocio.map_or("", OcioSpace::digest);
    let own = [PIXELS_VERSION, &options, &tables.unwrap_or_default(), ocio, &plan.is_absolute.to_string()];
    key(own.into_iter().chain(colors.iter().map(String::as_str)))
}

fn sfm_options(args: &PrepareArgs, installed: Option<&Colmap>) -> String {
    format!("{:?} {:?} {:?}", args.camera_model, args.matching, installed.map(|c| &c.version))
}

/// How poses came about that the user had COLMAP find.
fn given_model(folders: &Folders) -> String {
    format!("the model that was found in {}", folders.work.join("sparse").display())
}

/// From proxies to the data set.
struct Motion<'a> {
    args: &'a PrepareArgs,
    developer: &'a Developer<'a>,
}

impl Motion<'_> {
    /// Poses and data set, and how they came about; `None` without COLMAP, where the commands are written instead.
    fn run(
        &self,
        installed: Option<&Colmap>,
        records: &[ViewRecord],
        state: &mut State,
        console: &mut Console,
    ) -> Result<(Option<Registration>, String)> {
        let options = (self.args.camera_model, self.args.matching);
        let Developer { folders, plan, .. } = *self.developer;
        let pictures = self.pictures(records);
        let Some(colmap) = installed else {
            let colmap = Colmap::unknown(&self.args.colmap);
            let steps = colmap.steps(folders, records, &plan.cameras, options)?;
            let path = folders.output.join("colmap.sh");
            write_text(&path, &colmap.script(&steps, folders))?;
            let given = folders.work.join("sparse");
            // Views that came or went since leave the poses of the others as they are.
            let is_of_others = pictures.iter().any(|(view, key)| state.pictures.get(view).is_some_and(|seen| seen != key));
            if given.is_dir() && is_of_others {
                let aside = colmap::set_aside(&given)?;
                console.warn(&format!(
                    "the model in {} is of other pictures than proxies/ has now; it is in {}",
                    given.display(),
                    aside.display()
                ));
            }
            if !given.is_dir() {
                state.pictures.clear();
            }
            state.pictures.extend(pictures);
            state.save()?;
            if !given.is_dir() {
                return Ok((None, format!("none yet: the commands are in {}; run them, then luxel prepare again", path.display())));
            }
            let registration = self.assemble(records, console)?;
            return Ok((Some(registration), given_model(folders)));
        };
        // What the user made by the commands that were written, without this command's doing: nothing to be made anew.
        let is_given = state.sfm_key.is_none() && !state.pictures.is_empty() && state.pictures == pictures;
        if is_given && colmap::largest_model(folders).is_ok() {
            let registration = self.assemble(records, console)?;
            return Ok((Some(registration), given_model(folders)));
        }
        let keys = records.iter().map(|r| r.key.as_str());
        let wanted = sfm_options(self.args, installed);
        let sfm_key = key(keys.chain([wanted.as_str()]));
        if state.sfm_key.as_ref() != Some(&sfm_key) || !folders.work.join("sparse").is_dir() {
            state.sfm_key = None;
            // From here on what is in work/sparse is this command's.
            state.pictures.clear();
            state.save()?;
            let steps = colmap.steps(folders, records, &plan.cameras, options)?;
            colmap.run(&steps, folders, records.len(), console)?;
            state.sfm_key = Some(sfm_key);
            state.pictures = pictures;
            state.save()?;
        }
        let registration = self.assemble(records, console)?;
        Ok((Some(registration), format!("{}, lens model {}", colmap.version, self.args.camera_model.name())))
    }

    fn assemble(&self, records: &[ViewRecord], console: &mut Console) -> Result<Registration> {
        let Developer { folders, plan, space, .. } = *self.developer;
        let (model, models) = colmap::largest_model(folders)?;
        dataset::write(folders, records, (&model, models), (space, plan.is_absolute), console)
    }

    /// Keys of the pictures that structure from motion gets, by view.
    fn pictures(&self, records: &[ViewRecord]) -> BTreeMap<String, String> {
        let by_name: BTreeMap<&str, &ViewRecord> = records.iter().map(|record| (record.name.as_str(), record)).collect();
        let made = self.developer.plan.views.iter().filter_map(|view| Some((view, *by_name.get(view.name.as_str())?)));
        made.map(|(view, record)| (view.name.clone(), self.developer.picture_key(view, record))).collect()
    }
}

/// The result for people and programs.
fn tell(args: &PrepareArgs, report: &PrepareReport, console: &Console) -> Result<()> {
    let output = args.output.display();
    let mut text = match &report.registration {
        Some(found) => format!(
            "{} of {} have poses; {:.1} stops; mean error {:.2} px\ntrain with: luxel train {output} -o run",
            found.views.len(),
            plural(report.views.len(), "view"),
            report.range_stops,
            found.mean_error_px
        ),
        None => format!(
            "radiance of {} in {output}/work/radiance, pictures for structure from motion in {output}/proxies\n\
             poses: run sh {output}/colmap.sh (Debian: apt-get install colmap), then the same luxel prepare again",
            plural(report.views.len(), "view")
        ),
    };
    for line in &report.advice {
        text += &format!("\nre-shoot: {line}");
    }
    text += &format!("\nreport: {output}/prepare.html");
    let registered = report.registration.as_ref().map(|r| r.views.len());
    let event = json!({
        "event": "finished", "output": args.output, "views": report.views.len(), "registered": registered, "advice": report.advice,
    });
    console.result(&event, &text)
}
