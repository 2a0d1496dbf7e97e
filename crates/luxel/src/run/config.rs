//! What a run is made with, resolved: `config.toml` of the run folder, and how it follows from the command line.
//!
//! Options said on the command line are told apart from defaults: a run made `--config FILE` takes the file's values where
//! nothing was said, and a resumed run keeps its own and refuses what contradicts them. Options take their value from the first of: what was
//! said; the preset, if one was said; the file; the file's preset; the default.

mod said;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ArgMatches;
use clap::parser::ValueSource;
use luxel_train::{Preset, TrainConfig};
use serde::{Deserialize, Serialize};

use crate::cli::{DeviceArgs, LoadArgs, RunArgs, TrainArgs};
use crate::files;

/// First line of config.toml.
const HEAD: &str = "# A Luxel training run. This file marks the folder as one; --resume and --config read it.\n";

/// A config.toml is a few kilobytes.
const LIMIT_BYTES: u64 = 1 << 20;

/// Who made a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum MadeBy {
    /// `luxel train`.
    Train,
    /// `luxel demo`: its folder may be replaced by the next demo.
    Demo,
}

/// Everything that was decided for a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunConfig {
    /// Version of the program that wrote it.
    pub(crate) luxel_version: String,
    /// Which command.
    pub(crate) made_by: MadeBy,
    /// Folder of the data set; relative to the run folder if not absolute.
    pub(crate) dataset: PathBuf,
    /// How the data set is read.
    pub(crate) load: LoadArgs,
    /// Where the work is done.
    pub(crate) device: DeviceArgs,
    /// What is saved and evaluated.
    pub(crate) run: RunArgs,
    /// The method.
    pub(crate) train: TrainConfig,
}

/// Options that a resumed run may change: they leave the steps already made as they are.
const FREE_ON_RESUME: [&str; 7] = ["device", "threads", "checkpoint_every", "keep_checkpoints", "eval_at", "eval_every", "iterations"];

/// Sections of the file that options belong to.
const SECTIONS: [&str; 4] = ["load", "device", "run", TRAIN];

/// The section of the method's options.
const TRAIN: &str = "train";

/// Sections that decide the result.
const RESULT_SECTIONS: [&str; 2] = ["load", TRAIN];

/// The option that stands for [`Preset::OPTIONS`].
const PRESET: &str = "preset";

impl RunConfig {
    /// The configuration of a new run as the command line alone says it: what was `said` (by its ids), over the preset, over the defaults.
    pub(crate) fn from_args(args: &TrainArgs, dataset: PathBuf, said: &[String]) -> Self {
        Self {
            luxel_version: env!("CARGO_PKG_VERSION").into(),
            made_by: MadeBy::Train,
            dataset,
            load: args.load.clone(),
            device: args.device.clone(),
            run: args.run.clone(),
            train: args.train.clone().with_preset(|id| said.iter().any(|said| said == id)),
        }
    }

    /// Reads a config.toml. Options of the method that it leaves out have the value of its preset.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let content = files::read_text(path, LIMIT_BYTES)?;
        let parsed = toml::from_str::<Self>(&content).and_then(|config| Ok((config, toml::from_str::<toml::Table>(&content)?)));
        let (config, table) = parsed.with_context(|| format!("{}: not a configuration of this version of luxel", path.display()))?;
        Ok(Self { train: config.train.with_preset(|id| value(&table, TRAIN, id).is_some()), ..config })
    }

    /// Writes it atomically.
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let content = self.to_toml().with_context(|| format!("{}: cannot encode", path.display()))?;
        Ok(files::write_text(path, &(HEAD.to_owned() + &content))?)
    }

    /// As TOML.
    pub(crate) fn to_toml(&self) -> Result<String> {
        Ok(toml::to_string_pretty(self)?)
    }

    /// `self` with the options that were `said` (by their ids), and those of a preset that was, replaced by those of `command_line`.
    pub(crate) fn overlaid(&self, command_line: &Self, said: &[String]) -> Result<Self> {
        let mut base = toml::Table::try_from(self)?;
        let other = toml::Table::try_from(command_line)?;
        let of_preset: &[&str] = if said.iter().any(|id| id == PRESET) { Preset::OPTIONS } else { &[] };
        for (section, id) in of_preset.iter().map(|id| (TRAIN, *id)).chain(options(&other, said)) {
            let value = value(&other, section, id).cloned();
            if let Some(section) = base.get_mut(section).and_then(toml::Value::as_table_mut) {
                // An alternative to an option takes its place: --eval-at after --eval-every.
                if id == "eval_at" {
                    section.remove("eval_every");
                }
                match value {
                    Some(value) => section.insert(id.into(), value),
                    None => section.remove(id),
                };
            }
        }
        let merged = Self::of_table(&base)?;
        // What the file says of a choice that is now another one falls with it, unless it was said again.
        let is_chosen = |id: &str| said.iter().any(|said| said == id) || of_preset.contains(&id);
        let fallen: Vec<String> =
            merged.train.misplaced().into_iter().filter(|(_, choice)| is_chosen(choice)).map(|(id, _)| id.replace('-', "_")).collect();
        if let Some(train) = base.get_mut(TRAIN).and_then(toml::Value::as_table_mut) {
            train.retain(|id, _| said.iter().any(|said| said == id) || !fallen.iter().any(|fallen| fallen == id));
        }
        if fallen.is_empty() { Ok(merged) } else { Self::of_table(&base) }
    }

    /// What a preset leaves unset has no line in the table, and is not to have its default.
    fn of_table(table: &toml::Table) -> Result<Self> {
        let config: Self = table.clone().try_into()?;
        Ok(Self { train: config.train.with_preset(|id| value(table, TRAIN, id).is_some()), ..config })
    }

    /// `self`, the configuration of an interrupted run, with what the command line may change. Everything else that was `said` must
    /// be as it was.
    pub(crate) fn resumed(&self, command_line: &Self, said: &[String]) -> Result<Self> {
        let (base, other) = (toml::Table::try_from(self)?, toml::Table::try_from(command_line)?);
        let mut contradictions = Vec::new();
        for (section, id) in options(&other, said) {
            let (stored, now) = (value(&base, section, id), value(&other, section, id));
            if stored != now && !FREE_ON_RESUME.contains(&id) {
                contradictions.push(format!("--{} is {} in the run, {} now", id.replace('_', "-"), shown(stored), shown(now)));
            }
        }
        if !contradictions.is_empty() {
            bail!(
                "a resumed run keeps its settings: {}; leave these options out, or start anew with --overwrite or another output folder",
                contradictions.join("; ")
            );
        }
        // A preset that was said is the run's own, whose values may since have been changed one by one: they stay.
        let said: Vec<String> = said.iter().filter(|id| *id != PRESET).cloned().collect();
        self.overlaid(command_line, &said)
    }

    /// How `wanted` differs in the data set, how it is read, or the method: what decides a run's result.
    pub(crate) fn differences(&self, wanted: &Self) -> Result<Vec<String>> {
        let (stored, wanted_table) = (toml::Table::try_from(self)?, toml::Table::try_from(wanted)?);
        let mut differences = Vec::new();
        if self.dataset != wanted.dataset {
            differences.push(format!("the data set is {} there, {} now", self.dataset.display(), wanted.dataset.display()));
        }
        for section in RESULT_SECTIONS {
            let ids = |table: &toml::Table| {
                table.get(section).and_then(toml::Value::as_table).map(|t| t.keys().cloned().collect()).unwrap_or_default()
            };
            let (mut all, more): (Vec<String>, Vec<String>) = (ids(&stored), ids(&wanted_table));
            all.extend(more.into_iter().filter(|id| value(&stored, section, id).is_none()));
            for id in all {
                let (there, now) = (value(&stored, section, &id), value(&wanted_table, section, &id));
                if there != now {
                    differences.push(format!("--{} is {} there, {} now", id.replace('_', "-"), shown(there), shown(now)));
                }
            }
        }
        Ok(differences)
    }

    /// Radiance behind everything in normalised units.
    pub(crate) fn background(&self, radiance_scale: f32) -> [f32; 3] {
        self.train.background.map(|v| v / radiance_scale)
    }

    /// Where the data set is, for a run in `folder`.
    pub(crate) fn dataset_path(&self, folder: &Path) -> PathBuf {
        folder.join(&self.dataset)
    }
}

/// Ids of the options that were said on the command line.
pub(crate) fn said_options(matches: &ArgMatches) -> Vec<String> {
    let said = |id: &&clap::Id| matches.value_source(id.as_str()) == Some(ValueSource::CommandLine);
    matches.ids().filter(said).map(|id| id.as_str().to_owned()).collect()
}

/// The said options that are part of a configuration, with their sections.
fn options<'a>(table: &toml::Table, said: &'a [String]) -> Vec<(&'static str, &'a str)> {
    let section_of = |id: &str| SECTIONS.into_iter().find(|section| value(table, section, id).is_some());
    said.iter().filter_map(|id| Some((section_of(id)?, id.as_str()))).collect()
}

/// A value for people.
fn shown(value: Option<&toml::Value>) -> String {
    value.map_or("unset".into(), ToString::to_string)
}

fn value<'a>(table: &'a toml::Table, section: &str, id: &str) -> Option<&'a toml::Value> {
    table.get(section)?.as_table()?.get(id)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::{CommandFactory, FromArgMatches};

    use super::*;
    use crate::cli::{Cli, Command};

    /// Options of `train` that are not part of a configuration; tests of the program show what each does.
    const BEHAVIOUR: [&str; 11] =
        ["dataset", "output", "config", "overwrite", "resume", "stop_at_end_of_input", "profile", "log_format", "quiet", "help", "version"];

    /// The configuration and the said options of `luxel train data -o run` and `more`.
    pub(super) fn parsed(more: &[String]) -> Result<(RunConfig, Vec<String>), clap::Error> {
        let args = ["luxel", "train", "data", "-o", "run"].into_iter().map(String::from).chain(more.iter().cloned());
        let matches = Cli::command().try_get_matches_from(args)?;
        let said = said_options(matches.subcommand().unwrap().1);
        let Command::Train(args) = Cli::from_arg_matches(&matches)?.command else { unreachable!("train was said") };
        Ok((RunConfig::from_args(&args, "data".into(), &said), said))
    }

    fn toml(config: &RunConfig) -> String {
        config.to_toml().unwrap()
    }

    /// A way to say the option that changes the configuration.
    fn saying(arg: &clap::Arg) -> Option<(Vec<String>, RunConfig, Vec<String>)> {
        let base = toml(&parsed(&[]).unwrap().0);
        let named: Vec<String> = arg.get_possible_values().iter().map(|value| value.get_name().to_owned()).collect();
        let numbers = ["4", "0.25", "2,3,4", "17", "gpu:some card", "0.1,0.2"].map(String::from);
        let long = format!("--{}", arg.get_long()?);
        let with_value = named.iter().chain(&numbers).map(|value| vec![format!("{long}={value}")]);
        std::iter::once(vec![long.clone()]).chain(with_value).find_map(|words| {
            let (config, said) = parsed(&words).ok()?;
            (toml(&config) != base).then_some((words, config, said))
        })
    }

    #[test]
    fn every_option_of_train_changes_the_configuration_or_the_behaviour() {
        let mut command = Cli::command();
        command.build();
        let train = command.find_subcommand("train").unwrap();
        let mut behaviour = BTreeSet::from(BEHAVIOUR);
        for arg in train.get_arguments() {
            let id = arg.get_id().as_str();
            let changes = saying(arg).is_some();
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
            let Some((words, config, said)) = saying(arg) else { continue };
            config.write(&path).unwrap();
            assert_eq!(toml(&RunConfig::read(&path).unwrap()), toml(&config), "{words:?} in the file");
            assert_eq!(toml(&base.overlaid(&config, &said).unwrap()), toml(&config), "{words:?} over a file");
        }
    }

    #[test]
    fn defaults_do_not_override_a_file() {
        let (file, _) = parsed(&words("--seed 7 --eval-every 500 --method sh3")).unwrap();
        let (line, said) = parsed(&words("--method lcd")).unwrap();
        let merged = file.overlaid(&line, &said).unwrap();
        assert_eq!((merged.train.seed, merged.run.eval_every, merged.train.method), (7, Some(500), line.train.method));
        let (line, said) = parsed(&words("--eval-at 100,200")).unwrap();
        let merged = file.overlaid(&line, &said).unwrap();
        assert_eq!((merged.run.eval_every, merged.run.eval_at), (None, vec![100, 200]));
    }

    #[test]
    fn what_goes_with_another_choice_falls_with_it() {
        let (file, _) = parsed(&words("--activation exp --chroma-degree 2 --luminance-lr-final 1e-3 --absgrad --max-splats 9")).unwrap();
        let (line, said) = parsed(&words("--method sh3 --strategy mcmc")).unwrap();
        let merged = file.overlaid(&line, &said).unwrap().train;
        merged.validate().unwrap();
        let kept = TrainConfig { absgrad: false, max_splats: Some(9), ..line.train };
        assert_eq!(merged, kept);
        // What is said beside it is refused, and so is a file that contradicts itself.
        let (line, said) = parsed(&words("--method sh3 --activation relu")).unwrap();
        assert!(file.overlaid(&line, &said).unwrap().train.validate().unwrap_err().to_string().starts_with("--activation"));
        let odd = RunConfig { train: TrainConfig { method: luxel_train::Method::Sh3, ..file.train }, ..file };
        let (line, said) = parsed(&words("--seed 3")).unwrap();
        assert!(odd.overlaid(&line, &said).unwrap().train.validate().is_err());
    }

    pub(super) fn words(text: &str) -> Vec<String> {
        text.split(' ').map(String::from).collect()
    }

    #[test]
    fn a_preset_stands_between_what_is_said_and_the_file() {
        let fast = TrainConfig::of_preset(Preset::Fast);
        let paper = TrainConfig::of_preset(Preset::Paper);
        // Said over preset over default.
        let (alone, _) = parsed(&words("--preset fast --max-splats 7")).unwrap();
        assert_eq!(alone.train, TrainConfig { max_splats: Some(7), ..fast.clone() });
        // The preset over a file; the file where neither speaks.
        let (file, _) = parsed(&words("--iterations 77 --max-splats 8 --seed 9")).unwrap();
        let (line, said) = parsed(&words("--iterations 66 --preset fast")).unwrap();
        assert_eq!(file.overlaid(&line, &said).unwrap().train, TrainConfig { iterations: 66, seed: 9, ..fast.clone() });
        // One preset over another, down to what the new one leaves unset.
        let (line, said) = parsed(&words("--preset paper")).unwrap();
        assert_eq!(alone.overlaid(&line, &said).unwrap().train, paper);
        // What a preset leaves unset stays so, whatever the default is.
        let (unbounded, _) = parsed(&words("--preset paper")).unwrap();
        let (line, said) = parsed(&words("--seed 42")).unwrap();
        assert_eq!(unbounded.overlaid(&line, &said).unwrap().train, unbounded.train);
        // What the file's preset set is kept without one.
        let (line, said) = parsed(&words("--seed 5")).unwrap();
        assert_eq!(alone.overlaid(&line, &said).unwrap().train, TrainConfig { seed: 5, ..alone.train });
    }

    #[test]
    fn a_file_may_name_a_preset_and_leave_its_options_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        let (fast, _) = parsed(&words("--preset fast")).unwrap();
        let mut table = toml::Table::try_from(&fast).unwrap();
        let train = toml::toml! { preset = "fast"
        iterations = 50 };
        table.insert(TRAIN.into(), train.into());
        files::write_text(&path, &toml::to_string(&table).unwrap()).unwrap();
        assert_eq!(RunConfig::read(&path).unwrap().train, TrainConfig { iterations: 50, ..fast.train });
    }

    #[test]
    fn a_resumed_run_keeps_its_preset_and_the_options_beside_it() {
        let (stored, _) = parsed(&words("--preset fast --max-splats 7")).unwrap();
        let (line, said) = parsed(&words("--preset fast --iterations 50000")).unwrap();
        assert_eq!(stored.resumed(&line, &said).unwrap().train, TrainConfig { iterations: 50_000, ..stored.train.clone() });
        let (line, said) = parsed(&words("--preset paper")).unwrap();
        let error = stored.resumed(&line, &said).unwrap_err().to_string();
        assert!(error.contains("--preset is \"fast\" in the run, \"paper\" now"), "{error}");
    }

    #[test]
    fn what_decides_the_result_is_compared_and_nothing_else() {
        let (stored, _) = parsed(&words("--seed 7 --max-splats 9")).unwrap();
        let (free, _) = parsed(&words("--seed 7 --max-splats 9 --threads 3 --checkpoint-every 10 --eval-at 5")).unwrap();
        assert_eq!(stored.differences(&free).unwrap(), Vec::<String>::new());
        let (other, _) = parsed(&words("--seed 8 --downscale 2 --init-scale 0.5")).unwrap();
        let other = RunConfig { dataset: "elsewhere".into(), ..other };
        assert_eq!(
            stored.differences(&other).unwrap(),
            [
                "the data set is data there, elsewhere now",
                "--downscale is 1 there, 2 now",
                "--max-splats is 9 there, unset now",
                "--seed is 7 there, 8 now",
                "--init-scale is unset there, 0.5 now",
            ]
        );
    }

    #[test]
    fn a_resumed_run_takes_only_what_leaves_its_steps_alone() {
        let (stored, _) = parsed(&words("--seed 7")).unwrap();
        let (line, said) = parsed(&words("--iterations 50000 --threads 3 --checkpoint-every 10")).unwrap();
        let resumed = stored.resumed(&line, &said).unwrap();
        assert_eq!((resumed.train.iterations, resumed.device.threads, resumed.run.checkpoint_every), (50000, Some(3), 10));
        assert_eq!(resumed.train.seed, 7);
        let (line, said) = parsed(&words("--seed 8 --downscale 2 --threads 3 --max-splats 10")).unwrap();
        let error = stored.resumed(&line, &said).unwrap_err().to_string();
        for part in ["--seed is 7 in the run, 8 now", "--downscale is 1 in the run, 2 now", "--max-splats is unset in the run, 10 now"] {
            assert!(error.contains(part), "{part}: {error}");
        }
        assert!(!error.contains("--threads"), "{error}");
    }
}
