//! Structure from motion by COLMAP, a program of its own: commands, progress, what came of it.
//!
//! In: proxies in a folder, with the camera of each. Out: models in `work/sparse`, of which the largest is read. SIFT runs on the processor. One
//! lens is shared by all proxies of one camera: features are extracted camera by camera into one database. What COLMAP says goes to
//! `work/colmap.log`.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc;

use crate::error::{Context, bail};
use crate::files::write_text;
use luxel_capture::prepare::{PlannedCamera, ViewRecord};
use luxel_io::colmap::{ColmapModel, read_colmap_model};

use super::folders::{Folders, proxy_name};
use super::{Matching, MotionOptions};
use crate::{Event, ItemKind, Observer, Result};

/// Views up to which each is matched with each.
const EXHAUSTIVE_VIEWS: usize = 200;
/// Lines of COLMAP that an error shows.
const LAST_LINES: usize = 6;

/// An installed COLMAP.
#[derive(Clone, Debug)]
pub(super) struct Colmap {
    program: PathBuf,
    /// `COLMAP 3.8`.
    pub(super) version: String,
    /// Since 3.12 options of features and matches begin with these instead of SiftExtraction and SiftMatching.
    has_feature_options: bool,
}

/// One of the commands to be run.
pub(super) struct Step {
    /// For people.
    what: &'static str,
    arguments: Vec<OsString>,
}

impl Colmap {
    /// `None` if there is no such program.
    pub(super) fn find(program: &Path) -> Option<Self> {
        let help = |arguments: &[&str]| {
            let output = Command::new(program).args(arguments).env("QT_QPA_PLATFORM", "offscreen").stdin(Stdio::null()).output().ok()?;
            Some(String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr))
        };
        let version = help(&["-h"])?.lines().find(|line| line.contains("COLMAP")).map(|line| line.trim().to_owned())?;
        let has_feature_options = help(&["feature_extractor", "-h"])?.contains("FeatureExtraction.use_gpu");
        Some(Self { program: program.to_owned(), version, has_feature_options })
    }

    /// As the current release has it, for commands that are only shown.
    pub(super) fn unknown(program: &Path) -> Self {
        Self { program: program.to_owned(), version: String::new(), has_feature_options: false }
    }

    /// The commands, in order. Writes the lists of images by camera.
    pub(super) fn steps(
        &self,
        folders: &Folders,
        views: &[ViewRecord],
        cameras: &[PlannedCamera],
        options: MotionOptions,
    ) -> Result<Vec<Step>> {
        let MotionOptions { camera_model: model, matching } = options;
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
            let mut arguments =
                paths("feature_extractor", &[("--database_path", &database), ("--image_path", &pictures), ("--image_list_path", &list)]);
            let mut give = |name: &str, value: &str| arguments.extend([name.into(), value.into()]);
            give("--ImageReader.single_camera", "1");
            give("--ImageReader.camera_model", model.name());
            if let Some(focal) = cameras.get(*camera).and_then(|c| c.focal_per_side) {
                let (w, h) = (*width as f64, *height as f64);
                give("--ImageReader.camera_params", &model.params(focal * w.max(h), [0.5 * w, 0.5 * h]));
            }
            give(&format!("{extraction}.use_gpu"), "0");
            steps.push(Step { what: "features", arguments });
        }
        let is_exhaustive = match matching {
            Matching::Auto => views.len() <= EXHAUSTIVE_VIEWS,
            Matching::Exhaustive => true,
            Matching::Sequential => false,
        };
        let mut arguments =
            paths(if is_exhaustive { "exhaustive_matcher" } else { "sequential_matcher" }, &[("--database_path", &database)]);
        arguments.extend([format!("{matches}.use_gpu").into(), "0".into()]);
        steps.push(Step { what: "matches", arguments });
        let sparse = folders.work.join("sparse");
        let arguments = paths("mapper", &[("--database_path", &database), ("--image_path", &pictures), ("--output_path", &sparse)]);
        steps.push(Step { what: "poses", arguments });
        Ok(steps)
    }

    /// The commands as a script, for those who run them elsewhere: paths are those below the data set, and options are those of the release that
    /// is there.
    pub(super) fn script(&self, steps: &[Step], folders: &Folders) -> String {
        let program = quoted(&self.program.to_string_lossy());
        let mut out = String::from(
            "#!/bin/sh\n# Poses of the pictures in proxies/, by COLMAP, into work/sparse.\nset -e\ncd \"$(dirname \"$0\")\"\n",
        );
        out += "# What an earlier time left is of other pictures.\n";
        out += "rm -rf work/sparse work/database.db work/database.db-wal work/database.db-shm\nmkdir -p work/sparse\n# Since COLMAP 3.12 two groups of options have other names.\nextraction=SiftExtraction matching=SiftMatching\n";
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
        for path in [folders.work.join("database.db"), folders.work.join("database.db-wal"), folders.work.join("database.db-shm")] {
            if path.exists() {
                std::fs::remove_file(&path).with_context(|| format!("{}: cannot remove", path.display()))?;
            }
        }
        if sparse.exists() {
            std::fs::remove_dir_all(&sparse).with_context(|| format!("{}: cannot remove", sparse.display()))?;
        }
        std::fs::create_dir_all(&sparse).with_context(|| format!("{}: cannot create", sparse.display()))?;
        let log_path = folders.work.join("colmap.log");
        let mut log = std::fs::File::create(&log_path).with_context(|| format!("{}: cannot write", log_path.display()))?;
        for step in steps {
            observer.note(&format!("COLMAP: {}", step.what));
            self.run_step(step, views, &mut log, &log_path, observer)?;
        }
        Ok(())
    }

    fn run_step(&self, step: &Step, views: usize, log: &mut std::fs::File, log_path: &Path, observer: &dyn Observer) -> Result<()> {
        let mut child = Command::new(&self.program)
            .args(&step.arguments)
            .env("QT_QPA_PLATFORM", "offscreen")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("{}: cannot start", self.program.display()))?;
        let (sender, lines) = mpsc::channel();
        let streams: [Option<Box<dyn Read + Send>>; 2] =
            [child.stdout.take().map(|s| Box::new(s) as Box<dyn Read + Send>), child.stderr.take().map(|s| Box::new(s) as _)];
        for stream in streams.into_iter().flatten() {
            let sender = sender.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(stream).split(b'\n').map_while(Result::ok) {
                    if sender.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let mut last: Vec<String> = Vec::new();
        observer.event(Event::StepsBegin { done: 0, total: views as u32 });
        for line in lines {
            // A log that cannot be written is no reason to stop.
            let _ = writeln!(log, "{line}");
            if let Some(done) = progress(&line) {
                observer.event(Event::Step { done });
                let name = step.what.to_owned();
                observer.event(Event::Item { kind: ItemKind::StructureFromMotion, name, done, total: views as u32 });
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
            bail!("COLMAP failed in its step \"{}\" ({status}): {}; all it said is in {}", step.what, last.join(" | "), log_path.display());
        }
        Ok(())
    }
}

/// How many views a line of COLMAP says are done: `Processed file [12/35]`, `Registering image #5 (7)`.
fn progress(line: &str) -> Option<u32> {
    let after = |mark: &str| line.split_once(mark).map(|(_, rest)| rest);
    let number = |text: &str| text.trim_start().split(|c: char| !c.is_ascii_digit()).next().and_then(|n| n.parse().ok());
    if let Some(rest) = after("Processed file [") {
        return number(rest);
    }
    after("Registering image #").and_then(|rest| rest.split_once('(')).and_then(|(_, rest)| number(rest))
}

fn paths(command: &str, options: &[(&str, &PathBuf)]) -> Vec<OsString> {
    let mut out = vec![OsString::from(command)];
    for (name, path) in options {
        out.extend([OsString::from(name), path.as_os_str().to_owned()]);
    }
    out
}

/// For a shell.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}

/// Puts a model that is of other pictures out of the way. Returns where it is.
pub(super) fn set_aside(sparse: &Path) -> Result<PathBuf> {
    let aside = sparse.with_extension("old");
    if aside.exists() {
        std::fs::remove_dir_all(&aside).with_context(|| format!("{}: cannot remove", aside.display()))?;
    }
    std::fs::rename(sparse, &aside).with_context(|| format!("{}: cannot rename to {}", sparse.display(), aside.display()))?;
    Ok(aside)
}

/// The model with the most images, and how many models there are.
pub(super) fn largest_model(folders: &Folders) -> Result<(ColmapModel, usize)> {
    let sparse = folders.work.join("sparse");
    let entries = std::fs::read_dir(&sparse).with_context(|| format!("{}: cannot list", sparse.display()))?;
    let mut models = Vec::new();
    for folder in entries.flatten().map(|e| e.path()).filter(|p| p.join("cameras.bin").is_file() || p.join("cameras.txt").is_file()) {
        models.push(read_colmap_model(&folder)?);
    }
    let count = models.len();
    match models.into_iter().max_by_key(|model| model.images.len()) {
        Some(model) => Ok((model, count)),
        None => bail!(
            "COLMAP found no poses: views need more overlap or more to see; the pictures it saw are in {}, what it said in {}",
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
