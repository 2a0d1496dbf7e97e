//! Structure from motion by COLMAP, a separate program: its commands, progress and result.
//!
//! In: proxies in a folder, with the camera of each. Out: models in `work/sparse`, of which the
//! largest is read. SIFT runs on the processor. All proxies of one camera share a lens: features
//! are extracted camera by camera into one database. COLMAP's output goes to `work/colmap.log`.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use luxel_capture::prepare::{PlannedCamera, ViewRecord};
use luxel_io::colmap::{ColmapModel, read_colmap_model};

use super::folders::{Folders, proxy_name};
use super::{Matching, MotionOptions};
use crate::error::{Context, bail};
use crate::files::{remove_if_there, write_text};
use crate::{Event, ItemKind, Observer, Result};

/// Number of views up to which every pair is matched.
const EXHAUSTIVE_VIEWS: usize = 200;
/// Number of COLMAP's last lines that an error has.
const LAST_LINES: usize = 6;

/// An installed COLMAP.
#[derive(Clone, Debug)]
pub(super) struct Colmap {
    program: PathBuf,
    /// Its name and version: `COLMAP 3.8`.
    pub(super) version: String,
    /// Whether options begin with FeatureExtraction and FeatureMatching, as since 3.12, in place of
    /// SiftExtraction and SiftMatching.
    has_feature_options: bool,
}

/// A command to be run.
pub(super) struct Step {
    /// Its purpose, for people.
    purpose: &'static str,
    arguments: Vec<OsString>,
}

impl Colmap {
    /// Asks a program for its version and options. Returns `None` if there is no such program.
    pub(super) fn find(program: &Path) -> Option<Self> {
        let help = |arguments: &[&str]| {
            let output = Command::new(program).args(arguments).env("QT_QPA_PLATFORM", "offscreen").stdin(Stdio::null()).output().ok()?;
            Some(String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr))
        };
        let version = help(&["-h"])?.lines().find(|line| line.contains("COLMAP")).map(|line| line.trim().to_owned())?;
        let has_feature_options = help(&["feature_extractor", "-h"])?.contains("FeatureExtraction.use_gpu");
        Some(Self { program: program.to_owned(), version, has_feature_options })
    }

    /// Returns a COLMAP that is not installed, for commands that are only written down.
    pub(super) fn unknown(program: &Path) -> Self {
        Self { program: program.to_owned(), version: String::new(), has_feature_options: false }
    }

    /// Returns the commands, in order. Writes the lists of images by camera.
    pub(super) fn steps(
        &self,
        folders: &Folders,
        views: &[ViewRecord],
        cameras: &[PlannedCamera],
        options: MotionOptions,
    ) -> Result<Vec<Step>> {
        let (extraction, matches) =
            if self.has_feature_options { ("--FeatureExtraction", "--FeatureMatching") } else { ("--SiftExtraction", "--SiftMatching") };
        let database = folders.work.join("database.db");
        let pictures = folders.output.join("proxies");
        let mut lists: BTreeMap<(usize, [usize; 2]), Vec<&ViewRecord>> = BTreeMap::new();
        for view in views {
            lists.entry((view.camera, view.proxy_px)).or_default().push(view);
        }
        let mut steps = Vec::new();
        for (number, ((camera, [width, height]), views)) in lists.iter().enumerate() {
            let list = folders.work.join(format!("camera_{number}.txt"));
            write_text(&list, &(views.iter().map(|v| proxy_name(&v.name)).collect::<Vec<_>>().join("\n") + "\n"))?;
            let mut arguments = paths(
                "feature_extractor",
                &[
                    PathOption::new("--database_path", &database),
                    PathOption::new("--image_path", &pictures),
                    PathOption::new("--image_list_path", &list),
                ],
            );
            let mut add = |name: &str, value: &str| arguments.extend([name.into(), value.into()]);
            add("--ImageReader.single_camera", "1");
            add("--ImageReader.camera_model", options.camera_model.name());
            if let Some(focal) = cameras.get(*camera).and_then(|c| c.focal_per_side) {
                let (w, h) = (*width as f64, *height as f64);
                add("--ImageReader.camera_params", &options.camera_model.params(focal * w.max(h), [0.5 * w, 0.5 * h]));
            }
            add(&format!("{extraction}.use_gpu"), "0");
            steps.push(Step { purpose: "features", arguments });
        }
        let is_exhaustive = match options.matching {
            Matching::Auto => views.len() <= EXHAUSTIVE_VIEWS,
            Matching::Exhaustive => true,
            Matching::Sequential => false,
        };
        let mut arguments = paths(
            if is_exhaustive { "exhaustive_matcher" } else { "sequential_matcher" },
            &[PathOption::new("--database_path", &database)],
        );
        arguments.extend([format!("{matches}.use_gpu").into(), "0".into()]);
        steps.push(Step { purpose: "matches", arguments });
        let sparse = folders.work.join("sparse");
        let arguments = paths(
            "mapper",
            &[
                PathOption::new("--database_path", &database),
                PathOption::new("--image_path", &pictures),
                PathOption::new("--output_path", &sparse),
            ],
        );
        steps.push(Step { purpose: "poses", arguments });
        Ok(steps)
    }

    /// Returns the commands as a script, to be run elsewhere: paths are relative to the data set,
    /// and options are those of the release that is installed there.
    pub(super) fn script(&self, steps: &[Step], folders: &Folders) -> String {
        let program = quoted(&self.program.to_string_lossy());
        let mut out = String::from(
            "#!/bin/sh\n# Poses of the pictures in proxies/, by COLMAP, into work/sparse.\nset -e\ncd \"$(dirname \"$0\")\"\n",
        );
        out += "# Files of an earlier run are of other pictures.\n";
        out += "rm -rf work/sparse work/database.db work/database.db-wal work/database.db-shm\nmkdir -p work/sparse\n";
        out += "# Since COLMAP 3.12 two groups of options have other names.\nextraction=SiftExtraction matching=SiftMatching\n";
        out += &format!("if {program} feature_extractor -h 2>&1 | grep -q FeatureExtraction.use_gpu; then\n");
        out += "  extraction=FeatureExtraction matching=FeatureMatching\nfi\n";
        for step in steps {
            let word = |argument: &OsString| {
                let path = Path::new(argument).strip_prefix(&folders.output).unwrap_or(Path::new(argument));
                match path.to_string_lossy().as_ref() {
                    "--SiftExtraction.use_gpu" => "--$extraction.use_gpu".to_owned(),
                    "--SiftMatching.use_gpu" => "--$matching.use_gpu".to_owned(),
                    other => quoted(other),
                }
            };
            let words = step.arguments.iter().map(word).collect::<Vec<_>>().join(" ");
            out += &format!("{program} {words}\n");
        }
        out
    }

    /// Runs the commands on a fresh database.
    pub(super) fn run(&self, steps: &[Step], folders: &Folders, views: usize, observer: &dyn Observer) -> Result<()> {
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
            self.run_step(step, views, &mut log, observer)?;
        }
        Ok(())
    }

    fn run_step(&self, step: &Step, views: usize, log: &mut Log, observer: &dyn Observer) -> Result<()> {
        let mut child = Command::new(&self.program)
            .args(&step.arguments)
            .env("QT_QPA_PLATFORM", "offscreen")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("{}: cannot start", self.program.display()))?;
        let total = views as u32;
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
/// image #5 (7)`.
fn progress(line: &str) -> Option<u32> {
    let after = |mark: &str| line.split_once(mark).map(|(_, rest)| rest);
    let number = |text: &str| text.trim_start().split(|c: char| !c.is_ascii_digit()).next().and_then(|n| n.parse().ok());
    if let Some(rest) = after("Processed file [") {
        return number(rest);
    }
    after("Registering image #").and_then(|rest| rest.split_once('(')).and_then(|(_, rest)| number(rest))
}

/// An option of COLMAP that has a path.
struct PathOption<'a> {
    name: &'static str,
    path: &'a Path,
}

impl<'a> PathOption<'a> {
    fn new(name: &'static str, path: &'a Path) -> Self {
        Self { name, path }
    }
}

/// Returns a command of COLMAP with options that have paths.
fn paths(command: &str, options: &[PathOption<'_>]) -> Vec<OsString> {
    let mut out = vec![OsString::from(command)];
    for option in options {
        out.extend([OsString::from(option.name), option.path.as_os_str().to_owned()]);
    }
    out
}

/// Returns a word quoted for a shell.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
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
        assert_eq!(progress("  => Image sees 120 / 300 points"), None);
    }

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(quoted("a/b-c.db"), "a/b-c.db");
        assert_eq!(quoted("my photos"), "'my photos'");
        assert_eq!(quoted("it's"), "'it'\\''s'");
    }

    #[test]
    fn a_program_that_is_not_there_is_none() {
        assert!(Colmap::find(Path::new("/nowhere/colmap")).is_none());
    }
}
