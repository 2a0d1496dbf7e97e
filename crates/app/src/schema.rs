//! The JSON documents that Luxel writes for programs, and the versions of their schemas.
//!
//! A document has its version in the field `schema_version`. Added fields leave a version as it is;
//! a field that is removed or gets another meaning makes a new one. The reference page of the book
//! (`docs/src/reference/json.md`) lists the same documents and versions.

use serde::Serialize;

/// A kind of document.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Document {
    /// Its name in the reference: a file's name, or the command that prints it.
    pub name: &'static str,
    /// Version of its schema.
    pub version: u32,
}

/// Name of the field with the version.
pub const VERSION_FIELD: &str = "schema_version";

/// Metrics of a run.
pub const METRICS: Document = Document { name: "metrics.json", version: 1 };
/// A line of a run's log.
pub const LOG: Document = Document { name: "log.jsonl", version: 1 };
/// Cameras of a run whose poses were refined.
pub const CAMERAS: Document = Document { name: "cameras.json", version: 1 };
/// Gains, camera response and vignetting that training found.
pub const CAPTURES: Document = Document { name: "captures.json", version: 1 };
/// Measurements of a run as part of a study.
pub const MEASURED: Document = Document { name: "measured.json", version: 1 };
/// The report of a preparation; version 1 had `figures` for `metrics`.
pub const PREPARE: Document = Document { name: "prepare.json", version: 2 };
/// The parts of a preparation that are finished.
pub const PREPARE_STATE: Document = Document { name: "work/state.json", version: 1 };
/// A line of progress or result.
pub const EVENT: Document = Document { name: "--log-format json", version: 1 };
/// A description; version 1 had `figures` for `metrics`.
pub const INFO: Document = Document { name: "luxel info --json", version: 2 };
/// An examination of the machine.
pub const DOCTOR: Document = Document { name: "luxel doctor --json", version: 1 };
/// Metrics of images against references.
pub const COMPARISON: Document = Document { name: "luxel compare --json", version: 1 };
/// Two runs on the same test views.
pub const RUN_COMPARISON: Document = Document { name: "runs.json", version: 1 };
/// Metrics of a scene file.
pub const SCENE_METRICS: Document = Document { name: "luxel eval SCENE --json", version: 1 };
/// The effect of edits; version 1 had the sum R + G + B under `luminance`.
pub const EDIT: Document = Document { name: "luxel edit --json", version: 2 };
/// Two scenes under the same edits.
pub const EDIT_COMPARISON: Document = Document { name: "comparison.json", version: 1 };
/// A picked pixel.
pub const PICK: Document = Document { name: "luxel pick --json", version: 1 };
/// A block of a data set.
pub const BLOCK: Document = Document { name: "block.json", version: 1 };
/// The blocks of a data set.
pub const BLOCKS: Document = Document { name: "blocks.json", version: 1 };
/// A measurement of speed.
pub const BENCH: Document = Document { name: "luxel bench --json", version: 1 };
/// The work of a training step on a GPU.
pub const BENCH_COUNT: Document = Document { name: "luxel bench --count --json", version: 1 };
/// The scene and the probe that a viewer answers with.
pub const VIEW: Document = Document { name: "luxel view", version: 1 };

/// All documents, in the order of the reference.
pub const DOCUMENTS: [Document; 21] = [
    METRICS,
    LOG,
    CAMERAS,
    CAPTURES,
    MEASURED,
    PREPARE,
    PREPARE_STATE,
    EVENT,
    INFO,
    DOCTOR,
    COMPARISON,
    RUN_COMPARISON,
    SCENE_METRICS,
    EDIT,
    EDIT_COMPARISON,
    PICK,
    BLOCK,
    BLOCKS,
    BENCH,
    BENCH_COUNT,
    VIEW,
];

impl Document {
    /// Returns the content with the version before it.
    ///
    /// ```
    /// use std::collections::BTreeMap;
    ///
    /// use luxel_app::schema::METRICS;
    ///
    /// let content = BTreeMap::from([("seed", 42)]);
    /// let text = serde_json::to_string(&METRICS.versioned(&content))?;
    /// assert_eq!(text, r#"{"schema_version":1,"seed":42}"#);
    /// # Ok::<(), serde_json::Error>(())
    /// ```
    pub fn versioned<T: Serialize>(self, content: T) -> Versioned<T> {
        Versioned { schema_version: self.version, content }
    }
}

/// A document's content with its version.
#[derive(Clone, Debug, Serialize)]
pub struct Versioned<T> {
    schema_version: u32,
    #[serde(flatten)]
    content: T,
}
