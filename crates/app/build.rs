//! Finds the revision that this crate is built from: of the archive of a release, or of the clone.
//! Without either there is none, and the build goes on.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if let Some(revision) = of_archive().or_else(of_clone) {
        println!("cargo::rustc-env=LUXEL_REVISION={revision}");
    }
}

/// Returns the commit that `cargo package` notes in an archive.
fn of_archive() -> Option<String> {
    let noted = std::fs::read_to_string(".cargo_vcs_info.json").ok()?;
    let commit = noted.split_once("\"sha1\"")?.1.split('"').nth(1)?;
    Some(commit.chars().take(12).collect())
}

/// Returns what `git describe` says, if this crate's files are part of the repository around them.
fn of_clone() -> Option<String> {
    git(&["ls-files", "--error-unmatch", "Cargo.toml"])?;
    for name in ["HEAD", "logs/HEAD"] {
        let path = git(&["rev-parse", "--git-path", name])?;
        if Path::new(&path).exists() {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    git(&["describe", "--always", "--tags", "--abbrev=12"]).filter(|revision| !revision.is_empty())
}

fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
