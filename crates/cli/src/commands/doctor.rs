//! `luxel doctor`: what of this machine and of other programs Luxel can use, what each is for, and
//! how to get what is missing. Nothing that is missing is an error.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use anyhow::Result;
use luxel_app::{build_info, machine, schema};
use serde_json::Value;

use crate::args::{self, DoctorArgs};
use crate::commands::devices;
use crate::inputs::programs;
use crate::output::console::Console;
use crate::output::tree::Tree;

/// Longest wait for another program's version.
const LONGEST_WAIT: Duration = Duration::from_secs(10);

/// Another program.
struct Program {
    name: &'static str,
    /// Arguments that print the version.
    version: &'static [&'static str],
    /// A part of the line with the version.
    mark: &'static str,
    needed_for: &'static str,
    install: &'static str,
}

const PROGRAMS: [Program; 2] = [
    Program {
        name: "colmap",
        version: &["-h"],
        mark: "COLMAP",
        needed_for: "poses of photographs: luxel prepare",
        install: "Debian: apt-get install colmap; macOS: brew install colmap; others: colmap.github.io",
    },
    Program {
        name: "ffmpeg",
        version: &["-version"],
        mark: "ffmpeg version",
        needed_for: "videos: luxel render --video, luxel prepare VIDEO",
        install: "Debian: apt-get install ffmpeg; macOS: brew install ffmpeg; others: ffmpeg.org",
    },
];

/// Looks and prints.
pub(crate) fn run(args: &DoctorArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let facts = describe();
    let text = if args.json { facts.document(schema::DOCTOR) } else { facts.text().trim_end().to_owned() };
    console.finish(facts.json(), &text)
}

fn describe() -> Tree {
    let mut facts = Tree::default();
    let mut program = Tree::default();
    program.set("version", luxel::VERSION).set("revision", build_info::REVISION.map_or(Value::Null, Value::from));
    program.set("features", args::features().join(", "));
    if let Ok(path) = std::env::current_exe() {
        program.set("file", path.display().to_string());
    }
    facts.group("luxel", program);
    let mut about = Tree::default();
    for (name, value) in machine::facts(std::thread::available_parallelism().map_or(1, usize::from)) {
        about.set(name, value);
    }
    about.set("memory_for_reading_a_file_bytes", luxel_io::memory_limit());
    facts.group("machine", about);
    facts.group("temporary_folder", temporary_folder());
    facts.group("devices", devices::describe());
    for program in &PROGRAMS {
        facts.group(program.name, describe_program(program));
    }
    facts.group("pycolmap", describe_pycolmap());
    facts
}

fn describe_program(program: &Program) -> Tree {
    let mut facts = Tree::default();
    facts.set("needed_for", program.needed_for);
    match programs::find(Path::new(program.name)) {
        Some(path) => {
            facts.set("found", path.display().to_string());
            let said = output_of(&path, program.version).unwrap_or_default();
            let line = said.lines().find(|line| line.contains(program.mark));
            facts.set("version", line.map_or("does not tell", |line| line.split(" Copyright").next().unwrap_or(line).trim()));
        }
        None => {
            facts.set("found", "no").set("install", program.install);
        }
    }
    facts
}

/// Describes COLMAP's Python package, with which COLMAP's models can be made too.
fn describe_pycolmap() -> Tree {
    let mut facts = Tree::default();
    facts.set("needed_for", "luxel prepare: poses, where there is no colmap");
    let script = "import pycolmap; print('pycolmap', pycolmap.__version__, pycolmap.__file__)";
    let printed = |name| output_of(&programs::find(Path::new(name))?, &["-c", script]);
    let package = ["python3", "python"].into_iter().find_map(|name| PythonPackage::from_output(&printed(name)?));
    match package {
        Some(PythonPackage { version, file }) => facts.set("found", file).set("version", version),
        None => facts.set("found", "no").set("install", "pip install pycolmap"),
    };
    facts
}

/// The Python package pycolmap, as it names itself.
#[derive(Debug, PartialEq)]
struct PythonPackage {
    version: String,
    file: String,
}

impl PythonPackage {
    /// Reads the line "pycolmap VERSION FILE"; `None` if there is none, but an error of Python.
    fn from_output(printed: &str) -> Option<Self> {
        let (version, file) = printed.lines().find_map(|line| line.strip_prefix("pycolmap ")?.split_once(' '))?;
        Some(Self { version: version.to_owned(), file: file.trim().to_owned() })
    }
}

/// Returns what a program prints on both outputs; `None` where it cannot be started or takes long.
fn output_of(program: &Path, args: &[&str]) -> Option<String> {
    let mut command = Command::new(program);
    command.args(args).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let (send, receive) = mpsc::channel();
    std::thread::spawn(move || send.send(command.output()));
    let output = receive.recv_timeout(LONGEST_WAIT).ok()?.ok()?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr))
}

/// Describes the folder that other programs' files and those of tests go to.
fn temporary_folder() -> Tree {
    let folder = std::env::temp_dir();
    let probe = folder.join(format!(".luxel-doctor-{}", std::process::id()));
    let is_writable = std::fs::write(&probe, "").is_ok();
    // Where it could not be written, there is none.
    let _ = std::fs::remove_file(probe);
    let mut facts = Tree::default();
    facts.set("path", folder.display().to_string()).set("writable", is_writable);
    if !is_writable {
        facts.set("remedy", "set the environment variable TMPDIR (Windows: TEMP) to a folder that can be written");
    }
    facts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_package_is_found_by_its_own_line_and_not_by_an_error_of_python() {
        let error = "Traceback (most recent call last):\n  File \"<string>\", line 1, in <module>\nModuleNotFoundError: No module named 'pycolmap'\n";
        assert_eq!(PythonPackage::from_output(error), None);
        let package = PythonPackage { version: "4.2.0".to_owned(), file: "/usr/lib/pycolmap/__init__.py".to_owned() };
        assert_eq!(PythonPackage::from_output("a warning\npycolmap 4.2.0 /usr/lib/pycolmap/__init__.py\n"), Some(package));
    }
}
