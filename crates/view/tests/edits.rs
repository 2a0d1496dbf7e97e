//! Edits over HTTP: what is found, what is written, what is refused.
#![allow(missing_docs, clippy::unwrap_used, reason = "tests")]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use luxel::{Device, Renderer, Scene, StopFlag, synthetic};
use luxel_core::edit::{EditStack, MaskShares, SelectionSummary, ShMap};
use luxel_view::{Subject, Viewer};
use serde_json::{Value, json};

struct Running {
    address: SocketAddr,
    scene: Scene,
    folder: tempfile::TempDir,
    stop: StopFlag,
    thread: Option<std::thread::JoinHandle<()>>,
}

struct Reply {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Reply {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&self.body)))
    }

    fn error(&self) -> String {
        self.json()["error"].as_str().unwrap_or_default().to_owned()
    }
}

impl Running {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = tempfile::tempdir().unwrap();
        synthetic::write_dataset(data.path(), synthetic::BallsOptions::default()).unwrap();
        let dataset = luxel::Dataset::open(data.path()).unwrap();
        let scene = synthetic::room(300, 1);
        let subject = Subject::new("room", &scene, Some(&dataset)).unwrap().saving_to(folder.path()).unwrap().opened_as(folder.path());
        let viewer = Viewer::bind("127.0.0.1:0".parse().unwrap()).unwrap();
        let url = viewer.url();
        let port = url.split(':').nth(2).unwrap().split('/').next().unwrap().parse::<u16>().unwrap();
        let (served, stop) = (scene.clone(), StopFlag::new());
        let flag = stop.clone();
        let thread = std::thread::spawn(move || {
            let renderer = Renderer::new(&served, Device::Cpu.with_threads(1)).unwrap();
            viewer.serve(subject, served, renderer, &flag).unwrap();
        });
        Self { address: ([127, 0, 0, 1], port).into(), scene, folder, stop, thread: Some(thread) }
    }

    fn send(&self, method: &str, path: &str, body: &[u8]) -> Reply {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let head = format!(
            "{method} /api/edit/{path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
            self.address,
            body.len()
        );
        stream.write_all(head.as_bytes()).unwrap();
        stream.write_all(body).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
        Reply { status: head.split(' ').nth(1).unwrap().parse().unwrap(), head, body: bytes[end + 4..].to_vec() }
    }

    fn get(&self, path: &str) -> Reply {
        self.send("GET", path, b"")
    }

    fn save(&self, request: &Value) -> Reply {
        self.send("POST", "save", request.to_string().as_bytes())
    }

    fn saved(&self, name: &str) -> PathBuf {
        self.folder.path().join("edits").join(name)
    }

    fn files(&self) -> usize {
        std::fs::read_dir(self.folder.path().join("edits")).map_or(0, Iterator::count)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.request();
        self.thread.take().unwrap().join().unwrap();
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
    let running = Running::start();
    let selection: luxel_core::Selection = "L > p60 ~1".parse().unwrap();
    let weights = selection.weights(&running.scene, &MaskShares::new()).unwrap();
    let expected = SelectionSummary::new(&running.scene, &weights);
    let found = running.get(&format!("selection?where={}", encoded("L > p60 ~1"))).json();
    assert_eq!(found["count"], json!(expected.count));
    assert_eq!(found["share_of_light"], json!(expected.light_share));
    let drawn = running.get(&format!("overlay.png?where={}&{}", encoded("L > p60 ~1"), camera_query()));
    assert!(drawn.status == 200 && drawn.body.starts_with(b"\x89PNG") && drawn.head.contains("luxel-frame: {"), "{}", drawn.head);
    let histogram = running.get("luminance?edit=gain%202").json();
    assert_eq!(histogram["count"], json!(300));
    let median = running.scene.luminance(0);
    assert!(median > 0.0 && histogram["percentiles"].as_array().unwrap().len() == 101);
    assert!(running.get("floaters").json()["words"].as_str().unwrap().contains("of 300 splats"));
    assert_eq!(running.get("selection?floaters=1").status, 200);
}

#[test]
fn a_saved_scene_has_the_bytes_of_the_same_stack() {
    let running = Running::start();
    let text = "where L > p60 ~1; gain 0.25; delete L < p20; up 0,1,0.5; origin 1,0,0";
    let reply = running.save(&json!({ "name": "first", "edit": text, "scene": true, "stack": true }));
    assert_eq!(reply.status, 200, "{}", reply.error());
    let stack: EditStack = text.parse().unwrap();
    let mut scene = running.scene.clone().into_core();
    let removed = luxel::edit::Removed::selected(stack.delete.as_ref().unwrap(), &scene, &MaskShares::new()).unwrap();
    let inputs = luxel::edit::StackInputs { masks: MaskShares::new(), removed };
    luxel::edit::apply_stack(&stack, &mut scene, &inputs, ShMap::default(), &luxel::Silent).unwrap();
    let expected = luxel_io::encode_scene_ply(Path::new("first.ply"), &scene).unwrap();
    assert!(std::fs::read(running.saved("first.ply")).unwrap() == expected);
    assert_eq!(luxel::edit::read_stack(&running.saved("first.edits")).unwrap(), stack);
    assert_eq!(running.get("saved").json()["names"], json!(["first"]));
    assert_eq!(running.get("stack?name=first").json()["edit"].as_str().unwrap().parse::<EditStack>().unwrap(), stack);
    let again = running.save(&json!({ "name": "first", "edit": "gain 2", "scene": true }));
    assert!(again.status == 409 && again.error().contains("exists already"), "{}", again.error());
    assert!(std::fs::read(running.saved("first.ply")).unwrap() == expected);
}

#[test]
fn a_painted_mask_selects_and_is_saved_beside_the_stack() {
    let running = Running::start();
    let mask = running.send("POST", &format!("mask?{}", camera_query()), &white_png());
    assert_eq!(mask.status, 200, "{}", mask.error());
    let mask = mask.json();
    let test = format!("mask(\"{}\", \"{}\")", mask["file"].as_str().unwrap(), mask["view"].as_str().unwrap());
    assert!(running.get(&format!("selection?where={}", encoded(&test))).json()["count"].is_u64());
    let reply = running.save(&json!({ "name": "painted", "edit": format!("where {test}; gain 2"), "stack": true }));
    assert_eq!(reply.status, 200, "{}", reply.error());
    let file = std::fs::read_to_string(running.saved("painted.edits")).unwrap();
    assert!(file.contains("mask(\"mask-1.png\", \"mask-1.json\")"), "{file}");
    assert!(running.get("stack?name=painted").json()["edit"].as_str().unwrap().contains(&test));
    for (query, body) in [
        (camera_query(), b"GIF89a".to_vec()),
        (camera_query(), white_png()[..60].to_vec()),
        (format!("camera={}&width=20&height=30", encoded(CAMERA)), white_png()),
        (format!("camera={}&width=100000&height=100000", encoded(CAMERA)), white_png()),
        ("width=40&height=30".into(), white_png()),
        (camera_query(), Vec::new()),
    ] {
        let refused = running.send("POST", &format!("mask?{query}"), &body);
        assert!((400..500).contains(&refused.status) && !refused.error().is_empty(), "{query}");
    }
    assert_eq!(running.files(), 3);
}

#[test]
fn hostile_names_bodies_and_masks_are_refused() {
    let running = Running::start();
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
            assert!(refused.status == 422 && refused.error().contains("expected one of there"), "{mask}: {}", refused.error());
        }
    }
    assert_eq!(running.get("selection?where=all&floaters=1").status, 400);
    assert_eq!(running.get("nothing").status, 404);
    assert_eq!(running.get("save").status, 405);
    assert_eq!(running.get("saved?more=1").status, 400);
    assert_eq!(running.files(), 0);
}
