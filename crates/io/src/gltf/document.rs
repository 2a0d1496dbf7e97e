//! The parts of a glTF document that splats need.

use std::cell::Cell;
use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::{Map, Value};

use crate::memory::memory_limit;

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Document {
    pub(super) asset: Asset,
    pub(super) scene: Option<usize>,
    pub(super) scenes: Vec<SceneNodes>,
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<Mesh>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) buffer_views: Vec<BufferView>,
    pub(super) buffers: Vec<Buffer>,
    /// Bytes of all accessors that were read.
    #[serde(skip)]
    spent_bytes: Cell<u64>,
}

/// Bytes of numbers that any file may hold, however short.
const FREE_BYTES: u64 = 64 << 20;

/// Bytes of numbers that a byte of the file's buffer may stand for beyond that: a byte becomes an
/// f32, and a mesh may be placed several times.
const MAX_RATIO: u64 = 64;

impl Document {
    /// Counts the bytes of an accessor that is about to be read. Many attributes may name one
    /// accessor, so that a short file could ask for any amount of memory.
    pub(super) fn spend(&self, bytes: u64, buffer_bytes: u64) -> Result<(), String> {
        let spent = self.spent_bytes.get().saturating_add(bytes);
        self.spent_bytes.set(spent);
        let limit = memory_limit().min(FREE_BYTES.saturating_add(buffer_bytes.saturating_mul(MAX_RATIO)));
        if spent > limit {
            return Err(format!(
                "the file's attributes are more than {limit} bytes, in a buffer of {buffer_bytes}: too many of them name the same accessors; \
                 export each mesh once"
            ));
        }
        Ok(())
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Asset {
    pub(super) extras: Map<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct SceneNodes {
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub(super) mesh: Option<usize>,
    pub(super) children: Vec<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<String, usize>,
    pub(super) extensions: Map<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    pub(super) normalized: bool,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Buffer {
    pub(super) uri: Option<Value>,
}
