//! `luxel view` and `luxel train --view` as a script uses them: the address on stdout, pictures
//! over HTTP, steering of a training.
#![cfg(feature = "view")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use luxel_io::{ReadOptions, read_image};
use serde_json::Value;

use crate::common::{self, Workplace};

/// The program at work, until it is dropped.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    /// Starts the program; its address is in the first line of output that has one.
    fn start(place: &Workplace, args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
        command.current_dir(place.path("")).args(args).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        let line = lines.find(|line| line.contains("http://")).unwrap();
        // What follows is read, so that the program can write it.
        std::thread::spawn(move || lines.for_each(drop));
        let address = line.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
        Self { child, address }
    }

    fn request(&self, method: &str, path: &str) -> (String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        write!(stream, "{method} {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.address).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n").unwrap() + 4;
        (String::from_utf8_lossy(&bytes[..end]).into_owned(), bytes[end..].to_vec())
    }

    fn get(&self, path: &str) -> Vec<u8> {
        let (head, body) = self.request("GET", path);
        assert!(head.starts_with("HTTP/1.1 200"), "{path}: {head}{}", String::from_utf8_lossy(&body));
        body
    }

    fn json(&self, path: &str) -> Value {
        serde_json::from_slice(&self.get(path)).unwrap()
    }

    /// Waits until the scene says so.
    fn until(&self, is_so: impl Fn(&Value) -> bool) -> Value {
        for _ in 0..600 {
            let scene = self.json("/api/scene");
            if is_so(&scene) {
                return scene;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("{}", self.json("/api/scene"));
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

const ANY_PORT: [&str; 3] = ["--listen", "127.0.0.1:0", "--no-browser"];

#[test]
fn the_exr_of_a_view_is_that_of_render() {
    let place = Workplace::new();
    place.train("run", &[]);
    place.ok(&["render", "run", "--split", "test", "-o", "frames", "--device", "cpu"]);
    place.ok(&["render", "run", "--split", "test", "-o", "layers", "--alpha", "--depth", "--device", "cpu"]);
    let server = Server::start(&place, &[&["view", "run"], &ANY_PORT[..]].concat());
    let scene = server.json("/api/scene");
    assert_eq!((&scene["name"], &scene["schema_version"]), (&"run".into(), &1.into()));
    let tests = scene["cameras"].as_array().unwrap().iter().filter(|camera| camera["split"] == "test");
    let names: Vec<&str> = tests.map(|camera| camera["name"].as_str().unwrap()).collect();
    assert!(!names.is_empty());
    for name in names {
        let stem = name.rsplit('/').next().unwrap();
        for (folder, channels) in [("frames", "rgb"), ("layers", "rgb,depth,alpha")] {
            std::fs::write(place.path("served.exr"), server.get(&format!("/api/frame.exr?view={name}&channels={channels}"))).unwrap();
            let [served, rendered] = [place.path("served.exr"), place.path(folder).join(format!("{stem}.exr"))]
                .map(|path| read_image(&path, &ReadOptions::default()).unwrap());
            assert_eq!(served.image, rendered.image, "{name} {channels}");
        }
        let rendered = read_image(&place.path("layers").join(format!("{stem}.exr")), &ReadOptions::default()).unwrap().image;
        let probe = server.json(&format!("/api/probe?view={stem}&x=12&y=11"));
        for (c, value) in rendered.at(12, 11).iter().enumerate() {
            assert!((probe["radiance"][c].as_f64().unwrap() - f64::from(*value)).abs() <= 4.9e-4 * f64::from(*value));
        }
    }
}

#[test]
fn a_run_without_its_data_set_and_a_plain_file_are_shown() {
    let place = Workplace::new();
    place.train("run", &[]);
    std::fs::rename(place.path("data"), place.path("elsewhere")).unwrap();
    let server = Server::start(&place, &[&["view", "run"], &ANY_PORT[..]].concat());
    assert_eq!(server.json("/api/scene")["cameras"], serde_json::json!([]));
    let scene = "run/point_cloud/iteration_40/point_cloud.ply";
    let server = Server::start(&place, &[&["view", scene, "--data", "elsewhere"], &ANY_PORT[..]].concat());
    assert_eq!(server.json("/api/scene")["cameras"].as_array().unwrap().len(), common::VIEWS);
    place.error(&[&["view", scene, "--data", "nowhere"], &ANY_PORT[..]].concat(), &["nowhere"]);
    place.error(&["view", scene, "--no-browser", "--listen", &server.address], &["cannot listen", "--listen", "port"]);
}

#[test]
fn looking_at_a_training_changes_nothing() {
    let place = Workplace::new();
    // Long enough for a request on its way.
    let steps = ["--iterations", "3000", "--init-points", "100", "--max-splats", "100", "--threads", "2", "--checkpoint-every", "0"];
    let watched = ["train", "data", "-o", "watched", "--view", "127.0.0.1:0", "--log-format", "json"];
    let mut server = Server::start(&place, &[&watched, &steps[..]].concat());
    let (head, _) = server.request("POST", "/api/training/pause");
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    let paused = server.until(|scene| scene["training"]["is_paused"] == true);
    let done = paused["training"]["done"].as_u64().unwrap();
    let name = paused["cameras"][0]["name"].as_str().unwrap();
    let frame = server.get(&format!("/api/frame?view={name}&channels=rgb,alpha,depth"));
    assert_eq!(frame.len(), common::SIDE * common::SIDE * 12);
    assert!(server.json(&format!("/api/probe?view={name}&x=3&y=4"))["radiance"][0].as_f64().unwrap() >= 0.0);
    server.request("POST", "/api/training/save");
    for _ in 0..600 {
        if std::fs::read_dir(place.path("watched/checkpoints")).is_ok_and(|files| files.count() > 0) {
            break;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(std::fs::read_dir(place.path("watched/checkpoints")).unwrap().count() > 0);
    let now = server.until(|scene| scene["training"]["is_paused"] == true);
    assert!(now["training"]["done"].as_u64().unwrap() <= done + 2);
    server.request("POST", "/api/training/continue");
    assert!(server.child.wait().unwrap().success());
    place.ok(&[&["train", "data", "-o", "alone"], &steps[..]].concat());
    let [watched, alone] =
        ["watched", "alone"].map(|run| std::fs::read(place.path(run).join("point_cloud/iteration_3000/point_cloud.ply")).unwrap());
    assert!(watched == alone);
}

#[test]
fn the_page_can_stop_a_training() {
    let place = Workplace::new();
    let args =
        ["train", "data", "-o", "run", "--view=127.0.0.1:0", "--log-format", "json", "--iterations", "100000", "--init-points", "300"];
    let mut server = Server::start(&place, &args);
    server.until(|scene| scene["training"]["done"].as_u64() > Some(0));
    server.request("POST", "/api/training/stop");
    assert_eq!(server.child.wait().unwrap().code(), Some(130));
    assert!(std::fs::read_dir(place.path("run/checkpoints")).unwrap().count() > 0);
}

#[test]
fn the_cameras_of_a_training_that_refines_poses_move() {
    let place = Workplace::new();
    let args = ["train", "data", "-o", "run", "--view=127.0.0.1:0", "--log-format", "json", "--iterations", "100000"];
    let server = Server::start(&place, &[&args[..], &["--init-points", "300", "--refine-poses", "--pose-from", "1"]].concat());
    let version = |scene: &Value| scene["cameras_version"].as_u64().unwrap();
    let before = server.json("/api/scene");
    server.until(|scene| version(scene) > version(&before));
    server.request("POST", "/api/training/pause");
    let after = server.until(|scene| scene["training"]["is_paused"] == true);
    assert_eq!(server.json("/api/cameras"), after["cameras"]);
    let cameras = |scene: &Value| scene["cameras"].as_array().unwrap().clone();
    for (before, after) in cameras(&before).iter().zip(&cameras(&after)) {
        let [a, b] = [before, after].map(|camera| &camera["transform_matrix"]);
        // Test views are seen from where they were.
        let number = |value: &Value, row: usize, column: usize| value[row][column].as_f64().unwrap();
        let apart = (0..12).map(|i| (number(a, i / 4, i % 4) - number(b, i / 4, i % 4)).abs()).fold(0.0, f64::max);
        assert_eq!(apart > 1e-9, before["split"] == "train", "{}: {apart}", before["name"]);
        assert_eq!(before["fl_x"], after["fl_x"]);
    }
}
