//! Scene files of any format: recognised by their first bytes, read into a [`Scene`].

use std::io::Read;
use std::path::Path;

use luxel_core::{Antialias, ColorSpace, Cutoffs, RadianceScale, RasterConfig, Remedy, Scene, Similarity, Splats};

use crate::byte_order_mark::bytes_without_mark;
use crate::image::image_format;
use crate::input::Input;
use crate::read_file::{open_regular, read_file};
use crate::{IoError, gltf, ply, sog, spz, usd};

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

/// Returns a scene of plain 3D Gaussian splatting, as other programs write it: colours of a
/// display, that method's cut-offs.
pub(crate) fn display_scene(splats: Splats, antialias: Antialias) -> Scene {
    Scene {
        splats,
        radiance_scale: RadianceScale::ONE,
        color_space: ColorSpace::DisplaySrgb,
        raster: RasterConfig { cutoffs: Cutoffs::PARITY, antialias, ..RasterConfig::default() },
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

/// Formats that scenes are read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneFormat {
    /// Polygon file format, `.ply`: exact, baked, plain or compressed.
    Ply,
    /// OpenUSD as text, `.usda`.
    Usda,
    /// OpenUSD in its binary form, `.usdc`.
    UsdBinary,
    /// A ZIP archive: a package of OpenUSD, `.usdz`, or SOG, `.sog`.
    Archive,
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
            (usd::PACKAGE_MAGIC, SceneFormat::Archive),
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
        Some(SceneFormat::Archive) => {
            let bytes = read_file(path)?;
            let input = Input::new(path, &bytes);
            if sog::is_sog(&bytes) { sog::decode(input) } else { usd::decode_binary_file(input) }
        }
        Some(SceneFormat::Glb) => gltf::read_scene_file(path),
        Some(SceneFormat::Spz) => spz::read_scene_file(path),
        // Files that call themselves PLY get that reader's message.
        None if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) => ply::read_scene_file(path),
        None => Err(not_a_scene(Input::new(path, &head))),
    }
}

/// Names the format of a file that is no scene, or what it begins with.
fn not_a_scene(input: Input<'_>) -> IoError {
    if let Some(refused) = refused_scene(input) {
        return refused;
    }
    const SCENES: &str = "expected a scene: PLY, OpenUSD, binary glTF, SPZ or SOG";
    if let Some(format) = image_format(input) {
        let message = format!("{format}, and no scene, {SCENES}");
        return input.unsupported(message).with_remedy(Remedy::advice("info describes images and compare measures them"));
    }
    let found: Vec<_> = input.bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let message = format!("begins with bytes {}, {SCENES}; convert it to one of these", found.join(" "));
    input.unsupported(message)
}

/// Returns the refusal of a file that holds splats in a format that is not read; `None` for any
/// other file. Most of these formats have no first bytes to know them by: their extension says what
/// they are.
pub(crate) fn refused_scene(input: Input<'_>) -> Option<IoError> {
    let extension = input.name.extension()?.to_str()?.to_ascii_lowercase();
    let convert = "convert it to .ply with the program it is from, or with splat-transform";
    let message = match extension.as_str() {
        "splat" => format!(".splat holds splats without harmonics, in bytes, and is not read; {convert}"),
        "ksplat" => format!(".ksplat is GaussianSplats3D's own format and is not read; {convert}"),
        "rad" | "lcc" => format!(".{extension} is not read; {convert}"),
        "gltf" => "glTF as text with its numbers in other files is not read; export it as one binary file, .glb".to_owned(),
        "html" | "htm" => "a page with a scene in it is for browsers and is not read; use the scene that it was made from".to_owned(),
        "json" if input.bytes.trim_ascii_start().starts_with(b"{") && input.name.file_name().is_some_and(|name| name == "meta.json") => {
            "the description of an unpacked SOG, which is read from its one file .sog; bundle it with splat-transform".to_owned()
        }
        _ => return None,
    };
    Some(input.unsupported(message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_of_formats_that_are_not_read_are_refused_by_their_names() {
        for (name, part) in [("a.splat", "without harmonics"), ("a.ksplat", "GaussianSplats3D"), ("a.gltf", ".glb"), ("a.html", "browsers")]
        {
            let error = not_a_scene(Input::new(name, b"{}")).to_string();
            assert!(error.contains(part) && error.contains("is not read"), "{error}");
        }
        assert!(not_a_scene(Input::new("a.bin", &[1, 2])).to_string().contains("begins with bytes 01 02"));
        for (head, part) in [
            (&b"\x76\x2f\x31\x01"[..], "an OpenEXR image"),
            (b"\x89PNG\r\n\x1a\n", "a PNG image"),
            (b"\0\0\0\x18ftypheic", "HEIC"),
            (b"8BPS", "Photoshop"),
        ] {
            let error = not_a_scene(Input::new("a.bin", head));
            assert!(error.message.contains(part) && error.message.contains("expected a scene") && error.remedy.is_some(), "{error}");
        }
    }
}
