//! The matrix: methods x data sets x seeds, each cell a run folder.
//!
//! In: [`StudyOptions`]. Out: [`Matrix`], its cells in the order in which they are trained: one
//! seed of everything before the next, so that an interrupted matrix has something of every method.
//! Degenerate: stored cells with another configuration are an error that names each difference, and
//! nothing is trained.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::{DeviceOptions, Error, Observer, Result};
use luxel_core::Remedy;
use luxel_io::LoadOptions;
use luxel_train::{HdrNormalisation, TrainConfig};

use super::method::{self, StudyMethod, with_method};
use super::options::{StudyDataset, StudyOptions};
use super::reading::{SourceReading, reading_of};
use super::stored::{Stored, union};
use crate::files;
use crate::run::evaluation::Metrics;
use crate::run::{Difference, ExplicitArgs, MadeBy, PathContents, RunConfig, RunFolder, RunOptions};

/// Folder of the cells within the output folder.
const RUNS: &str = "runs";

/// Name of the file that marks the output folder and holds the latest options.
const MARK: &str = "matrix.toml";

/// First line of the file that marks the folder.
const HEAD: &str = "# A matrix of Luxel training runs, as it was last asked for. This file marks the folder as one.\n";

/// Number of cells with differences that an error lists.
const LISTED_CELLS: usize = 5;

/// Limit of the size of metrics.json, which has a few kilobytes per view.
const LIMIT_BYTES: u64 = 256 << 20;

/// A data set.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Source {
    /// Name of its folder, which names the cells' folder too.
    pub(super) name: String,
    /// Absolute path.
    pub(super) path: PathBuf,
}

/// The state of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CellState {
    /// It is to be trained from the first step or from its newest checkpoint.
    Open,
    /// It is trained and evaluated.
    Finished,
    /// It is not asked for now, and no finished run of an earlier call.
    Absent,
}

/// A run of the matrix.
#[derive(Clone, Debug)]
pub(super) struct Cell {
    /// Index into [`Matrix::sources`].
    pub(super) source: usize,
    /// Index into [`Matrix::methods`].
    pub(super) method: usize,
    pub(super) seed: u64,
    /// Place in the output folder: `runs/desk-lamp/lcd/seed_42`.
    pub(super) place: PathBuf,
    pub(super) folder: RunFolder,
    pub(super) config: RunConfig,
    /// Place among the runs that this call asks for, from 0, in the order of its own lists; `None`
    /// if an earlier call asked for it, and it is reported if it is finished.
    pub(super) job: Option<usize>,
}

/// The cells of a study, and what they share.
#[derive(Debug)]
pub(super) struct Matrix {
    pub(super) root: PathBuf,
    pub(super) sources: Vec<Source>,
    pub(super) methods: Vec<StudyMethod>,
    pub(super) seeds: Vec<u64>,
    pub(super) cells: Vec<Cell>,
    /// Number of cells that are trained side by side.
    pub(super) jobs: usize,
    /// Threads per cell.
    pub(super) threads: usize,
    /// Memory that reading one file may take in each cell, GiB.
    pub(super) memory_gib: Option<u64>,
    /// How data sets are read, as it was asked for.
    load: LoadOptions,
    /// How each of [`Self::sources`] is read, but for what a method implies.
    readings: Vec<SourceReading>,
}

impl Matrix {
    /// Returns the matrix that the options ask for, with what earlier calls asked for; writes
    /// nothing.
    pub(super) fn plan(options: &StudyOptions) -> Result<Self> {
        let root = std::path::absolute(&options.output).with_context(|| format!("{}: not a path", options.output.display()))?;
        let asked = sources(options)?;
        if let Some(method) = repeated(&options.methods) {
            bail!("method {} is given twice, expected each once", method.name());
        }
        if let Some(seed) = repeated(&options.seeds) {
            bail!("seed {seed} is given twice, expected each once");
        }
        let stored = Stored::read(&root.join(MARK))?;
        // A data set that is asked for by a stored name is that one, wherever it is now.
        let stored_sources: Vec<Source> = stored
            .datasets
            .into_iter()
            .map(stored_source)
            .map(|of_call| asked.iter().find(|source| source.name == of_call.name).cloned().unwrap_or(of_call))
            .collect();
        let sources = union(&stored_sources, &asked);
        let (methods, seeds) = (union(&stored.methods, &options.methods), union(&stored.seeds, &options.seeds));
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let jobs = options.jobs.max(1);
        let threads = options.device.threads.map_or_else(|| (cores / jobs).max(1), |threads| threads as usize);
        let mut matrix = Self {
            root,
            sources,
            methods,
            seeds,
            cells: Vec::new(),
            jobs,
            threads,
            memory_gib: options.memory_gib,
            load: options.load.clone(),
            readings: Vec::new(),
        };
        for source in &matrix.sources {
            let places = |method| matrix.seeds.iter().map(move |seed| run_place(source, method, *seed));
            let runs: Vec<PathBuf> = matrix.methods.iter().copied().flat_map(places).map(|place| matrix.root.join(place)).collect();
            matrix.readings.push(reading_of(&source.name, &source.path, &matrix.load, &runs, asked.contains(source))?);
        }
        for seed in matrix.seeds.clone() {
            for (source, method) in
                (0..matrix.sources.len()).flat_map(|source| (0..matrix.methods.len()).map(move |method| (source, method)))
            {
                // Methods are compared after equal numbers of steps.
                let train = TrainConfig { seed, early_end: None, ..with_method(&options.train, matrix.methods[method]) };
                let of_source = place_in(&asked, &matrix.sources[source]);
                let of_method = place_in(&options.methods, &matrix.methods[method]);
                let job = match (place_in(&options.seeds, &seed), of_source, of_method) {
                    (Some(seed), Some(source), Some(method)) => Some((seed * asked.len() + source) * options.methods.len() + method),
                    _ => None,
                };
                let cell = matrix.cell(options, [source, method], train)?;
                matrix.cells.push(Cell { job, ..cell });
            }
        }
        Ok(matrix)
    }

    fn cell(&self, options: &StudyOptions, [source, method]: [usize; 2], train: TrainConfig) -> Result<Cell> {
        let (dataset, model) = (&self.sources[source], self.methods[method]);
        let seed = train.seed;
        let place = run_place(dataset, model, seed);
        let train = crate::blocks::train_config(&dataset.path, train)?;
        train.validate().with_context(|| format!("method {}", model.name()))?;
        let mut config = RunConfig {
            luxel_version: luxel::VERSION.into(),
            made_by: MadeBy::Train,
            dataset: dataset.path.clone(),
            load: self.readings[source].load.clone(),
            device: DeviceOptions { threads: Some(u32::try_from(self.threads)?), ..options.device.clone() },
            // Nobody looks at the scenes of a study in a splat viewer.
            run: RunOptions {
                checkpoint_every: options.checkpoint_every,
                keep_checkpoints: 1,
                eval_at: Vec::new(),
                eval_every: None,
                refine_display: 0,
                ..RunOptions::default()
            },
            train,
        };
        config.imply_supervision(&ExplicitArgs::default());
        config.imply_exposure();
        Ok(Cell { source, method, seed, folder: RunFolder::at(&self.root.join(&place)), place, config, job: None })
    }

    /// Tells of images that are reduced by their sizes.
    pub(super) fn report_readings(&self, observer: &dyn Observer) {
        self.readings.iter().filter_map(|reading| reading.note.as_deref()).for_each(|note| observer.note(note));
    }

    /// Returns a method in a few words.
    pub(super) fn description(&self, method: StudyMethod) -> String {
        let cell = self.cells.iter().find(|cell| self.methods[cell.method] == method);
        method::description(method, cell.map_or(HdrNormalisation::default(), |cell| cell.config.train.hdr_normalisation))
    }

    /// Returns the state of each cell, in order.
    ///
    /// # Errors
    /// Cells with another configuration, with the differences in the words of `word`.
    pub(super) fn states(&self, word: fn(&Difference) -> String) -> Result<Vec<CellState>> {
        let mut states = Vec::with_capacity(self.cells.len());
        let mut unfit = Vec::new();
        for cell in &self.cells {
            if self.root.is_dir() {
                luxel_io::check_within(&self.root, cell.folder.root())?;
            }
            if cell.job.is_some() {
                states.push(cell.state(&mut unfit, word)?);
                continue;
            }
            let mut unfit_alone = Vec::new();
            let state = cell.state(&mut unfit_alone, word)?;
            let is_finished = state == CellState::Finished && unfit_alone.is_empty();
            states.push(if is_finished { CellState::Finished } else { CellState::Absent });
        }
        if unfit.is_empty() {
            return Ok(states);
        }
        let mut message = format!("{}: holds runs that are not of this matrix", self.root.display());
        for line in unfit.iter().take(LISTED_CELLS) {
            let _ = write!(message, "\n  {line}");
        }
        if unfit.len() > LISTED_CELLS {
            let _ = write!(message, "\n  and {} more", unfit.len() - LISTED_CELLS);
        }
        message += "\ngive the options that they were made with, delete them, or choose another folder";
        Err(Error::new(message).with_remedy(Remedy::give("output")))
    }

    /// Returns the names of the cells that are asked for and not finished.
    pub(super) fn missing(&self, states: &[CellState]) -> Vec<String> {
        let cells = self.cells.iter().zip(states).filter(|(cell, state)| cell.job.is_some() && **state != CellState::Finished);
        cells.map(|(cell, _)| cell.name(self)).collect()
    }

    /// Refuses a folder that holds something else.
    pub(super) fn check_root(&self) -> Result<()> {
        let root = self.root.display();
        let folder = RunFolder::at(&self.root);
        let contents = folder.contents()?;
        // Last: another process may write the mark meanwhile, or be about to.
        if self.root.join(MARK).is_file() || folder.is_locked() {
            return Ok(());
        }
        match contents {
            PathContents::Nothing => Ok(()),
            PathContents::Run(_) => Err(other_folder(format!("{root}: holds a training run"))),
            PathContents::Foreign => Err(other_folder(format!("{root}: is not empty and not a matrix of runs"))),
        }
    }

    /// Writes the file that marks the folder.
    pub(super) fn claim(&self) -> Result<()> {
        std::fs::create_dir_all(&self.root).with_context(|| format!("{}: cannot create the output folder", self.root.display()))?;
        files::write_text(&self.root.join(MARK), &format!("{HEAD}{}", self.toml()?))
    }

    /// Returns the options as TOML, for people and for the record.
    pub(super) fn toml(&self) -> Result<String> {
        let mut table = toml::Table::new();
        let strings = |values: Vec<String>| toml::Value::Array(values.into_iter().map(toml::Value::String).collect());
        table.insert("luxel_version".into(), luxel::VERSION.into());
        table.insert("datasets".into(), strings(self.sources.iter().map(|source| source.path.display().to_string()).collect()));
        table.insert("dataset_names".into(), strings(self.sources.iter().map(|source| source.name.clone()).collect()));
        table.insert("methods".into(), strings(self.methods.iter().map(|method| method.name()).collect()));
        // As text: TOML's integers have a sign.
        table.insert("seeds".into(), strings(self.seeds.iter().map(u64::to_string).collect()));
        if let Some(cell) = self.cells.first() {
            let mut train = toml::Table::try_from(&cell.config.train).map_err(Error::wrap)?;
            for id in method::METHOD_OPTIONS.iter().chain(&["seed"]) {
                train.remove(*id);
            }
            table.insert("load".into(), toml::Value::try_from(&self.load).map_err(Error::wrap)?);
            table.insert("train".into(), train.into());
        }
        toml::to_string_pretty(&table).map_err(Error::wrap)
    }
}

/// Returns an error that another folder remedies.
fn other_folder(message: String) -> Error {
    Error::new(message).with_remedy(Remedy::advice("choose another folder").or(Remedy::give("output")))
}

impl Cell {
    /// Reads the metrics that training wrote at its end, by the run's own radiance scale.
    pub(super) fn metrics_of_training(&self) -> Result<Metrics> {
        let path = self.folder.evaluation(self.config.train.iterations).join("metrics.json");
        let text = files::read_text(&path, LIMIT_BYTES)?;
        serde_json::from_str(&text).with_context(|| format!("{}: not the metrics of a run", path.display()))
    }

    /// Returns the name of the cell: `desk-lamp lcd seed 42`.
    pub(super) fn name(&self, matrix: &Matrix) -> String {
        let (source, method) = (&matrix.sources[self.source], matrix.methods[self.method]);
        format!("{} {} seed {}", source.name, method.name(), self.seed)
    }

    /// Returns the state of the cell's folder, and adds what does not fit.
    fn state(&self, unfit: &mut Vec<String>, word: fn(&Difference) -> String) -> Result<CellState> {
        let place = self.place.display();
        match self.folder.contents()? {
            PathContents::Nothing => Ok(CellState::Open),
            PathContents::Foreign => {
                unfit.push(format!("{place}: is not empty and not a run"));
                Ok(CellState::Open)
            }
            PathContents::Run(stored) => {
                let differences = stored.differences(&self.config)?;
                if !differences.is_empty() {
                    let lines: Vec<String> = differences.iter().map(word).collect();
                    unfit.push(format!("{place}: {}", lines.join("; ")));
                }
                let is_finished = self.folder.evaluated_iterations().contains(&self.config.train.iterations);
                Ok(if is_finished { CellState::Finished } else { CellState::Open })
            }
        }
    }
}

/// Returns the place of a run in the output folder.
fn run_place(source: &Source, method: StudyMethod, seed: u64) -> PathBuf {
    Path::new(RUNS).join(&source.name).join(method.name()).join(format!("seed_{seed}"))
}

/// Returns where a value is in a list.
fn place_in<T: PartialEq>(values: &[T], value: &T) -> Option<usize> {
    values.iter().position(|other| other == value)
}

/// Returns the first value that occurs twice.
fn repeated<T: PartialEq + Copy>(values: &[T]) -> Option<T> {
    values.iter().enumerate().find(|(i, value)| values[..*i].contains(value)).map(|(_, value)| *value)
}

/// Returns a data set of an earlier call.
fn stored_source(StudyDataset { name, path }: StudyDataset) -> Source {
    let of_folder = || path.file_name().map_or_else(|| "dataset".into(), |name| name.to_string_lossy().into_owned());
    Source { name: name.unwrap_or_else(of_folder), path }
}

/// Returns the data sets, whose names differ.
fn sources(options: &StudyOptions) -> Result<Vec<Source>> {
    let mut sources: Vec<Source> = Vec::new();
    for StudyDataset { name, path: given } in &options.datasets {
        let path = std::fs::canonicalize(given).with_context(|| format!("{}: cannot open the data set", given.display()))?;
        if options.load.format.is_none() {
            luxel_io::detect_format(&path).context("cannot read the data set")?;
        }
        // `.` and `..` have the name of the folder that they lead to.
        let of_folder =
            || given.file_name().or(path.file_name()).map_or_else(|| "dataset".into(), |name| name.to_string_lossy().into_owned());
        let name = name.clone().unwrap_or_else(of_folder);
        if let Some(other) = sources.iter().find(|source| source.name == name) {
            bail!(
                "{} and {} have one name, {name}, which names their runs; give one of them another: OTHER={}",
                other.path.display(),
                path.display(),
                given.display()
            );
        }
        sources.push(Source { name, path });
    }
    Ok(sources)
}
