//! A viewer at work, and requests to it as a program sends them.
#![allow(dead_code, reason = "each test uses a part of it")]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use luxel::{Dataset, Device, Renderer, Scene, StopFlag, synthetic};
use luxel_view::{Other, Subject, Viewer};
use serde_json::Value;

/// A viewer at work, until it is dropped.
pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    pub(crate) url: String,
    /// The folder of the data set, and of what the page saves.
    pub(crate) folder: tempfile::TempDir,
    pub(crate) scene: Scene,
    pub(crate) dataset: Dataset,
    stop: StopFlag,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Running {
    /// Starts a viewer that saves nothing.
    pub(crate) fn start(address: &str) -> Self {
        Self::show(address, synthetic::room(300, 1), Vec::new())
    }

    /// Starts a viewer of a scene beside others.
    pub(crate) fn show(address: &str, scene: Scene, others: Vec<Scene>) -> Self {
        Self::with(address, scene, others, |subject, _| subject)
    }

    /// Starts a viewer that saves into its folder.
    pub(crate) fn saving() -> Self {
        Self::with("127.0.0.1:0", synthetic::room(300, 1), Vec::new(), |subject, folder| {
            subject.saving_to(folder).unwrap().opened_as(folder)
        })
    }

    fn with(address: &str, scene: Scene, others: Vec<Scene>, prepare: impl FnOnce(Subject, &std::path::Path) -> Subject) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        synthetic::write_dataset(&data, synthetic::BallsOptions::default()).unwrap();
        let dataset = Dataset::open(&data).unwrap();
        let subject = Subject::new("balls <1>", &scene, Some(&dataset)).unwrap().with_cd_m2_per_unit(Some(2.0));
        let subject = prepare(subject, folder.path());
        let viewer = Viewer::bind(address.parse().unwrap()).unwrap();
        let (url, stop) = (viewer.url(), StopFlag::new());
        let port = url.split(':').nth(2).unwrap().split('/').next().unwrap().parse::<u16>().unwrap();
        let (served, flag) = (scene.clone(), stop.clone());
        let thread = std::thread::spawn(move || {
            let renderer = Renderer::new(&served, Device::Cpu.with_threads(1)).unwrap();
            let others = others.into_iter().map(|scene| {
                let renderer = Renderer::new(&scene, Device::Cpu.with_threads(1)).unwrap();
                Other { name: "other".into(), scene, renderer }
            });
            viewer.serve_beside(subject, served, renderer, others.collect(), &flag).unwrap();
        });
        Self { address: ([127, 0, 0, 1], port).into(), url, folder, scene, dataset, stop, thread: Some(thread) }
    }

    /// Sends bytes as they are.
    pub(crate) fn raw(&self, request: &[u8]) -> Response {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        stream.write_all(request).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        Response::parse(&bytes)
    }

    /// Sends a request without a body; each line of `headers` ends in CR and LF.
    pub(crate) fn request(&self, method: &str, path: &str, headers: &str) -> Response {
        self.raw(format!("{method} {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{headers}\r\n", self.address).as_bytes())
    }

    pub(crate) fn send(&self, method: &str, path: &str, body: &[u8]) -> Response {
        let (address, length) = (self.address, body.len());
        let head = format!("{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n");
        self.raw(&[head.as_bytes(), body].concat())
    }

    pub(crate) fn get(&self, path: &str) -> Response {
        self.request("GET", path, "")
    }

    pub(crate) fn post(&self, path: &str, body: &Value) -> Response {
        self.send("POST", path, body.to_string().as_bytes())
    }

    pub(crate) fn json(&self, path: &str) -> Value {
        self.get(path).json()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.request();
        self.thread.take().unwrap().join().unwrap();
    }
}

/// An answer; its head is in lower case.
pub(crate) struct Response {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Response {
    pub(crate) fn parse(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n").map_or(bytes.len(), |at| at + 4);
        let head = String::from_utf8_lossy(&bytes[..end]).to_lowercase();
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Self { status, head, body: bytes[end..].to_vec() }
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub(crate) fn json(&self) -> Value {
        assert_eq!(self.status, 200, "{}", self.text());
        serde_json::from_slice(&self.body).unwrap()
    }

    /// Checks that the request was refused with words that have these in them.
    pub(crate) fn refused(&self, status: u16, words: &str) {
        assert!(self.status == status && self.text().contains(words), "{}: {}, expected {status} \"{words}\"", self.status, self.text());
    }
}
