//! Training of one cell in a process of its own, `luxel train --resume`: its memory is its own, and
//! a crash does not affect others.
//!
//! In: the program and a cell. Out: [`WorkerEvent`]s, then [`Ended`]. The child reports progress as
//! JSON lines on stdout. It saves and stops at the end of its standard input, which this process
//! holds open: the child ends with this process, however that ends.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};

use luxel::error::Context;
use luxel::{Error, Result};
use luxel_core::Remedy;
use serde::Deserialize;

use super::matrix::Cell;
use crate::run::EXIT_INTERRUPTED;

/// Bytes kept of a child's stderr: errors are at the end.
const STDERR_TAIL_BYTES: usize = 16 << 10;

/// The end of a cell's training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    Finished,
    /// A stop was requested; the state is saved.
    Interrupted,
    /// Another process trains it.
    Elsewhere,
}

/// An event that a child reports.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub(super) enum WorkerEvent {
    Progress {
        iteration: u32,
    },
    Warning {
        message: String,
    },
    #[serde(other)]
    Other,
}

/// A running child.
pub(super) struct Worker {
    child: Child,
}

impl Worker {
    /// Starts or continues the cell. Dropping the returned input stops the worker.
    pub(super) fn start(program: &Path, cell: &Cell, memory_gib: Option<u64>) -> Result<(Self, ChildStdin)> {
        // The settings mark the folder; a run without a step is continued from the beginning.
        cell.folder.write_config(&cell.config)?;
        let mut command = Command::new(program);
        command.args(arguments(cell.folder.root(), memory_gib));
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // A terminal's Ctrl-C is for this process, which stops its children.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().with_context(|| format!("{}: cannot start", program.display()))?;
        let stdin = child.stdin.take().context("a child has no standard input")?;
        Ok((Self { child }, stdin))
    }

    /// Reports the child's events until it ends.
    pub(super) fn wait(mut self, mut on_event: impl FnMut(WorkerEvent)) -> Result<Ended> {
        let (stdout, stderr) = (self.child.stdout.take(), self.child.stderr.take());
        let errors = std::thread::spawn(move || stderr.map_or_else(String::new, tail));
        for line in stdout.into_iter().flat_map(|stdout| BufReader::new(stdout).lines()) {
            let Ok(line) = line else { break };
            if let Ok(event) = serde_json::from_str(&line) {
                on_event(event);
            }
        }
        let status = self.child.wait().context("cannot wait for a child")?;
        let errors = errors.join().unwrap_or_default();
        match status.code() {
            Some(0) => Ok(Ended::Finished),
            Some(code) if code == i32::from(EXIT_INTERRUPTED) => Ok(Ended::Interrupted),
            Some(_) => Err(error_of(&errors)),
            None => {
                let text = format!("the process was killed ({status}), usually for lack of memory");
                Err(Error::new(text).with_remedy(Remedy::lower("jobs")))
            }
        }
    }
}

/// Returns the arguments of the child for a run's folder.
fn arguments(folder: &Path, memory_gib: Option<u64>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = ["train", "--resume", "--stop-at-end-of-input", "--log-format", "json"].map(Into::into).into();
    if let Some(gib) = memory_gib {
        arguments.extend(["--memory".into(), gib.to_string().into()]);
    }
    arguments.extend(["-o".into(), folder.into()]);
    arguments
}

/// Returns the end of a stream.
fn tail(mut stream: impl Read) -> String {
    let (mut kept, mut buffer) = (Vec::new(), [0; 4096]);
    while let Ok(count @ 1..) = stream.read(&mut buffer) {
        kept.extend(buffer.iter().take(count));
        let excess = kept.len().saturating_sub(STDERR_TAIL_BYTES);
        kept.drain(..excess);
    }
    String::from_utf8_lossy(&kept).into_owned()
}

/// Returns the error that a child printed, with its causes.
fn error_of(stderr: &str) -> Error {
    let lines: Vec<&str> = stderr.lines().collect();
    let Some(at) = lines.iter().rposition(|line| line.starts_with("error: ")) else {
        return Error::new(format!("the process failed without a message: {}", lines.last().copied().unwrap_or("nothing on stderr")));
    };
    let causes = lines[at + 1..].iter().filter_map(|line| line.trim_start().strip_prefix("caused by: "));
    let mut parts: Vec<&str> = causes.collect();
    parts.insert(0, lines[at].trim_start_matches("error: "));
    Error::new(parts.join(": "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_known_by_name_and_others_pass() {
        let event = |line: &str| serde_json::from_str::<WorkerEvent>(line).ok();
        let progress = event(r#"{"event":"progress","iteration":300,"iterations_per_second":12.5,"loss":0.1}"#);
        assert_eq!(progress, Some(WorkerEvent::Progress { iteration: 300 }));
        assert_eq!(event(r#"{"event":"warning","message":"8 bits"}"#), Some(WorkerEvent::Warning { message: "8 bits".into() }));
        assert_eq!(event(r#"{"event":"evaluation","mean":{}}"#), Some(WorkerEvent::Other));
        assert_eq!(event("no JSON"), None);
    }

    #[test]
    fn the_limit_of_memory_is_passed_on() {
        let text = |memory_gib| arguments(Path::new("runs/a"), memory_gib).join(" ".as_ref()).into_string().unwrap();
        assert!(text(Some(7)).contains(" --memory 7 ") && text(Some(7)).ends_with(" -o runs/a"), "{}", text(Some(7)));
        assert!(!text(None).contains("--memory"));
    }

    #[test]
    fn an_error_has_its_causes_and_nothing_before_it() {
        let stderr = "warning: odd\nerror: cannot read the data set\n  caused by: images/000.exr: truncated\n";
        assert_eq!(error_of(stderr).to_string(), "cannot read the data set: images/000.exr: truncated");
        assert_eq!(error_of("Killed\n").to_string(), "the process failed without a message: Killed");
    }

    #[test]
    fn only_the_end_of_a_stream_is_kept() {
        let text = "x".repeat(3 * STDERR_TAIL_BYTES) + "end";
        let kept = tail(text.as_bytes());
        assert!(kept.len() == STDERR_TAIL_BYTES && kept.ends_with("xend"));
    }
}
