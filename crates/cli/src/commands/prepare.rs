//! `luxel prepare`: a folder of photographs to a data set.

use anyhow::Result;
use luxel_app::output;
use luxel_app::prepare::{PrepareOptions, PrepareReport, Prepared, WorldReport, prepare};
use luxel_app::text::plural;
use luxel_capture::prepare::PrepareNote;
use luxel_core::photo::EQUAL_EXPOSURES_STOPS;
use serde_json::json;

use crate::args::PrepareArgs;
use crate::output::console::Console;
use crate::remedy::with_remedy;

/// Share of a view's pixels that every exposure saturates from which on they should be masked.
const SATURATED: f64 = 0.01;

/// Runs the command.
pub(crate) fn run(args: &PrepareArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    output::check_folder_name(&args.output, &output::RESULT_EXTENSIONS)?;
    let options = PrepareOptions { word_note, ..args.options() };
    match prepare(&options, &console)? {
        Prepared::UpToDate => {
            let output = args.output.display().to_string();
            console.finish(json!({ "output": output }), &format!("{output} is up to date"))
        }
        Prepared::Written { report } => report_result(args, &report, &console),
    }
}

fn word_note(note: &PrepareNote) -> String {
    with_remedy(&note.text, note.remedy.as_ref())
}

/// Returns the options that training needs on these views: masks where many pixels are saturated,
/// whose radiance is a lower bound that depends on the exposure; and gains where single developed
/// pictures were exposed differently, because the curve that divides them is not exactly theirs.
fn training_options(report: &PrepareReport, output: &str) -> String {
    let mut options = String::new();
    if report.views.iter().any(|view| view.saturated > SATURATED) {
        options += &format!(" --masks {output}/saturation");
    }
    let stops = || report.views.iter().flat_map(|view| &view.stops);
    let spread = stops().fold(f64::MIN, |a, b| a.max(*b)) - stops().fold(f64::MAX, |a, b| a.min(*b));
    let is_single = report.views.iter().all(|view| view.files.len() == 1);
    if report.response.is_some() && is_single && spread > EQUAL_EXPOSURES_STOPS {
        options += " --exposure-compensation exposure";
    }
    options
}

/// Prints the result for people and programs.
fn report_result(args: &PrepareArgs, report: &PrepareReport, console: &Console) -> Result<()> {
    // As text: JSON has no form for a name that is not UTF-8.
    let output = args.output.display().to_string();
    let mut text = match &report.registration {
        Some(found) => format!(
            "{} of {} have poses; {:.1} stops; mean error {:.2} px\n{}train with: luxel train {output} -o run{}",
            found.views.len(),
            plural(report.views.len(), "view"),
            report.range_stops,
            found.mean_error_px,
            report.world.iter().flat_map(WorldReport::lines).map(|line| line + "\n").collect::<String>(),
            training_options(report, &output)
        ),
        None => format!(
            "radiance of {} in {output}/work/radiance, pictures for structure from motion in {output}/proxies\n\
             poses: none yet; install COLMAP (Debian: apt-get install colmap) and run sh {output}/colmap.sh, or pip install pycolmap; \
             then give the same luxel prepare command again",
            plural(report.views.len(), "view")
        ),
    };
    for line in &report.advice {
        text += &format!("\nre-shoot: {line}");
    }
    text += &format!("\nreport: {output}/prepare.html");
    let registered = report.registration.as_ref().map(|r| r.views.len());
    let facts = json!({ "output": output, "views": report.views.len(), "registered": registered, "advice": report.advice });
    console.finish(facts, &text)
}
