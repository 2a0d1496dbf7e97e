//! Edits over HTTP: what is found, what is written, what is refused.
#![allow(missing_docs, clippy::unwrap_used, reason = "tests")]

mod common;

use std::path::{Path, PathBuf};

use luxel_core::edit::{EditStack, MaskShares, SelectionSummary, ShMap};
use serde_json::{Value, json};

use common::{Response, Running};

/// A viewer that saves, asked below `/api/edit/`.
struct Editing(Running);

impl Editing {
    fn start() -> Self {
        Self(Running::saving())
    }

    fn send(&self, method: &str, path: &str, body: &[u8]) -> Response {
        self.0.send(method, &format!("/api/edit/{path}"), body)
    }

    fn get(&self, path: &str) -> Response {
        self.send("GET", path, b"")
    }

    fn save(&self, request: &Value) -> Response {
        self.send("POST", "save", request.to_string().as_bytes())
    }

    fn saved(&self, name: &str) -> PathBuf {
        self.0.folder.path().join("edits").join(name)
    }

    fn files(&self) -> usize {
        std::fs::read_dir(self.saved("")).map_or(0, Iterator::count)
    }
}

/// Percent-encodes a value of a query.
fn encoded(text: &str) -> String {
    text.bytes().map(|byte| if byte.is_ascii_alphanumeric() { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

const CAMERA: &str = r#"{"transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]],"fl_x":40,"fl_y":40,"cx":20,"cy":15}"#;

fn camera_query() -> String {
    format!("camera={}&width=40&height=30", encoded(CAMERA))
}

fn white_png() -> Vec<u8> {
    luxel_io::encode_png(40, 30, &[255; 40 * 30 * 3]).unwrap()
}

#[test]
fn a_selection_has_the_numbers_of_the_language() {
    let running = Editing::start();
    let selection: luxel_core::Selection = "L > p60 ~1".parse().unwrap();
    let weights = selection.weights(&running.0.scene, &MaskShares::new()).unwrap();
    let expected = SelectionSummary::new(&running.0.scene, &weights);
    let found = running.get(&format!("selection?where={}", encoded("L > p60 ~1"))).json();
    assert_eq!(found["count"], json!(expected.count));
    assert_eq!(found["share_of_light"], json!(expected.light_share));
    let drawn = running.get(&format!("overlay.png?where={}&{}", encoded("L > p60 ~1"), camera_query()));
    assert!(drawn.status == 200 && drawn.body.starts_with(b"\x89PNG") && drawn.head.contains("luxel-frame: {"), "{}", drawn.head);
    let histogram = running.get("luminance?edit=gain%202").json();
    assert_eq!(histogram["count"], json!(300));
    let median = running.0.scene.luminance(0);
    assert!(median > 0.0 && histogram["percentiles"].as_array().unwrap().len() == 101);
    assert!(running.get("floaters").json()["words"].as_str().unwrap().contains("of 300 splats"));
    assert_eq!(running.get("selection?floaters=1").status, 200);
}

#[test]
fn a_saved_scene_has_the_bytes_of_the_same_stack() {
    let running = Editing::start();
    let text = "where L > p60 ~1; gain 0.25; delete L < p20; up 0,1,0.5; origin 1,0,0";
    let reply = running.save(&json!({ "name": "first", "edit": text, "scene": true, "stack": true }));
    assert_eq!(reply.status, 200, "{}", reply.text());
    let stack: EditStack = text.parse().unwrap();
    let mut scene = running.0.scene.clone().into_core();
    let removed = luxel::edit::Removed::selected(stack.delete.as_ref().unwrap(), &scene, &MaskShares::new()).unwrap();
    let inputs = luxel::edit::StackInputs { masks: MaskShares::new(), removed };
    luxel::edit::apply_stack(&stack, &mut scene, &inputs, ShMap::default(), &luxel::Silent).unwrap();
    let expected = luxel_io::encode_scene_ply(Path::new("first.ply"), &scene).unwrap();
    assert!(std::fs::read(running.saved("first.ply")).unwrap() == expected);
    assert_eq!(luxel::edit::read_stack(&running.saved("first.edits")).unwrap(), stack);
    assert_eq!(running.get("saved").json()["names"], json!(["first"]));
    assert_eq!(running.get("stack?name=first").json()["edit"].as_str().unwrap().parse::<EditStack>().unwrap(), stack);
    let again = running.save(&json!({ "name": "first", "edit": "gain 2", "scene": true }));
    assert!(again.status == 409 && again.text().contains("exists already"), "{}", again.text());
    assert!(std::fs::read(running.saved("first.ply")).unwrap() == expected);
}

#[test]
fn a_painted_mask_selects_and_is_saved_beside_the_stack() {
    let running = Editing::start();
    let mask = running.send("POST", &format!("mask?{}", camera_query()), &white_png());
    assert_eq!(mask.status, 200, "{}", mask.text());
    let mask = mask.json();
    let test = format!("mask(\"{}\", \"{}\")", mask["file"].as_str().unwrap(), mask["view"].as_str().unwrap());
    assert!(running.get(&format!("selection?where={}", encoded(&test))).json()["count"].is_u64());
    let reply = running.save(&json!({ "name": "painted", "edit": format!("where {test}; gain 2"), "stack": true }));
    assert_eq!(reply.status, 200, "{}", reply.text());
    let file = std::fs::read_to_string(running.saved("painted.edits")).unwrap();
    assert!(file.contains("mask(\"mask-1.png\", \"mask-1.json\")"), "{file}");
    assert!(running.get("stack?name=painted").json()["edit"].as_str().unwrap().contains(&test));
    // The text of the file, from anywhere: its masks are those of this place.
    let read = |text: &str| running.send("POST", "read", text.as_bytes());
    assert!(read(&file).json()["edit"].as_str().unwrap().contains(&test));
    assert!(read(&format!("where {test}; gain 2")).json()["edit"].as_str().unwrap().contains(&test));
    for (text, words) in [
        ("where mask(\"mask-9.png\", \"mask-9.json\"); gain 2", "mask-9.png"),
        ("where mask(\"../mask-1.png\", \"mask-1.json\"); gain 2", "is not in"),
        ("shine 3", "shine"),
        ("", "no edits"),
    ] {
        let refused = read(text);
        assert!((400..500).contains(&refused.status) && refused.text().contains(words), "{text}: {}", refused.text());
    }
    assert_eq!(running.send("POST", "read", b"\xff\xfe").status, 400);
    for (query, body) in [
        (camera_query(), b"GIF89a".to_vec()),
        (camera_query(), white_png()[..60].to_vec()),
        (format!("camera={}&width=20&height=30", encoded(CAMERA)), white_png()),
        (format!("camera={}&width=100000&height=100000", encoded(CAMERA)), white_png()),
        ("width=40&height=30".into(), white_png()),
        (camera_query(), Vec::new()),
    ] {
        let refused = running.send("POST", &format!("mask?{query}"), &body);
        assert!((400..500).contains(&refused.status) && !refused.text().is_empty(), "{query}");
    }
    assert_eq!(running.files(), 3);
}

#[test]
fn hostile_names_bodies_and_masks_are_refused() {
    let running = Editing::start();
    let outside = tempfile::tempdir().unwrap();
    std::fs::write(outside.path().join("mask-1.png"), white_png()).unwrap();
    for name in ["", "..", "../x", "/etc/passwd", "a/b", "a\\b", ".hidden", "con", "a\u{0}b", "é", &"n".repeat(200)] {
        let refused = running.save(&json!({ "name": name, "edit": "gain 2", "scene": true, "stack": true }));
        assert!((400..500).contains(&refused.status), "{name}");
        assert!((400..500).contains(&running.get(&format!("stack?name={}", encoded(name))).status), "{name}");
    }
    for body in [
        "",
        "{",
        "[]",
        "null",
        r#"{"name":"a"}"#,
        r#"{"name":"a","edit":"gain 2"}"#,
        r#"{"name":"a","edit":"shine","scene":true}"#,
        r#"{"name":"a","edit":"","stack":true}"#,
        r#"{"name":"a","edit":"delete all","scene":true}"#,
        r#"{"name":"a","edit":"gain 2","scene":true,"path":"/tmp"}"#,
    ] {
        assert!((400..500).contains(&running.send("POST", "save", body.as_bytes()).status), "{body}");
    }
    assert_eq!(running.send("POST", "save", &vec![b' '; 2 << 20]).status, 413);
    let elsewhere = outside.path().join("mask-1.png");
    for mask in
        [format!("mask(\"{}\", 003)", elsewhere.display()), "mask(\"../mask-1.png\", 003)".into(), "mask(/etc/passwd, /etc/x.json)".into()]
    {
        for path in ["selection?where=", "luminance?edit=where%20"] {
            let asked = format!("{path}{}{}", encoded(&mask), if path.starts_with("lum") { "%3B%20gain%202" } else { "" });
            let refused = running.get(&asked);
            assert!(refused.status == 422 && refused.text().contains("expected one of there"), "{mask}: {}", refused.text());
        }
    }
    assert_eq!(running.get("selection?where=all&floaters=1").status, 400);
    assert_eq!(running.get("nothing").status, 404);
    assert_eq!(running.get("save").status, 405);
    assert_eq!(running.get("saved?more=1").status, 400);
    assert_eq!(running.files(), 0);
}
