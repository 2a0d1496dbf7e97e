//! The settings of a run (`config.toml`), and how new settings combine with stored ones.
//!
//! In: settings, and the names of those that were given explicitly. Out: a [`RunConfig`]. An option
//! has the first of: the explicit value; that of an explicit preset; the file's; that of the file's
//! preset; the default. A resumed run keeps what decides the steps already made.

use std::fmt;
use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::export::DEFAULT_REFINE_STEPS;
use luxel::step_methods::check_is_built;
use luxel::{DeviceOptions, Error, Remedy, Result};
use luxel_core::RadianceScale;
use luxel_io::{Downscale, ImageMemory, LoadOptions};
use luxel_train::{FieldNetworkChoice, NamedChoice, OptionSpec, Preset, TrainConfig};
use serde::{Deserialize, Serialize};

use super::{ExplicitArgs, PlotLog, TimeLimit};
use crate::files;

/// First line of config.toml.
const HEAD: &str = "# A Luxel training run. This file marks the folder as one; --resume and --config read it.\n";

/// A config.toml is a few kilobytes.
const LIMIT_BYTES: u64 = 1 << 20;

/// The command that made a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MadeBy {
    /// Training on data of the user's.
    Train,
    /// The demo: the next one may replace the folder.
    Demo,
}

/// Options of saving and evaluating during a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunOptions {
    /// Steps between two checkpoints; 0 for one at the end only.
    pub checkpoint_every: u32,
    /// Newest checkpoints to keep, at least 1.
    pub keep_checkpoints: u32,
    /// Steps after which the test views are evaluated and the scene is written; the last step
    /// always is.
    pub eval_at: Vec<u32>,
    /// Steps between two evaluations, in place of [`Self::eval_at`].
    pub eval_every: Option<u32>,
    /// Steps of refining the display layer of the last scene file; 0 leaves it out.
    #[serde(default = "default_refine_display")]
    pub refine_display: u32,
    /// Limit on the memory that images take.
    #[serde(default)]
    pub image_memory: ImageMemory,
    /// Time that the training may take, in place of a number of steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<TimeLimit>,
    /// Scene, or folder of a run, whose splats the run starts from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<PathBuf>,
    /// Forms of the log for plots, beside `log.jsonl`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub log: Vec<PlotLog>,
}

fn default_refine_display() -> u32 {
    DEFAULT_REFINE_STEPS
}

impl Default for RunOptions {
    fn default() -> Self {
        let refine_display = default_refine_display();
        Self {
            checkpoint_every: 5000,
            keep_checkpoints: 2,
            eval_at: vec![7000, 30000],
            eval_every: None,
            refine_display,
            image_memory: ImageMemory::Auto,
            time: None,
            from: None,
            log: Vec::new(),
        }
    }
}

/// Everything that was decided for a run.
///
/// ```
/// use luxel::TrainConfig;
/// use luxel_app::run::{ExplicitArgs, RunConfig};
///
/// # fn main() -> luxel::Result<()> {
/// let stored = RunConfig::new("my-images", TrainConfig { seed: 7, ..TrainConfig::default() });
/// let longer = TrainConfig { iterations: 500, ..TrainConfig::default() };
/// let given = RunConfig::new("my-images", longer);
/// let explicit: ExplicitArgs = ["iterations"].into_iter().collect();
/// let resumed = stored.resumed(&given, &explicit)?;
/// assert_eq!((resumed.train.iterations, resumed.train.seed), (500, 7));
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// Version of Luxel that wrote it.
    pub luxel_version: String,
    /// The command that made the run.
    pub made_by: MadeBy,
    /// Folder of the data set; relative to the run folder if not absolute.
    pub dataset: PathBuf,
    /// Options of reading the data set.
    pub load: LoadOptions,
    /// The device.
    pub device: DeviceOptions,
    /// Options of saving and evaluating.
    pub run: RunOptions,
    /// The method.
    pub train: TrainConfig,
}

/// An option that differs between two configurations, with the values as TOML; `None` where it is
/// unset.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Name of the option, such as `max_splats`; `dataset` for the data set.
    pub option: String,
    /// Value in the stored configuration.
    pub stored: Option<String>,
    /// Value now.
    pub now: Option<String>,
}

impl Difference {
    /// Returns the stored value for people.
    pub fn stored_text(&self) -> &str {
        self.stored.as_deref().unwrap_or("unset")
    }

    /// Returns the value now for people.
    pub fn now_text(&self) -> &str {
        self.now.as_deref().unwrap_or("unset")
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is {} in the run, {} now", self.option, self.stored_text(), self.now_text())
    }
}

/// Options that a resumed run may change: they leave the steps already made as they are.
const FREE_ON_RESUME: [&str; 11] = [
    "device",
    "threads",
    "checkpoint_every",
    "keep_checkpoints",
    "eval_at",
    "eval_every",
    "refine_display",
    "image_memory",
    "log",
    "iterations",
    "time",
];

/// Sections of the file that options belong to.
const SECTIONS: [&str; 4] = ["load", "device", "run", TRAIN];

/// The section of the method's options.
const TRAIN: &str = "train";

/// Sections that decide the result.
const RESULT_SECTIONS: [&str; 2] = ["load", TRAIN];

/// The option that stands for [`Preset::OPTIONS`].
const PRESET: &str = "preset";

/// The option of the images' reduction.
const DOWNSCALE: &str = "downscale";

impl RunConfig {
    /// Returns the configuration of a run of `train` on `dataset`, with defaults for everything
    /// else.
    pub fn new(dataset: impl Into<PathBuf>, train: TrainConfig) -> Self {
        Self {
            luxel_version: luxel::VERSION.into(),
            made_by: MadeBy::Train,
            dataset: dataset.into(),
            load: LoadOptions::default(),
            device: DeviceOptions::default(),
            run: RunOptions::default(),
            train,
        }
    }

    /// Checks the ranges of options, which a config.toml may leave.
    ///
    /// # Errors
    /// The first option that is out of range, and the range.
    pub fn validate(&self) -> Result<()> {
        check_is_built(self.train.method)?;
        self.train.validate()?;
        self.check_supervision()?;
        for (option, number) in [("keep_checkpoints", Some(self.run.keep_checkpoints)), ("eval_every", self.run.eval_every)] {
            if number == Some(0) {
                return Err(Error::new(format!("{option}: found 0, expected at least 1")).with_remedy(Remedy::set(option, "1")));
            }
        }
        Ok(())
    }

    /// Reads a config.toml. Options of the method that it leaves out have the value of its preset.
    ///
    /// # Errors
    /// A file that cannot be read, or is not a configuration of this version.
    pub fn read(path: &Path) -> Result<Self> {
        let content = files::read_text(path, LIMIT_BYTES)?;
        Self::parse(&content).with_context(|| format!("{}: not a configuration of this version of luxel", path.display()))
    }

    /// Parses what [`Self::to_toml`] returns. Options of the method that it leaves out have the
    /// value of its preset.
    ///
    /// # Errors
    /// Text that is not a configuration of this version.
    pub fn parse(content: &str) -> Result<Self> {
        let config: Self = toml::from_str(content).map_err(Error::wrap)?;
        let table: toml::Table = toml::from_str(content).map_err(Error::wrap)?;
        let old_name = |id: &str| OptionSpec::find(id).and_then(|option| option.old_name);
        let is_given = |id: &str| [Some(id), old_name(id)].into_iter().flatten().any(|name| value(&table, TRAIN, name).is_some());
        Ok(Self { train: config.train.with_preset(is_given), ..config })
    }

    /// Writes a config.toml, whole or not at all.
    ///
    /// # Errors
    /// Values that TOML cannot hold; the file system's refusal.
    pub fn write(&self, path: &Path) -> Result<()> {
        let content = self.to_toml().with_context(|| format!("{}: cannot encode", path.display()))?;
        files::write_text(path, &(HEAD.to_owned() + &content))
    }

    /// Returns the configuration as TOML.
    ///
    /// # Errors
    /// Values that TOML cannot hold, such as text that is not Unicode.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(Error::wrap)
    }

    fn to_table(&self) -> Result<toml::Table> {
        toml::Table::try_from(self).map_err(Error::wrap)
    }

    /// Returns this configuration with the explicit options, and those of an explicit preset,
    /// replaced by those of `given`.
    ///
    /// # Errors
    /// Values that TOML cannot hold.
    pub fn overlaid(&self, given: &Self, explicit: &ExplicitArgs) -> Result<Self> {
        let (mut base, other) = (self.to_table()?, given.to_table()?);
        let of_preset: &[&str] = if explicit.contains(PRESET) { Preset::OPTIONS } else { &[] };
        // Given steps come with an early end, or with none.
        let early_end = explicit.contains("iterations").then_some((TRAIN, "early_end"));
        for (section, id) in of_preset.iter().map(|id| (TRAIN, *id)).chain(options(&other, explicit)).chain(early_end) {
            let value = value(&other, section, id).cloned();
            if let Some(section) = base.get_mut(section).and_then(toml::Value::as_table_mut) {
                // An alternative to an option takes its place: eval_at after eval_every.
                if id == "eval_at" {
                    section.remove("eval_every");
                }
                match value {
                    Some(value) => section.insert(id.into(), value),
                    None => section.remove(id),
                };
            }
        }
        let merged = Self::from_table(&base)?;
        // A stored value that depends on a choice is dropped where that choice changes, unless it
        // was given again.
        let is_chosen = |id: &str| explicit.contains(id) || of_preset.contains(&id);
        let dropped: Vec<&str> =
            merged.train.misplaced().into_iter().filter(|m| is_chosen(m.condition.option())).map(|m| m.option.name).collect();
        if let Some(train) = base.get_mut(TRAIN).and_then(toml::Value::as_table_mut) {
            train.retain(|id, _| explicit.contains(id) || !dropped.contains(&id));
        }
        if dropped.is_empty() { Ok(merged) } else { Self::from_table(&base) }
    }

    /// Reads a table. An option that a preset leaves unset has no line in it, and must not get its
    /// default.
    fn from_table(table: &toml::Table) -> Result<Self> {
        let config: Self = table.clone().try_into().map_err(Error::wrap)?;
        Ok(Self { train: config.train.with_preset(|id| value(table, TRAIN, id).is_some()), ..config })
    }

    /// Returns this configuration, of an interrupted run, with the explicit options that a resumed
    /// run may change.
    ///
    /// # Errors
    /// Explicit options that a resumed run may not change; [`Self::contradictions`] lists them.
    pub fn resumed(&self, given: &Self, explicit: &ExplicitArgs) -> Result<Self> {
        let contradictions = self.contradictions(given, explicit)?;
        if !contradictions.is_empty() {
            let list: Vec<String> = contradictions.iter().map(ToString::to_string).collect();
            bail!("a resumed run keeps its settings: {}", list.join("; "));
        }
        // An explicit preset is the run's own, whose values may since have been changed one by one:
        // they stay. So does the reduction that the run chose.
        self.overlaid(given, &explicit.without(PRESET).without(DOWNSCALE))
    }

    /// Returns the explicit options that differ from this configuration, of an interrupted run, and
    /// decide its result.
    ///
    /// # Errors
    /// Values that TOML cannot hold.
    pub fn contradictions(&self, given: &Self, explicit: &ExplicitArgs) -> Result<Vec<Difference>> {
        let (base, other) = (self.to_table()?, given.to_table()?);
        // To leave the reduction to the run is to keep what it chose.
        let is_open = |id: &str| id == DOWNSCALE && given.load.downscale == Downscale::Auto;
        let fixed = options(&other, explicit).into_iter().filter(|(_, id)| !FREE_ON_RESUME.contains(id) && !is_open(id));
        Ok(fixed.filter_map(|(section, id)| difference(&base, &other, section, id)).collect())
    }

    /// Returns how `wanted` differs in the data set, how it is read, or the method: in what decides
    /// a run's result.
    ///
    /// # Errors
    /// Values that TOML cannot hold.
    pub fn differences(&self, wanted: &Self) -> Result<Vec<Difference>> {
        let (stored, now) = (self.to_table()?, wanted.to_table()?);
        let mut differences = Vec::new();
        if self.dataset != wanted.dataset {
            let text = |path: &Path| Some(path.display().to_string());
            differences.push(Difference { option: "dataset".into(), stored: text(&self.dataset), now: text(&wanted.dataset) });
        }
        for section in RESULT_SECTIONS {
            let ids = |table: &toml::Table| {
                table.get(section).and_then(toml::Value::as_table).map(|t| t.keys().cloned().collect()).unwrap_or_default()
            };
            let (mut all, more): (Vec<String>, Vec<String>) = (ids(&stored), ids(&now));
            all.extend(more.into_iter().filter(|id| value(&stored, section, id).is_none()));
            differences.extend(all.iter().filter_map(|id| difference(&stored, &now, section, id)));
        }
        Ok(differences)
    }

    /// Returns the radiance behind everything, in normalised units.
    pub fn background(&self, radiance_scale: RadianceScale) -> [f32; 3] {
        radiance_scale.normalised(self.train.background)
    }

    /// Returns where the data set is, for a run in `folder`.
    pub fn dataset_path(&self, folder: &Path) -> PathBuf {
        folder.join(&self.dataset)
    }

    /// Returns where the data set is, for a run in `folder`.
    ///
    /// # Errors
    /// A data set that is no longer there; `remedy` says how its new place is given.
    pub fn find_dataset(&self, folder: &Path, remedy: Remedy) -> Result<PathBuf> {
        let path = self.dataset_path(folder);
        if path.exists() {
            return Ok(path);
        }
        let message = format!("{}: the data set of the run {} is not there; it was moved or removed", path.display(), folder.display());
        Err(Error::new(message).with_remedy(remedy))
    }

    /// Returns the name of the method: `lcd`, `sh3`, `nerf-grid`. That of a field without a hash
    /// grid has the network in its place: `nerf-8x256`.
    pub fn method_name(&self) -> String {
        let name = self.train.method.name();
        match self.train.field_network {
            Some(network @ FieldNetworkChoice::Layers { .. }) => name.replace("-grid", &format!("-{network}")),
            _ => name.to_owned(),
        }
    }
}

/// Returns the explicit options that are part of a configuration, with their sections.
fn options<'a>(table: &toml::Table, explicit: &'a ExplicitArgs) -> Vec<(&'static str, &'a str)> {
    let section_of = |id: &str| SECTIONS.into_iter().find(|section| value(table, section, id).is_some());
    explicit.iter().filter_map(|id| Some((section_of(id)?, id))).collect()
}

fn difference(stored: &toml::Table, now: &toml::Table, section: &str, id: &str) -> Option<Difference> {
    let (stored, now) = (value(stored, section, id), value(now, section, id));
    let text = |value: Option<&toml::Value>| value.map(|v| v.as_float().map_or_else(|| v.to_string(), |real| (real as f32).to_string()));
    (stored != now).then(|| Difference { option: id.to_owned(), stored: text(stored), now: text(now) })
}

fn value<'a>(table: &'a toml::Table, section: &str, id: &str) -> Option<&'a toml::Value> {
    table.get(section)?.as_table()?.get(id)
}
