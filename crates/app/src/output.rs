//! The rule for output paths, which all commands share.
//!
//! - A file has the extension of its format, and a folder has none of those.
//! - A file that exists is replaced only if that is asked for.
//! - A frame, one of many files in a folder, carries the [`Recipe`] of what made it. A frame of the
//!   same recipe is kept; another is replaced only if that is asked for.
//! - A file that is read is never written over.
//!
//! Folders of runs are in [`crate::run::RunFolder`], as they hold more than files.

use std::path::{Path, PathBuf};

use luxel::error::bail;
pub use luxel::output::{
    DEEP_MADE_BY, ExrType, MADE_BY, PREVIEW_EXPOSURE, PREVIEW_MADE_BY, check_extension, check_free, check_no_input, extension,
};
use luxel::{Error, Result};
use luxel_core::{Camera, ColorSpace, Remedy, RenderOptions, Scene};

use crate::text;

/// Extensions of images and videos, which a folder of images does not have.
pub const IMAGE_EXTENSIONS: [&str; 5] = ["exr", "png", "mp4", "mov", "mkv"];
/// Extensions of scenes and other results, which the folder of a run does not have.
pub const RESULT_EXTENSIONS: [&str; 15] =
    ["exr", "png", "mp4", "mov", "mkv", "ply", "usda", "usd", "usdc", "usdz", "glb", "gltf", "spz", "sog", "json"];

/// Refuses the name of a file, which has one of `extensions`, for a folder that does not exist yet.
///
/// # Errors
/// The name has one of the extensions.
pub fn check_folder_name(path: &Path, extensions: &[&str]) -> Result<()> {
    let found = extension(path);
    if extensions.contains(&found.as_str()) && !path.exists() {
        bail!("{}: found the extension .{found}, expected the name of a folder", path.display());
    }
    Ok(())
}

/// Refuses a folder that has content, or the name of a file: some results go to a folder of their
/// own.
///
/// # Errors
/// The path is taken.
pub fn check_new_folder(folder: &Path) -> Result<()> {
    check_folder_name(folder, &RESULT_EXTENSIONS)?;
    let has_entries = || std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
    if folder.is_file() || has_entries() {
        bail!("{}: exists already; give the name of a new folder", folder.display());
    }
    Ok(())
}

/// The form of the frames of a render.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameForm {
    /// Colour space of the pixels.
    pub color_space: ColorSpace,
    /// Number format.
    pub exr_type: ExrType,
    /// Whether there is a channel of coverage.
    pub alpha: bool,
    /// Whether there is a channel of depth.
    pub depth: bool,
    /// Whether there are channels of normals.
    pub normals: bool,
}

/// A digest of everything that decides the content of a file.
///
/// ```
/// use luxel_app::output::Recipe;
///
/// let scene = Recipe::new("scene").with("splats", 10);
/// assert_ne!(scene.clone().with("samples", 1).digest(), scene.with("samples", 2).digest());
/// ```
#[derive(Clone, Debug)]
pub struct Recipe(blake3::Hasher);

impl Recipe {
    /// Returns a recipe of a kind of file.
    pub fn new(kind: &str) -> Self {
        Self(blake3::Hasher::new()).with("kind", kind)
    }

    /// Returns the recipe of all renders of a scene with these options.
    pub fn of_scene(scene: &Scene, options: &RenderOptions) -> Self {
        let splats = &scene.splats;
        let mut recipe = Self::new("render").with("color_model", format_args!("{:?}", splats.color_model));
        let arrays: [&[f32]; 7] = [
            splats.position.as_flattened(),
            splats.rotation.as_flattened(),
            splats.log_scale.as_flattened(),
            &splats.opacity_logit,
            &splats.sh,
            &splats.raw_luminance,
            &splats.smoothing,
        ];
        let mut bytes = Vec::new();
        // Scenes without gains keep the recipes that they had.
        for array in arrays.into_iter().chain(Some(splats.gain.as_slice()).filter(|gain| !gain.is_empty())) {
            recipe.0.update(&(array.len() as u64).to_le_bytes());
            for part in array.chunks(1 << 14) {
                bytes.clear();
                bytes.extend(part.iter().flat_map(|value| value.to_le_bytes()));
                recipe.0.update(&bytes);
            }
        }
        recipe = recipe.with("radiance_scale", scene.radiance_scale).with("color_space", scene.color_space.name());
        if !scene.world_from_local.is_identity() {
            recipe = recipe.with("world_from_local", format_args!("{:?}", scene.world_from_local));
        }
        recipe.with("options", format_args!("{options:?}"))
    }

    /// Returns the recipe of all frames of a scene in a form, but for their cameras.
    pub fn of_frames(scene: &Scene, options: &RenderOptions, form: FrameForm) -> Self {
        let FrameForm { color_space, exr_type, alpha, depth, normals } = form;
        let recipe = Self::of_scene(scene, options).with("output_color_space", color_space.name());
        let recipe = recipe.with("exr_type", format_args!("{exr_type:?}")).with("alpha", alpha).with("depth", depth);
        // Frames without normals keep the recipe that they had before there were any.
        if normals { recipe.with("normals", true) } else { recipe }
    }

    /// Adds a camera.
    #[must_use]
    pub fn with_camera(self, camera: &Camera) -> Self {
        self.with("camera", format_args!("{camera:?}"))
    }

    /// Adds a setting.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl std::fmt::Display) -> Self {
        for part in [name, &value.to_string()] {
            self.0.update(&(part.len() as u64).to_le_bytes());
            self.0.update(part.as_bytes());
        }
        self
    }

    /// Returns the digest as text.
    pub fn digest(&self) -> String {
        self.0.finalize().to_hex().to_string()
    }
}

/// The state of a file that a recipe is to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameState {
    /// It is not there.
    Missing,
    /// It is there, made by the same recipe.
    Same,
    /// Something else is there.
    Other,
}

/// Returns the state of an OpenEXR file by the digest in its attribute `name`.
pub fn frame_state(path: &Path, name: &str, digest: &str) -> FrameState {
    if !path.exists() {
        return FrameState::Missing;
    }
    let found = luxel_io::read_exr_attributes(path).ok().and_then(|found| found.texts.get(name).cloned());
    if found.as_deref() == Some(digest) { FrameState::Same } else { FrameState::Other }
}

/// Refuses to replace frames of another recipe unless `overwrite` is set.
///
/// # Errors
/// There are such frames.
pub fn check_replaceable(others: &[PathBuf], overwrite: bool) -> Result<()> {
    let (Some(first), false) = (others.first(), overwrite) else { return Ok(()) };
    let more = if others.len() > 1 { format!(", and so do {} more", text::count(others.len() - 1)) } else { String::new() };
    let message = format!("{}: exists already, made of another scene, camera, edit or option{more}", first.display());
    Err(Error::new(message).with_remedy(Remedy::advice("choose another folder").or(Remedy::set("overwrite", "true"))))
}

/// Returns whether both paths lead to one file or folder, existing or not.
pub fn is_same(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| {
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let by_its_folder = || Some(std::fs::canonicalize(absolute.parent()?).ok()?.join(absolute.file_name()?));
        std::fs::canonicalize(path).ok().or_else(by_its_folder).unwrap_or(absolute)
    };
    real(a) == real(b)
}

#[cfg(test)]
mod tests {
    use luxel_core::synthetic;

    use super::*;

    #[test]
    fn folders_are_not_called_like_files() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["frame.exr", "run.PLY", "a.b.mp4"] {
            let path = folder.path().join(name);
            assert!(
                check_folder_name(&path, &RESULT_EXTENSIONS).unwrap_err().to_string().contains("expected the name of a folder"),
                "{name}"
            );
            // One that exists keeps its name.
            std::fs::create_dir(&path).unwrap();
            check_folder_name(&path, &RESULT_EXTENSIONS).unwrap();
        }
        for name in ["shot", "v1.2", "take.final"] {
            check_folder_name(&folder.path().join(name), &RESULT_EXTENSIONS).unwrap();
        }
    }

    #[test]
    fn a_recipe_changes_with_each_part() {
        let scene = Scene { splats: synthetic::room(20, 1), ..scene() };
        let options = scene.render_options();
        let of = |scene: &Scene, options: &RenderOptions| Recipe::of_scene(scene, options).digest();
        let first = of(&scene, &options);
        assert_eq!(of(&scene.clone(), &options), first);
        let mut moved = scene.clone();
        moved.splats.position[3][1] += 1e-6;
        let mut rescaled = scene.clone();
        rescaled.radiance_scale = luxel_core::RadianceScale::new(2.0).unwrap();
        let lit = RenderOptions { background: [0.0, 0.0, 1e-3], ..options };
        for other in [of(&moved, &options), of(&rescaled, &options), of(&scene, &lit)] {
            assert_ne!(other, first);
        }
        let camera = synthetic::room_camera([16, 12]);
        let frame = |camera: &Camera| Recipe::of_scene(&scene, &options).with_camera(camera).digest();
        assert_ne!(frame(&camera), frame(&synthetic::room_camera([16, 13])));
        // Borders of parts count.
        assert_ne!(Recipe::new("a").with("b", "c").digest(), Recipe::new("a").with("bc", "").digest());
    }

    fn scene() -> Scene {
        Scene {
            splats: luxel_core::Splats::empty(luxel_core::ColorModel::Sh { degree: 0 }),
            radiance_scale: luxel_core::RadianceScale::ONE,
            color_space: ColorSpace::default(),
            raster: luxel_core::RasterConfig::default(),
            edits: Vec::new(),
            world_from_local: luxel_core::Similarity::IDENTITY,
            metres_per_unit: None,
        }
    }
}
