//! Structure from motion by COLMAP, a separate program or Python package: what is installed, its
//! progress and its result.
//!
//! In: [`Step`]s. Out: models in `work/sparse`, of which the largest is read. COLMAP's output goes
//! to `work/colmap.log`. The package gets the same commands through a script, which this program
//! carries.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use luxel::error::{Context, bail};
use luxel::{Event, ItemKind, Observer, Result};
use luxel_io::colmap::{ColmapModel, read_colmap_model};

use super::folders::Folders;
use crate::files::remove_if_there;

/// Number of COLMAP's last lines that an error has.
const LAST_LINES: usize = 6;

/// The script that gives the Python package the options of the program.
const PYCOLMAP_STEPS: &str = include_str!("pycolmap_steps.py");

/// An installed COLMAP: the program, or the Python package.
#[derive(Clone, Debug)]
pub(super) struct Colmap {
    /// The program, or a Python interpreter.
    pub(super) program: PathBuf,
    /// Arguments before the command: the script for Python.
    before: Vec<OsString>,
    /// Its name and version: `COLMAP 3.8`, `pycolmap 4.2.1`.
    pub(super) version: String,
    pub(super) abilities: Abilities,
}

/// A command to be run.
pub(super) struct Step {
    /// Its purpose, for people.
    pub(super) purpose: &'static str,
    pub(super) arguments: Vec<OsString>,
    /// Number of things that it reports progress by.
    pub(super) total: usize,
}

/// The abilities of an installed COLMAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Abilities {
    /// Options begin with FeatureExtraction and FeatureMatching, as since 3.12, in place of
    /// SiftExtraction and SiftMatching.
    pub(super) feature_options: bool,
    /// ALIKED and LightGlue.
    pub(super) aliked: bool,
    /// The global mapper.
    pub(super) global_mapper: bool,
    /// Lists of pairs to match.
    pub(super) pairs: bool,
    /// Rigs of cameras.
    pub(super) rigs: bool,
}

impl Colmap {
    /// Asks a program for its version and options; `pycolmap`, or a Python interpreter, is the
    /// Python package. Returns `None` if there is no such program or package.
    pub(super) fn find(program: &Path) -> Option<Self> {
        let name = program.file_name()?.to_string_lossy();
        match &*name {
            "pycolmap" => Self::find_package(Path::new("python3")).or_else(|| Self::find_package(Path::new("python"))),
            name if name.starts_with("python") => Self::find_package(program),
            _ => Self::find_program(program),
        }
    }

    fn find_program(program: &Path) -> Option<Self> {
        let help = |arguments: &[&str]| {
            let output = command(program).args(arguments).output().ok()?;
            Some(String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr))
        };
        let version = help(&["-h"])?.lines().find(|line| line.contains("COLMAP")).map(|line| line.trim().to_owned())?;
        let extraction = help(&["feature_extractor", "-h"])?;
        let commands = help(&["help"]).unwrap_or_default();
        let abilities = Abilities {
            feature_options: extraction.contains("FeatureExtraction.use_gpu"),
            aliked: extraction.contains("AlikedExtraction."),
            global_mapper: commands.split_whitespace().any(|word| word == "global_mapper"),
            pairs: true,
            rigs: commands.split_whitespace().any(|word| word == "rig_configurator"),
        };
        Some(Self { program: program.to_owned(), before: Vec::new(), version, abilities })
    }

    fn find_package(python: &Path) -> Option<Self> {
        let before: Vec<OsString> = ["-u", "-c", PYCOLMAP_STEPS].map(OsString::from).into();
        let output = command(python).args(&before).arg("describe").output().ok().filter(|output| output.status.success())?;
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let version = text.lines().find(|line| line.starts_with("pycolmap "))?.trim().to_owned();
        let can = |what: &str| text.lines().any(|line| line.trim() == what);
        let abilities = Abilities {
            feature_options: true,
            aliked: can("aliked"),
            global_mapper: can("global"),
            pairs: can("pairs"),
            rigs: can("rigs"),
        };
        Some(Self { program: python.to_owned(), before, version, abilities })
    }

    /// Returns a COLMAP that is not installed, for commands that are only written down.
    pub(super) fn unknown(program: &Path) -> Self {
        let abilities = Abilities { feature_options: false, aliked: true, global_mapper: true, pairs: true, rigs: true };
        Self { program: program.to_owned(), before: Vec::new(), version: String::new(), abilities }
    }

    /// Runs the commands on a fresh database.
    pub(super) fn run(&self, steps: &[Step], folders: &Folders, observer: &dyn Observer) -> Result<()> {
        let sparse = folders.work.join("sparse");
        for name in ["database.db", "database.db-wal", "database.db-shm"] {
            remove_if_there(&folders.work.join(name))?;
        }
        if sparse.exists() {
            std::fs::remove_dir_all(&sparse).with_context(|| format!("{}: cannot remove", sparse.display()))?;
        }
        std::fs::create_dir_all(&sparse).with_context(|| format!("{}: cannot create", sparse.display()))?;
        let log_path = folders.work.join("colmap.log");
        // A link in its place is not followed.
        remove_if_there(&log_path)?;
        let file = std::fs::File::create(&log_path).with_context(|| format!("{}: cannot write", log_path.display()))?;
        let mut log = Log { path: log_path, file };
        for step in steps {
            observer.note(&format!("COLMAP: {}", step.purpose));
            self.run_step(step, &mut log, observer)?;
        }
        Ok(())
    }

    fn run_step(&self, step: &Step, log: &mut Log, observer: &dyn Observer) -> Result<()> {
        let mut child = command(&self.program)
            .args(&self.before)
            .args(&step.arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("{}: cannot start", self.program.display()))?;
        let total = step.total as u32;
        let mut last: Vec<String> = Vec::new();
        observer.event(Event::StepsBegin { done: 0, total });
        for line in lines_of(&mut child) {
            // A log that cannot be written is no reason to stop.
            let _ = writeln!(log.file, "{line}");
            if let Some(done) = progress(&line) {
                observer.event(Event::Step { done });
                observer.event(Event::Item { kind: ItemKind::StructureFromMotion, name: step.purpose.to_owned(), done, total });
            }
            if !line.trim().is_empty() {
                last.push(line.trim().to_owned());
                if last.len() > LAST_LINES {
                    last.remove(0);
                }
            }
        }
        observer.event(Event::StepsEnd);
        let status = child.wait().context("cannot wait for COLMAP")?;
        if !status.success() {
            let (purpose, log) = (step.purpose, log.path.display());
            bail!("COLMAP failed in its step \"{purpose}\" ({status}): {}; its output is in {log}", last.join(" | "));
        }
        Ok(())
    }
}

/// Returns a call of a program that sees no screen and no input.
fn command(program: &Path) -> Command {
    let mut command = Command::new(program);
    command.env("QT_QPA_PLATFORM", "offscreen").stdin(Stdio::null());
    command
}

/// The file that COLMAP's output goes to.
struct Log {
    path: PathBuf,
    file: std::fs::File,
}

/// Returns the lines that a program writes to standard output and standard error, as they come.
fn lines_of(child: &mut Child) -> mpsc::Receiver<String> {
    let (sender, lines) = mpsc::channel();
    let streams: [Option<Box<dyn Read + Send>>; 2] =
        [child.stdout.take().map(|s| Box::new(s) as Box<dyn Read + Send>), child.stderr.take().map(|s| Box::new(s) as _)];
    for stream in streams.into_iter().flatten() {
        let sender = sender.clone();
        std::thread::spawn(move || {
            for line in BufReader::new(stream).split(b'\n').map_while(std::result::Result::ok) {
                if sender.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                    break;
                }
            }
        });
    }
    lines
}

/// Returns how many views are done by a line of COLMAP: `Processed file [12/35]`, `Registering
/// image #5 (7)`, since 3.12 `Registering image #5 (num_reg_frames=7)`.
fn progress(line: &str) -> Option<u32> {
    let after = |mark: &str| line.split_once(mark).map(|(_, rest)| rest);
    let number = |text: &str| {
        let text = text.trim_start().trim_start_matches("num_reg_frames=");
        text.split(|c: char| !c.is_ascii_digit()).next().and_then(|n| n.parse().ok())
    };
    if let Some(rest) = after("Processed file [") {
        return number(rest);
    }
    after("Registering image #").and_then(|rest| rest.split_once('(')).and_then(|(_, rest)| number(rest))
}

/// Moves a model of other pictures out of the way. Returns its new place.
pub(super) fn set_aside(sparse: &Path) -> Result<PathBuf> {
    let aside = sparse.with_extension("old");
    if aside.exists() {
        std::fs::remove_dir_all(&aside).with_context(|| format!("{}: cannot remove", aside.display()))?;
    }
    std::fs::rename(sparse, &aside).with_context(|| format!("{}: cannot rename to {}", sparse.display(), aside.display()))?;
    Ok(aside)
}

/// The largest of the models that COLMAP made.
pub(super) struct LargestModel {
    pub(super) model: ColmapModel,
    /// Number of models in all.
    pub(super) models: usize,
}

/// Reads the model with the most images.
pub(super) fn largest_model(folders: &Folders) -> Result<LargestModel> {
    let sparse = folders.work.join("sparse");
    let entries = std::fs::read_dir(&sparse).with_context(|| format!("{}: cannot list", sparse.display()))?;
    let mut models = Vec::new();
    for folder in entries.flatten().map(|e| e.path()).filter(|p| p.join("cameras.bin").is_file() || p.join("cameras.txt").is_file()) {
        models.push(read_colmap_model(&folder)?);
    }
    let count = models.len();
    match models.into_iter().max_by_key(|model| model.images.len()) {
        Some(model) => Ok(LargestModel { model, models: count }),
        None => bail!(
            "COLMAP found no poses: views need more overlap or more detail; its pictures are in {}, its output is in {}",
            folders.output.join("proxies").display(),
            folders.work.join("colmap.log").display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_read_from_what_colmap_says() {
        assert_eq!(progress("Processed file [12/35]"), Some(12));
        assert_eq!(progress("I2024 feature.cc:1] Processed file [3/9]"), Some(3));
        assert_eq!(progress("Registering image #5 (17)"), Some(17));
        assert_eq!(progress("I2026 pipeline.cc:620] Registering image #8 (num_reg_frames=3)"), Some(3));
        assert_eq!(progress("  => Image sees 120 / 300 points"), None);
    }

    #[test]
    fn a_program_that_is_not_there_is_none() {
        assert!(Colmap::find(Path::new("/nowhere/colmap")).is_none());
        assert!(Colmap::find(Path::new("/nowhere/python3")).is_none());
    }
}
