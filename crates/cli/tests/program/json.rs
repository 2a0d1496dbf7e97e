//! Every JSON document states the version of its schema, which is that of the reference page.

use luxel_app::schema::{self, Document};
use serde_json::Value;

use crate::common::Workplace;

/// Checks that a document is JSON and states the version.
fn check(document: Document, text: &str) {
    let value: Value = serde_json::from_str(text).unwrap_or_else(|error| panic!("{}: {error} in {text}", document.name));
    assert_eq!(value["schema_version"], document.version, "{}: {text}", document.name);
}

#[test]
fn every_document_states_the_version_of_its_schema() {
    let place = Workplace::new();
    let read = |name: &str| std::fs::read_to_string(place.path(name)).unwrap();
    for line in place.train("run", &["--log-format", "json", "--exposure-compensation", "exposure"]).lines() {
        check(schema::EVENT, line);
    }
    check(schema::METRICS, &read("run/metrics.json"));
    check(schema::METRICS, &read("run/eval/step_40/metrics.json"));
    check(schema::CAPTURES, &read("run/captures.json"));
    for line in read("run/log.jsonl").lines() {
        check(schema::LOG, line);
    }
    for path in ["run", "data", "run/point_cloud/iteration_40/point_cloud.ply", "data/images/000.exr"] {
        check(schema::INFO, &place.ok(&["info", path, "--json"]));
    }
    check(schema::INFO, &place.ok(&["info", "--devices", "--json"]));
    check(schema::COMPARISON, &place.ok(&["compare", "data/images/000.exr", "data/images/001.exr", "--metrics", "fast", "--json"]));
    check(schema::BENCH, &place.ok(&["bench", "--generate", "50", "--size", "16x12", "--steps", "1", "--warmup", "0", "--json"]));
    check(schema::EDIT, &place.ok(&["edit", "run", "--gain", "2", "--dry-run", "--json"]));
    check(schema::EDIT_COMPARISON, &place.ok(&["edit", "run", "--gain", "2", "--against", "run", "-o", "both", "--json"]));
    check(schema::EDIT_COMPARISON, &read("both/comparison.json"));
    for command in [&["export", "run", "-o", "a.spz"][..], &["probe", "run", "--at", "0,0,0", "--size", "16", "-o", "a.exr"]] {
        check(schema::EVENT, place.ok(&[command, &["--log-format", "json"]].concat()).lines().last().unwrap());
    }

    // Metrics and a log that predate the field are read all the same.
    for name in ["run/metrics.json", "run/log.jsonl"] {
        let without = read(name).replace("\"schema_version\": 1,", "").replace("\"schema_version\":1,", "");
        assert!(!without.contains("schema_version"));
        std::fs::write(place.path(name), without).unwrap();
    }
    let run: Value = serde_json::from_str(&place.ok(&["info", "run", "--json"])).unwrap();
    assert!(run["metrics"]["test"]["psnr_scene"].is_number(), "{run}");
    place.ok(&["eval", "run"]);
    assert!(place.json("run/metrics.json")["train_seconds"].as_f64().unwrap() > 0.0);
}

#[test]
fn the_reference_page_lists_every_document_with_its_version() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/reference/json.md");
    let page = std::fs::read_to_string(page).unwrap();
    let listed: Vec<String> = page.lines().filter(|line| line.starts_with("| `")).map(String::from).collect();
    for (i, Document { name, version }) in schema::DOCUMENTS.into_iter().enumerate() {
        assert!(listed[i].starts_with(&format!("| `{name}` | {version} |")), "{name} {version}: {}", listed[i]);
    }
}
