//! The configuration of a run from the arguments of `luxel train`, and the wording of options that
//! contradict it or have no effect.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::ArgMatches;
use clap::parser::ValueSource;
use luxel_app::run::{Choice, Difference, ExplicitArgs, Inapplicable, MadeBy, RunConfig, RunOptions};

use super::{TrainArgs, flag};

/// Returns the options that were given on the command line.
pub(crate) fn explicit_args(matches: &ArgMatches) -> ExplicitArgs {
    let is_explicit = |id: &&clap::Id| matches.value_source(id.as_str()) == Some(ValueSource::CommandLine);
    // What reading may take is no property of a run.
    matches.ids().filter(is_explicit).map(|id| id.as_str().to_owned()).filter(|id| id != super::MEMORY).collect()
}

/// Returns the configuration of a new run by the command line alone: explicit options over the
/// preset over the defaults.
pub(crate) fn from_args(args: &TrainArgs, dataset: PathBuf, explicit: &ExplicitArgs) -> RunConfig {
    RunConfig {
        luxel_version: luxel::VERSION.into(),
        made_by: MadeBy::Train,
        dataset,
        load: args.load.options(),
        device: args.device.options(),
        run: RunOptions { from: args.from.clone(), ..args.run.options() },
        train: args.train.config.clone().with_preset(|id| explicit.contains(id)),
    }
}

/// Returns `stored`, the configuration of an interrupted run, with the options that may change.
pub(crate) fn resumed(stored: &RunConfig, given: &RunConfig, explicit: &ExplicitArgs) -> Result<RunConfig> {
    let contradictions = stored.contradictions(given, explicit)?;
    if !contradictions.is_empty() {
        let word = |d: &Difference| format!("{} is {} in the run, {} now", flag(&d.option), d.stored_text(), d.now_text());
        bail!(
            "a resumed run keeps its settings: {}; leave these options out, or start anew with --overwrite or another output folder",
            contradictions.iter().map(word).collect::<Vec<_>>().join("; ")
        );
    }
    Ok(stored.resumed(given, explicit)?)
}

/// Refuses an explicit option that changes nothing.
pub(crate) fn reject_inapplicable(config: &RunConfig, explicit: &ExplicitArgs) -> Result<()> {
    match config.inapplicable(explicit) {
        Some(Inapplicable { option, choice: Choice { option: other, value: Choice::LEFT_OUT } }) => {
            bail!("{}: has no effect with {}; leave one of them out", flag(option), flag(other))
        }
        Some(Inapplicable { option, choice }) => {
            bail!("{}: has an effect with {} only; give that too, or leave this out", flag(option), choice_as_typed(choice))
        }
        None => Ok(()),
    }
}

fn choice_as_typed(choice: Choice) -> String {
    format!("{} {}", flag(choice.option), choice.value).trim_end().to_owned()
}

/// Returns a difference between a stored run and a wanted one, for people.
pub(crate) fn difference_line(difference: &Difference) -> String {
    let name = if difference.option == "dataset" { "the data set".to_owned() } else { flag(&difference.option) };
    format!("{name} is {} there, {} now", difference.stored_text(), difference.now_text())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::{CommandFactory, FromArgMatches};
    use luxel::{Downscale, LoadOptions};
    use luxel_app::files;
    use luxel_train::{Preset, TrainConfig};

    use super::*;
    use crate::args::{Cli, Command};

    /// Options of `train` that are not part of a configuration; tests of the program cover each.
    const BEHAVIOUR: [&str; 13] = [
        "dataset",
        "output",
        "config",
        "overwrite",
        "resume",
        "stop_at_end_of_input",
        "requeue_code",
        "distributed",
        "profile",
        "log_format",
        "quiet",
        "help",
        "version",
    ];

    /// The configuration and the explicit options of `luxel train data -o run` and `more`.
    fn parsed(more: &[String]) -> Result<(RunConfig, ExplicitArgs), clap::Error> {
        let args = ["luxel", "train", "data", "-o", "run"].into_iter().map(String::from).chain(more.iter().cloned());
        let matches = Cli::command().try_get_matches_from(args)?;
        let explicit = explicit_args(matches.subcommand().unwrap().1);
        let Command::Train(args) = Cli::from_arg_matches(&matches)?.command else { unreachable!("train was given") };
        Ok((from_args(&args, "data".into(), &explicit), explicit))
    }

    fn toml(config: &RunConfig) -> String {
        config.to_toml().unwrap()
    }

    /// Finds a value of the option that changes the configuration.
    fn effective(arg: &clap::Arg) -> Option<(Vec<String>, RunConfig, ExplicitArgs)> {
        let base = toml(&parsed(&[]).unwrap().0);
        let named: Vec<String> = arg.get_possible_values().iter().map(|value| value.get_name().to_owned()).collect();
        let numbers = ["4", "0.25", "2,3,4", "17", "gpu:some card", "0.1,0.2", "64MiB", "200", "8x256", "10min"].map(String::from);
        let long = format!("--{}", arg.get_long()?);
        let with_value = named.iter().chain(&numbers).map(|value| vec![format!("{long}={value}")]);
        std::iter::once(vec![long.clone()]).chain(with_value).find_map(|words| {
            let (config, explicit) = parsed(&words).ok()?;
            (toml(&config) != base).then_some((words, config, explicit))
        })
    }

    #[test]
    fn every_option_of_train_changes_the_configuration_or_the_behaviour() {
        let mut command = Cli::command();
        command.build();
        let train = command.find_subcommand("train").unwrap();
        let mut behaviour = BTreeSet::from(BEHAVIOUR);
        behaviour.extend(cfg!(feature = "view").then_some("view"));
        for arg in train.get_arguments() {
            let id = arg.get_id().as_str();
            let changes = effective(arg).is_some();
            assert!(changes || behaviour.contains(id), "--{id} is accepted and changes nothing");
            behaviour.remove(id);
        }
        assert!(behaviour.is_empty(), "not options of train: {behaviour:?}");
    }

    #[test]
    fn a_configuration_survives_its_file_and_takes_every_option_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        let mut command = Cli::command();
        command.build();
        let (base, _) = parsed(&[]).unwrap();
        for arg in command.find_subcommand("train").unwrap().get_arguments() {
            let Some((words, config, explicit)) = effective(arg) else { continue };
            config.write(&path).unwrap();
            assert_eq!(toml(&RunConfig::read(&path).unwrap()), toml(&config), "{words:?} in the file");
            assert_eq!(toml(&base.overlaid(&config, &explicit).unwrap()), toml(&config), "{words:?} over a file");
        }
    }

    #[test]
    fn defaults_do_not_override_a_file() {
        let (file, _) = parsed(&words("--seed 7 --eval-every 500 --method sh3")).unwrap();
        let (line, explicit) = parsed(&words("--method lcd")).unwrap();
        let merged = file.overlaid(&line, &explicit).unwrap();
        assert_eq!((merged.train.seed, merged.run.eval_every, merged.train.method), (7, Some(500), line.train.method));
        let (line, explicit) = parsed(&words("--eval-at 100,200")).unwrap();
        let merged = file.overlaid(&line, &explicit).unwrap();
        assert_eq!((merged.run.eval_every, merged.run.eval_at), (None, vec![100, 200]));
    }

    #[test]
    fn what_goes_with_another_choice_is_dropped_with_it() {
        let (file, _) = parsed(&words("--activation exp --chroma-degree 2 --luminance-lr-final 1e-3 --absgrad --max-splats 9")).unwrap();
        let (line, explicit) = parsed(&words("--method sh3 --strategy mcmc")).unwrap();
        let merged = file.overlaid(&line, &explicit).unwrap().train;
        merged.validate().unwrap();
        let kept = TrainConfig { absgrad: false, max_splats: Some(9), ..line.train };
        assert_eq!(merged, kept);
        // An explicit option beside it is refused, and so is a file that contradicts itself.
        let (line, explicit) = parsed(&words("--method sh3 --activation relu")).unwrap();
        assert!(file.overlaid(&line, &explicit).unwrap().train.validate().unwrap_err().to_string().starts_with("activation"));
        let odd = RunConfig { train: TrainConfig { method: luxel_train::Method::Sh3, ..file.train }, ..file };
        let (line, explicit) = parsed(&words("--seed 3")).unwrap();
        assert!(odd.overlaid(&line, &explicit).unwrap().train.validate().is_err());
    }

    fn words(text: &str) -> Vec<String> {
        text.split(' ').map(String::from).collect()
    }

    #[test]
    fn a_preset_stands_between_explicit_options_and_the_file() {
        let fast = TrainConfig::from_preset(Preset::Fast);
        let paper = TrainConfig::from_preset(Preset::Paper);
        // Explicit over preset over default.
        let (alone, _) = parsed(&words("--preset fast --max-splats 7")).unwrap();
        assert_eq!(alone.train, TrainConfig { max_splats: Some(7), ..fast.clone() });
        // The preset over a file; the file where neither speaks.
        let (file, _) = parsed(&words("--iterations 77 --max-splats 8 --seed 9")).unwrap();
        let (line, explicit) = parsed(&words("--iterations 66 --preset fast")).unwrap();
        assert_eq!(
            file.overlaid(&line, &explicit).unwrap().train,
            TrainConfig { iterations: 66, early_end: None, seed: 9, ..fast.clone() }
        );
        // One preset over another, down to what the new one leaves unset.
        let (line, explicit) = parsed(&words("--preset paper")).unwrap();
        assert_eq!(alone.overlaid(&line, &explicit).unwrap().train, paper);
        // What a preset leaves unset stays so, whatever the default is.
        let (unbounded, _) = parsed(&words("--preset paper")).unwrap();
        let (line, explicit) = parsed(&words("--seed 42")).unwrap();
        assert_eq!(unbounded.overlaid(&line, &explicit).unwrap().train, unbounded.train);
        // What the file's preset set is kept without one.
        let (line, explicit) = parsed(&words("--seed 5")).unwrap();
        assert_eq!(alone.overlaid(&line, &explicit).unwrap().train, TrainConfig { seed: 5, ..alone.train });
    }

    #[test]
    fn a_file_may_name_a_preset_and_leave_its_options_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        let (fast, _) = parsed(&words("--preset fast")).unwrap();
        let mut table = toml::Table::try_from(&fast).unwrap();
        let train = toml::toml! { preset = "fast"
        iterations = 50 };
        table.insert("train".into(), train.into());
        files::write_text(&path, &toml::to_string(&table).unwrap()).unwrap();
        assert_eq!(RunConfig::read(&path).unwrap().train, TrainConfig { iterations: 50, early_end: None, ..fast.train });
    }

    #[test]
    fn a_resumed_run_keeps_its_preset_and_the_options_beside_it() {
        let (stored, _) = parsed(&words("--preset fast --max-splats 7")).unwrap();
        let (line, explicit) = parsed(&words("--preset fast --iterations 50000")).unwrap();
        let longer = TrainConfig { iterations: 50_000, early_end: None, ..stored.train.clone() };
        assert_eq!(resumed(&stored, &line, &explicit).unwrap().train, longer);
        let (line, explicit) = parsed(&words("--preset paper")).unwrap();
        let error = resumed(&stored, &line, &explicit).unwrap_err().to_string();
        assert!(error.contains("--preset is \"fast\" in the run, \"paper\" now"), "{error}");
    }

    #[test]
    fn what_decides_the_result_is_compared_and_nothing_else() {
        let (stored, _) = parsed(&words("--seed 7 --max-splats 9")).unwrap();
        let (free, _) = parsed(&words("--seed 7 --max-splats 9 --threads 3 --checkpoint-every 10 --eval-at 5")).unwrap();
        assert_eq!(stored.differences(&free).unwrap(), Vec::new());
        let (other, _) = parsed(&words("--seed 8 --downscale 2 --init-scale 0.5")).unwrap();
        let other = RunConfig { dataset: "elsewhere".into(), ..other };
        assert_eq!(
            stored.differences(&other).unwrap().iter().map(difference_line).collect::<Vec<_>>(),
            [
                "the data set is data there, elsewhere now",
                "--downscale is \"auto\" there, 2 now",
                "--max-splats is 9 there, unset now",
                "--seed is 7 there, 8 now",
                "--init-scale is unset there, 0.5 now",
            ]
        );
    }

    #[test]
    fn a_resumed_run_takes_only_what_leaves_its_steps_alone() {
        let (stored, _) = parsed(&words("--seed 7")).unwrap();
        let (line, explicit) = parsed(&words("--iterations 50000 --threads 3 --checkpoint-every 10")).unwrap();
        let merged = resumed(&stored, &line, &explicit).unwrap();
        assert_eq!((merged.train.iterations, merged.device.threads, merged.run.checkpoint_every), (50000, Some(3), 10));
        assert_eq!(merged.train.seed, 7);
        // A number of steps that is given is made in full.
        assert!(stored.train.early_end.is_some() && merged.train.early_end.is_none());
        let (line, explicit) = parsed(&words("--iterations 50000 --early-end 40000")).unwrap();
        assert_eq!(line.train.early_end, Some(40000));
        assert_eq!(stored.overlaid(&line, &explicit).unwrap().train.early_end, Some(40000));
        let (line, explicit) = parsed(&words("--seed 8 --downscale 2 --threads 3 --max-splats 10")).unwrap();
        let error = resumed(&stored, &line, &explicit).unwrap_err().to_string();
        for part in
            ["--seed is 7 in the run, 8 now", "--downscale is \"auto\" in the run, 2 now", "--max-splats is unset in the run, 10 now"]
        {
            assert!(error.contains(part), "{part}: {error}");
        }
        assert!(!error.contains("--threads"), "{error}");
    }

    #[test]
    fn a_resumed_run_keeps_the_reduction_that_it_chose() {
        let (asked, _) = parsed(&words("--seed 7")).unwrap();
        let stored = RunConfig { load: LoadOptions { downscale: Downscale::By(3), ..asked.load.clone() }, ..asked };
        for text in ["--threads 3", "--downscale auto", "--downscale 3"] {
            let (line, explicit) = parsed(&words(text)).unwrap();
            assert_eq!(resumed(&stored, &line, &explicit).unwrap().load.downscale, Downscale::By(3), "{text}");
        }
        let (line, explicit) = parsed(&words("--downscale 1")).unwrap();
        let error = resumed(&stored, &line, &explicit).unwrap_err().to_string();
        assert!(error.contains("--downscale is 3 in the run, 1 now"), "{error}");
        // A new run of its configuration may choose anew.
        let (line, explicit) = parsed(&words("--downscale auto")).unwrap();
        assert_eq!(stored.overlaid(&line, &explicit).unwrap().load.downscale, Downscale::Auto);
    }

    #[test]
    fn a_file_holds_a_number_or_auto_and_nothing_else() {
        let (asked, _) = parsed(&[]).unwrap();
        let text = toml(&asked);
        assert!(text.contains("downscale = \"auto\""), "{text}");
        // Files of earlier programs hold 1, 2, 4 or 8.
        for (value, expected) in [("1", Downscale::FULL_SIZE), ("8", Downscale::By(8)), ("\"auto\"", Downscale::Auto)] {
            let file = text.replace("downscale = \"auto\"", &format!("downscale = {value}"));
            assert_eq!(RunConfig::parse(&file).unwrap().load.downscale, expected);
        }
        for bad in ["0", "17", "\"large\"", "1.5"] {
            let file = text.replace("downscale = \"auto\"", &format!("downscale = {bad}"));
            let error = RunConfig::parse(&file).unwrap_err().to_string();
            assert!(error.contains("expected auto or a whole number from 1 to 16"), "{bad}: {error}");
        }
    }

    /// Every option that belongs to a choice, with a value, and what makes the choice.
    const CASES: [(&str, &str, &str); 21] = [
        ("--luminance-lr 0.1", "--method sh3", "--method lcd"),
        ("--tone-width 64", "--method sh3", "--method hdr-gs"),
        ("--lift-lr 1e-3", "--method hdr-gs", "--method mono-hdr-gs"),
        ("--cycle-weight 0.1", "--method lcd", "--method mono-hdr-gs"),
        ("--feature-lr 1e-3", "--method hdr-gs", "--method gausshdr"),
        ("--turnover 0.2", "--strategy mcmc", "--strategy adc"),
        ("--early-end 300", "--strategy mcmc", "--strategy adc"),
        ("--densify-threshold 1e-3", "--strategy mcmc", "--strategy adc"),
        ("--percent-dense 0.1", "--strategy mcmc", "--strategy adc"),
        ("--prune-scale 0.2", "--strategy mcmc", "--strategy adc"),
        ("--prune-unseen 0.1", "--strategy mcmc", "--strategy adc"),
        ("--opacity-reset-interval 100", "--strategy mcmc", "--strategy adc"),
        ("--mcmc-growth 0.1", "--strategy adc", "--strategy mcmc"),
        ("--mcmc-noise 5e4", "--seed 1", "--strategy mcmc"),
        ("--mcmc-opacity-weight 0.1", "--seed 1", "--strategy mcmc"),
        ("--mcmc-scale-weight 0.1", "--seed 1", "--strategy mcmc"),
        ("--absgrad-threshold 1e-3", "--seed 1", "--absgrad"),
        ("--samples-share 0.5", "--samples 1", "--samples 2"),
        ("--noise-model off", "--supervision ldr", "--supervision hdr"),
        ("--unit-exposure 0.7", "--seed 1", "--supervision ldr"),
        ("--exposures single", "--supervision hdr", "--supervision ldr"),
    ];

    #[test]
    fn what_belongs_to_another_choice_is_refused_where_it_is_explicit() {
        for (option, other, choice) in CASES {
            let check = |text: &str| {
                let (config, explicit) = parsed(&words(text)).unwrap();
                reject_inapplicable(&config, &explicit)
            };
            let error = check(&format!("{option} {other}")).unwrap_err().to_string();
            let name = option.split(' ').next().unwrap();
            let choice_name = if choice == "--samples 2" { "--samples above 1" } else { choice };
            assert!(error.starts_with(&format!("{name}: has an effect with {choice_name} only")), "{error}");
            check(&format!("{option} {choice}")).unwrap();
        }
    }

    #[test]
    fn what_a_file_holds_is_not_explicit() {
        let (file, _) = parsed(&words("--strategy mcmc --mcmc-noise 5e4 --luminance-lr 0.1")).unwrap();
        let (line, explicit) = parsed(&words("--strategy adc --method sh3")).unwrap();
        reject_inapplicable(&file.overlaid(&line, &explicit).unwrap(), &explicit).unwrap();
    }

    #[test]
    fn the_options_are_options_of_train() {
        let command = Cli::command();
        let train = command.find_subcommand("train").unwrap();
        let (config, _) = parsed(&[]).unwrap();
        for option in config.dependent_options() {
            for id in [option.option, option.choice.option] {
                assert!(train.get_arguments().any(|arg| arg.get_id() == id), "{id}");
            }
        }
    }
}
