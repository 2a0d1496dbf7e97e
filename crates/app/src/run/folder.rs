//! The folder of a training run: where its files are, whether a folder is one, and what may be
//! deleted.
//!
//! ```text
//! config.toml                              settings; marks the folder as a run
//! checkpoints/                             state to resume from
//! point_cloud/iteration_N/point_cloud.ply  the scene, where other tools look for it
//! field/iteration_N/field.safetensors      the radiance field of a run without splats
//! anchors/iteration_N/anchors.safetensors  the anchors of a run whose splats they decode
//! eval/step_N/{renders,gt}/*.exr           test views in the units of the data set
//! eval/step_N/metrics.json                 their metrics; marks the evaluation as complete
//! eval/step_N_on_DATA/                     test views of other data, named in source.toml
//! metrics.json  log.jsonl  report.html     newest metrics, training curves, report
//! cameras.json                             refined cameras
//! captures.json                            gains, response, vignetting that training found
//! measured.json                            measurements of the run as part of a study
//! ```

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use luxel::error::{Context, bail};
use luxel::{Error, Result};
use luxel_core::Remedy;
use luxel_io::LoadOptions;
use luxel_train::Method;

use super::RunConfig;
use super::non_splat_kind::NonSplatKind;
use super::plots;
use crate::files;

const CONFIG: &str = "config.toml";

/// Names the data of an evaluation on other data.
const SOURCE: &str = "source.toml";

/// Locked while a process works in the folder. The file is empty and stays.
pub const LOCK: &str = ".lock";

/// Everything training puts into a run folder besides [`CONFIG`]; all that [`RunFolder::clear`]
/// deletes.
const CONTENTS: [&str; 13] = [
    "checkpoints",
    "point_cloud",
    "field",
    "anchors",
    "eval",
    "metrics.json",
    "cameras.json",
    "captures.json",
    "log.jsonl",
    plots::TABLE,
    plots::TENSORBOARD,
    "report.html",
    "measured.json",
];

/// A run's place on disk.
#[derive(Clone, Debug)]
pub struct RunFolder {
    root: PathBuf,
}

/// Keeps other processes from working in a folder. The system releases it when the process ends in
/// any way.
#[derive(Debug)]
pub struct RunLock {
    _file: std::fs::File,
    /// Nothing is written where links lead out of the folder.
    _confinement: luxel_io::Confinement,
}

/// Tells a lock from one that was put in its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LockIdentity {
    /// Number of the file, where the system has one.
    number: u64,
}

/// The content of an output path.
#[derive(Debug)]
pub enum PathContents {
    /// Nothing, or an empty folder.
    Nothing,
    /// A run.
    Run(Box<RunConfig>),
    /// Something else.
    Foreign,
}

impl RunFolder {
    /// Returns the folder at `root`, whatever its content.
    pub fn at(root: &Path) -> Self {
        Self { root: root.into() }
    }

    /// Returns the folder for images of the data set that memory has no room for. It lies beside
    /// the run, outlives it, and may be deleted at any time.
    pub fn image_cache(&self) -> PathBuf {
        let root = std::path::absolute(&self.root).unwrap_or_else(|_| self.root.clone());
        match root.file_name() {
            Some(name) => {
                let mut name = name.to_owned();
                name.push(".images");
                root.with_file_name(name)
            }
            None => root.join("run.images"),
        }
    }

    /// Opens a folder that must be a run.
    ///
    /// # Errors
    /// The folder is no run, or its configuration cannot be read.
    pub fn open(root: &Path) -> Result<(Self, RunConfig)> {
        let folder = Self::at(root);
        let config = folder.read_config()?;
        Ok((folder, config))
    }

    /// Returns whether `root` has the mark of a run, its config.toml.
    pub fn is_run(root: &Path) -> bool {
        root.join(CONFIG).is_file()
    }

    /// Returns the folder's content. A run whose configuration cannot be read is an error, not
    /// [`PathContents::Foreign`].
    ///
    /// # Errors
    /// A folder or configuration that cannot be read.
    pub fn contents(&self) -> Result<PathContents> {
        if Self::is_run(&self.root) {
            return Ok(PathContents::Run(Box::new(self.read_config()?)));
        }
        match std::fs::read_dir(&self.root) {
            Ok(entries) => {
                let others = entries.flatten().any(|entry| !is_left_over(&entry.file_name()));
                Ok(if others { PathContents::Foreign } else { PathContents::Nothing })
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(PathContents::Nothing),
            Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => {
                bail!("{}: is a file, expected a folder or a free name", self.root.display())
            }
            Err(error) => Err(error).with_context(|| format!("{}: cannot look into the output folder", self.root.display())),
        }
    }

    /// Makes the folder if needed and locks it for this process. Removes what killed processes left
    /// in it unfinished. While the lock is held, nothing is written where links lead out of the
    /// folder, which may come from somebody else.
    ///
    /// # Errors
    /// A folder that cannot be written, that another process works in, or whose lock is no file.
    pub fn lock(&self) -> Result<RunLock> {
        if self.root.is_symlink() && !self.root.exists() {
            bail!("{}: is a link to a missing folder, expected a folder or a free name; remove it", self.root.display());
        }
        std::fs::create_dir_all(&self.root).with_context(|| format!("{}: cannot create the output folder", self.root.display()))?;
        let confinement = luxel_io::confine(&self.root)?;
        let path = self.root.join(LOCK);
        // A link could lead anywhere, and opening a pipe would wait.
        if std::fs::symlink_metadata(&path).is_ok_and(|found| !found.is_file()) {
            bail!("{}: is a link or no file, expected an empty file; remove it", path.display());
        }
        let opened = std::fs::File::options().create(true).truncate(false).write(true).open(&path);
        let file = opened.with_context(|| format!("{}: cannot write into the output folder", path.display()))?;
        // A file system without locks is no reason not to work.
        if let Err(std::fs::TryLockError::WouldBlock) = file.try_lock() {
            bail!("{}: another luxel is at work in this folder; wait for it, or choose another", self.root.display());
        }
        sweep(&self.root, 0);
        ["point_cloud", "field", "anchors", "eval"].into_iter().for_each(|name| sweep(&self.root.join(name), 2));
        Ok(RunLock { _file: file, _confinement: confinement })
    }

    /// Returns the lock as it is now, to be compared with that of another moment; `None` if it is
    /// missing or nobody holds it.
    pub(super) fn lock_identity(&self) -> Option<LockIdentity> {
        let file = std::fs::File::open(self.root.join(LOCK)).ok()?;
        // Another handle of the same process is refused, too. Any other error means that there are
        // no locks here.
        if file.try_lock_shared().is_ok() {
            return None;
        }
        let metadata = file.metadata().ok()?;
        #[cfg(unix)]
        return Some(LockIdentity { number: std::os::unix::fs::MetadataExt::ino(&metadata) });
        #[cfg(not(unix))]
        Some(LockIdentity { number: u64::from(metadata.is_file()) })
    }

    /// Returns whether a process works in the folder.
    pub(crate) fn is_locked(&self) -> bool {
        self.lock_identity().is_some()
    }

    /// Deletes the files of a run, and leaves everything else in the folder. The mark is deleted
    /// last, so that an interrupted deletion can be repeated.
    ///
    /// # Errors
    /// A file that cannot be deleted.
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
            let error = Error::new(format!("{}: no {CONFIG}, so this is not the folder of a training run", self.root.display()));
            return Err(error.with_remedy(Remedy::advice("if it is a data set, train on it first")));
        }
        RunConfig::read(&path)
    }

    /// Writes the configuration, which makes the folder a run.
    ///
    /// # Errors
    /// The file system's refusal.
    pub fn write_config(&self, config: &RunConfig) -> Result<()> {
        config.write(&self.root.join(CONFIG))
    }

    /// Returns the folder's path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the path of the scene after `iteration` steps.
    pub fn scene(&self, iteration: u32) -> PathBuf {
        self.root.join("point_cloud").join(format!("iteration_{iteration}")).join("point_cloud.ply")
    }

    /// Returns the path of the field or the anchors after `iteration` steps.
    pub fn non_splat(&self, kind: NonSplatKind, iteration: u32) -> PathBuf {
        let name = kind.name();
        self.root.join(name).join(format!("iteration_{iteration}")).join(format!("{name}.safetensors"))
    }

    /// Returns the path of the scene of a method after `iteration` steps, of whatever kind it is.
    pub fn result(&self, method: Method, iteration: u32) -> PathBuf {
        NonSplatKind::of(method).map_or_else(|| self.scene(iteration), |kind| self.non_splat(kind, iteration))
    }

    /// Returns whether there is a scene of any kind.
    pub(super) fn has_results(&self) -> bool {
        !self.scene_iterations().is_empty() || NonSplatKind::ALL.into_iter().any(|kind| !self.non_splat_iterations(kind).is_empty())
    }

    /// Returns the folder of the evaluation after `iteration` steps.
    pub fn evaluation(&self, iteration: u32) -> PathBuf {
        self.root.join("eval").join(format!("step_{iteration}"))
    }

    /// Makes the folder of an evaluation on other data than the run's own, or on its own read with
    /// other options, and notes in it which: `data`, read by `load`. A digest distinguishes data
    /// sets of one name.
    ///
    /// # Errors
    /// The file system's refusal.
    pub fn claim_evaluation_of(&self, iteration: u32, data: &Path, load: &LoadOptions) -> Result<PathBuf> {
        let name = std::path::absolute(data).ok().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
        let real = std::fs::canonicalize(data).unwrap_or_else(|_| data.into());
        let entries = [("dataset", real.to_string_lossy().as_ref().into()), ("load", toml::Value::try_from(load).map_err(Error::wrap)?)];
        let source = toml::to_string(&BTreeMap::from(entries)).map_err(Error::wrap)?;
        let plain = self.root.join("eval").join(format!("step_{iteration}_on_{}", name.unwrap_or_else(|| "other_data".into())));
        let folder = match luxel_io::read_file(&plain.join(SOURCE)) {
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

    /// Returns the path of the metrics of the newest evaluation.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.json")
    }

    /// Returns the path of the gains and the camera response that training found.
    pub fn captures(&self) -> PathBuf {
        self.root.join("captures.json")
    }

    /// Returns the path of the refined cameras.
    pub fn cameras(&self) -> PathBuf {
        self.root.join("cameras.json")
    }

    /// Returns the path of the log.
    pub fn log(&self) -> PathBuf {
        self.root.join("log.jsonl")
    }

    /// Returns the path of the measurements of the run as part of a study.
    pub fn measured(&self) -> PathBuf {
        self.root.join("measured.json")
    }

    /// Returns the path of the report.
    pub fn report(&self) -> PathBuf {
        self.root.join("report.html")
    }

    /// Returns the iterations with a scene, newest first.
    pub fn scene_iterations(&self) -> Vec<u32> {
        let mut found = numbered(&self.root.join("point_cloud"), "iteration_");
        found.retain(|&n| self.scene(n).is_file());
        found
    }

    /// Returns the iterations with a field or with anchors, newest first.
    pub fn non_splat_iterations(&self, kind: NonSplatKind) -> Vec<u32> {
        let mut found = numbered(&self.root.join(kind.name()), "iteration_");
        found.retain(|&n| self.non_splat(kind, n).is_file());
        found
    }

    /// Returns the iterations with images of test views, newest first.
    pub(crate) fn rendered_iterations(&self) -> Vec<u32> {
        let mut found = numbered(&self.root.join("eval"), "step_");
        found.retain(|&n| ["renders", "gt"].iter().all(|name| self.evaluation(n).join(name).is_dir()));
        found
    }

    /// Returns the iterations with a complete evaluation by training, newest first.
    pub fn evaluated_iterations(&self) -> Vec<u32> {
        let mut found = numbered(&self.root.join("eval"), "step_");
        found.retain(|&n| self.evaluation(n).join("metrics.json").is_file());
        found
    }
}

/// Returns whether an entry of a folder is left over from a process that was killed before it had
/// written anything.
pub fn is_left_over(name: &OsStr) -> bool {
    name == LOCK || luxel_io::is_unfinished_name(name)
}

/// Removes what killed processes left unfinished in a folder, and in its folders to a depth.
fn sweep(folder: &Path, depth: usize) {
    luxel_io::sweep_unfinished(folder);
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    if depth > 0 {
        // A link is no folder here.
        let folders = entries.flatten().filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
        folders.for_each(|entry| sweep(&entry.path(), depth - 1));
    }
}

/// Returns the numbers of the entries named `prefix` and a number, greatest first; none for an
/// unreadable folder.
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
        assert!(matches!(run.contents().unwrap(), PathContents::Nothing));
        std::fs::create_dir(run.root()).unwrap();
        assert!(matches!(run.contents().unwrap(), PathContents::Nothing));
        // A process that was killed in its first write.
        std::fs::write(run.root().join(".luxel-a1b2c3.tmp"), "half").unwrap();
        assert!(matches!(run.contents().unwrap(), PathContents::Nothing));
        std::fs::write(run.root().join("thesis.doc"), "years").unwrap();
        assert!(matches!(run.contents().unwrap(), PathContents::Foreign));
    }

    #[test]
    fn a_folder_is_locked_for_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(&folder.path().join("run"));
        let lock = run.lock().unwrap();
        assert!(run.lock().unwrap_err().to_string().contains("another luxel"));
        drop(lock);
        assert!(run.lock().is_ok());
        assert!(matches!(run.contents().unwrap(), PathContents::Nothing));
    }

    #[test]
    fn a_lock_that_was_removed_or_replaced_is_another() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::at(&folder.path().join("run"));
        assert_eq!(run.lock_identity(), None);
        let lock = run.lock().unwrap();
        let first = run.lock_identity();
        assert!(first.is_some() && run.lock_identity() == first);
        // Kept under another name, so that its number is not given away.
        std::fs::rename(run.root().join(LOCK), run.root().join("old")).unwrap();
        assert_eq!(run.lock_identity(), None);
        let other = run.lock().unwrap();
        if cfg!(unix) {
            assert!(run.lock_identity().is_some() && run.lock_identity() != first);
        }
        drop((lock, other));
        assert_eq!(run.lock_identity(), None);
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
        let halved = LoadOptions { downscale: 2.into(), ..LoadOptions::default() };
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
