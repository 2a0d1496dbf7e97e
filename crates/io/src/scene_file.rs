//! Scene files of any format: recognised by their first bytes, read into a [`Scene`].

use std::io::Read;
use std::path::Path;

use luxel_core::Scene;

use crate::byte_order_mark::bytes_without_mark;
use crate::read_file::open_regular;
use crate::{IoError, gltf, ply, read_spz, usd};

/// A scene with what a user should know about its file.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    /// The scene.
    pub scene: Scene,
    /// Remarks about parts that are left out or assumed, without the file's name.
    pub warnings: Vec<String>,
}

impl From<Scene> for SceneFile {
    fn from(scene: Scene) -> Self {
        Self { scene, warnings: Vec::new() }
    }
}

/// Formats that scenes are read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneFormat {
    /// Polygon file format, `.ply`: exact, baked, plain or compressed.
    Ply,
    /// OpenUSD as text, `.usda`.
    Usda,
    /// OpenUSD in its binary form, `.usdc`, or a package of it, `.usdz`.
    UsdBinary,
    /// glTF in one binary file, `.glb`.
    Glb,
    /// SPZ of versions 2 to 4, `.spz`.
    Spz,
}

impl SceneFormat {
    /// Recognises the format by the first bytes of a file; `None` if they are those of no scene.
    pub fn from_bytes(head: &[u8]) -> Option<Self> {
        const MAGIC: [(&[u8], SceneFormat); 8] = [
            (b"ply\n", SceneFormat::Ply),
            (b"ply\r", SceneFormat::Ply),
            (b"#usda", SceneFormat::Usda),
            (usd::BINARY_MAGIC, SceneFormat::UsdBinary),
            (usd::PACKAGE_MAGIC, SceneFormat::UsdBinary),
            (b"glTF", SceneFormat::Glb),
            (b"NGSP", SceneFormat::Spz),
            (&[0x1f, 0x8b], SceneFormat::Spz),
        ];
        let head = bytes_without_mark(head);
        MAGIC.iter().find(|(magic, _)| head.starts_with(magic)).map(|&(_, format)| format)
    }
}

/// Bytes that tell formats apart.
const HEAD_BYTES: u64 = 16;

/// Reads a scene file, and leaves its warnings out.
///
/// # Errors
/// The same as [`read_scene_file`].
pub fn read_scene(path: &Path) -> Result<Scene, IoError> {
    read_scene_file(path).map(|file| file.scene)
}

/// Reads a scene file. Splats with a number that is NaN or infinite are left out with a warning.
///
/// # Errors
/// The file can't be read, is damaged, or is of a format or version that is not supported; the
/// message names the remedy.
pub fn read_scene_file(path: &Path) -> Result<SceneFile, IoError> {
    let mut head = Vec::new();
    let (file, _) = open_regular(path)?;
    file.take(HEAD_BYTES).read_to_end(&mut head).map_err(|e| IoError::system(path, "read", &e))?;
    match SceneFormat::from_bytes(&head) {
        Some(SceneFormat::Ply) => ply::read_scene_file(path),
        Some(SceneFormat::Usda) => usd::read_scene_file(path),
        Some(SceneFormat::UsdBinary) => usd::read_binary_file(path),
        Some(SceneFormat::Glb) => gltf::read_scene_file(path),
        Some(SceneFormat::Spz) => read_spz(path).map(SceneFile::from),
        // Files that call themselves PLY get that reader's message.
        None if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) => ply::read_scene_file(path),
        None => {
            let found: Vec<_> = head.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            let message = format!("begins with bytes {}, expected a scene: PLY, OpenUSD, binary glTF or SPZ", found.join(" "));
            Err(IoError::unsupported(path, message))
        }
    }
}
