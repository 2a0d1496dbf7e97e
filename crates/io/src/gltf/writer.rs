//! A bake, and the radiance model beside it, to binary glTF; buffers are written attribute by
//! attribute, in blocks.

use std::io::Write;
use std::path::Path;

use glam::DVec3;
use luxel_core::tone::srgb_decode;
use luxel_core::{ColorSpace, Remedy, SH_OFFSET, Scene, Splats, sh, sigmoid};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::{CHUNK_BIN, CHUNK_JSON, EXTENSION, FLOAT, GLB_MAGIC, KHR};
use crate::bake::{Appearance, BakeRecord, Baked, RECORD_KEY, WorldRecord};
use crate::lights::{PUNCTUAL, StageLights, light_extras, light_nodes, punctual_lights};
use crate::local_frame::LocalFrame;
use crate::validity::check_lengths;
use crate::{IoError, write_atomically};

/// Splats of a block.
const BLOCK: usize = 1 << 16;
const UNSIGNED_BYTE: u32 = 5121;
const ARRAY_BUFFER: u32 = 34962;

/// Writes a bake, with `exact` the radiance model, too (of the same splats, in the same world), and
/// with lights their lamps; glTF has no map.
///
/// # Errors
/// A scene that could not be read back, a linear bake in other than linear Rec.709, more than the 4
/// GiB that the format holds, or the file system's refusal.
pub fn write_glb(path: &Path, baked: &Baked, exact: Option<&Scene>, lights: Option<&StageLights>) -> Result<(), IoError> {
    let layout = GlbLayout::new(path, baked, exact, lights)?;
    write_atomically(path, |file| layout.write(file).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes the bytes that [`write_glb`] writes without lights; `name` is for errors.
///
/// # Errors
/// The same as [`write_glb`].
pub fn encode_glb(name: &Path, baked: &Baked, exact: Option<&Scene>) -> Result<Vec<u8>, IoError> {
    let mut bytes = Vec::new();
    GlbLayout::new(name, baked, exact, None)?.write(&mut bytes).map_err(|e| IoError::system(name, "write", &e))?;
    Ok(bytes)
}

/// Appends the bytes of a row.
type Row<'a> = Box<dyn Fn(usize, &mut Vec<u8>) + Sync + 'a>;

/// One attribute: an accessor and a buffer view of its own.
struct Attribute<'a> {
    name: String,
    kind: &'static str,
    component_type: u32,
    row_bytes: usize,
    row: Row<'a>,
}

impl<'a> Attribute<'a> {
    fn floats<const N: usize>(name: impl Into<String>, row: impl Fn(usize) -> [f32; N] + Sync + 'a) -> Self {
        let kind = match N {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        let row = move |i: usize, out: &mut Vec<u8>| out.extend(row(i).into_iter().flat_map(f32::to_le_bytes));
        Self { name: name.into(), kind, component_type: FLOAT, row_bytes: 4 * N, row: Box::new(row) }
    }
}

struct GlbLayout<'a> {
    count: usize,
    json: Vec<u8>,
    attributes: Vec<Attribute<'a>>,
    bin_bytes: u32,
    file_bytes: u32,
}

impl<'a> GlbLayout<'a> {
    fn new(name: &Path, baked: &'a Baked, exact: Option<&'a Scene>, lights: Option<&StageLights>) -> Result<Self, IoError> {
        crate::ply::check(name, &baked.scene)?;
        check_lengths(&baked.scene.splats).map_err(|e| IoError::invalid(name, format_args!("scene to write: {e}")))?;
        let splats = &baked.scene.splats;
        let space = color_space(baked).ok_or_else(|| {
            let message = format!(
                "{}, expected linear-rec709: the only linear space that KHR_gaussian_splatting has",
                baked.scene.color_space.name()
            );
            IoError::unsupported(name, message)
        })?;
        if splats.is_empty() {
            return Err(IoError::unsupported(name, "no splats, glTF needs at least one"));
        }
        let mut attributes = display_attributes(baked);
        let shown = attributes.len();
        if let Some(scene) = exact {
            crate::ply::check(name, scene)?;
            if scene.splats.len() != splats.len() {
                let message = format!("bake of {} splats for a scene of {}", splats.len(), scene.splats.len());
                return Err(IoError::invalid(name, message));
            }
            attributes.extend(exact_attributes(scene));
        }
        let count = splats.len();
        let mut document = document(baked, exact, &attributes, shown, space).map_err(|e| IoError::invalid(name, e))?;
        if let Some(lights) = lights {
            add_lights(&mut document, lights);
        }
        let mut json = serde_json::to_vec(&document).map_err(|e| IoError::invalid(name, e))?;
        json.resize(json.len().next_multiple_of(4), b' ');
        let bin: u64 = attributes.iter().map(|a| (a.row_bytes * count) as u64).sum();
        let file = 12 + 8 + json.len() as u64 + 8 + bin;
        let (Ok(bin_bytes), Ok(file_bytes)) = (u32::try_from(bin), u32::try_from(file)) else {
            let message = format!("{file} bytes, of which binary glTF holds 4 GiB");
            let remedy = Remedy::lower("max_splats").or(Remedy::advice("leave the exact model out"));
            return Err(IoError::unsupported(name, message).with_remedy(remedy));
        };
        Ok(Self { count, json, attributes, bin_bytes, file_bytes })
    }

    fn write<W: Write + ?Sized>(&self, out: &mut W) -> std::io::Result<()> {
        for word in [GLB_MAGIC, 2, self.file_bytes, self.json.len() as u32, CHUNK_JSON] {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(&self.json)?;
        for word in [self.bin_bytes, CHUNK_BIN] {
            out.write_all(&word.to_le_bytes())?;
        }
        for attribute in &self.attributes {
            let blocks = (0..self.count).into_par_iter().step_by(BLOCK);
            let block = |first: usize| {
                let mut bytes = Vec::with_capacity(BLOCK.min(self.count) * attribute.row_bytes);
                (first..(first + BLOCK).min(self.count)).for_each(|i| (attribute.row)(i, &mut bytes));
                bytes
            };
            // One attribute at a time: 80 MB for five million splats.
            let made: Vec<Vec<u8>> = blocks.map(block).collect();
            made.iter().try_for_each(|bytes| out.write_all(bytes))?;
        }
        Ok(())
    }
}

/// Returns the extension's name of the bake's colour space.
fn color_space(baked: &Baked) -> Option<&'static str> {
    match baked.appearance {
        Appearance::Display { .. } => Some("srgb_rec709_display"),
        Appearance::Linear { color_space: ColorSpace::LinearRec709, .. } => Some("lin_rec709_display"),
        Appearance::Linear { .. } => None,
    }
}

fn display_attributes(baked: &Baked) -> Vec<Attribute<'_>> {
    let splats = &baked.scene.splats;
    let is_display = matches!(baked.appearance, Appearance::Display { .. });
    let unit = |q: [f32; 4]| {
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let [w, x, y, z] = q.map(|v| v / length);
        [x, y, z, w]
    };
    let byte = |v: f32| (v * 255.0).round() as u8;
    // COLOR_0 is linear light in glTF.
    let color = move |i: usize, out: &mut Vec<u8>| {
        let rgb = splats.sh_of(i).iter().take(3).map(|dc| (SH_OFFSET + sh::C0 * dc).clamp(0.0, 1.0));
        out.extend(rgb.map(|v| byte(if is_display { srgb_decode(v) } else { v })));
        out.push(byte(sigmoid(splats.opacity_logit[i])));
    };
    let mut attributes = vec![
        Attribute::floats("POSITION", |i| splats.position[i]),
        Attribute { name: "COLOR_0".into(), kind: "VEC4", component_type: UNSIGNED_BYTE, row_bytes: 4, row: Box::new(color) },
        Attribute::floats(format!("{KHR}:ROTATION"), move |i| unit(splats.rotation[i])),
        Attribute::floats(format!("{KHR}:SCALE"), |i| splats.log_scale[i].map(f32::exp)),
        Attribute::floats(format!("{KHR}:OPACITY"), |i| [sigmoid(splats.opacity_logit[i])]),
    ];
    let mut m = 0;
    for degree in 0..=splats.color_model.sh_degree() {
        for n in 0..=2 * degree {
            attributes.push(harmonic(splats, format!("{KHR}:SH_DEGREE_{degree}_COEF_{n}"), m));
            m += 1;
        }
    }
    attributes
}

fn harmonic(splats: &Splats, name: String, m: usize) -> Attribute<'_> {
    Attribute::floats(name, move |i| {
        let sh = splats.sh_of(i);
        [sh[3 * m], sh[3 * m + 1], sh[3 * m + 2]]
    })
}

fn exact_attributes(scene: &Scene) -> Vec<Attribute<'_>> {
    let splats = &scene.splats;
    let model = splats.color_model;
    let mut attributes: Vec<_> = (0..model.sh_coefficients()).map(|m| harmonic(splats, format!("SH_{m}"), m)).collect();
    let luminance = |m: usize| Attribute::floats(format!("RAW_LUMINANCE_{m}"), move |i| [splats.raw_luminance_of(i)[m]]);
    attributes.extend((0..model.luminance_coefficients()).map(luminance));
    // Through the display layer's opacity and scale they would not come back to the bit.
    attributes.push(Attribute::floats("OPACITY_LOGIT", |i| [splats.opacity_logit[i]]));
    attributes.push(Attribute::floats("LOG_SCALE", |i| splats.log_scale[i]));
    if !splats.smoothing.is_empty() {
        attributes.push(Attribute::floats("FILTER", |i| [splats.smoothing[i]]));
    }
    if !splats.gain.is_empty() {
        attributes.push(Attribute::floats("GAIN", |i| [splats.gain[i]]));
    }
    attributes
}

/// Returns the JSON. The first `shown` attributes are the primitive's own.
fn document(baked: &Baked, exact: Option<&Scene>, attributes: &[Attribute<'_>], shown: usize, space: &str) -> serde_json::Result<Value> {
    let count = baked.scene.splats.len();
    let (mut views, mut accessors, mut offset) = (Vec::new(), Vec::new(), 0usize);
    for attribute in attributes {
        let bytes = attribute.row_bytes * count;
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": ARRAY_BUFFER }));
        let mut accessor = json!({
            "bufferView": accessors.len(), "componentType": attribute.component_type, "count": count, "type": attribute.kind,
        });
        if attribute.component_type != FLOAT {
            accessor["normalized"] = true.into();
        }
        accessors.push(accessor);
        offset += bytes;
    }
    let positions = &baked.scene.splats.position;
    for (name, pick) in [("min", f32::min as fn(f32, f32) -> f32), ("max", f32::max)] {
        let corner = positions.iter().copied().reduce(|a, b| [0, 1, 2].map(|c| pick(a[c], b[c])));
        accessors[0][name] = json!(corner.unwrap_or_default());
    }
    let index = |(i, a): (usize, &Attribute<'_>)| (a.name.clone(), Value::from(i));
    let mut khr = json!({ "kernel": "ellipse", "colorSpace": space, "projection": "perspective", "sortingMethod": "cameraDistance" });
    let mut used = vec![KHR];
    if let Some(scene) = exact {
        used.push(EXTENSION);
        let references: Map<String, Value> = attributes.iter().enumerate().skip(shown).map(index).collect();
        khr["extensions"] = json!({ EXTENSION: {
            "colorModel": scene.splats.color_model,
            "colorSpace": scene.color_space,
            "radianceScale": scene.radiance_scale,
            "raster": scene.raster,
            "edits": scene.edits,
            "attributes": references,
        } });
        if let Some(world) = WorldRecord::from_similarity(&baked.file_from_world) {
            khr["extensions"][EXTENSION]["fileFromWorld"] = serde_json::to_value(world)?;
        }
        if let Some(frame) = LocalFrame::from_similarity(&baked.scene.world_from_local) {
            khr["extensions"][EXTENSION]["localFrame"] = serde_json::to_value(frame)?;
        }
        if let Some(metres) = scene.metres_per_unit {
            khr["extensions"][EXTENSION]["metresPerUnit"] = json!(metres);
        }
    }
    let mut node = json!({ "mesh": 0, "name": "Splats" });
    if baked.origin_in_file() != DVec3::ZERO {
        node["translation"] = json!(baked.origin_in_file().to_array());
    }
    let own: Map<String, Value> = attributes.iter().take(shown).enumerate().map(index).collect();
    Ok(json!({
        "asset": { "version": "2.0", "generator": "Luxel", "extras": { RECORD_KEY: BakeRecord::from_bake(baked).json()? } },
        "extensionsUsed": used,
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": own, "mode": 0, "extensions": { KHR: khr } }] }],
        "buffers": [{ "byteLength": offset }],
        "bufferViews": views,
        "accessors": accessors,
    }))
}

/// Adds lamps as nodes beside the splats' one.
fn add_lights(document: &mut Value, lights: &StageLights) {
    let nodes = light_nodes(lights);
    // Empty arrays are not allowed.
    if nodes.is_empty() {
        return;
    }
    document["extensions"] = json!({ PUNCTUAL: { "lights": punctual_lights(lights) } });
    document["extras"] = light_extras(lights);
    document["scenes"][0]["nodes"] = (0..=nodes.len()).collect();
    for (list, values) in [("extensionsUsed", vec![PUNCTUAL.into()]), ("nodes", nodes)] {
        if let Some(list) = document[list].as_array_mut() {
            list.extend(values);
        }
    }
}
