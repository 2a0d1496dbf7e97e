//! Checkpoints: the complete state of a training run in one safetensors file.
//!
//! Tensors, f32 unless stated: `splats.{position [N,3], rotation [N,4], log_scale [N,3],
//! opacity_logit [N], sh [N,K,3], raw_luminance [N,M], smoothing [N or 0]}`, the same under
//! `moments.first` and `moments.second`, and `stats.{gradient, abs_gradient, views (u32)}` [N or
//! 0]; last, where the run averages its parameters and has begun to, `average` with the arrays of
//! `splats`. Everything else is in the metadata, in JSON where it is not a single word. A BLAKE3
//! digest over metadata, names, shapes and values detects a damaged file. Files are
//! written whole or not at all, and equal states give equal bytes. Values are moved in small
//! pieces: a run that is saved is not copied, and reading holds no second copy of the snapshot.

use std::collections::BTreeMap;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use luxel_core::engine::DensifyStats;
use luxel_core::{
    ColorModel, ColorSpace, EngineError, Moments, RadianceScale, RasterConfig, SavedState, Scene, Similarity, Snapshot, Splats,
};
use safetensors::tensor::{Dtype, Metadata, TensorInfo};
use serde::Serialize;

use crate::local_frame::LocalFrame;
use crate::read_file::open_regular;
use crate::validity::{is_length, is_usable};
use crate::{IoError, write_atomically};

mod digest;
mod files;
mod tensors;

use digest::Digest;
pub use files::{CheckpointFile, checkpoint_path, list_checkpoints, prune_checkpoints};
use tensors::{PIECE_BYTES, tensors_of};

/// Version of names and metadata.
const FORMAT_VERSION: &str = "1";
/// Value of the key `format`.
const FORMAT_NAME: &str = "luxel-checkpoint";
/// Longest header that is believed to be one, bytes: as the safetensors library allows.
const MAX_HEADER: u64 = 100_000_000;
/// Length of the header's length.
const LENGTH_BYTES: u64 = 8;
const DIGEST_KEY: &str = "blake3";
/// Local coordinates, where they are not those of the world.
const FRAME_KEY: &str = "local_frame";
/// Length of a unit of the world, metres, where it is known.
const METRES_KEY: &str = "metres_per_unit";

/// Head of a safetensors file in a fixed order.
#[derive(Serialize)]
struct Head<'a> {
    #[serde(rename = "__metadata__")]
    metadata: &'a BTreeMap<&'static str, String>,
    #[serde(flatten)]
    tensors: BTreeMap<&'a str, TensorInfo>,
}

/// Writes a checkpoint, whole or not at all and synced to the disk; folders are made as needed.
///
/// # Errors
/// Arrays of wrong lengths, splats that are not finite, or the file system's refusal; older files
/// are untouched.
pub fn write_checkpoint(path: &Path, mut state: impl SavedState) -> Result<(), IoError> {
    check(&mut state).map_err(|e| invalid(path, &e))?;
    write_atomically(path, |file| write(&mut state, file).map_err(|e| refused(path, &e)))
}

/// Encodes the bytes that [`write_checkpoint`] writes; `name` is for errors.
///
/// # Errors
/// The same as [`write_checkpoint`].
pub fn encode_checkpoint(name: &Path, mut state: impl SavedState) -> Result<Vec<u8>, IoError> {
    check(&mut state).map_err(|e| invalid(name, &e))?;
    let mut bytes = Vec::new();
    write(&mut state, &mut bytes).map_err(|e| refused(name, &e))?;
    Ok(bytes)
}

fn invalid(path: &Path, reason: impl std::fmt::Display) -> IoError {
    IoError::invalid(path, format_args!("checkpoint to write: {reason}"))
}

/// Returns the error of writing: the system's, or what is wrong with the state.
fn refused(path: &Path, error: &std::io::Error) -> IoError {
    let of_engine = error.get_ref().and_then(|inner| inner.downcast_ref::<EngineError>());
    match (of_engine.and_then(EngineError::remedy), error.kind()) {
        (Some(remedy), _) => invalid(path, error).with_remedy(remedy.clone()),
        (None, std::io::ErrorKind::Other) if error.raw_os_error().is_none() => invalid(path, error),
        (None, _) => IoError::system(path, "write", error),
    }
}

/// Reads a checkpoint.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, or one of another version.
pub fn read_checkpoint(path: &Path) -> Result<Snapshot, IoError> {
    let (file, length) = open_regular(path)?;
    read(path, BufReader::with_capacity(1 << 20, file), length)
}

/// Decodes a file's bytes as [`read_checkpoint`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_checkpoint`].
pub fn decode_checkpoint(name: &Path, bytes: &[u8]) -> Result<Snapshot, IoError> {
    read(name, bytes, bytes.len() as u64)
}

/// Checks what can be checked before the values are read.
fn check(state: &mut impl SavedState) -> Result<(), String> {
    let (count, scene) = (state.splat_count(), state.scene());
    if !scene.splats.color_model.is_valid() {
        return Err(format!("no colour model: {}", scene.splats.color_model.name()));
    }
    if !is_usable(&scene.raster) {
        return Err(format!("raster configuration {:?}, expected cut-offs of 0 to 1 and 1 to 4 samples", scene.raster));
    }
    let DensifyStats { gradient, abs_gradient, views } = state.stats();
    let lengths = [("gradient", gradient.len()), ("abs_gradient", abs_gradient.len()), ("views", views.len())];
    match lengths.into_iter().find(|(_, len)| *len != 0 && *len != count) {
        Some((name, len)) => Err(format!("stats.{name} has {len} values, expected {count} for {count} splats")),
        None => Ok(()),
    }
}

/// Writes a state. Its values are read twice: the digest stands before them.
fn write<W: Write + ?Sized>(state: &mut impl SavedState, out: &mut W) -> std::io::Result<()> {
    let tensors = tensors_of(state)?;
    let mut metadata = metadata_of(state)?;
    let mut digest = Digest::of_metadata(&metadata);
    let mut infos = BTreeMap::new();
    let mut offset = 0;
    for tensor in &tensors {
        let length = 4 * tensor.len();
        digest.tensor(&tensor.name, &tensor.shape);
        tensor.for_each_piece(state, |bytes| {
            digest.bytes(bytes);
            Ok(())
        })?;
        infos.insert(
            tensor.name.as_str(),
            TensorInfo { dtype: tensor.dtype(), shape: tensor.shape.clone(), data_offsets: (offset, offset + length) },
        );
        offset += length;
    }
    metadata.insert(DIGEST_KEY, digest.finish());
    let mut head = serde_json::to_vec(&Head { metadata: &metadata, tensors: infos })?;
    head.resize(head.len().next_multiple_of(LENGTH_BYTES as usize), b' ');
    if head.len() as u64 > MAX_HEADER {
        return Err(std::io::Error::other("the trainer's state is longer than a header may be (100 MB)"));
    }
    out.write_all(&(head.len() as u64).to_le_bytes())?;
    out.write_all(&head)?;
    tensors.iter().try_for_each(|tensor| tensor.for_each_piece(state, |bytes| out.write_all(bytes)))
}

fn metadata_of(state: &impl SavedState) -> std::io::Result<BTreeMap<&'static str, String>> {
    let scene = state.scene();
    let mut metadata = BTreeMap::from([
        ("format", FORMAT_NAME.to_owned()),
        ("version", FORMAT_VERSION.to_owned()),
        ("splats", state.splat_count().to_string()),
        ("color_model", serde_json::to_string(&scene.splats.color_model)?),
        ("color_space", scene.color_space.name().to_owned()),
        ("radiance_scale", format!("{:e}", scene.radiance_scale)),
        ("raster", serde_json::to_string(&scene.raster)?),
        ("state", state.state_json().to_owned()),
    ]);
    if let Some(frame) = LocalFrame::from_similarity(&scene.world_from_local) {
        metadata.insert(FRAME_KEY, serde_json::to_string(&frame)?);
    }
    if let Some(metres) = scene.metres_per_unit {
        metadata.insert(METRES_KEY, format!("{metres:e}"));
    }
    Ok(metadata)
}

/// A file under way of being read.
struct Reader<'a, R> {
    path: &'a Path,
    reader: R,
    digest: Digest,
    head: Metadata,
}

fn read<R: Read>(path: &Path, mut reader: R, length: u64) -> Result<Snapshot, IoError> {
    let head = read_head(path, &mut reader, length)?;
    let metadata = head.metadata().clone().unwrap_or_default();
    let value =
        |key: &str| metadata.get(key).ok_or_else(|| IoError::invalid(path, format_args!("header: no {key:?}: not a checkpoint of luxel")));
    let wrong = |key: &str, expected: &str| {
        let found: String = metadata.get(key).map_or("", String::as_str).chars().take(80).collect();
        IoError::invalid(path, format_args!("header: {key:?} is {found:?}, expected {expected}"))
    };
    if value("format")? != FORMAT_NAME {
        return Err(wrong("format", FORMAT_NAME));
    }
    let version = value("version")?;
    if version != FORMAT_VERSION {
        let message = format!("checkpoint version {version:?}, expected {FORMAT_VERSION:?}; use the release of luxel that wrote it");
        return Err(IoError::unsupported(path, message));
    }
    let model: ColorModel = serde_json::from_str(value("color_model")?).map_err(|_| wrong("color_model", "a colour model"))?;
    if !model.is_valid() {
        return Err(wrong("color_model", "degrees in range"));
    }
    let color_space = ColorSpace::from_name(value("color_space")?).ok_or_else(|| wrong("color_space", ColorSpace::NAMES))?;
    let scale = value("radiance_scale")?.parse().ok().and_then(RadianceScale::new);
    let radiance_scale = scale.ok_or_else(|| wrong("radiance_scale", "a positive number"))?;
    let raster: Option<RasterConfig> = serde_json::from_str(value("raster")?).ok();
    let raster = raster.filter(is_usable).ok_or_else(|| wrong("raster", "cut-offs of 0 to 1, antialias and 1 to 4 samples"))?;
    let world_from_local = match metadata.get(FRAME_KEY) {
        None => Some(Similarity::IDENTITY),
        Some(json) => LocalFrame::parse(json).and_then(|frame| frame.world_from_local()),
    };
    let world_from_local = world_from_local.ok_or_else(|| wrong(FRAME_KEY, "an origin and a positive unit"))?;
    let is_metres = |text: &String| text.parse().ok().filter(is_length).ok_or_else(|| wrong(METRES_KEY, "a number above 0"));
    let metres_per_unit = metadata.get(METRES_KEY).map(is_metres).transpose()?;
    let state_json = value("state")?.clone();
    let count: usize = value("splats")?.parse().map_err(|_| wrong("splats", "a whole number"))?;
    let claimed = value(DIGEST_KEY)?.clone();
    let digested: BTreeMap<String, String> =
        metadata.iter().filter(|(k, _)| *k != DIGEST_KEY).map(|(k, v)| (k.clone(), v.clone())).collect();
    let mut reader = Reader { path, reader, digest: Digest::of_metadata(&digested), head };
    let is_averaged = reader.check_tensors()?;
    let splats = reader.splats("splats", model, count)?;
    let moments = Moments { first: reader.splats("moments.first", model, count)?, second: reader.splats("moments.second", model, count)? };
    let stats = reader.stats(count)?;
    let average = is_averaged.then(|| reader.splats(tensors::AVERAGE, model, count)).transpose()?;
    if reader.digest.finish() != claimed {
        return Err(IoError::invalid(path, "the content does not match its digest: the file is damaged, use an older checkpoint"));
    }
    for splats in [&splats].into_iter().chain(&average) {
        splats.validate().map_err(|e| IoError::invalid(path, e))?;
    }
    Ok(Snapshot {
        scene: Scene { splats, radiance_scale, color_space, raster, edits: Vec::new(), world_from_local, metres_per_unit },
        moments,
        stats,
        average,
        state_json,
    })
}

/// Reads the header and checks its claims against the length of the file.
fn read_head<R: Read>(path: &Path, reader: &mut R, length: u64) -> Result<Metadata, IoError> {
    let mut prefix = [0u8; LENGTH_BYTES as usize];
    fill(path, reader, &mut prefix, "the header's length")?;
    let head_length = u64::from_le_bytes(prefix);
    if head_length > MAX_HEADER || head_length > length.saturating_sub(LENGTH_BYTES) {
        let message = format!("header of {head_length} bytes in a file of {length}; the file is truncated or not a checkpoint");
        return Err(IoError::invalid(path, message));
    }
    let mut head = vec![0u8; head_length as usize];
    fill(path, reader, &mut head, "the header")?;
    let head: Metadata = serde_json::from_slice(&head).map_err(|e| IoError::invalid(path, format_args!("header: {e}")))?;
    let expected = LENGTH_BYTES + head_length + head.data_len() as u64;
    if expected != length {
        let message = format!("file has {length} bytes, expected {expected} from its header; the file is truncated or damaged");
        return Err(IoError::invalid(path, message));
    }
    Ok(head)
}

fn fill<R: Read>(path: &Path, reader: &mut R, buffer: &mut [u8], what: &str) -> Result<(), IoError> {
    reader.read_exact(buffer).map_err(|e| match e.kind() {
        std::io::ErrorKind::UnexpectedEof => IoError::invalid(path, format_args!("file ends within {what}; the file is truncated")),
        _ => IoError::system(path, "read", &e),
    })
}

impl<R: Read> Reader<'_, R> {
    /// Reads the tensors in the order of the file, which is that of [`tensors_of`]; returns whether
    /// there is an average.
    fn check_tensors(&self) -> Result<bool, IoError> {
        let mut found = self.head.offset_keys();
        let is_averaged = found.iter().any(|name| name.strip_prefix(tensors::AVERAGE).is_some_and(|rest| rest.starts_with('.')));
        let expected = tensors::names(is_averaged);
        // Tensors without values share their offset; the reader's order among them is by chance.
        found.sort_by_key(|name| {
            let offsets = self.head.info(name).map_or((0, 0), |info| info.data_offsets);
            (offsets, expected.iter().position(|e| e == name))
        });
        if found != expected {
            let odd = found.iter().find(|f| !expected.contains(f)).or_else(|| expected.iter().find(|e| !found.contains(e)));
            let odd = odd.map_or("their order", String::as_str);
            return Err(IoError::invalid(self.path, format_args!("header: unexpected tensors ({odd}), expected {}", expected.join(", "))));
        }
        Ok(is_averaged)
    }

    fn splats(&mut self, group: &str, color_model: ColorModel, n: usize) -> Result<Splats, IoError> {
        let (k, m) = (color_model.sh_coefficients(), color_model.luminance_coefficients());
        Ok(Splats {
            color_model,
            position: self.rows(&format!("{group}.position"), n)?,
            rotation: self.rows(&format!("{group}.rotation"), n)?,
            log_scale: self.rows(&format!("{group}.log_scale"), n)?,
            opacity_logit: self.floats(&format!("{group}.opacity_logit"), &[n])?,
            sh: self.floats(&format!("{group}.sh"), &[n, k, 3])?,
            raw_luminance: self.floats(&format!("{group}.raw_luminance"), &[n, m])?,
            smoothing: self.optional(&format!("{group}.smoothing"), n)?,
            // Training has none.
            gain: Vec::new(),
        })
    }

    fn stats(&mut self, n: usize) -> Result<DensifyStats, IoError> {
        let gradient = self.optional("stats.gradient", n)?;
        let abs_gradient = self.optional("stats.abs_gradient", n)?;
        let shape = self.optional_shape("stats.views", n);
        let mut views = Vec::new();
        self.values("stats.views", &shape, Dtype::U32, |count, bytes| {
            views.reserve_exact(count.saturating_sub(views.len()));
            views.extend(bytes.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)));
        })?;
        Ok(DensifyStats { gradient, abs_gradient, views })
    }

    fn rows<const W: usize>(&mut self, name: &str, n: usize) -> Result<Vec<[f32; W]>, IoError> {
        let mut rows = Vec::new();
        self.values(name, &[n, W], Dtype::F32, |count, bytes| {
            rows.reserve_exact((count / W).saturating_sub(rows.len()));
            let numbers = bytes.as_chunks::<4>().0.as_chunks::<W>().0;
            rows.extend(numbers.iter().map(|row| row.map(f32::from_le_bytes)));
        })?;
        Ok(rows)
    }

    fn floats(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, IoError> {
        let mut floats = Vec::new();
        self.values(name, shape, Dtype::F32, |count, bytes| {
            floats.reserve_exact(count.saturating_sub(floats.len()));
            floats.extend(bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)));
        })?;
        Ok(floats)
    }

    /// Returns a tensor of `n` values or none.
    fn optional(&mut self, name: &str, n: usize) -> Result<Vec<f32>, IoError> {
        let shape = self.optional_shape(name, n);
        self.floats(name, &shape)
    }

    fn optional_shape(&self, name: &str, n: usize) -> [usize; 1] {
        let is_absent = self.head.info(name).is_some_and(|info| info.shape == [0]);
        [if is_absent { 0 } else { n }]
    }

    /// Passes the next tensor of the file to `take(number of values in all, bytes of some whole
    /// rows)`. Its length is what the header claims, which was checked against that of the file.
    fn values(&mut self, name: &str, shape: &[usize], dtype: Dtype, mut take: impl FnMut(usize, &[u8])) -> Result<(), IoError> {
        let invalid = |message: String| IoError::invalid(self.path, format_args!("tensor {name}: {message}"));
        let info = self.head.info(name).ok_or_else(|| invalid("missing".to_owned()))?;
        if info.dtype != dtype || info.shape != shape {
            return Err(invalid(format!("{:?} {:?}, expected {dtype:?} {shape:?}", info.dtype, info.shape)));
        }
        self.digest.tensor(name, shape);
        let mut left = info.data_offsets.1 - info.data_offsets.0;
        let count = left / 4;
        let mut piece = [0u8; PIECE_BYTES];
        while left > 0 {
            let part = &mut piece[..left.min(PIECE_BYTES)];
            fill(self.path, &mut self.reader, part, name)?;
            self.digest.bytes(part);
            left -= part.len();
            take(count, part);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
