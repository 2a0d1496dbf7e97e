//! The folder of a training run: what lies where, whether a folder is one, and what may be deleted.
//!
//! ```text
//! config.toml                                  resolved configuration; marks the folder as a run
//! checkpoints/                                 state to resume from
//! point_cloud/iteration_N/point_cloud.ply      the scene, where other tools look for it
//! eval/step_N/{renders,gt}/*.exr, metrics.json test views in the units of the data set, figures of that step by training
//! eval/step_N_on_DATA/                         test views of luxel eval on other data, or on the run's own read otherwise; source.toml says which
//! metrics.json  log.jsonl  report.html
//! measured.json                                what luxel reproduce measured of its runs
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::Result;
use crate::error::{Context, bail};

use luxel_io::LoadOptions;

use super::RunConfig;
use crate::files;

const CONFIG: &str = "config.toml";

/// What an evaluation on other data is of.
const SOURCE: &str = "source.toml";

/// Locked while a process works in the folder. The file itself says nothing and stays.
pub const LOCK: &str = ".lock";

/// Everything training puts into a run folder besides [`CONFIG`]; all that `--overwrite` deletes.
const CONTENTS: [&str; 8] =
    ["checkpoints", "point_cloud", "eval", "metrics.json", "captures.json", "log.jsonl", "report.html", "measured.json"];

/// A run's place on disk.
#[derive(Clone, Debug)]
pub struct RunFolder {
    root: PathBuf,
}

/// Keeps other processes from working in a folder; the system lets go of it when the process ends, however it ends.
#[derive(Debug)]
pub struct RunLock {
    _file: std::fs::File,
}

/// What is at an output path.
#[derive(Debug)]
pub enum Occupant {
    /// Nothing, or an empty folder.
    Nothing,
    /// A run.
    Run(Box<RunConfig>),
    /// Something else.
    Foreign,
}

impl RunFolder {
    /// The folder at `root`, whatever is there.
    pub fn at(root: &Path) -> Self {
        Self { root: root.into() }
    }

    /// A folder that must be a run.
    pub fn open(root: &Path) -> Result<(Self, RunConfig)> {
        let folder = Self::at(root);
        let config = folder.read_config()?;
        Ok((folder, config))
    }

    /// Whether `root` has the mark of a run.
    pub fn is_run(root: &Path) -> bool {
        root.join(CONFIG).is_file()
    }

    /// What is there now. A run whose configuration cannot be read is an error, not [`Occupant::Foreign`].
    pub fn occupant(&self) -> Result<Occupant> {
        if Self::is_run(&self.root) {
            return Ok(Occupant::Run(Box::new(self.read_config()?)));
        }
        match std::fs::read_dir(&self.root) {
            Ok(entries) => {
                let others = entries.flatten().any(|entry| entry.file_name() != LOCK);
                Ok(if others { Occupant::Foreign } else { Occupant::Nothing })
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Occupant::Nothing),
            Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => {
                bail!("{}: is a file, expected a folder or a free name", self.root.display())
            }
            Err(error) => Err(error).with_context(|| format!("{}: cannot look into the output folder", self.root.display())),
        }
    }

    /// Makes the folder if need be and locks it for this process.
    pub fn lock(&self) -> Result<RunLock> {
        std::fs::create_dir_all(&self.root).with_context(|| format!("{}: cannot create the output folder", self.root.display()))?;
        let path = self.root.join(LOCK);
        let opened = std::fs::File::options().create(true).truncate(false).write(true).open(&path);
        let file = opened.with_context(|| format!("{}: cannot write into the output folder", path.display()))?;
        // A file system without locks is no reason not to work.
        if let Err(std::fs::TryLockError::WouldBlock) = file.try_lock() {
            bail!("{}: another luxel is at work in this folder; wait for it, or choose another", self.root.display());
        }
        Ok(RunLock { _file: file })
    }

    /// Deletes what a run consists of, and leaves everything else in the folder. The mark goes last, so that an interrupted
    /// deletion can be repeated.
    pub fn clear(&self) -> Result<()> {
        for name in CONTENTS.iter().chain([&CONFIG]) {
            let path = self.root.join(name);
            let removed = match std::fs::symlink_metadata(&path) {
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
                Err(error) => Err(error),
                Ok(metadata) if metadata.is_dir() => std::fs::remove_dir_all(&path),
                Ok(_) => std::fs::remove_file(&path),
            };
            removed.with_context(|| format!("{}: cannot delete", path.display()))?;
        }
        Ok(())
    }

    fn read_config(&self) -> Result<RunConfig> {
        let path = self.root.join(CONFIG);
        if !path.is_file() {
            bail!("{}: no {CONFIG}, so this is not the folder of a training run", self.root.display());
        }
        RunConfig::read(&path)
    }

    /// Writes the configuration: from here on the folder is a run.
    pub fn write_config(&self, config: &RunConfig) -> Result<()> {
        config.write(&self.root.join(CONFIG))
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The scene after `iteration` steps.
    pub fn scene(&self, iteration: u32) -> PathBuf {
        self.root.join("point_cloud").join(format!("iteration_{iteration}")).join("point_cloud.ply")
    }

    /// Evaluation after `iteration` steps.
    pub fn evaluation(&self, iteration: u32) -> PathBuf {
        self.root.join("eval").join(format!("step_{iteration}"))
    }

    /// Makes the folder of the same on other data than the run's own, or on that read otherwise, and writes into it which: `data`, read by `load`. The data
    /// set's name is told apart by a digest where another one of this name was there first.
    pub fn claim_evaluation_of(&self, iteration: u32, data: &Path, load: &LoadOptions) -> Result<PathBuf> {
        let name = std::path::absolute(data).ok().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
        let real = std::fs::canonicalize(data).unwrap_or_else(|_| data.into());
        let entries = [("dataset", real.to_string_lossy().as_ref().into()), ("load", toml::Value::try_from(load)?)];
        let source = toml::to_string(&BTreeMap::from(entries))?;
        let plain = self.root.join("eval").join(format!("step_{iteration}_on_{}", name.unwrap_or_else(|| "other_data".into())));
        let folder = match std::fs::read(plain.join(SOURCE)) {
            Ok(other) if other != source.as_bytes() => {
                let mut told_apart = plain.into_os_string();
                told_apart.push(format!("_{}", &blake3::hash(source.as_bytes()).to_hex()[..8]));
                told_apart.into()
            }
            _ => plain,
        };
        files::write_text(&folder.join(SOURCE), &source)?;
        Ok(folder)
    }

    /// Figures of the newest evaluation.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.json")
    }

    /// What was found of the training images.
    pub fn captures(&self) -> PathBuf {
        self.root.join("captures.json")
    }

    /// Training curves.
    pub fn log(&self) -> PathBuf {
        self.root.join("log.jsonl")
    }

    /// What was measured of the run as part of a matrix.
    pub fn measured(&self) -> PathBuf {
        self.root.join("measured.json")
    }

    /// The report.
    pub fn report(&self) -> PathBuf {
        self.root.join("report.html")
    }

    /// Iterations of which a scene was written, newest first.
    pub fn scene_iterations(&self) -> Vec<u32> {
        let mut found = numbered(&self.root.join("point_cloud"), "iteration_");
        found.retain(|&n| self.scene(n).is_file());
        found
    }

    /// Iterations that training evaluated to the end, newest first.
    pub fn evaluated_iterations(&self) -> Vec<u32> {
        let mut found = numbered(&self.root.join("eval"), "step_");
        found.retain(|&n| self.evaluation(n).join("metrics.json").is_file());
        found
    }
}

/// Numbers of the entries `prefix` and number, greatest first; an unreadable folder has none.
fn numbered(folder: &Path, prefix: &str) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let number = |entry: std::fs::DirEntry| entry.file_name().to_str()?.strip_prefix(prefix)?.parse().ok();
    let mut found: Vec<u32> = entries.flatten().filter_map(number).collect();
    found.sort_unstable_by(|a, b| b.cmp(a));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_missing_and_foreign_folders_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(&folder.path().join("run"));
        assert!(matches!(run.occupant().unwrap(), Occupant::Nothing));
        std::fs::create_dir(run.root()).unwrap();
        assert!(matches!(run.occupant().unwrap(), Occupant::Nothing));
        std::fs::write(run.root().join("thesis.doc"), "years").unwrap();
        assert!(matches!(run.occupant().unwrap(), Occupant::Foreign));
    }

    #[test]
    fn a_folder_is_locked_for_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(&folder.path().join("run"));
        let lock = run.lock().unwrap();
        assert!(run.lock().unwrap_err().to_string().contains("another luxel"));
        drop(lock);
        assert!(run.lock().is_ok());
        assert!(matches!(run.occupant().unwrap(), Occupant::Nothing));
    }

    #[test]
    fn clearing_leaves_what_is_not_luxels() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(folder.path());
        for name in ["config.toml", "log.jsonl", "notes.txt"] {
            std::fs::write(folder.path().join(name), "x").unwrap();
        }
        std::fs::create_dir_all(folder.path().join("checkpoints/deep")).unwrap();
        std::fs::create_dir_all(folder.path().join("photos")).unwrap();
        std::fs::create_dir_all(folder.path().join("pictures")).unwrap();
        run.clear().unwrap();
        let mut left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["notes.txt", "photos", "pictures"]);
    }

    #[test]
    fn evaluations_on_other_data_of_one_name_have_a_folder_each() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(&folder.path().join("run"));
        let at_full_size = LoadOptions::default();
        let halved = LoadOptions { downscale: 2, ..LoadOptions::default() };
        let claim = |data: &str, load| {
            let data = folder.path().join(data);
            std::fs::create_dir_all(&data).unwrap();
            run.claim_evaluation_of(40, &data, load).unwrap()
        };
        let first = claim("a/data", &at_full_size);
        assert_eq!(first, run.root().join("eval/step_40_on_data"));
        let others = [claim("b/data", &at_full_size), claim("a/data", &halved)];
        assert!(others[0] != others[1] && !others.contains(&first), "{others:?}");
        // Each keeps its own.
        assert_eq!([claim("a/data/../data", &at_full_size), claim("b/data", &at_full_size)], [first, others[0].clone()]);
        assert!(run.evaluated_iterations().is_empty());
    }

    #[test]
    fn scenes_are_listed_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(folder.path());
        for n in [7000, 30000, 900] {
            std::fs::create_dir_all(run.scene(n).parent().unwrap()).unwrap();
            std::fs::write(run.scene(n), "ply").unwrap();
        }
        std::fs::create_dir_all(folder.path().join("point_cloud/iteration_x")).unwrap();
        std::fs::create_dir_all(folder.path().join("point_cloud/iteration_99999")).unwrap();
        assert_eq!(run.scene_iterations(), [30000, 7000, 900]);
    }
}
