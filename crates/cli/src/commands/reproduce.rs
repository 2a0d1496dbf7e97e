//! `luxel reproduce`: methods, data sets and seeds, trained, measured and set side by side.

use std::ffi::OsString;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use luxel_app::run::{ExplicitArgs, Outcome};
use luxel_app::study::{Failure, Study, StudyFiles, StudyJob, StudyOptions, StudyPlan, jobs, plan, report, run as run_study};
use luxel_app::{output, text};
use serde_json::json;

use crate::args::ReproduceArgs;
use crate::args::run_config::difference_line;
use crate::interrupt;
use crate::output::console::Console;

/// Runs the command; `explicit` names the options that were given, and `words` are those of the
/// command line.
pub(crate) fn run(args: &ReproduceArgs, explicit: &ExplicitArgs, words: &[OsString]) -> Result<Outcome> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    output::check_folder_name(&args.output, &output::RESULT_EXTENSIONS)?;
    let options = options(args, explicit)?;
    if args.dry_run {
        report_plan(plan(&options, &console)?, &console)?;
        return Ok(Outcome::Finished);
    }
    if args.list {
        print_jobs(&jobs(&options)?, words, &console)?;
        return Ok(Outcome::Finished);
    }
    match if args.report { report(&options, &console)? } else { run_study(&options, &console, interrupt::stop())? } {
        Study::Interrupted => {
            console.interrupted("saved; the same command continues from here");
            Ok(Outcome::Interrupted)
        }
        Study::InPart { missing, failures } => {
            check_failures(failures, "there is no report")?;
            let text = match missing.is_empty() {
                true => "all runs are finished; another process writes the report".to_owned(),
                false => format!("this share is trained; {}", missing_line(&missing)),
            };
            console.finish_with_note(json!({ "missing": missing }), &text);
            Ok(Outcome::Finished)
        }
        Study::Reported { files, missing, failures } => {
            if !missing.is_empty() && failures.is_empty() {
                console.warn(&missing_line(&missing));
            }
            print_files(&files, &missing, &console)?;
            check_failures(failures, "the report is without it")?;
            Ok(Outcome::Finished)
        }
    }
}

/// Fails with the first of the runs that failed.
fn check_failures(mut failures: Vec<Failure>, consequence: &str) -> Result<()> {
    if failures.is_empty() {
        return Ok(());
    }
    let first = failures.remove(0);
    let others = if failures.is_empty() { String::new() } else { format!(" (and {} more)", failures.len()) };
    bail!("{}: {:#}{others}; {consequence}, and the same command tries it again", first.run, first.error)
}

/// Names of runs that a line lists.
const LISTED_RUNS: usize = 5;

/// Returns which runs are missing.
fn missing_line(missing: &[String]) -> String {
    let named: Vec<&str> = missing.iter().take(LISTED_RUNS).map(String::as_str).collect();
    let more = if missing.len() > LISTED_RUNS { format!(" and {} more", missing.len() - LISTED_RUNS) } else { String::new() };
    format!("{} missing: {}{more}", text::plural(missing.len(), "run"), named.join(", "))
}

/// Prints a line per run, the command that trains it alone: this one, with its share.
fn print_jobs(jobs: &[StudyJob], words: &[OsString], console: &Console) -> Result<()> {
    let text_of = |word: &OsString| word.to_str().map(str::to_owned).context("--list: a word of the command line is not UTF-8; rename it");
    let words: Vec<String> = words.iter().filter(|word| *word != "--list").map(text_of).collect::<Result<_>>()?;
    for (i, job) in jobs.iter().enumerate() {
        let share = format!("{}/{}", i + 1, jobs.len());
        let mut command = words.clone();
        command.extend(["--only".into(), share.clone()]);
        let line: Vec<String> = command.iter().map(|word| text::shell_word(word)).collect();
        let event = json!({ "event": "job", "only": share, "run": job.run, "folder": job.folder.display().to_string(), "steps": job.steps, "finished": job.is_finished, "command": command });
        console.result(&event, &format!("{}  # {}", line.join(" "), job.run))?;
    }
    console.finish_silently(json!({ "jobs": jobs.len() }));
    Ok(())
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
        share: args.only,
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
fn print_files(files: &StudyFiles, missing: &[String], console: &Console) -> Result<()> {
    let [report, tables, runs, means, profiles] =
        [&files.report, &files.tables, &files.runs, &files.means, &files.profiles].map(|path| path.display().to_string());
    let facts = json!({ "report": report, "tables": tables, "runs": runs, "means": means, "profiles": profiles, "missing": missing });
    let text =
        format!("report  {report}   <- open this in a browser\ntables  {tables}\nmetrics {runs}\n        {means}\n        {profiles}");
    console.finish(facts, &text)
}
