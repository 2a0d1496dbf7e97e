//! The scene on the device: parameters, moments and statistics, in shards.
//!
//! In, out: [`Splats`], [`Moments`], [`DensifyStats`].
//!
//! A shard is a run of splats whose parameters fit into one binding, `[rows, stride]` with the rows
//! of [`ParameterRows`]: neighbouring threads read neighbouring numbers. Adapters with large
//! bindings need one shard; where a binding is at most 128 MiB, a shard holds about half a million
//! splats.

use std::ops::Range;

use luxel_core::engine::{DensifyStats, Geometry, ParameterRows};
use luxel_core::{ColorModel, EngineError, Moments, Remedy, Splats};

use crate::device::{Buffer, Gpu};
use crate::layout::{STATS_ROWS, ShardUniform};

/// A run of splats whose buffers are bound together.
pub(crate) struct Shard {
    pub(crate) base: usize,
    pub(crate) len: usize,
    pub(crate) stride: usize,
    pub(crate) uniform: Buffer,
    pub(crate) parameters: Buffer,
    pub(crate) first: Buffer,
    pub(crate) second: Buffer,
    pub(crate) stats: Buffer,
}

/// Rows behind those of the parameters: the 3D filter, and the gains of edits, where a scene has
/// any.
const ROWS_BEYOND_PARAMETERS: usize = 2;

/// Returns how many splats' parameters fit into a binding.
pub(crate) fn shard_len(rows: ParameterRows, binding_bytes: u64) -> usize {
    let splat_bytes = 4 * (rows.count() as u64 + ROWS_BEYOND_PARAMETERS as u64);
    usize::try_from(binding_bytes / splat_bytes / 64 * 64).unwrap_or(usize::MAX).max(64)
}

/// The scene: all its splats.
pub(crate) struct GpuScene {
    pub(crate) rows: ParameterRows,
    pub(crate) count: usize,
    pub(crate) has_smoothing: bool,
    /// Gains of edits; empty if the scene has none, as in training.
    pub(crate) gain: Vec<f32>,
    pub(crate) shards: Vec<Shard>,
}

impl GpuScene {
    /// Makes a scene without splats.
    pub(crate) fn empty() -> Self {
        let rows = ParameterRows { color_model: ColorModel::Sh { degree: 0 } };
        Self { rows, count: 0, has_smoothing: false, gain: Vec::new(), shards: Vec::new() }
    }

    /// Makes a scene of `count` splats in shards of at most `shard_len`, with all values zero.
    pub(crate) fn zeros(gpu: &Gpu, rows: ParameterRows, count: usize, shard_len: usize) -> Result<Self, EngineError> {
        Self::with_gain(gpu, rows, count, shard_len, Vec::new())
    }

    /// Makes a scene with these gains, whose other values are zero.
    pub(crate) fn with_gain(gpu: &Gpu, rows: ParameterRows, count: usize, shard_len: usize, gain: Vec<f32>) -> Result<Self, EngineError> {
        if count >= 1 << 31 {
            return Err(EngineError::invalid(format!("gpu: {count} splats, at most {} are supported", 1u32 << 31))
                .with_remedy(Remedy::lower("max_splats")));
        }
        let mut shards = Vec::new();
        for base in (0..count).step_by(shard_len) {
            let len = shard_len.min(count - base);
            // Rows begin at multiples of 256 bytes, so that a subgroup's loads are aligned.
            let stride = len.next_multiple_of(64);
            let numbers = stride as u64 * 4;
            let all_rows = rows.count() as u64 + 1 + u64::from(!gain.is_empty());
            let uniform = ShardUniform { base: base as u32, len: len as u32, stride: stride as u32, padding: 0 };
            shards.push(Shard {
                base,
                len,
                stride,
                uniform: gpu.uniform("shard", &uniform)?,
                parameters: gpu.storage("parameters", numbers * all_rows)?,
                first: gpu.storage("first moments", numbers * rows.count() as u64)?,
                second: gpu.storage("second moments", numbers * rows.count() as u64)?,
                stats: gpu.storage("statistics", numbers * STATS_ROWS as u64)?,
            });
        }
        for Shard { base, len, stride, parameters, .. } in shards.iter().filter(|_| !gain.is_empty()) {
            let offset = 4 * ((rows.count() + 1) * stride) as u64;
            gpu.queue.write_buffer(&parameters.raw, offset, bytemuck::cast_slice(&gain[*base..base + len]));
        }
        Ok(Self { rows, count, has_smoothing: false, gain, shards })
    }

    /// Copies splats, and moments if there are any, to the device.
    pub(crate) fn upload(gpu: &Gpu, splats: &Splats, moments: Option<&Moments>, shard_len: usize) -> Result<Self, EngineError> {
        let mut scene =
            Self::with_gain(gpu, ParameterRows { color_model: splats.color_model }, splats.len(), shard_len, splats.gain.clone())?;
        scene.has_smoothing = !splats.smoothing.is_empty();
        for shard in &scene.shards {
            let write = |buffer: &Buffer, values: &Splats, rows: usize| {
                gpu.queue.write_buffer(&buffer.raw, 0, bytemuck::cast_slice(&shard.rows_of(scene.rows, values, rows)));
            };
            write(&shard.parameters, splats, scene.rows.count() + 1);
            if let Some(moments) = moments {
                write(&shard.first, &moments.first, scene.rows.count());
                write(&shard.second, &moments.second, scene.rows.count());
            }
        }
        gpu.check()?;
        Ok(scene)
    }

    /// Downloads the parameters, or the buffer of each shard that `pick` chooses, which must have
    /// their layout.
    pub(crate) fn download<'a>(&'a self, gpu: &Gpu, pick: impl Fn(usize, &'a Shard) -> &'a Buffer) -> Result<Splats, EngineError> {
        let mut splats = Moments::zeros(self.rows.color_model, self.count).first;
        for (n, shard) in self.shards.iter().enumerate() {
            shard.store_rows(self.rows, &gpu.read(pick(n, shard), shard.stride * self.rows.count())?, &mut splats);
        }
        Ok(splats)
    }

    /// Downloads an array of some splats, splat by splat, from the buffer of each shard that `pick`
    /// chooses.
    pub(crate) fn download_array(
        &self,
        gpu: &Gpu,
        pick: fn(&Shard) -> &Buffer,
        rows: Range<usize>,
        splats: &Range<usize>,
    ) -> Result<Vec<f32>, EngineError> {
        let (first, width) = (splats.start, rows.len());
        let mut values = vec![0.0; width * splats.len()];
        for shard in &self.shards {
            let own = splats.start.max(shard.base)..splats.end.min(shard.base + shard.len);
            if own.is_empty() || width == 0 {
                continue;
            }
            let offset = |row: usize| 4 * (row * shard.stride + own.start - shard.base) as u64;
            let offsets: Vec<u64> = rows.clone().map(offset).collect();
            let found: Vec<f32> = gpu.read_parts(pick(shard), &offsets, own.len())?;
            for (row, found) in found.chunks_exact(own.len()).enumerate() {
                let to = values[(own.start - first) * width..].iter_mut().skip(row).step_by(width);
                to.zip(found).for_each(|(to, value)| *to = *value);
            }
        }
        Ok(values)
    }

    /// Checks that the scene can be trained.
    pub(crate) fn check_trainable(&self) -> Result<(), EngineError> {
        Splats::check_trainable(self.rows.color_model, &self.gain)
    }

    /// Downloads the 3D filter; empty if the scene has none.
    pub(crate) fn smoothing(&self, gpu: &Gpu) -> Result<Vec<f32>, EngineError> {
        let mut smoothing = Vec::new();
        for shard in self.shards.iter().filter(|_| self.has_smoothing) {
            let offset = 4 * (self.rows.count() * shard.stride) as u64;
            smoothing.extend(gpu.read_parts::<f32>(&shard.parameters, &[offset], shard.len)?);
        }
        Ok(smoothing)
    }

    /// Downloads position, log scale and opacity only.
    pub(crate) fn geometry(&self, gpu: &Gpu) -> Result<Geometry, EngineError> {
        let mut geometry = Geometry::default();
        for shard in &self.shards {
            let values: Vec<f32> = gpu.read(&shard.parameters, shard.stride * ParameterRows::SH)?;
            let at = |row: usize, i: usize| values[row * shard.stride + i];
            for i in 0..shard.len {
                geometry.position.push([0, 1, 2].map(|c| at(ParameterRows::POSITION + c, i)));
                geometry.log_scale.push([0, 1, 2].map(|c| at(ParameterRows::LOG_SCALE + c, i)));
                geometry.opacity_logit.push(at(ParameterRows::OPACITY, i));
            }
        }
        Ok(geometry)
    }

    pub(crate) fn stats(&self, gpu: &Gpu) -> Result<DensifyStats, EngineError> {
        let mut stats = DensifyStats::default();
        for shard in &self.shards {
            let values: Vec<f32> = gpu.read(&shard.stats, STATS_ROWS * shard.stride)?;
            let row = |n: usize| &values[n * shard.stride..][..shard.len];
            stats.gradient.extend_from_slice(row(0));
            stats.abs_gradient.extend_from_slice(row(1));
            // Numbers of views are whole numbers far below 2^24.
            stats.views.extend(row(2).iter().map(|views| *views as u32));
        }
        Ok(stats)
    }

    /// Uploads statistics, which must match the number of splats.
    pub(crate) fn set_stats(&self, gpu: &Gpu, stats: &DensifyStats) -> Result<(), EngineError> {
        for shard in &self.shards {
            let own = shard.base..shard.base + shard.len;
            let mut values = vec![0.0f32; STATS_ROWS * shard.stride];
            values[..shard.len].copy_from_slice(&stats.gradient[own.clone()]);
            values[shard.stride..][..shard.len].copy_from_slice(&stats.abs_gradient[own.clone()]);
            for (value, views) in values[2 * shard.stride..].iter_mut().zip(&stats.views[own]) {
                *value = *views as f32;
            }
            gpu.queue.write_buffer(&shard.stats.raw, 0, bytemuck::cast_slice(&values));
        }
        gpu.check()
    }
}

impl Shard {
    /// Converts the shard's part of `splats` to `rows` rows.
    fn rows_of(&self, layout: ParameterRows, splats: &Splats, rows: usize) -> Vec<f32> {
        let mut out = vec![0.0; rows * self.stride];
        for i in 0..self.len {
            let splat = self.base + i;
            let parameters = splats.position[splat]
                .iter()
                .chain(&splats.rotation[splat])
                .chain(&splats.log_scale[splat])
                .chain([&splats.opacity_logit[splat]])
                .chain(splats.sh_of(splat))
                .chain(splats.raw_luminance_of(splat));
            for (row, value) in parameters.enumerate() {
                out[row * self.stride + i] = *value;
            }
            if let Some(value) = splats.smoothing.get(splat).filter(|_| rows > layout.count()) {
                out[layout.count() * self.stride + i] = *value;
            }
        }
        out
    }

    /// The inverse of [`Self::rows_of`], without the 3D filter.
    fn store_rows(&self, layout: ParameterRows, rows: &[f32], splats: &mut Splats) {
        let (k, m) = (3 * layout.color_model.sh_coefficients(), layout.color_model.luminance_coefficients());
        for i in 0..self.len {
            let splat = self.base + i;
            let at = |row: usize| rows[row * self.stride + i];
            splats.position[splat] = std::array::from_fn(|c| at(ParameterRows::POSITION + c));
            splats.rotation[splat] = std::array::from_fn(|c| at(ParameterRows::ROTATION + c));
            splats.log_scale[splat] = std::array::from_fn(|c| at(ParameterRows::LOG_SCALE + c));
            splats.opacity_logit[splat] = at(ParameterRows::OPACITY);
            for (c, value) in splats.sh[splat * k..(splat + 1) * k].iter_mut().enumerate() {
                *value = at(ParameterRows::SH + c);
            }
            for (c, value) in splats.raw_luminance[splat * m..(splat + 1) * m].iter_mut().enumerate() {
                *value = at(layout.luminance() + c);
            }
        }
    }
}
