//! A display bake to SPZ.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use luxel_core::{Antialias, Splats, sigmoid};
use rayon::prelude::*;

use super::layout::{
    AXES_EXTENSION, FLAG_ANTIALIASED, FLAG_EXTENSIONS, HEADER, LEGACY_HEADER, MAGIC, MAX_FIXED, MAX_FRACTIONAL_BITS, RIGHT_UP_BACK, axes,
    block_bytes, fractional_bits, pack_color, pack_coordinate, pack_harmonic, pack_log_scale, pack_opacity, pack_rotation_first_three,
    pack_rotation_smallest_three, unpack_log_scale,
};
use crate::bake::{Appearance, Baked};
use crate::{IoError, write_atomically};

/// Version of the format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// gzip, rotations of 24 bits.
    V2,
    /// gzip, rotations of 32 bits.
    V3,
    /// zstd, block by block, as the reference writes.
    #[default]
    V4,
}

impl SpzVersion {
    fn number(self) -> u32 {
        match self {
            Self::V2 => 2,
            Self::V3 => 3,
            Self::V4 => 4,
        }
    }
}

/// zstd's level: the reference's.
const ZSTD_LEVEL: i32 = 12;

/// Writes a display bake, whole or not at all. Splats that lie so far out that the grid of
/// positions would be too coarse for all the others are left out: see [`spz_positions`].
///
/// # Errors
/// A linear bake, no splats, or the file system's refusal.
pub fn write_spz(path: &Path, baked: &Baked, version: SpzVersion) -> Result<(), IoError> {
    let bytes = encode_spz(path, baked, version)?;
    write_atomically(path, |file| file.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))
}

/// Returns how many splats are larger or smaller than the format holds, from e^-10 to e^5.9 units:
/// they are written at its ends.
pub fn spz_out_of_range(baked: &Baked) -> usize {
    let held = unpack_log_scale(0)..=unpack_log_scale(u8::MAX);
    baked.scene.splats.log_scale.iter().filter(|s| s.iter().any(|s| !held.contains(s))).count()
}

/// The effect of the format's grid on the positions of a bake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpzPositions {
    /// Step of the grid, units of the file.
    pub step: f32,
    /// Median size of the splats: the standard deviation of each one's longest axis, units of the
    /// file.
    pub median_size: f32,
    /// Number of splats that are left out: they lie so far out that the step would be too coarse
    /// for all the others.
    pub left_out: usize,
}

impl SpzPositions {
    /// Returns whether the step is too coarse for the splats.
    pub fn is_coarse(&self) -> bool {
        self.step > self.median_size * FINE_STEP
    }
}

/// Largest step of the grid that is not seen, as a fraction of the splats' median size.
const FINE_STEP: f32 = 0.25;
/// Splats, of which one may be left out for lying far out.
const SPLATS_PER_OUTLIER: usize = 200;

/// Returns what [`write_spz`] makes of the positions.
pub fn spz_positions(baked: &Baked) -> SpzPositions {
    let mut splats = baked.scene.splats.clone();
    axes().apply(&mut splats);
    Grid::for_splats(&splats).positions
}

/// The grid of positions that suits some splats.
struct Grid {
    bits: u8,
    positions: SpzPositions,
    /// Largest coordinate that is kept.
    bound: f32,
}

impl Grid {
    fn for_splats(splats: &Splats) -> Self {
        let extent = |p: &[f32; 3]| p.iter().fold(0.0f32, |most, v| most.max(v.abs()));
        let step = |bits: u8| 1.0 / (1u32 << bits) as f32;
        let mut sizes: Vec<f32> = splats.log_scale.iter().map(|[a, b, c]| a.max(*b).max(*c).exp()).collect();
        let middle = sizes.len() / 2;
        let median_size = if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(middle, f32::total_cmp).1 };
        let grid = |bound: f32| {
            let kept = splats.position.iter().map(extent).filter(|v| *v <= bound);
            let (count, largest) = kept.fold((0, 0.0f32), |(count, most), v| (count + 1, most.max(v)));
            let bits = fractional_bits(largest);
            Self { bits, positions: SpzPositions { step: step(bits), median_size, left_out: splats.len() - count }, bound }
        };
        let whole = grid(f32::INFINITY);
        if !whole.positions.is_coarse() {
            return whole;
        }
        let wanted = (0..=MAX_FRACTIONAL_BITS).find(|bits| step(*bits) <= FINE_STEP * median_size).unwrap_or(MAX_FRACTIONAL_BITS);
        let fine = grid(MAX_FIXED * step(wanted));
        if fine.positions.left_out * SPLATS_PER_OUTLIER <= splats.len() { fine } else { whole }
    }

    /// Returns the splats that are kept.
    fn select(&self, splats: Splats) -> Splats {
        if self.positions.left_out == 0 {
            return splats;
        }
        let is_kept = |p: &[f32; 3]| p.iter().all(|v| v.abs() <= self.bound);
        let kept: Vec<u32> = (0u32..).zip(&splats.position).filter(|(_, p)| is_kept(p)).map(|(i, _)| i).collect();
        splats.select(kept)
    }
}

/// Encodes the bytes that [`write_spz`] writes; `name` is for errors.
///
/// # Errors
/// The same as [`write_spz`].
pub fn encode_spz(name: &Path, baked: &Baked, version: SpzVersion) -> Result<Vec<u8>, IoError> {
    if let Appearance::Linear { .. } = baked.appearance {
        return Err(IoError::unsupported(name, "SPZ has 8 bits per colour, which end at 1.44: radiance does not fit, bake for a display"));
    }
    crate::ply::check(name, &baked.scene)?;
    if baked.scene.splats.is_empty() {
        return Err(IoError::unsupported(name, "no splats, SPZ needs at least one"));
    }
    let count = u32::try_from(baked.scene.splats.len()).ok().filter(|n| *n <= i32::MAX as u32);
    let Some(count) = count else {
        return Err(IoError::unsupported(name, format!("{} splats, of which SPZ holds {}", baked.scene.splats.len(), i32::MAX)));
    };
    let mut splats = baked.scene.splats.clone();
    axes().apply(&mut splats);
    let grid = Grid::for_splats(&splats);
    let (bits, splats) = (grid.bits, grid.select(splats));
    // At most as many as there were.
    let count = count - grid.positions.left_out as u32;
    let blocks = blocks(&splats, version.number(), bits);
    let is_antialiased = baked.scene.raster.antialias == Antialias::Mip;
    let head = Head { version: version.number(), count, degree: splats.color_model.sh_degree() as u8, bits, is_antialiased };
    let system = |e: std::io::Error| IoError::system(name, "compress", &e);
    match version {
        SpzVersion::V2 | SpzVersion::V3 => gzip(&head, &blocks).map_err(system),
        SpzVersion::V4 => zstd(&head, &blocks).map_err(system),
    }
}

struct Head {
    version: u32,
    count: u32,
    degree: u8,
    bits: u8,
    is_antialiased: bool,
}

impl Head {
    /// Returns the header that all versions begin with; the last byte is version 4's number of
    /// streams.
    fn bytes(&self, streams: u8) -> [u8; LEGACY_HEADER] {
        let mut bytes = [0; LEGACY_HEADER];
        bytes[..4].copy_from_slice(&MAGIC.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.version.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.count.to_le_bytes());
        // Bakes are of an ordinary renderer, but for colours that another program's anti-aliasing
        // made.
        let antialiased = if self.is_antialiased { FLAG_ANTIALIASED } else { 0 };
        bytes[12..].copy_from_slice(&[self.degree, self.bits, antialiased | FLAG_EXTENSIONS, streams]);
        bytes
    }
}

/// Returns the attribute blocks in the order of the file.
fn blocks(splats: &Splats, version: u32, bits: u8) -> Vec<Vec<u8>> {
    let degree = splats.color_model.sh_degree();
    let [_, _, _, _, rotation_bytes, sh_bytes] = block_bytes(version, degree);
    let unit = |q: &[f32; 4]| {
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let [w, x, y, z] = q.map(|v| v / length);
        [x, y, z, w]
    };
    let positions = splats.position.par_iter().flat_map_iter(|p| p.map(|v| pack_coordinate(v, bits)).into_iter().flatten()).collect();
    let opacities = splats.opacity_logit.par_iter().map(|o| pack_opacity(sigmoid(*o))).collect();
    let k = 3 * splats.color_model.sh_coefficients();
    let colors = splats.sh.par_chunks_exact(k).flat_map_iter(|sh| sh.iter().take(3).map(|dc| pack_color(*dc))).collect();
    let scales = splats.log_scale.par_iter().flat_map_iter(|s| s.map(pack_log_scale)).collect();
    let pack_rotation = |q: &[f32; 4]| -> [u8; 4] {
        if version >= 3 {
            return pack_rotation_smallest_three(unit(q));
        }
        let [a, b, c] = pack_rotation_first_three(unit(q));
        [a, b, c, 0]
    };
    let rotations = splats.rotation.par_iter().flat_map_iter(|q| pack_rotation(q).into_iter().take(rotation_bytes)).collect();
    // Values 0 to 8 behind the constant term are those of degree 1.
    let harmonic = |(i, value): (usize, &f32)| pack_harmonic(*value, if i < 9 { 1 } else { 2 });
    let harmonics: Vec<u8> = splats.sh.par_chunks_exact(k).flat_map_iter(|sh| sh.iter().skip(3).enumerate().map(harmonic)).collect();
    debug_assert_eq!(harmonics.len(), sh_bytes * splats.len());
    vec![positions, opacities, colors, scales, rotations, harmonics]
}

fn gzip(head: &Head, blocks: &[Vec<u8>]) -> std::io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&head.bytes(0))?;
    for block in blocks {
        encoder.write_all(block)?;
    }
    encoder.write_all(&axes_record())?;
    encoder.finish()
}

/// Returns the extension that states the axes. They are those of the convention, which not every
/// program keeps to.
fn axes_record() -> Vec<u8> {
    [AXES_EXTENSION, 4, RIGHT_UP_BACK].map(u32::to_le_bytes).concat()
}

fn zstd(head: &Head, blocks: &[Vec<u8>]) -> std::io::Result<Vec<u8>> {
    let blocks: Vec<&Vec<u8>> = blocks.iter().filter(|block| !block.is_empty()).collect();
    let streams: Vec<Vec<u8>> = blocks.par_iter().map(|block| ::zstd::bulk::compress(block, ZSTD_LEVEL)).collect::<std::io::Result<_>>()?;
    let mut out = Vec::new();
    // At most six streams.
    out.extend(head.bytes(streams.len() as u8));
    let extension = axes_record();
    out.extend(((HEADER + extension.len()) as u32).to_le_bytes());
    out.resize(HEADER, 0);
    out.extend(extension);
    for (block, stream) in blocks.iter().zip(&streams) {
        out.extend((stream.len() as u64).to_le_bytes());
        out.extend((block.len() as u64).to_le_bytes());
    }
    streams.iter().for_each(|stream| out.extend_from_slice(stream));
    Ok(out)
}
