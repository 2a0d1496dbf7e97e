//! What the program prints, where, and what it does not print.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use common::Workplace;

#[cfg(target_os = "linux")]
#[test]
fn graphics_drivers_are_quiet_without_a_display() {
    let place = Workplace::new();
    let said = |args: &[&str]| {
        let output = place.luxel(args).output().unwrap();
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    assert_eq!(said(&["info", "--devices"]), (true, String::new()));
    let quiet = ["train", "data", "-o", "run", "--iterations", "2", "--init-points", "20", "--device", "auto", "-q"];
    assert_eq!(said(&quiet), (true, String::new()));
}

#[cfg(target_os = "linux")]
#[test]
fn texts_that_cannot_be_written_are_an_error() {
    let place = Workplace::empty();
    for args in [&["help"][..], &["--help"], &["--version"], &["render", "--help"], &["help", "train"], &["completions", "zsh"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_luxel")).args(args).stdout(full).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}: {stderr}");
        assert!(stderr.starts_with("error: cannot write to standard output"), "{args:?}: {stderr}");
        // A reader that leaves is no error.
        place.ok_unread(args);
    }
    assert!(place.fails(2, &["rendre"]).contains("unrecognized subcommand"));
}

#[test]
fn no_colours_are_printed_into_a_pipe() {
    let place = Workplace::new();
    place.train("run", &[]);
    for args in [
        &["help"][..],
        &["rendre"],
        &["train", "data"],
        &["info", "run"],
        &["eval", "run"],
        &["render", "run", "-o", "frames"],
        &["render", "nowhere", "-o", "frames"],
        &["train", "data", "-o", "again", "--iterations", "2", "--init-points", "20"],
    ] {
        let output = place.luxel(args).output().unwrap();
        assert!(!output.stdout.contains(&0x1b) && !output.stderr.contains(&0x1b), "{args:?}: {output:?}");
    }
}
