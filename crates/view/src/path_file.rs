//! Camera paths: keyframes in, cameras out.
//!
//! In: JSON of the page ([`PathJson`]), in the world of the data set. Out: a camera file that
//! `luxel render --cameras` takes; its field `luxel_path` has the keyframes, so that it can be
//! opened again. A file without them is a path with a keyframe for each of its cameras.

use luxel::camera_path::keyframes::{Ease, Keyframe, KeyframeOptions, MAX_FRAMES, keyframe_path};
use luxel::{Error, PathCamera, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// Field of a camera file with the keyframes.
const FIELD: &str = "luxel_path";
/// Frames a second of a camera file that states none.
const DEFAULT_RATE: f64 = 24.0;

/// A path as the page has it.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PathJson {
    keyframes: Vec<KeyframeJson>,
    /// Length, seconds.
    duration: f64,
    frames_per_second: f64,
    #[serde(default)]
    ease: EaseJson,
    /// Whether the end joins the beginning.
    #[serde(default)]
    closed: bool,
    width: u32,
    height: u32,
}

/// A camera at a time, seconds.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct KeyframeJson {
    time: f64,
    /// A frame of `transforms.json`.
    camera: Map<String, Value>,
}

/// The places at which a path slows down.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum EaseJson {
    #[default]
    Nowhere,
    Ends,
    Keyframes,
}

/// A path made into cameras, and the file of them.
pub(crate) struct PathFile {
    /// The cameras as they are read from the file, world.
    pub(crate) cameras: Vec<PathCamera>,
    pub(crate) text: String,
}

impl PathJson {
    /// Returns the cameras and their file.
    pub(crate) fn file(&self) -> Result<PathFile> {
        if self.keyframes.len() > MAX_FRAMES {
            return Err(Error::new(format!("{} keyframes, expected at most {MAX_FRAMES}", self.keyframes.len())));
        }
        let options = KeyframeOptions {
            duration_s: self.duration,
            frames_per_second: self.frames_per_second,
            ease: match self.ease {
                EaseJson::Nowhere => Ease::Nowhere,
                EaseJson::Ends => Ease::Ends,
                EaseJson::Keyframes => Ease::Keyframes,
            },
            is_closed: self.closed,
            size_px: [self.width, self.height],
        };
        // Before anything is made of them.
        options.frames()?;
        let path = keyframe_path(&self.cameras()?, &options)?;
        let text = luxel_io::camera_file_text(&path);
        let cameras = luxel::decode_cameras("path", text.as_bytes())?;
        let mut file: Value = serde_json::from_str(&text).map_err(|error| Error::new(error.to_string()))?;
        file[FIELD] = serde_json::to_value(self).map_err(|error| Error::new(error.to_string()))?;
        Ok(PathFile { cameras, text: format!("{file:#}\n") })
    }

    fn cameras(&self) -> Result<Vec<Keyframe>> {
        if self.keyframes.is_empty() {
            return Ok(Vec::new());
        }
        let frame = |(i, keyframe): (usize, &KeyframeJson)| {
            let mut camera = keyframe.camera.clone();
            camera.insert("file_path".into(), format!("keyframe_{i}").into());
            Value::Object(camera)
        };
        let frames: Vec<Value> = self.keyframes.iter().enumerate().map(frame).collect();
        let cameras = luxel::decode_cameras("keyframes", json!({ "frames": frames }).to_string().as_bytes())?;
        Ok(self.keyframes.iter().zip(cameras).map(|(keyframe, named)| Keyframe { time_s: keyframe.time, camera: named.camera }).collect())
    }

    /// Reads a camera file.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self> {
        let mut file: Value = serde_json::from_slice(bytes).map_err(|error| Error::new(format!("the camera file is not JSON: {error}")))?;
        if let Some(path) = file.get_mut(FIELD) {
            let path: Self = serde_json::from_value(path.take()).map_err(|error| Error::new(format!("\"{FIELD}\": {error}")))?;
            // What it holds must be a path.
            path.file()?;
            return Ok(path);
        }
        let cameras = luxel::decode_cameras("camera file", bytes)?;
        if cameras.len() > MAX_FRAMES {
            return Err(Error::new(format!("{} cameras, expected at most {MAX_FRAMES}", cameras.len())));
        }
        // nerfstudio's name.
        let rate = file.get("fps").and_then(Value::as_f64).filter(|rate| (0.1..=1000.0).contains(rate)).unwrap_or(DEFAULT_RATE);
        let (duration, last) = (cameras.len() as f64 / rate, cameras.len().saturating_sub(1).max(1) as f64);
        let [width, height] = cameras.first().map_or([1, 1], |named| named.camera.size_px);
        let written: Value = serde_json::from_str(&luxel_io::camera_file_text(&cameras)).map_err(|error| Error::new(error.to_string()))?;
        let frames = written["frames"].as_array().into_iter().flatten().filter_map(Value::as_object);
        let keyframes = frames.enumerate().map(|(i, camera)| KeyframeJson { time: duration * i as f64 / last, camera: camera.clone() });
        let (ease, closed) = (EaseJson::Nowhere, false);
        Ok(Self { keyframes: keyframes.collect(), duration, frames_per_second: rate, ease, closed, width, height })
    }
}
