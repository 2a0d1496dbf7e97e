//! `log.jsonl` of a run: one JSON object a line, every [`LOG_EVERY`] steps and before every
//! checkpoint.
//!
//! A line for step k is on disk before the checkpoint of step k, so that a resumed run finds the
//! training time spent so far. Resuming at k drops the lines after k and a line that a killed
//! process left unfinished.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

pub use luxel::LogRecord;
use luxel::Result;
use luxel::error::Context;

use super::plots::{PlotLog, Plots};
use crate::{files, schema};

/// Steps between lines: 300 points on a curve of 30000 steps.
pub const LOG_EVERY: u32 = 100;

/// An open log.
pub struct RunLog {
    path: PathBuf,
    file: File,
    plots: Plots,
}

impl RunLog {
    /// Keeps the lines up to `iteration` and appends after them; returns the last line kept. The
    /// plots that are asked for are written beside the log.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn open(path: &Path, iteration: u32, asked: &[PlotLog]) -> Result<(Self, Option<LogRecord>)> {
        let mut kept = read(path)?;
        kept.retain(|record| record.iteration <= iteration);
        let mut content = String::new();
        for record in &kept {
            content.push_str(&serde_json::to_string(&schema::LOG.versioned(record))?);
            content.push('\n');
        }
        files::write_text(path, &content)?;
        let file = File::options().append(true).open(path).with_context(|| format!("{}: cannot open", path.display()))?;
        let plots = Plots::begin(path.parent().unwrap_or(Path::new("")), asked, &kept)?;
        Ok((Self { path: path.into(), file, plots }, kept.pop()))
    }

    /// Appends a line in one write.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn append(&mut self, record: &LogRecord) -> Result<()> {
        let line = serde_json::to_string(&schema::LOG.versioned(record))? + "\n";
        self.file.write_all(line.as_bytes()).with_context(|| format!("{}: cannot write", self.path.display()))?;
        self.plots.append(record)
    }

    /// Waits until all lines are on disk. For use before a checkpoint: at every line it might take
    /// longer than the steps.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn sync(&mut self) -> Result<()> {
        self.file.sync_data().with_context(|| format!("{}: cannot write", self.path.display()))
    }
}

/// Reads the lines of a log; skips lines that are not records, such as one that a killed process
/// left unfinished. A missing file has none.
///
/// # Errors
/// A file that cannot be read.
pub fn read(path: &Path) -> Result<Vec<LogRecord>> {
    if !std::fs::exists(path).is_ok_and(|exists| exists) {
        return Ok(Vec::new());
    }
    let content = luxel_io::read_file(path)?;
    Ok(String::from_utf8_lossy(&content).lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns a record of a step.
    pub(in crate::run) fn record(iteration: u32) -> LogRecord {
        LogRecord {
            iteration,
            loss: 0.1,
            l1: Some(0.05),
            ssim: Some(0.9),
            psnr_train: Some(30.0),
            psnr_test: None,
            psnr_test_sample: Some(28.0),
            poses: None,
            vignetting_corner_ev: Vec::new(),
            splats: 10,
            visible: 5,
            iterations_per_second: 20.0,
            steps_left_at_pace: None,
            elapsed_s: f64::from(iteration) / 20.0,
            cpu_s: Some(f64::from(iteration) / 10.0),
            rss_bytes: Some(1 << 20),
            peak_rss_bytes: None,
        }
    }

    #[test]
    fn resuming_drops_later_and_torn_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let (mut log, last) = RunLog::open(&path, 0, &[]).unwrap();
        assert_eq!(last, None);
        for iteration in [100, 200, 300] {
            log.append(&record(iteration)).unwrap();
        }
        File::options().append(true).open(&path).unwrap().write_all(b"{\"iteration\": 40").unwrap();

        let (mut log, last) = RunLog::open(&path, 200, &[]).unwrap();
        assert_eq!(last, Some(record(200)));
        log.append(&record(250)).unwrap();
        assert_eq!(read(&path).unwrap(), [record(100), record(200), record(250)]);
    }
}
