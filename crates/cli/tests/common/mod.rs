//! A tiny data set and a way to run the program.
#![allow(
    missing_docs,
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    reason = "each test uses some of these helpers, which fail the test"
)]

mod shared_run;

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use luxel_core::Image;
use luxel_io::{ExrOptions, ExrSample, ReadOptions};

/// Pixels a side.
pub const SIDE: usize = 24;
pub const VIEWS: usize = 9;

/// A folder that goes away with it.
pub struct Workplace {
    folder: tempfile::TempDir,
}

impl Workplace {
    /// With a data set in `data`.
    pub fn new() -> Self {
        let place = Self::empty();
        write_dataset(&place.path("data"));
        place
    }

    pub fn empty() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// In a folder of this place, for what outlives the test.
    fn within(folder: &Path) -> Self {
        Self { folder: tempfile::tempdir_in(folder).unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The program, in this folder.
    pub fn luxel(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
        command.current_dir(self.folder.path()).env_remove("RUST_LOG").args(args);
        // As on a server: the program must keep graphics drivers from complaining about it.
        command.env_remove("XDG_RUNTIME_DIR");
        command
    }

    /// Runs to success; stdout.
    pub fn ok(&self, args: &[&str]) -> String {
        let output = self.luxel(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{args:?}: {:?}\n{stderr}", output.status);
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs to success; stderr.
    pub fn notes(&self, args: &[&str]) -> String {
        let output = self.luxel(args).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{args:?}\n{stderr}");
        stderr
    }

    /// Runs to a failure with this exit code; stderr.
    pub fn fails(&self, code: i32, args: &[&str]) -> String {
        let output = self.luxel(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{args:?}\n{stderr}");
        stderr
    }

    /// Runs to an error; its message must have every one of `parts`.
    pub fn error(&self, args: &[&str], parts: &[&str]) {
        let stderr = self.fails(1, args);
        assert!(stderr.lines().any(|line| line.starts_with("error: ")), "{args:?}\n{stderr}");
        assert!(!stderr.contains("panicked"), "{args:?}\n{stderr}");
        for part in parts {
            assert!(stderr.contains(part), "{args:?}: no \"{part}\" in\n{stderr}");
        }
    }

    /// Runs to success with a reader of stdout that has left.
    pub fn ok_unread(&self, args: &[&str]) {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_luxel"));
        let status =
            command.current_dir(self.folder.path()).args(args).stdout(writer).stderr(std::process::Stdio::null()).status().unwrap();
        assert!(status.success(), "{args:?}: {status:?}");
    }

    /// Trains `run` for a few steps. The run that many tests begin with, `run` without further
    /// options on the data set as it is, is trained once and copied.
    pub fn train(&self, run: &str, more: &[&str]) -> String {
        if run == "run"
            && more.is_empty()
            && !self.path(run).exists()
            && let Some(stdout) = shared_run::copy(self)
        {
            return stdout;
        }
        self.train_anew(run, more)
    }

    fn train_anew(&self, run: &str, more: &[&str]) -> String {
        let mut args = vec!["train", "data", "-o", run];
        args.extend(QUICK);
        args.extend(more);
        self.ok(&args)
    }

    /// Runs to success with events on stdout, one JSON object a line; those of this name.
    pub fn events(&self, args: &[&str], name: &str) -> Vec<serde_json::Value> {
        let told = self.ok(&[args, &["--log-format", "json"]].concat());
        let events =
            told.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{args:?}: {error} in {line}\n{told}")));
        events.filter(|event: &serde_json::Value| event["event"] == name).collect()
    }

    pub fn image(&self, name: &str) -> Image {
        luxel_io::read_image(&self.path(name), &ReadOptions::default()).unwrap().image
    }

    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).unwrap()).unwrap()
    }
}

/// Options of the shortest run that means something.
pub const QUICK: [&str; 6] = ["--iterations", "40", "--init-points", "300", "--threads", "2"];

/// Three balls of light from an arc of cameras.
pub fn write_dataset(folder: &Path) {
    luxel::synthetic::write_dataset(folder, luxel::synthetic::BallsOptions { side_px: SIDE, views: VIEWS }).unwrap();
}

/// A float EXR.
pub fn write_image(path: &Path, image: &Image) {
    luxel_io::write_exr(path, image, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
}
