//! Options of a study.

use std::path::PathBuf;

use luxel_core::ColorModel;
use luxel_io::LoadOptions;
use luxel_metrics::FlipChoice;
use luxel_train::TrainConfig;

use crate::DeviceOptions;
use crate::run::Difference;

/// Options of [`run`](super::run).
///
/// ```
/// use luxel::study::{StudyOptions, parse_method};
///
/// let methods = vec![parse_method("sh3")?, parse_method("lcd-l1")?];
/// let options = StudyOptions::new(["desk-lamp"], "ablation", "/usr/bin/luxel");
/// let options = StudyOptions { methods, seeds: vec![1, 2], ..options };
/// assert_eq!(options.jobs, 1);
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug)]
pub struct StudyOptions {
    /// Folders of the data sets.
    pub datasets: Vec<PathBuf>,
    /// Folder of runs and report.
    pub output: PathBuf,
    /// Colour models, in the order of the tables.
    pub methods: Vec<ColorModel>,
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
    /// Options of training that all runs share; colour model and seed are replaced run by run.
    pub train: TrainConfig,
    /// Whether HDR-FLIP is measured.
    pub flip: FlipChoice,
    /// Weights for LPIPS, which is measured if they are given.
    pub lpips_weights: Option<PathBuf>,
    /// The program `luxel`, which trains each run in a process of its own.
    pub program: PathBuf,
    /// Words the difference between a stored run and a wanted one. Neutral by default.
    pub word_difference: fn(&Difference) -> String,
}

impl StudyOptions {
    /// Returns the default options: 3DGS and LCD-GS, seed 42, one run at a time.
    pub fn new<P: Into<PathBuf>>(datasets: impl IntoIterator<Item = P>, output: impl Into<PathBuf>, program: impl Into<PathBuf>) -> Self {
        Self {
            datasets: datasets.into_iter().map(Into::into).collect(),
            output: output.into(),
            methods: vec![super::paper::BASELINE, super::paper::LCD_GS],
            seeds: vec![42],
            jobs: 1,
            checkpoint_every: 1000,
            load: LoadOptions::default(),
            device: DeviceOptions::default(),
            train: TrainConfig::default(),
            flip: FlipChoice::Skip,
            lpips_weights: None,
            program: program.into(),
            word_difference: Difference::to_string,
        }
    }
}
