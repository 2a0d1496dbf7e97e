//! Scene to PLY, in blocks of rows: memory does not grow with the scene.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use glam::DVec3;
use luxel_core::{ColorModel, Scene, Similarity, Splats, sh};
use rayon::prelude::*;

use crate::bake::{Appearance, Bake, BakeOptions, Baked, MAX_BAKED, WorldRecord, smoothed};
use crate::local_frame::LocalFrame;
use crate::ply::{COMMENT_TAG, FORMAT_VERSION, GAIN_VERSION, record};
use crate::validity::{is_normalizable, is_usable};
use crate::{IoError, write_atomically};

/// Rows made at a time.
const BLOCK_ROWS: usize = 4096;

/// Key of the local coordinates of a scene, where they are not those of the world.
pub(super) const FRAME_COMMENT: &str = "local_frame";
/// Key of the comment with the length of a unit of the data set's world, metres.
pub(super) const METRES_COMMENT: &str = "metres_per_unit";

/// Gains of edits.
pub(super) const GAIN: &str = "lcd_gain";

/// Opacity logit and log scale of the model, where the display layer has others.
pub(super) const EXACT_OPACITY: &str = "lcd_opacity";
pub(super) const EXACT_SCALE: [&str; 3] = ["lcd_log_scale_0", "lcd_log_scale_1", "lcd_log_scale_2"];

/// Returns the prefix of the properties that hold `Splats::sh`.
pub(super) fn sh_prefix(color_model: ColorModel) -> &'static str {
    match color_model {
        ColorModel::Sh { .. } => "lcd_s_",
        ColorModel::LogSh { .. } => "lcd_g_",
        ColorModel::Lcd { .. } => "lcd_c_",
        ColorModel::Mix(_) => "lcd_m_",
    }
}

/// The source of the display layer's harmonics.
enum Layer<'a> {
    /// Baked row by row.
    Streamed(Box<Bake>),
    /// Baked already.
    Baked(&'a Baked),
}

impl Layer<'_> {
    fn preview(scene: &Scene) -> Self {
        Self::Streamed(Box::new(Bake::new(scene, &BakeOptions { appearance: Appearance::preview_of(scene.color_space), max_degree: 3 })))
    }

    /// Returns the number of coefficients K.
    fn coefficients(&self) -> usize {
        match self {
            Self::Streamed(bake) => bake.coefficients(),
            Self::Baked(baked) => baked.scene.splats.color_model.sh_coefficients(),
        }
    }

    fn description(&self) -> String {
        match self {
            Self::Streamed(bake) => bake.description(),
            Self::Baked(baked) => baked.description(),
        }
    }

    /// Returns a splat's harmonics by channel; entries from K on are 0.
    fn splat(&self, splats: &Splats, i: usize) -> [[f32; MAX_BAKED]; 3] {
        match self {
            Self::Streamed(bake) => bake.splat(splats, i),
            Self::Baked(baked) => {
                let mut channels = [[0.0; MAX_BAKED]; 3];
                for (m, rgb) in baked.scene.splats.sh_of(i).chunks_exact(3).enumerate().take(sh::coefficients(3)) {
                    channels.iter_mut().zip(rgb).for_each(|(channel, value)| channel[m] = *value);
                }
                channels
            }
        }
    }

    /// Returns the log scale and opacity logit of a splat in the display layer.
    fn geometry(&self, splats: &Splats, i: usize) -> ([f32; 3], f32) {
        match (self, splats.smoothing.get(i)) {
            (Self::Baked(baked), _) => (baked.scene.splats.log_scale[i], baked.scene.splats.opacity_logit[i]),
            (Self::Streamed(_), Some(deviation)) => smoothed(splats.log_scale[i], splats.opacity_logit[i], *deviation),
            (Self::Streamed(_), None) => (splats.log_scale[i], splats.opacity_logit[i]),
        }
    }

    /// Returns whether the display layer has the scene's own log scales and opacities, all of them.
    fn shares_geometry(&self, splats: &Splats) -> bool {
        let shown = match self {
            Self::Streamed(_) => splats,
            Self::Baked(baked) => &baked.scene.splats,
        };
        splats.smoothing.is_empty() && (&shown.log_scale, &shown.opacity_logit) == (&splats.log_scale, &splats.opacity_logit)
    }
}

/// Writes a file as [`write_scene_ply`] does, with a display layer of choice; both in the world of
/// the file.
///
/// # Errors
/// The same as [`write_scene_ply`], or the bake is not of this scene.
pub fn write_exact_ply(path: &Path, scene: &Scene, baked: &Baked) -> Result<(), IoError> {
    check(path, scene)?;
    check(path, &baked.scene)?;
    if baked.scene.splats.len() != scene.splats.len() {
        let message = format!("bake of {} splats for a scene of {}", baked.scene.splats.len(), scene.splats.len());
        return Err(IoError::invalid(path, message));
    }
    write_atomically(path, |file| write(scene, &Layer::Baked(baked), file).map_err(|e| IoError::system(path, "write", &e)))
}

/// Writes a scene, whole or not at all; folders are made as needed.
///
/// ```
/// use luxel_core::{ColorSpace, RadianceScale, RasterConfig, Scene, Similarity, synthetic};
/// use luxel_io::{read_scene, write_scene_ply};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("room.ply");
/// let scene = Scene {
///     splats: synthetic::room(50, 1),
///     radiance_scale: RadianceScale::ONE,
///     color_space: ColorSpace::LinearRec709,
///     raster: RasterConfig::default(),
///     edits: Vec::new(),
///     world_from_local: Similarity::IDENTITY,
///     metres_per_unit: Some(0.5),
/// };
/// write_scene_ply(&path, &scene)?;
/// // The file holds the scene to the bit.
/// assert_eq!(read_scene(&path)?, scene);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A scene that could not be read back (wrong lengths, NaN, a rotation of length zero, a radiance
/// scale that is not positive), or the file system's refusal.
pub fn write_scene_ply(path: &Path, scene: &Scene) -> Result<(), IoError> {
    check(path, scene)?;
    let scene = &in_world_units(scene);
    write_atomically(path, |file| write(scene, &Layer::preview(scene), file).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes the bytes that [`write_scene_ply`] writes; `name` is for errors.
///
/// # Errors
/// The same as [`write_scene_ply`].
pub fn encode_scene_ply(name: &Path, scene: &Scene) -> Result<Vec<u8>, IoError> {
    check(name, scene)?;
    let scene = &in_world_units(scene);
    let mut bytes = Vec::new();
    write(scene, &Layer::preview(scene), &mut bytes).map_err(|e| IoError::system(name, "write", &e))?;
    Ok(bytes)
}

/// Returns the scene with lengths in units of the world.
fn in_world_units(scene: &Scene) -> Cow<'_, Scene> {
    let unit = scene.world_from_local.scale();
    let mut scene = Cow::Borrowed(scene);
    if unit != 1.0 {
        Similarity::scaling(unit).apply(&mut scene.to_mut().splats);
    }
    scene
}

/// Writes the local coordinates of a scene, where they are not those of the world: for this program
/// and for people.
pub(super) fn write_origin<W: Write + ?Sized>(world_from_local: &Similarity, out: &mut W) -> std::io::Result<()> {
    let Some(frame) = LocalFrame::from_similarity(world_from_local) else { return Ok(()) };
    writeln!(out, "comment {COMMENT_TAG} {FRAME_COMMENT} {}", serde_json::to_string(&frame)?)?;
    note_origin(world_from_local, out)
}

/// Writes, for people, the origin that positions are relative to, if it is another than that of the
/// world.
pub(super) fn note_origin<W: Write + ?Sized>(world_from_local: &Similarity, out: &mut W) -> std::io::Result<()> {
    let DVec3 { x, y, z } = world_from_local.translation();
    if world_from_local.translation() == DVec3::ZERO {
        return Ok(());
    }
    writeln!(out, "comment positions are relative to the origin {x} {y} {z} of the data set's coordinates")
}

pub(crate) fn check(path: &Path, scene: &Scene) -> Result<(), IoError> {
    let splats = &scene.splats;
    let invalid = |message: String| Err(IoError::invalid(path, format_args!("scene to write: {message}")));
    if let Err(e) = splats.validate() {
        return invalid(e.to_string());
    }
    if let Some(i) = splats.rotation.iter().position(|q| !is_normalizable(*q)) {
        return invalid(format!("rotation of splat {i} is {:?}, expected a quaternion of length about 1", splats.rotation[i]));
    }
    if let Some(i) = splats.smoothing.iter().position(|s| *s < 0.0) {
        return invalid(format!("smoothing of splat {i} is {}, expected 0 or more", splats.smoothing[i]));
    }
    if !is_usable(&scene.raster) {
        return invalid(format!("raster configuration {:?}, expected cut-offs of 0 to 1", scene.raster));
    }
    record::check(&scene.edits).map_err(|message| IoError::invalid(path, format_args!("scene to write: {message}")))
}

fn write<W: Write + ?Sized>(scene: &Scene, layer: &Layer<'_>, out: &mut W) -> std::io::Result<()> {
    let properties = properties(&scene.splats, layer);
    write_header(scene, layer, &properties, out)?;
    let layer = RowLayer { layer, shares_geometry: layer.shares_geometry(&scene.splats) };
    write_rows(scene.splats.len(), properties.len(), out, |i, values| fill_row(&scene.splats, i, &layer, values))
}

/// Writes `count` rows of `width` numbers that `fill` makes.
pub(super) fn write_rows<W: Write + ?Sized>(
    count: usize,
    width: usize,
    out: &mut W,
    fill: impl Fn(usize, &mut Vec<f32>) + Sync,
) -> std::io::Result<()> {
    let row_bytes = 4 * width;
    let mut block = vec![0u8; BLOCK_ROWS.min(count) * row_bytes];
    for first in (0..count).step_by(BLOCK_ROWS) {
        let rows = BLOCK_ROWS.min(count - first);
        let part = &mut block[..rows * row_bytes];
        part.par_chunks_exact_mut(row_bytes).enumerate().for_each_init(
            || Vec::with_capacity(width),
            |values, (row, bytes)| {
                values.clear();
                fill(first + row, values);
                for (to, value) in bytes.chunks_exact_mut(4).zip(values) {
                    to.copy_from_slice(&value.to_le_bytes());
                }
            },
        );
        out.write_all(part)?;
    }
    Ok(())
}

fn write_header<W: Write + ?Sized>(scene: &Scene, layer: &Layer<'_>, properties: &[String], out: &mut W) -> std::io::Result<()> {
    let model = serde_json::to_string(&scene.splats.color_model)?;
    let raster = serde_json::to_string(&scene.raster)?;
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    let version = if scene.splats.gain.is_empty() { FORMAT_VERSION } else { GAIN_VERSION };
    writeln!(out, "comment {COMMENT_TAG} scene {version}")?;
    writeln!(out, "comment {COMMENT_TAG} color_space {}", scene.color_space.name())?;
    writeln!(out, "comment {COMMENT_TAG} color_model {model}")?;
    writeln!(out, "comment {COMMENT_TAG} radiance_scale {:e}", scene.radiance_scale)?;
    writeln!(out, "comment {COMMENT_TAG} raster {raster}")?;
    for edit in &scene.edits {
        writeln!(out, "comment {COMMENT_TAG} edit {}", record::escaped(edit))?;
    }
    if let Layer::Baked(baked) = layer
        && let Some(world) = WorldRecord::from_similarity(&baked.file_from_world)
    {
        writeln!(out, "comment {COMMENT_TAG} file_from_world {}", serde_json::to_string(&world)?)?;
    }
    write_origin(&scene.world_from_local, out)?;
    if let Some(metres) = scene.metres_per_unit {
        writeln!(out, "comment {COMMENT_TAG} {METRES_COMMENT} {metres:e}")?;
    }
    writeln!(out, "comment {COMMENT_TAG} display_bake {}", layer.description())?;
    writeln!(out, "comment lcd_* properties hold the radiance model exactly; f_dc, f_rest, opacity and scale are for display")?;
    writeln!(out, "element vertex {}", scene.splats.len())?;
    for name in properties {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")
}

/// Names in the order of [`fill_row`].
fn properties(splats: &Splats, layer: &Layer<'_>) -> Vec<String> {
    let mut names = standard_properties(layer.coefficients());
    names.extend((0..splats.color_model.luminance_coefficients()).map(|m| format!("lcd_l_{m}")));
    let prefix = sh_prefix(splats.color_model);
    names.extend((0..3 * splats.color_model.sh_coefficients()).map(|i| format!("{prefix}{i}")));
    if !splats.smoothing.is_empty() {
        names.push("lcd_filter".to_owned());
    }
    if !splats.gain.is_empty() {
        names.push(GAIN.to_owned());
    }
    if !layer.shares_geometry(splats) {
        names.extend([EXACT_OPACITY].into_iter().chain(EXACT_SCALE).map(str::to_owned));
    }
    names
}

/// Names of 3D Gaussian splatting with harmonics of `coefficients` a channel.
pub(super) fn standard_properties(coefficients: usize) -> Vec<String> {
    let standard = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned);
    let mut names = Vec::from(standard);
    names.extend((0..3 * (coefficients - 1)).map(|i| format!("f_rest_{i}")));
    names.extend(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(str::to_owned));
    names
}

/// A display layer, and whether it shares the scene's geometry, found once for all rows.
struct RowLayer<'a> {
    layer: &'a Layer<'a>,
    shares_geometry: bool,
}

/// Fills a row with the values of splat `i` in the order of [`properties`].
fn fill_row(splats: &Splats, i: usize, row: &RowLayer<'_>, values: &mut Vec<f32>) {
    let layer = row.layer;
    let baked = layer.splat(splats, i);
    let (log_scale, opacity_logit) = layer.geometry(splats, i);
    values.extend(splats.position[i]);
    values.extend([0.0; 3]);
    values.extend(baked.map(|channel| channel[0]));
    for channel in &baked {
        values.extend_from_slice(&channel[1..layer.coefficients()]);
    }
    values.push(opacity_logit);
    values.extend(log_scale);
    values.extend(splats.rotation[i]);
    values.extend_from_slice(splats.raw_luminance_of(i));
    values.extend_from_slice(splats.sh_of(i));
    values.extend(splats.smoothing.get(i));
    values.extend(splats.gain.get(i));
    if !row.shares_geometry {
        values.push(splats.opacity_logit[i]);
        values.extend(splats.log_scale[i]);
    }
}
