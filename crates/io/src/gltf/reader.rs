//! glTF to a scene.

use std::collections::HashSet;
use std::path::Path;

use glam::{DMat4, DQuat, DVec3};
use luxel_core::tone::srgb_encode;
use luxel_core::{ColorModel, ColorSpace, Cutoffs, RadianceScale, RasterConfig, SH_OFFSET, Scene, Similarity, Splats, sh};
use serde::Deserialize;

use super::document::{Document, Node, Primitive};
use super::{CHUNK_BIN, CHUNK_JSON, EXTENSION, GLB_MAGIC, KHR, accessor, conventions};
use crate::IoError;
use crate::bake::{BakeRecord, Origin, RECORD_KEY, WorldRecord, place};
use crate::input::Input;
use crate::joined::{MAX_PARTS, join, similarity, suitable};
use crate::local_frame::{LocalFrame, settle};
use crate::read_file::read_file;
use crate::scene_file::SceneFile;
use crate::validity::{LeftOut, check_rotations, is_length, is_usable, leave_out_unusable};

/// Deepest nesting of nodes.
const MAX_DEPTH: usize = 64;
/// Most nodes visited.
const MAX_VISITS: usize = 10_000;
/// How far a rotation's length may be off 1: files round quaternions to a few digits.
const ROTATION_TOLERANCE: f64 = 0.01;
/// Reads all splats of the file's scene.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, no splats, or an unsupported feature: external
/// buffers, compression, shearing.
pub fn read_glb(path: &Path) -> Result<Scene, IoError> {
    read_scene_file(path).map(|file| file.scene)
}

/// Reads a scene with its warnings.
pub(crate) fn read_scene_file(path: &Path) -> Result<SceneFile, IoError> {
    decode(Input::new(path, &read_file(path)?))
}

/// Decodes a file's bytes as [`read_glb`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_glb`].
pub fn decode_glb(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    decode(Input::new(name, bytes)).map(|file| file.scene)
}

fn decode(input: Input<'_>) -> Result<SceneFile, IoError> {
    let invalid = |message: String| input.invalid(message);
    let (json, bin) = chunks(input.bytes).map_err(invalid)?;
    let document: Document = serde_json::from_slice(json).map_err(|e| invalid(format!("JSON: {e}")))?;
    let mut visited = Visited::default();
    for node in roots(&document).map_err(invalid)? {
        visit(&document, node, DMat4::IDENTITY, &mut visited, 0).map_err(invalid)?;
    }
    let record = document.asset.extras.get(RECORD_KEY).and_then(|v| v.as_str()).map(BakeRecord::parse).transpose().map_err(invalid)?;
    let mut placed = Vec::with_capacity(visited.primitives.len());
    let (mut left_out, mut count, mut warnings) = (LeftOut::default(), 0, Vec::new());
    for (primitive, matrix) in visited.primitives {
        let moved = similarity(matrix).map_err(|message| input.unsupported(message))?;
        let mut part = read_primitive(&document, bin, primitive, record.as_ref(), &mut warnings).map_err(invalid)?;
        count += part.scene.splats.len() as u64;
        left_out.add(leave_out_unusable(&mut part.scene.splats));
        placed.push((part, moved));
    }
    // The parts of a file of another program share local coordinates.
    let of_others = placed.iter().filter(|(part, _)| !part.is_ours);
    let suitable = suitable(of_others.map(|(part, moved)| (&part.scene.splats, moved)));
    let mut scenes = Vec::with_capacity(placed.len());
    for (mut part, moved) in placed {
        if part.is_ours || suitable.is_identity() {
            let origin = part.frame.map(|frame| Origin { frame, is_in_move: true });
            place(&mut part.scene, &moved, part.file_from_world.as_ref(), origin).map_err(|e| invalid(part.named(&e)))?;
        } else {
            settle(&mut part.scene, None, &moved, suitable);
        }
        left_out.add(leave_out_unusable(&mut part.scene.splats));
        part.scene.splats.validate().map_err(|e| invalid(e.to_string()))?;
        check_rotations(&part.scene.splats).map_err(invalid)?;
        scenes.push(part.scene);
    }
    let none = || input.unsupported(format!("no primitive with {KHR}: no splats in this file's scene"));
    let scene = join(scenes).map_err(|message| input.unsupported(message))?.ok_or_else(none)?;
    warnings.extend(left_out.lines(count));
    warnings.dedup();
    Ok(SceneFile { scene, warnings })
}

/// Returns the JSON and the binary buffer of a .glb.
fn chunks(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    if word(0) != Some(GLB_MAGIC) {
        return Err("does not begin with glTF: not a binary glTF file".into());
    }
    if word(4) != Some(2) {
        return Err(format!("glTF version {}, expected 2", word(4).unwrap_or(0)));
    }
    let (mut json, mut bin) = (None, None);
    let mut at = 12usize;
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let start = at + 8;
        let chunk = start.checked_add(length as usize).and_then(|end| bytes.get(start..end));
        let chunk =
            chunk.ok_or_else(|| format!("byte {at}: a chunk of {length} bytes goes beyond the file's end; the file is truncated"))?;
        match kind {
            CHUNK_JSON if json.is_none() => json = Some(chunk),
            CHUNK_BIN if bin.is_none() => bin = Some(chunk),
            _ => {}
        }
        at = start + chunk.len();
    }
    let json = json.ok_or("no JSON chunk; the file is truncated")?;
    Ok((json, bin.unwrap_or_default()))
}

/// Returns the nodes that the scene begins with; where there is no scene, those that are in no
/// other.
fn roots(document: &Document) -> Result<Vec<usize>, String> {
    let index = document.scene.unwrap_or(0);
    match document.scenes.get(index) {
        Some(scene) => Ok(scene.nodes.clone()),
        None if document.scene.is_some() => Err(format!("scene {index} does not exist, expected one of {}", document.scenes.len())),
        None => {
            let inner: HashSet<usize> = document.nodes.iter().flat_map(|node| node.children.iter().copied()).collect();
            Ok((0..document.nodes.len()).filter(|node| !inner.contains(node)).collect())
        }
    }
}

/// Returns the node's local matrix; the error explains what is wrong with its rotation.
fn local_matrix(node: &Node) -> Result<DMat4, String> {
    if let Some(matrix) = &node.matrix {
        return Ok(DMat4::from_cols_array(matrix));
    }
    let rotation = node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
    let is_unit = (rotation.length() - 1.0).abs() < ROTATION_TOLERANCE;
    if !is_unit {
        return Err(format!("rotation {:?} is of length {}, expected a quaternion of length 1", rotation.to_array(), rotation.length()));
    }
    let scale = node.scale.map_or(DVec3::ONE, DVec3::from_array);
    let translation = node.translation.map_or(DVec3::ZERO, DVec3::from_array);
    Ok(DMat4::from_scale_rotation_translation(scale, rotation.normalize(), translation))
}

/// The primitives of splats found so far, with their matrices, and the number of nodes visited.
#[derive(Default)]
struct Visited<'d> {
    primitives: Vec<(&'d Primitive, DMat4)>,
    nodes: usize,
}

/// Collects primitives of splats below a node.
fn visit<'d>(document: &'d Document, index: usize, parent: DMat4, out: &mut Visited<'d>, depth: usize) -> Result<(), String> {
    let node = document.nodes.get(index).ok_or_else(|| format!("node {index} does not exist"))?;
    out.nodes += 1;
    if depth > MAX_DEPTH || out.nodes > MAX_VISITS {
        return Err(format!(
            "node {index}: more than {MAX_DEPTH} nodes within one another, or {MAX_VISITS} in all: they may go in circles"
        ));
    }
    let matrix = parent * local_matrix(node).map_err(|e| format!("node {index}: {e}"))?;
    if let Some(mesh) = node.mesh {
        let mesh = document.meshes.get(mesh).ok_or_else(|| format!("node {index}: mesh {mesh} does not exist"))?;
        out.primitives.extend(mesh.primitives.iter().filter(|p| p.extensions.contains_key(KHR)).map(|p| (p, matrix)));
        if out.primitives.len() > MAX_PARTS {
            return Err(format!("node {index}: more than {MAX_PARTS} primitives of splats, expected fewer; join them first"));
        }
    }
    node.children.iter().try_for_each(|child| visit(document, *child, matrix, out, depth + 1))
}

/// Our extension.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Exact {
    color_model: ColorModel,
    color_space: ColorSpace,
    radiance_scale: f32,
    raster: RasterConfig,
    attributes: std::collections::BTreeMap<String, usize>,
    #[serde(default)]
    edits: Vec<String>,
    #[serde(default)]
    file_from_world: Option<WorldRecord>,
    #[serde(default)]
    local_frame: Option<LocalFrame>,
    #[serde(default)]
    metres_per_unit: Option<f64>,
}

/// The splats of a primitive where its node has not moved them yet, and what its file states of
/// their world.
struct Part {
    scene: Scene,
    file_from_world: Option<WorldRecord>,
    frame: Option<LocalFrame>,
    is_ours: bool,
    is_exact: bool,
}

impl Part {
    /// Returns an error with the name of what it is about.
    fn named(&self, error: &str) -> String {
        if self.is_exact { format!("{EXTENSION}: {error}") } else { error.to_owned() }
    }
}

/// Returns the splats of a primitive.
fn read_primitive(
    document: &Document,
    bin: &[u8],
    primitive: &Primitive,
    record: Option<&BakeRecord>,
    warnings: &mut Vec<String>,
) -> Result<Part, String> {
    let khr = primitive.extensions.get(KHR);
    let exact = khr.and_then(|v| v.get("extensions")).and_then(|e| e.get(EXTENSION));
    let exact = exact.map(|v| Exact::deserialize(v).map_err(|e| format!("{EXTENSION}: {e}")));
    let read = |name: &str, width: usize| {
        let index = primitive.attributes.get(name).ok_or_else(|| format!("no attribute {name:?}: compressed, or not splats"))?;
        accessor::read(document, bin, *index, width)
    };
    let (positions, scales) = (read("POSITION", 3)?, read(&format!("{KHR}:SCALE"), 3)?);
    let (rotations, opacities) = (read(&format!("{KHR}:ROTATION"), 4)?, read(&format!("{KHR}:OPACITY"), 1)?);
    let count = positions.len() / 3;
    if [scales.len(), rotations.len(), opacities.len()] != [3 * count, 4 * count, count] {
        return Err(format!("attributes of different lengths for {count} splats"));
    }
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    splats.position = positions.as_chunks::<3>().0.to_vec();
    // Logarithms take NaN for the least: one number that is not finite marks its splat.
    let own = |i: usize| scales[3 * i..3 * i + 3].iter().chain(&rotations[4 * i..4 * i + 4]).chain(&opacities[i..=i]);
    let unfinite = |i: &usize| own(*i).any(|v| !v.is_finite());
    for i in (0..count).filter(unfinite).collect::<Vec<_>>() {
        splats.position[i] = [f32::NAN; 3];
    }
    splats.rotation = rotations.as_chunks::<4>().0.iter().map(|[x, y, z, w]| [*w, *x, *y, *z]).collect();
    splats.log_scale = conventions::log_scales(scales.as_chunks::<3>().0, warnings)?;
    splats.opacity_logit = conventions::opacity_logits(&opacities, warnings)?;
    if let Some(exact) = exact.transpose()? {
        return read_exact(document, bin, splats, exact);
    }
    let stated = khr.and_then(|v| v.get("colorSpace"));
    let color_space = match record {
        Some(record) => record.color_space(),
        None => conventions::color_space(stated)?,
    };
    let has = |name: &str| primitive.attributes.contains_key(name);
    let is_bare = !has(&format!("{KHR}:SH_DEGREE_0_COEF_0"));
    if is_bare && has("COLOR_0") {
        warnings.push("no harmonics: the colours of the points, COLOR_0, are read in their place".to_owned());
        // Light in glTF, under the curve of the splats' space here.
        let colors = read("COLOR_0", 3).or_else(|_| read("COLOR_0", 4))?;
        let width = colors.len() / count.max(1);
        let code = |light: f32| if color_space.is_linear() { light } else { srgb_encode(light) };
        let constant = |rgb: &[f32]| [0, 1, 2].map(|c| (code(rgb[c]) - SH_OFFSET) / sh::C0);
        if ![3 * count, 4 * count].contains(&colors.len()) {
            return Err(format!("attributes of different lengths for {count} splats"));
        }
        splats.sh = colors.chunks_exact(width.max(3)).flat_map(constant).collect();
    } else {
        read_harmonics(&mut splats, |name, width| {
            let name = format!("{KHR}:{name}");
            primitive.attributes.contains_key(&name).then(|| read(&name, width))
        })?;
    }
    let raster = record.map_or_else(|| RasterConfig { cutoffs: Cutoffs::PARITY, ..RasterConfig::default() }, |record| record.raster);
    let (edits, world_from_local) = (Vec::new(), Similarity::IDENTITY);
    let metres_per_unit = record.and_then(|record| record.metres_per_unit);
    let scene = Scene { splats, radiance_scale: RadianceScale::ONE, color_space, raster, edits, world_from_local, metres_per_unit };
    let (file_from_world, frame) = record.map_or((None, None), |record| (record.file_from_world, record.local_frame));
    Ok(Part { scene, file_from_world, frame, is_ours: record.is_some(), is_exact: false })
}

/// Reads harmonics of as many degrees as there are.
fn read_harmonics(splats: &mut Splats, read: impl Fn(&str, usize) -> Option<Result<Vec<f32>, String>>) -> Result<(), String> {
    let mut planes = Vec::new();
    for degree in 0..=sh::MAX_DEGREE {
        let name = |n: usize| format!("SH_DEGREE_{degree}_COEF_{n}");
        if read(&name(0), 3).is_none() {
            break;
        }
        for n in 0..=2 * degree {
            planes.push(read(&name(n), 3).ok_or_else(|| format!("no attribute {:?}", name(n)))??);
        }
        splats.color_model = ColorModel::Sh { degree: degree as u8 };
    }
    if planes.is_empty() {
        return Err("no attribute \"SH_DEGREE_0_COEF_0\" and no \"COLOR_0\": splats without colours; export them with harmonics".into());
    }
    splats.sh = interleaved(&planes, 3, splats.len())?;
    Ok(())
}

/// Converts planes `[N, width]` to rows `[N, planes, width]`.
fn interleaved(planes: &[Vec<f32>], width: usize, count: usize) -> Result<Vec<f32>, String> {
    if planes.iter().any(|plane| plane.len() != width * count) {
        return Err(format!("attributes of different lengths for {count} splats"));
    }
    let mut rows = Vec::with_capacity(planes.len() * width * count);
    for i in 0..count {
        planes.iter().for_each(|plane| rows.extend_from_slice(&plane[width * i..width * (i + 1)]));
    }
    Ok(rows)
}

/// Returns the radiance model with the geometry of the display layer.
fn read_exact(document: &Document, bin: &[u8], mut splats: Splats, exact: Exact) -> Result<Part, String> {
    let invalid = |message: &str| format!("{EXTENSION}: {message}");
    if !exact.color_model.is_valid() {
        return Err(invalid("colour model is out of range"));
    }
    let radiance_scale = RadianceScale::new(exact.radiance_scale).filter(|_| is_usable(&exact.raster));
    let radiance_scale = radiance_scale.ok_or_else(|| invalid("radiance scale or cut-offs are out of range"))?;
    crate::ply::check_edits(&exact.edits).map_err(|e| invalid(&e))?;
    let count = splats.len();
    let optional =
        |name: &str, width: usize| {
            let index = exact.attributes.get(name)?;
            Some(accessor::read(document, bin, *index, width).and_then(|values| {
                if values.len() == width * count { Ok(values) } else { Err(format!("{name:?} is not of {count} splats")) }
            }))
        };
    let needed = |name: String, width: usize| optional(&name, width).unwrap_or_else(|| Err(invalid(&format!("no attribute {name:?}"))));
    let planes: Vec<Vec<f32>> = (0..exact.color_model.sh_coefficients()).map(|n| needed(format!("SH_{n}"), 3)).collect::<Result<_, _>>()?;
    let luminance: Vec<Vec<f32>> =
        (0..exact.color_model.luminance_coefficients()).map(|n| needed(format!("RAW_LUMINANCE_{n}"), 1)).collect::<Result<_, _>>()?;
    splats.sh = interleaved(&planes, 3, count)?;
    splats.raw_luminance = interleaved(&luminance, 1, count)?;
    splats.color_model = exact.color_model;
    if let Some(filter) = optional("FILTER", 1).transpose()? {
        if filter.iter().any(|f| *f < 0.0) {
            return Err(invalid("\"FILTER\" is negative"));
        }
        splats.smoothing = filter;
    }
    if let Some(gain) = optional("GAIN", 1).transpose()? {
        if gain.iter().any(|gain| *gain < 0.0) {
            return Err(invalid("\"GAIN\" is negative"));
        }
        splats.gain = gain;
    }
    if let Some(values) = optional("OPACITY_LOGIT", 1).transpose()? {
        splats.opacity_logit = values;
    }
    if let Some(values) = optional("LOG_SCALE", 3).transpose()? {
        splats.log_scale = values.as_chunks::<3>().0.to_vec();
    }
    let Exact { color_space, raster, edits, file_from_world, local_frame, metres_per_unit, .. } = exact;
    if metres_per_unit.is_some_and(|metres| !is_length(&metres)) {
        return Err(invalid("\"metresPerUnit\" is not a number above 0"));
    }
    if local_frame.is_some_and(|frame| frame.world_from_local().is_none()) {
        return Err(invalid("\"localFrame\" is not an origin and a positive unit"));
    }
    let scene = Scene { splats, radiance_scale, color_space, raster, edits, world_from_local: Similarity::IDENTITY, metres_per_unit };
    Ok(Part { scene, file_from_world, frame: local_frame, is_ours: true, is_exact: true })
}
