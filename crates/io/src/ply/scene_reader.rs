//! PLY to scene: the exact model of a file written here, or a plain 3D Gaussian splatting file as
//! `ColorModel::Sh`.

use std::io::BufRead;
use std::path::Path;

use luxel_core::{Antialias, ColorModel, ColorSpace, RadianceScale, RasterConfig, SH_OFFSET, Scene, Similarity, Splats, sh};

use crate::IoError;
use crate::bake::{BakeRecord, Origin, WorldRecord, place};
use crate::local_frame::{LocalFrame, settled};
use crate::ply::header::{Element, Format, Header};
use crate::ply::rows::{beyond_line, check_count, read_rows, seek_element};
use crate::ply::scene_writer::{EXACT_OPACITY, EXACT_SCALE, FRAME_COMMENT, GAIN, METRES_COMMENT, sh_prefix};
use crate::ply::source::PlySource;
use crate::ply::{COMMENT_TAG, FORMAT_VERSION, GAIN_VERSION, compressed, record};
use crate::scene_file::{SceneFile, display_scene};
use crate::splat_model::{FLAT, SplatModel, log_thickness};
use crate::validity::{LeftOut, is_length, is_normalizable, is_usable};

/// Reads a scene.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, no splat without a value that is NaN or
/// infinite and with a rotation, or a version of the format that is not known.
pub fn read_scene_ply(path: &Path) -> Result<Scene, IoError> {
    read_scene_file(path).map(|file| file.scene)
}

/// Reads a scene with its warnings.
pub(crate) fn read_scene_file(path: &Path) -> Result<SceneFile, IoError> {
    decode(PlySource::open(path)?)
}

/// Decodes a file's bytes as [`read_scene_ply`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_scene_ply`].
pub fn decode_scene_ply(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    decode(PlySource::from_bytes(name, bytes)).map(|file| file.scene)
}

/// Names of the properties that hold the model.
struct SceneColumns {
    log_scale: [&'static str; 3],
    opacity: &'static str,
    smoothing: Option<&'static str>,
    gain: Option<&'static str>,
    /// In the order of `Splats::sh`, [K,3].
    sh: Vec<String>,
    raw_luminance: Vec<String>,
    /// Whether the splats are flat: the last of `log_scale` is not in the file, or means nothing.
    is_flat: bool,
    /// White of `sh` that are red, green and blue in place of harmonics.
    rgb_white: Option<f32>,
}

const RGB: [&str; 3] = ["red", "green", "blue"];
const STANDARD_SCALE: [&str; 3] = ["scale_0", "scale_1", "scale_2"];
/// Columns of 2DGS, whose splats have two axes; the third is replaced by their thickness.
const FLAT_SCALE: [&str; 3] = ["scale_0", "scale_1", "scale_1"];

fn decode<R: BufRead>(mut source: PlySource<'_, R>) -> Result<SceneFile, IoError> {
    let header = Header::read(&mut source)?;
    if compressed::is_compressed(&header) {
        let mut file = compressed::read(&mut source, &header)?;
        let last = header.elements.last().map_or("", |element| element.name.as_str());
        file.warnings.extend(beyond_line(&source, &header, last));
        return Ok(file);
    }
    let element = seek_element(&mut source, &header, "vertex")?;
    let comments = Comments::new(&header);
    let record = comments.baked().map_err(|e| e.into_error(&source))?;
    let world = comments.world().map_err(|e| e.into_error(&source))?;
    let frame = comments.local_frame().map_err(|e| e.into_error(&source))?;
    let is_exact = record.is_none() && !comments.lines.is_empty();
    let (mut scene, layout) =
        if is_exact { comments.exact(element).map_err(|e| e.into_error(&source))? } else { plain(&source, &header, element)? };
    let mut exact_positions = Vec::new();
    let left_out = read_splats(&mut source, &header, element, &layout, &mut scene.splats, &mut exact_positions)?;
    let mut warnings = left_out.lines(element.count);
    if layout.is_flat {
        warnings.push(FLAT.to_owned());
    }
    warnings.extend(beyond_line(&source, &header, "vertex"));
    if let Some(record) = record {
        let scene = record.scene(scene.splats).map_err(|e| IoError::invalid(source.path, e))?;
        return Ok(SceneFile { scene, warnings });
    }
    if is_exact {
        let origin = frame.map(|frame| Origin { frame, is_in_move: false });
        place(&mut scene, &Similarity::IDENTITY, world.as_ref(), origin).map_err(|e| IoError::invalid(source.path, e))?;
        return Ok(SceneFile { scene, warnings });
    }
    warnings.extend(unusual_numbers(&scene.splats));
    Ok(SceneFile { scene: settled(scene, Some(&exact_positions).filter(|p| !p.is_empty()).map(Vec::as_slice)), warnings })
}

fn read_splats<R: BufRead>(
    source: &mut PlySource<'_, R>,
    header: &Header,
    element: &Element,
    layout: &SceneColumns,
    splats: &mut Splats,
    exact_positions: &mut Vec<[f64; 3]>,
) -> Result<LeftOut, IoError> {
    let geometry = ["x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3"].into_iter().chain(layout.log_scale).chain([layout.opacity]);
    let colors = layout.sh.iter().chain(&layout.raw_luminance).map(String::as_str);
    let mut columns = Vec::new();
    for name in geometry.chain(colors).chain(layout.smoothing).chain(layout.gain) {
        let missing = || {
            let message = format!("element \"vertex\" has no property {name:?}: not the splats of a scene, or a tool dropped it");
            source.invalid("header", message)
        };
        columns.push(element.position(name).ok_or_else(missing)?);
    }
    let count = check_count(source, element, header.format)?;
    splats.position.reserve_exact(count);
    splats.rotation.reserve_exact(count);
    splats.log_scale.reserve_exact(count);
    splats.opacity_logit.reserve_exact(count);
    splats.sh.reserve_exact(count * layout.sh.len());
    splats.raw_luminance.reserve_exact(count * layout.raw_luminance.len());
    let has_more_digits = header.format == Format::Ascii || columns[..3].iter().any(|&c| element.is_double(c));
    let (path, sh_len) = (source.path, layout.sh.len());
    let (mut unturned, mut first_unturned) = (0, None);
    let mut left_out = read_rows(source, element, header.format, &columns, |row, values, position| {
        let [x, y, z, qw, qx, qy, qz, s0, s1, s2, opacity, ref colors @ ..] = *values else {
            return Ok(());
        };
        let rotation = [qw, qx, qy, qz];
        if !is_normalizable(rotation) {
            let message = format!("vertex {row}: rotation rot_0..3 is {rotation:?}, expected a quaternion of length about 1");
            unturned += 1;
            first_unturned.get_or_insert_with(|| IoError::invalid(path, message));
            return Ok(());
        }
        splats.position.push([x, y, z]);
        if has_more_digits {
            exact_positions.push(position);
        }
        splats.rotation.push(rotation);
        splats.log_scale.push([s0, s1, if layout.is_flat { log_thickness(s0, s1) } else { s2 }]);
        splats.opacity_logit.push(opacity);
        let (harmonics, rest) = colors.split_at(sh_len);
        match layout.rgb_white {
            Some(white) => splats.sh.extend(harmonics.iter().map(|v| (v / white - SH_OFFSET) / sh::C0)),
            None => splats.sh.extend_from_slice(harmonics),
        }
        let (raw_luminance, rest) = rest.split_at(layout.raw_luminance.len());
        splats.raw_luminance.extend_from_slice(raw_luminance);
        let (smoothing, gain) = rest.split_at(usize::from(layout.smoothing.is_some()));
        for (name, value, expected) in [(layout.smoothing, smoothing, "a standard deviation"), (layout.gain, gain, "a gain")] {
            if let (Some(name), Some(value)) = (name, value.iter().find(|value| **value < 0.0)) {
                let message = format!("vertex {row}: property {name:?} is {value}, expected {expected} of 0 or more");
                return Err(IoError::invalid(path, message));
            }
        }
        splats.smoothing.extend_from_slice(smoothing);
        splats.gain.extend_from_slice(gain);
        Ok(())
    })?;
    left_out.add_unturned(unturned, first_unturned);
    left_out.of_rows(element.count)
}

/// Returns a file of some other program: harmonics of a display's colours, and the renderer they
/// were trained with.
fn plain<R: BufRead>(source: &PlySource<'_, R>, header: &Header, element: &Element) -> Result<(Scene, SceneColumns), IoError> {
    if let Some(extra) = element.properties.iter().find(|p| p.name.starts_with("lcd_")) {
        let message = format!(
            "property {:?} belongs to a radiance model, but the comments \"{COMMENT_TAG} ...\" that describe it are missing: a tool dropped \
             them; use the original file, or drop the lcd_* properties too to read the tone-mapped colours as radiance",
            extra.name
        );
        return Err(source.invalid("header", message));
    }
    let rest = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    let Some(degree) = (0..=sh::MAX_DEGREE).find(|&degree| 3 * (sh::coefficients(degree) - 1) == rest) else {
        let message = format!("{rest} properties f_rest_*, expected 0, 9, 24, 45, 72 or 105 (spherical harmonics of degree 0 to 5)");
        return Err(source.invalid("header", message));
    };
    let higher = sh::coefficients(degree) - 1;
    let has = |name: &str| element.position(name).is_some();
    // Without harmonics, colours as points have them.
    let rgb_white = if degree == 0 && !has("f_dc_0") && RGB.into_iter().all(has) { element.white(RGB[0]) } else { None };
    let dc = (0..3).map(|c| if rgb_white.is_some() { RGB[c].to_owned() } else { format!("f_dc_{c}") });
    // Channel-major in the file, coefficient-major here.
    let others = (0..higher).flat_map(|m| (0..3).map(move |c| format!("f_rest_{}", c * higher + m)));
    let smoothing = element.position("filter_3D").map(|_| "filter_3D");
    let model = header.splat_model();
    let antialias = if smoothing.is_some() { Antialias::Mip } else { model.antialias() };
    let scene = display_scene(Splats::empty(ColorModel::Sh { degree: degree as u8 }), antialias);
    // Without a third axis, or with one that means nothing.
    let is_flat = has("scale_0") && has("scale_1") && (!has("scale_2") || model == SplatModel::Flat);
    let layout = SceneColumns {
        log_scale: if is_flat { FLAT_SCALE } else { STANDARD_SCALE },
        is_flat,
        rgb_white,
        opacity: "opacity",
        smoothing,
        gain: None,
        sh: dc.chain(others).collect(),
        raw_luminance: Vec::new(),
    };
    Ok((scene, layout))
}

/// Least number of splats whose numbers tell a convention.
const TELLING: usize = 100;

/// Warns of sizes and opacities that are probably not the logarithms and logits that they are read
/// as: no size is below 0, and every opacity is from 0 to 1.
fn unusual_numbers(splats: &Splats) -> Option<String> {
    let is_length = splats.log_scale.as_flattened().iter().all(|s| *s >= 0.0);
    let is_opacity = splats.opacity_logit.iter().all(|o| (0.0..=1.0).contains(o));
    (splats.len() >= TELLING && is_length && is_opacity).then(|| {
        "all of \"scale_0..2\" are 0 or more and all of \"opacity\" are 0 to 1, read as logarithms of lengths and logits: if they are lengths \
         and opacities, write their logarithms and logits"
            .to_owned()
    })
}

/// Explains what is wrong with the comments.
enum CommentError {
    Invalid(String),
    Unsupported(String),
}

impl CommentError {
    fn into_error<R>(self, source: &PlySource<'_, R>) -> IoError {
        match self {
            Self::Invalid(message) => IoError::invalid(source.path, format_args!("header: {message}")),
            Self::Unsupported(message) => IoError::unsupported(source.path, format_args!("header: {message}")),
        }
    }
}

/// The comments that belong to this program, as key and value.
struct Comments<'h> {
    lines: Vec<(&'h str, &'h str)>,
}

impl<'h> Comments<'h> {
    fn new(header: &'h Header) -> Self {
        let ours = header.comments.iter().filter_map(|c| c.strip_prefix(COMMENT_TAG)?.strip_prefix(' '));
        Self { lines: ours.filter_map(|line| line.split_once(' ')).collect() }
    }

    fn value(&self, key: &str) -> Result<&'h str, CommentError> {
        let mut values = self.lines.iter().filter(|(k, _)| *k == key).map(|(_, value)| *value);
        match (values.next(), values.next()) {
            (Some(value), None) => Ok(value.trim()),
            (None, _) => {
                Err(CommentError::Invalid(format!("no comment \"{COMMENT_TAG} {key} ...\"; a tool dropped it, use the original file")))
            }
            _ => Err(CommentError::Invalid(format!("comment \"{COMMENT_TAG} {key}\" occurs twice"))),
        }
    }

    fn parse<T>(&self, key: &str, expected: &str, parse: impl FnOnce(&str) -> Option<T>) -> Result<T, CommentError> {
        let value = self.value(key)?;
        parse(value).ok_or_else(|| CommentError::Invalid(format!("comment \"{COMMENT_TAG} {key}\" is {value:?}, expected {expected}")))
    }

    /// Returns the records of edits, in order.
    fn edits(&self) -> Result<Vec<String>, CommentError> {
        let read = |text: &str| {
            let message = || format!("comment \"{COMMENT_TAG} edit\" is {text:?}, which is not escaped as it was written");
            record::unescaped(text.trim()).ok_or_else(|| CommentError::Invalid(message()))
        };
        let edits = self.lines.iter().filter(|(key, _)| *key == "edit").map(|(_, text)| read(text)).collect::<Result<Vec<_>, _>>()?;
        record::check(&edits).map_err(CommentError::Invalid)?;
        Ok(edits)
    }

    /// Returns the record that only a bake has.
    fn baked(&self) -> Result<Option<BakeRecord>, CommentError> {
        if !self.lines.iter().any(|(key, _)| *key == "baked") {
            return Ok(None);
        }
        BakeRecord::parse(self.value("baked")?).map(Some).map_err(CommentError::Invalid)
    }

    /// Returns how the file's world came from that of the data set, where they differ.
    fn world(&self) -> Result<Option<WorldRecord>, CommentError> {
        if !self.lines.iter().any(|(key, _)| *key == "file_from_world") {
            return Ok(None);
        }
        let is_similarity = |world: &WorldRecord| world.similarity().is_some();
        let world = |v: &str| serde_json::from_str::<WorldRecord>(v).ok().filter(is_similarity);
        self.parse("file_from_world", "a rotation and a positive scale", world).map(Some)
    }

    /// Returns the local coordinates of the scene, where they are not those of the world.
    fn local_frame(&self) -> Result<Option<LocalFrame>, CommentError> {
        if !self.lines.iter().any(|(key, _)| *key == FRAME_COMMENT) {
            return Ok(None);
        }
        self.parse(FRAME_COMMENT, "an origin and a positive unit", LocalFrame::parse).map(Some)
    }

    /// Returns the length of a unit of the world, metres, where it is known.
    fn metres_per_unit(&self) -> Result<Option<f64>, CommentError> {
        if !self.lines.iter().any(|(key, _)| *key == METRES_COMMENT) {
            return Ok(None);
        }
        self.parse(METRES_COMMENT, "a number above 0", |v| v.parse().ok().filter(is_length)).map(Some)
    }

    /// Returns an empty scene of the model that the comments describe, and the columns of its
    /// values.
    fn exact(&self, element: &Element) -> Result<(Scene, SceneColumns), CommentError> {
        let version: u32 = self.parse("scene", "a version number", |v| v.parse().ok())?;
        if !(FORMAT_VERSION..=GAIN_VERSION).contains(&version) {
            let message = format!(
                "scene format version {version}, expected {FORMAT_VERSION} or {GAIN_VERSION}; use the release of luxel that wrote the file"
            );
            return Err(CommentError::Unsupported(message));
        }
        let color_space = self.parse("color_space", ColorSpace::NAMES, ColorSpace::of_scene)?;
        let model_of = |v: &str| serde_json::from_str::<ColorModel>(v).ok().filter(|m| m.is_valid());
        let color_model = self.parse("color_model", "a colour model with degrees in range", model_of)?;
        let scale_of = |v: &str| RadianceScale::new(v.parse().ok()?);
        let radiance_scale = self.parse("radiance_scale", "a positive number", scale_of)?;
        let raster_of = |v: &str| serde_json::from_str::<RasterConfig>(v).ok().filter(is_usable);
        let raster = self.parse("raster", "cut-offs of 0 or more and antialias", raster_of)?;
        let splats = Splats::empty(color_model);
        let (edits, metres_per_unit) = (self.edits()?, self.metres_per_unit()?);
        Ok((
            Scene { splats, radiance_scale, color_space, raster, edits, world_from_local: Similarity::IDENTITY, metres_per_unit },
            exact_layout(color_model, element),
        ))
    }
}

fn exact_layout(color_model: ColorModel, element: &Element) -> SceneColumns {
    let prefix = sh_prefix(color_model);
    let has = |name: &str| element.position(name).is_some();
    let is_smoothed = has("lcd_filter");
    // One of them asks for all.
    let has_geometry = is_smoothed || has(EXACT_OPACITY) || EXACT_SCALE.into_iter().any(has);
    SceneColumns {
        log_scale: if has_geometry { EXACT_SCALE } else { STANDARD_SCALE },
        is_flat: false,
        rgb_white: None,
        opacity: if has_geometry { EXACT_OPACITY } else { "opacity" },
        smoothing: is_smoothed.then_some("lcd_filter"),
        gain: has(GAIN).then_some(GAIN),
        sh: (0..3 * color_model.sh_coefficients()).map(|i| format!("{prefix}{i}")).collect(),
        raw_luminance: (0..color_model.luminance_coefficients()).map(|m| format!("lcd_l_{m}")).collect(),
    }
}
