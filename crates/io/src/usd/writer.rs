//! A bake to OpenUSD text, in blocks made in parallel: memory does not grow with
//! the scene.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use luxel_core::{Splats, sigmoid};
use rayon::prelude::*;

use super::binary::{self, PackagePart};
use super::field::with_gain;
use super::{DISPLAY_SPACE, GAIN, ORDER, PRIM_TYPE, SCENE, SPLATS, TRAINED, TRANSLATE, usd_name};
use crate::bake::{Appearance, BakeRecord, Baked, RECORD_KEY};
use crate::lights::{StageLights, lights_prim_text};
use crate::validity::check_lengths;
use crate::{IoError, write_atomically};

/// Splats of a block.
const BLOCK: usize = 4096;
/// Blocks made at a time.
const BATCH: usize = 64;
/// Standard deviations that bounds reach to.
const EXTENT_SIGMA: f64 = 3.0;

/// Writes a bake, and lights beside it, whole or not at all; folders are made as needed. A bake
/// with gains is written as the light that they make, and with what cut-offs follow beside it.
///
/// # Errors
/// A scene that could not be read back, or the file system's refusal.
pub fn write_usda(path: &Path, baked: &Baked, lights: Option<&StageLights>) -> Result<(), IoError> {
    check(path, baked)?;
    write_atomically(path, |file| write(baked, lights, file).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes the bytes that [`write_usda`] writes without lights; `name` is for errors.
///
/// # Errors
/// The same as [`write_usda`].
pub fn encode_usda(name: &Path, baked: &Baked) -> Result<Vec<u8>, IoError> {
    check(name, baked)?;
    let mut bytes = Vec::new();
    write(baked, None, &mut bytes).map_err(|e| IoError::system(name, "write", &e))?;
    Ok(bytes)
}

/// Writes a bake, and lights beside it, in OpenUSD's binary form, whole or not at all; folders are
/// made as needed.
///
/// # Errors
/// The same as [`write_usda`].
pub fn write_usdc(path: &Path, baked: &Baked, lights: Option<&StageLights>) -> Result<(), IoError> {
    check(path, baked)?;
    write_atomically(path, |file| binary::write(baked, lights, file).map_err(|e| IoError::system(path, "write", &e)))
}

/// A file in a package beside its layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackagedFile {
    /// Name, without folders.
    pub name: String,
    /// Content.
    pub bytes: Vec<u8>,
}

/// Writes a bake, and lights beside it, as an OpenUSD package with one binary layer and the map of
/// the lights, whole or not at all; folders are made as needed.
///
/// # Errors
/// The same as [`write_usda`]; a package of more than 4 GiB.
pub fn write_usdz(path: &Path, baked: &Baked, lights: Option<&StageLights>, map: Option<&PackagedFile>) -> Result<(), IoError> {
    check(path, baked)?;
    let layer = |out: &mut dyn Write| binary::write(baked, lights, out);
    let map_bytes = |out: &mut dyn Write| out.write_all(map.map_or(&[], |map| &map.bytes));
    let mut parts = vec![PackagePart { name: "splats.usdc", write: &layer }];
    parts.extend(map.map(|map| PackagePart { name: &map.name, write: &map_bytes }));
    write_atomically(path, |file| binary::write_package(file, &parts).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes the bytes that [`write_usdc`] writes without lights; `name` is for errors.
///
/// # Errors
/// The same as [`write_usdc`].
pub fn encode_usdc(name: &Path, baked: &Baked) -> Result<Vec<u8>, IoError> {
    check(name, baked)?;
    let mut bytes = Vec::new();
    binary::write(baked, None, &mut bytes).map_err(|e| IoError::system(name, "write", &e))?;
    Ok(bytes)
}

fn check(path: &Path, baked: &Baked) -> Result<(), IoError> {
    crate::ply::check(path, &baked.scene)?;
    check_lengths(&baked.scene.splats).map_err(|e| IoError::invalid(path, format_args!("scene to write: {e}")))
}

/// Facts that the layer states about itself.
pub(super) struct StageFacts {
    /// Length of a unit, metres.
    pub(super) metres: f64,
    /// The layer in words.
    pub(super) documentation: String,
}

impl StageFacts {
    /// Returns the facts of a bake.
    pub(super) fn new(baked: &Baked) -> Self {
        // USD takes a unit for a centimetre where nothing is stated.
        let (metres, doubt) = match baked.metres_per_unit() {
            Some(metres) => (metres, ""),
            None => (1.0, "; the scale of the data set is unknown: metersPerUnit is not measured"),
        };
        Self { metres, documentation: format!("Gaussian splats by Luxel: {}{doubt}", baked.description()) }
    }
}

/// Numbers of splats as the schema has them.
pub(super) struct Prim<'a> {
    splats: &'a Splats,
}

impl<'a> Prim<'a> {
    /// Returns the numbers of splats.
    pub(super) fn new(splats: &'a Splats) -> Self {
        Self { splats }
    }

    /// Returns the standard deviations of splat `i`.
    pub(super) fn scale(&self, i: usize) -> [f32; 3] {
        self.splats.log_scale[i].map(f32::exp)
    }

    /// Returns the orientation of splat `i`: a unit quaternion w, x, y, z.
    pub(super) fn orientation(&self, i: usize) -> [f32; 4] {
        let q = self.splats.rotation[i];
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        q.map(|v| v / length)
    }

    /// Returns the harmonics `[K,3]` of splat `i`, with its gain.
    pub(super) fn harmonics(&self, i: usize) -> Cow<'a, [f32]> {
        let trained = self.splats.sh_of(i);
        if self.splats.gain.is_empty() { trained.into() } else { with_gain(trained, self.splats.gain[i]).into() }
    }

    /// Returns the opacity of splat `i`, 0 to 1.
    pub(super) fn opacity(&self, i: usize) -> f32 {
        sigmoid(self.splats.opacity_logit[i])
    }
}

fn write<W: Write + ?Sized>(baked: &Baked, lights: Option<&StageLights>, out: &mut W) -> std::io::Result<()> {
    // JSON within quotes: its own quotes and backslashes are escaped.
    let record = BakeRecord::from_bake(baked).json()?.replace('\\', "\\\\").replace('"', "\\\"");
    let top = if lights.is_some() { SCENE } else { SPLATS };
    writeln!(out, "#usda 1.0\n(")?;
    writeln!(out, "    customLayerData = {{\n        string {RECORD_KEY} = \"{record}\"\n    }}")?;
    let StageFacts { metres, documentation } = StageFacts::new(baked);
    writeln!(out, "    defaultPrim = \"{top}\"\n    doc = \"{documentation}\"")?;
    writeln!(out, "    metersPerUnit = {metres}\n    upAxis = \"Y\"\n)\n")?;
    let Some(lights) = lights else { return write_splats(baked, "", out) };
    writeln!(out, "def Xform \"{SCENE}\"\n{{")?;
    write_splats(baked, "    ", out)?;
    writeln!(out, "{}}}", lights_prim_text(lights, "    "))
}

/// Writes the prim of the splats, indented by `pad`.
fn write_splats<W: Write + ?Sized>(baked: &Baked, pad: &str, out: &mut W) -> std::io::Result<()> {
    let splats = &baked.scene.splats;
    let prim = Prim::new(splats);
    let space = match baked.appearance {
        Appearance::Linear { .. } => usd_name(baked.scene.color_space),
        Appearance::Display { .. } => DISPLAY_SPACE,
    };
    writeln!(out, "{pad}def {PRIM_TYPE} \"{SPLATS}\" (\n{pad}    prepend apiSchemas = [\"ColorSpaceAPI\"]\n{pad})\n{pad}{{")?;
    writeln!(out, "{pad}    uniform token colorSpace:name = \"{space}\"")?;
    if baked.origin_in_file() != DVec3::ZERO {
        let DVec3 { x, y, z } = baked.origin_in_file();
        writeln!(out, "{pad}    double3 {TRANSLATE} = ({x}, {y}, {z})")?;
        writeln!(out, "{pad}    uniform token[] {ORDER} = [\"{TRANSLATE}\"]")?;
    }
    let [low, high] = extent(splats);
    writeln!(out, "{pad}    float3[] extent = [({}, {}, {}), ({}, {}, {})]", low[0], low[1], low[2], high[0], high[1], high[2])?;
    write_array(out, &format!("{pad}point3f[] positions"), splats.len(), |i, text| tuple(text, &splats.position[i]))?;
    write_array(out, &format!("{pad}float3[] scales"), splats.len(), |i, text| tuple(text, &prim.scale(i)))?;
    write_array(out, &format!("{pad}quatf[] orientations"), splats.len(), |i, text| tuple(text, &prim.orientation(i)))?;
    write_array(out, &format!("{pad}float[] opacities"), splats.len(), |i, text| number(text, prim.opacity(i)))?;
    writeln!(out, "{pad}    uniform token projectionModeHint = \"perspective\"")?;
    writeln!(out, "{pad}    uniform token sortingModeHint = \"zDepth\"")?;
    writeln!(out, "{pad}    uniform int radiance:sphericalHarmonicsDegree = {}", splats.color_model.sh_degree())?;
    let harmonics = |i: usize, text: &mut Vec<u8>| tuples(text, &prim.harmonics(i));
    write_array(out, &format!("{pad}float3[] radiance:sphericalHarmonicsCoefficients"), splats.len(), harmonics)?;
    if !splats.gain.is_empty() {
        write_array(out, &format!("{pad}custom float[] {GAIN}"), splats.len(), |i, text| number(text, splats.gain[i]))?;
        write_array(out, &format!("{pad}custom float3[] {TRAINED}"), splats.len(), |i, text| tuples(text, splats.sh_of(i)))?;
    }
    writeln!(out, "{pad}}}")
}

/// Writes an attribute of `count` entries.
pub(super) fn write_array<W: Write + ?Sized>(
    out: &mut W,
    name: &str,
    count: usize,
    entry: impl Fn(usize, &mut Vec<u8>) + Sync,
) -> std::io::Result<()> {
    write_array_with(out, name, "", count, entry)
}

/// Writes an attribute of `count` entries, and its metadata.
pub(super) fn write_array_with<W: Write + ?Sized>(
    out: &mut W,
    name: &str,
    metadata: &str,
    count: usize,
    entry: impl Fn(usize, &mut Vec<u8>) + Sync,
) -> std::io::Result<()> {
    write!(out, "    {name} = [")?;
    let block = |first: usize| {
        let mut text = Vec::new();
        for i in first..(first + BLOCK).min(count) {
            if i > 0 {
                text.extend_from_slice(b", ");
            }
            entry(i, &mut text);
        }
        text
    };
    for batch in (0..count).step_by(BLOCK * BATCH) {
        let end = (batch + BLOCK * BATCH).min(count);
        let blocks: Vec<Vec<u8>> = (batch..end).into_par_iter().step_by(BLOCK).map(block).collect();
        for text in &blocks {
            out.write_all(text)?;
        }
    }
    writeln!(out, "]{metadata}")
}

/// Appends values three by three.
fn tuples(text: &mut Vec<u8>, values: &[f32]) {
    for (m, rgb) in values.chunks_exact(3).enumerate() {
        if m > 0 {
            text.extend_from_slice(b", ");
        }
        tuple(text, rgb);
    }
}

pub(super) fn tuple(text: &mut Vec<u8>, values: &[f32]) {
    text.push(b'(');
    for (i, value) in values.iter().enumerate() {
        if i > 0 {
            text.extend_from_slice(b", ");
        }
        number(text, *value);
    }
    text.push(b')');
}

/// Appends the shortest decimal that is read back as this number.
fn number(text: &mut Vec<u8>, value: f32) {
    let magnitude = value.abs();
    let is_plain = value == 0.0 || (1e-4..1e9).contains(&magnitude);
    // Writing to memory does not fail.
    let _ = if is_plain { write!(text, "{value}") } else { write!(text, "{value:e}") };
}

/// Returns the lower and upper corner of the splats' extent.
pub(super) fn extent(splats: &Splats) -> [[f32; 3]; 2] {
    let bounds = |i: usize| {
        let [w, x, y, z] = splats.rotation[i].map(f64::from);
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let sigma = splats.log_scale[i].map(|s| f64::from(s).clamp(-80.0, 80.0).exp());
        let reach = [0, 1, 2].map(|axis| {
            let row = axes.row(axis).to_array();
            EXTENT_SIGMA * row.iter().zip(sigma).map(|(r, s)| (r * s).powi(2)).sum::<f64>().sqrt()
        });
        let center = splats.position[i].map(f64::from);
        [-1.0, 1.0].map(|side| [0, 1, 2].map(|axis| (center[axis] + side * reach[axis]) as f32))
    };
    let join = |a: [[f32; 3]; 2], b: [[f32; 3]; 2]| [[0, 1, 2].map(|c| a[0][c].min(b[0][c])), [0, 1, 2].map(|c| a[1][c].max(b[1][c]))];
    let none = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    let found = (0..splats.len()).into_par_iter().map(bounds).reduce(|| none, join);
    if splats.is_empty() { [[0.0; 3]; 2] } else { found }
}
