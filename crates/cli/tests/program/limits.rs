//! The limits that the book and the README state are those of the program: each command of
//! `docs/src/reference/limits.csv` ends with the words that the table quotes.

use std::path::Path;

use crate::common::{self, Workplace};

/// A row of the table.
#[derive(serde::Deserialize)]
struct Limit {
    kind: String,
    command: String,
    says: String,
}

fn limits() -> Vec<Limit> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/reference/limits.csv");
    csv::Reader::from_path(path).unwrap().deserialize().collect::<Result<_, _>>().unwrap()
}

/// Returns a place with what the page says that its commands find: a data set `my-images`, a run
/// `run`, a radiance field `field`, an export `set.html`, and a photograph `raw/IMG_0001.CR2`.
fn place() -> Workplace {
    let place = Workplace::new();
    place.train("run", &[]);
    common::write_dataset(&place.path("my-images"));
    place.ok(&["train", "data", "-o", "field", "--method", "nerf-grid", "--iterations", "2", "--eval-at", "0", "--threads", "2"]);
    place.ok(&["export", "run", "-o", "set.html", "--threads", "2"]);
    std::fs::create_dir(place.path("raw")).unwrap();
    std::fs::write(place.path("raw/IMG_0001.CR2"), "not read").unwrap();
    place
}

/// Returns whether this program has what the command shows to be missing.
fn is_built_in(command: &str) -> bool {
    cfg!(feature = "camera-raw") && command.contains("prepare raw") || cfg!(feature = "mpi") && command.contains("--distributed")
}

#[test]
fn every_limit_of_the_book_is_one_of_the_program() {
    let place = place();
    let refused: Vec<_> = limits().into_iter().filter(|limit| limit.kind == "refused").collect();
    assert!(refused.len() >= 8, "{} rows with a command", refused.len());
    for Limit { command, says, .. } in &refused {
        let words: Vec<_> = command.trim_matches('`').split(' ').collect();
        assert!(words[0] == "luxel" && !says.is_empty(), "{command}: expected a command of luxel and its words");
        if is_built_in(command) {
            continue;
        }
        // Without the programs that the page says are not installed.
        let output = place.luxel(&words[1..]).env("PATH", "").output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{command}\n{stderr}");
        assert!(stderr.contains(says.as_str()), "{command}: no \"{says}\" in\n{stderr}");
    }
}

#[test]
fn limits_without_a_command_have_none_that_is_half_there() {
    for limit in limits().iter().filter(|limit| limit.kind != "refused") {
        assert!(["untried", "nature"].contains(&limit.kind.as_str()), "{}", limit.kind);
        assert!(limit.command.is_empty() && limit.says.is_empty(), "{}", limit.command);
    }
}
