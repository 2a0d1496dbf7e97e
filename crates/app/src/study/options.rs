//! Options of a study.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use luxel::DeviceOptions;
use luxel_io::LoadOptions;
use luxel_metrics::FlipChoice;
use luxel_train::TrainConfig;

use super::share::StudyShare;
use crate::run::Difference;

use super::method::StudyMethod;

/// A data set of a study, and the name that tables and folders of runs give it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StudyDataset {
    /// Name; `None` for that of the folder.
    pub name: Option<String>,
    /// Folder of the data set.
    pub path: PathBuf,
}

impl From<PathBuf> for StudyDataset {
    fn from(path: PathBuf) -> Self {
        Self { name: None, path }
    }
}

impl From<&str> for StudyDataset {
    fn from(path: &str) -> Self {
        Self { name: None, path: path.into() }
    }
}

/// Parses `PATH` or `NAME=PATH`. A path that exists is never split, and the name has no slash.
///
/// ```
/// use luxel_app::study::parse_dataset;
///
/// let desk = parse_dataset("desk=captures/data".into())?;
/// assert_eq!((desk.name.as_deref(), desk.path.to_str()), (Some("desk"), Some("captures/data")));
/// assert_eq!(parse_dataset("captures/a=b".into())?.name, None);
/// assert!(parse_dataset("my desk=data".into()).is_err());
/// # Ok::<(), String>(())
/// ```
///
/// # Errors
/// A name that is no name for a folder, or no path behind it.
pub fn parse_dataset(text: OsString) -> Result<StudyDataset, String> {
    let named = text.to_str().filter(|text| !Path::new(text).exists()).and_then(|text| text.split_once('='));
    match named.filter(|(name, _)| !name.contains(['/', '\\'])) {
        Some((name, path)) if is_plain_name(name) && !path.is_empty() => {
            Ok(StudyDataset { name: Some(name.to_owned()), path: path.into() })
        }
        Some((name, _)) => Err(format!("found the name \"{name}\", expected NAME=PATH with letters, digits, '.', '_' and '-' in the name")),
        None => Ok(PathBuf::from(text).into()),
    }
}

/// Returns whether a name is one for a folder everywhere.
fn is_plain_name(name: &str) -> bool {
    let is_plain = |c: char| c.is_alphanumeric() || "._-".contains(c);
    !name.is_empty() && !name.starts_with(['.', '-']) && name.chars().all(is_plain)
}

/// Options of [`run`](super::run).
///
/// ```
/// use luxel_app::study::{StudyOptions, parse_method};
///
/// let methods = vec![parse_method("sh3")?, parse_method("lcd-l1")?];
/// let options = StudyOptions::new(["desk-lamp"], "ablation", "/usr/bin/luxel");
/// let options = StudyOptions { methods, seeds: vec![1, 2], ..options };
/// assert_eq!(options.jobs, 1);
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug)]
pub struct StudyOptions {
    /// The data sets.
    pub datasets: Vec<StudyDataset>,
    /// Folder of runs and report.
    pub output: PathBuf,
    /// Methods, in the order of the tables.
    pub methods: Vec<StudyMethod>,
    /// Seeds: each method is trained once per seed on each data set.
    pub seeds: Vec<u64>,
    /// Runs side by side, at least 1.
    pub jobs: usize,
    /// Steps between checkpoints of a run; 0 for the end only.
    pub checkpoint_every: u32,
    /// Options of reading the data sets.
    pub load: LoadOptions,
    /// Device. Without a number of threads each run has its share of the cores.
    pub device: DeviceOptions,
    /// Memory that reading one file may take in each run, GiB; `None` for the default of the
    /// program.
    pub memory_gib: Option<u64>,
    /// Options of training that all runs share; method and seed are replaced run by run.
    pub train: TrainConfig,
    /// Whether HDR-FLIP is measured.
    pub flip: FlipChoice,
    /// Weights for LPIPS, which is measured if they are given.
    pub lpips_weights: Option<PathBuf>,
    /// The program `luxel`, which trains each run in a process of its own.
    pub program: PathBuf,
    /// The part of the runs that this call trains; `None` for all.
    pub share: Option<StudyShare>,
    /// Words the difference between a stored run and a wanted one. Neutral by default.
    pub word_difference: fn(&Difference) -> String,
}

impl StudyOptions {
    /// Returns the default options: 3DGS and LCD-GS, seed 42, one run at a time.
    pub fn new<D: Into<StudyDataset>>(
        datasets: impl IntoIterator<Item = D>,
        output: impl Into<PathBuf>,
        program: impl Into<PathBuf>,
    ) -> Self {
        Self {
            datasets: datasets.into_iter().map(Into::into).collect(),
            output: output.into(),
            methods: vec![super::paper::BASELINE, super::paper::LCD_GS],
            seeds: vec![42],
            jobs: 1,
            checkpoint_every: 1000,
            load: LoadOptions::default(),
            device: DeviceOptions::default(),
            memory_gib: None,
            train: TrainConfig::default(),
            flip: FlipChoice::Skip,
            lpips_weights: None,
            program: program.into(),
            share: None,
            word_difference: Difference::to_string,
        }
    }
}
