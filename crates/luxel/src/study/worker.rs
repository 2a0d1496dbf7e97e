//! One cell in a process of its own: `luxel train --resume`, so that its memory is its own and a crash takes nothing else with it.
//!
//! The child tells its progress as JSON lines on stdout, and stops, having saved, at the end of its standard input, which this process holds open: it
//! ends with this process, however that ends.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};

use crate::error::Context;
use crate::{Error, Result};
use luxel_core::Remedy;
use serde::Deserialize;

use super::matrix::Cell;
use crate::run::EXIT_INTERRUPTED;

/// What is kept of a child's stderr, bytes: errors are at the end.
const STDERR_TAIL_BYTES: usize = 16 << 10;

/// How a cell ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    Finished,
    /// Asked to stop; the state is saved.
    Interrupted,
}

/// What a child tells.
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

/// A child at work.
pub(super) struct Worker {
    child: Child,
}

impl Worker {
    /// Starts or continues the cell. Dropping what stands beside the worker stops it.
    pub(super) fn start(program: &Path, cell: &Cell) -> Result<(Self, ChildStdin)> {
        // The mark and the settings first; a run that has made no step is continued from the beginning.
        cell.folder.write_config(&cell.config)?;
        let mut command = Command::new(program);
        command.args(["train", "--resume", "--stop-at-end-of-input", "--log-format", "json", "-o"]).arg(cell.folder.root());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // A terminal's Ctrl-C is for this process, which tells its children.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().with_context(|| format!("{}: cannot start", program.display()))?;
        let stdin = child.stdin.take().context("a child has no standard input")?;
        Ok((Self { child }, stdin))
    }

    /// Follows the child to its end.
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

/// The last of a stream.
fn tail(mut stream: impl Read) -> String {
    let (mut kept, mut buffer) = (Vec::new(), [0; 4096]);
    while let Ok(count @ 1..) = stream.read(&mut buffer) {
        kept.extend(buffer.iter().take(count));
        let excess = kept.len().saturating_sub(STDERR_TAIL_BYTES);
        kept.drain(..excess);
    }
    String::from_utf8_lossy(&kept).into_owned()
}

/// The error that a child has printed, with its causes.
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
        let told = |line: &str| serde_json::from_str::<WorkerEvent>(line).ok();
        let progress = told(r#"{"event":"progress","iteration":300,"iterations_per_second":12.5,"loss":0.1}"#);
        assert_eq!(progress, Some(WorkerEvent::Progress { iteration: 300 }));
        assert_eq!(told(r#"{"event":"warning","message":"8 bits"}"#), Some(WorkerEvent::Warning { message: "8 bits".into() }));
        assert_eq!(told(r#"{"event":"evaluation","mean":{}}"#), Some(WorkerEvent::Other));
        assert_eq!(told("no JSON"), None);
    }

    #[test]
    fn an_error_comes_with_its_causes_and_without_what_was_before() {
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
