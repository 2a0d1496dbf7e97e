//! `luxel reproduce`: methods, data sets and seeds, trained, measured and set side by side.

use std::time::Duration;

use anyhow::{Context, Result, bail};
use luxel::output;
use luxel::run::{ExplicitArgs, Outcome};
use luxel::study::{Study, StudyFiles, StudyOptions, StudyPlan, plan, run as run_study};
use luxel::text;
use serde_json::json;

use crate::args::ReproduceArgs;
use crate::args::run_config::difference_line;
use crate::interrupt;
use crate::output::console::Console;

/// Runs the command; `explicit` names the options that were given.
pub(crate) fn run(args: &ReproduceArgs, explicit: &ExplicitArgs) -> Result<Outcome> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    output::check_folder_name(&args.output, &output::RESULT_EXTENSIONS)?;
    let options = options(args, explicit)?;
    if args.dry_run {
        report_plan(plan(&options, &console)?, &console)?;
        return Ok(Outcome::Finished);
    }
    match run_study(&options, &console, interrupt::stop())? {
        Study::Interrupted => {
            console.interrupted("saved; the same command continues from here");
            Ok(Outcome::Interrupted)
        }
        Study::Reported { files, mut failures } => {
            print_files(&files, &console)?;
            if failures.is_empty() {
                return Ok(Outcome::Finished);
            }
            let first = failures.remove(0);
            let others = if failures.is_empty() { String::new() } else { format!(" (and {} more)", failures.len()) };
            bail!("{}: {:#}{others}; the report is without it, and the same command tries it again", first.run, first.error)
        }
    }
}

/// Returns the library's options.
fn options(args: &ReproduceArgs, explicit: &ExplicitArgs) -> Result<StudyOptions> {
    let program = std::env::current_exe().context("cannot find the file of this program, which trains the runs")?;
    Ok(StudyOptions {
        methods: args.methods.iter().flat_map(|names| names.0.iter().copied()).collect(),
        seeds: args.seeds.clone(),
        jobs: args.jobs as usize,
        checkpoint_every: args.checkpoint_every,
        load: args.load.options(),
        device: args.device.options(),
        memory_gib: luxel_io::given_memory_limit().map(|bytes| bytes >> 30),
        train: args.train.config.clone().with_preset(|id| explicit.contains(id)),
        flip: args.metrics.metrics.into(),
        lpips_weights: args.metrics.lpips_weights.clone(),
        word_difference: difference_line,
        ..StudyOptions::new(args.datasets.iter().cloned(), &args.output, program)
    })
}

/// Prints what would be trained, and how long that takes.
fn report_plan(plan: StudyPlan, console: &Console) -> Result<()> {
    let StudyPlan { runs, finished, open, steps, jobs, seconds, is_from_finished_runs } = plan;
    let event =
        json!({ "event": "plan", "runs": runs, "finished": finished, "open": open, "steps": steps, "jobs": jobs, "seconds": seconds });
    let mut text = format!("{}: {} finished, {} to train", text::plural(runs, "run"), text::count(finished), text::count(open));
    if open > 0 {
        let time = Duration::try_from_secs_f64(seconds).map_or_else(|_| "unknown".into(), text::duration);
        let source = match is_from_finished_runs {
            true => "at the speed of finished runs",
            false => "at the speed of first steps or of other methods; steps with more splats take longer",
        };
        let steps = text::count(usize::try_from(steps).unwrap_or(usize::MAX));
        text += &format!("\ntraining  about {time}: {steps} steps, {} at a time, {source}", text::plural(jobs, "run"));
    }
    console.result(&event, &text)
}

/// Prints where the report is.
fn print_files(files: &StudyFiles, console: &Console) -> Result<()> {
    let [report, tables, runs, means, profiles] =
        [&files.report, &files.tables, &files.runs, &files.means, &files.profiles].map(|path| path.display().to_string());
    let facts = json!({ "report": report, "tables": tables, "runs": runs, "means": means, "profiles": profiles });
    let text =
        format!("report  {report}   <- open this in a browser\ntables  {tables}\nmetrics {runs}\n        {means}\n        {profiles}");
    console.finish(facts, &text)
}
