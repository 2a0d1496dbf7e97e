//! The memory that a run will take, before it takes it.
//!
//! In: the plan for the images, by their headers, and the settings. Out: [`RunMemory`], a line
//! about it, and an error for what cannot fit. The numbers are estimates from above: of images what
//! is decoded or their limit, of the engine's buffers what a step and a measurement of the largest
//! image hold, or stereo or the colours of the first splats, of splats their parameters with
//! moments, mean and copies. A run whose number of splats is bounded by its data alone is held
//! against those that it starts with, of a given scene all; the bound is reported. Degenerate:
//! where the system tells no limit, nothing is refused.

use luxel_core::engine::{ParameterRows, tile_memory};
use luxel_core::{ColorModel, Remedy, text};
use luxel_io::{ImagePlan, IoError, system_memory};
use luxel_train::{TrainConfig, first_colors_bytes, stereo_bytes};

use crate::memory;

/// Bytes per pixel and sample that a step holds on a processor, and that it keeps about tiles
/// where it may.
const STEP_PIXEL_BYTES: u64 = 90;
const TILE_PIXEL_BYTES: u64 = 320;
/// Bytes per pixel and sample of the gradients of tiles. Where they do not fit into half the memory
/// for what is kept, a step makes them band by band, of which there are at most so many.
const GRADIENT_PIXEL_BYTES: u64 = 70;
const MOST_BANDS: u64 = 15;
/// Bytes per pixel that a step holds besides where images have vignetting.
const VIGNETTED_PIXEL_BYTES: u64 = 16;
/// Bytes per pixel that a step holds besides of a method that blends channels of its own: images,
/// values of networks, and gradients by them.
const CHANNEL_PIXEL_BYTES: u64 = 600;
/// Bytes per pixel and sample that a render holds on a processor, and bytes per pixel that a
/// measurement holds beside it. A render gives back what only steps need.
const RENDER_PIXEL_BYTES: u64 = 70;
const MEASURED_PIXEL_BYTES: u64 = 80;
/// Copies of a splat's parameters at a time: the parameters, two moments, and the four arrays of a
/// checkpoint that a run continues from, or the gradient, the mean and what densification moves.
const COPIES: u64 = 7;
/// Bytes of a splat that do not depend on its parameters: projection, statistics, order.
const SPLAT_BYTES: u64 = 160;
/// Memory of the program without a scene.
const BASE_BYTES: u64 = 100 << 20;

/// Returns the memory that an engine on a processor takes with so many splats of a colour model,
/// their moments and gradient, and the bytes of its steps on images of so many pixels.
pub(crate) fn engine_bytes(splats: u64, color_model: ColorModel, largest_px: u64) -> u64 {
    let rows = ParameterRows { color_model }.count() as u64;
    let step = STEP_PIXEL_BYTES * largest_px + of_tiles(largest_px, memory::tile_bytes());
    splats.saturating_mul(4 * COPIES * rows + SPLAT_BYTES).saturating_add(step)
}

/// Returns what a step holds about the tiles of so many samples, bytes, and keeps at most
/// `tile_bytes` of.
fn of_tiles(samples: u64, tile_bytes: u64) -> u64 {
    let gradients = GRADIENT_PIXEL_BYTES * samples;
    tile_bytes.min(TILE_PIXEL_BYTES * samples) + gradients.min((tile_bytes / 2).max(gradients / MOST_BANDS))
}

/// Estimates of the memory that a run takes, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunMemory {
    /// Images.
    pub images_bytes: u64,
    /// Buffers of the engine and of measurements, by the largest image.
    pub buffers_bytes: u64,
    /// One splat with its moments.
    pub splat_bytes: u64,
    /// Splats that the run starts with, or may have at most if that number was given.
    pub splats: u64,
    /// The most splats that the run may have.
    pub most_splats: u64,
    /// Whether a step holds more than a measurement, so that smaller parts of images help.
    is_most_in_steps: bool,
}

impl RunMemory {
    /// Returns the estimates for images as planned, and for a run that starts from a scene of
    /// `scene_splats` splats, if it does. On a GPU, the buffers of a step and the splats are in its
    /// own memory.
    pub fn new(plan: &ImagePlan, train: &TrainConfig, scene_splats: Option<u64>, is_on_gpu: bool) -> Self {
        Self::estimate(plan, train, scene_splats, is_on_gpu, memory::tile_bytes().min(tile_memory(plan.limit_bytes)))
    }

    /// Returns the estimates with so many bytes for what a step may keep about tiles.
    fn estimate(plan: &ImagePlan, train: &TrainConfig, scene_splats: Option<u64>, is_on_gpu: bool, tile_bytes: u64) -> Self {
        let samples = if is_on_gpu { 0 } else { u64::from(train.samples_for(plan.largest_px)).pow(2) };
        let step_samples = samples * train.crop.map_or(plan.largest_px, |side| plan.largest_px.min(u64::from(side).pow(2)));
        let is_in_channels = train.method.has_own_steps();
        let pixel_bytes = STEP_PIXEL_BYTES
            + if train.vignetting { VIGNETTED_PIXEL_BYTES } else { 0 }
            + if is_in_channels { CHANNEL_PIXEL_BYTES } else { 0 };
        let step = pixel_bytes * step_samples + of_tiles(step_samples, tile_bytes);
        let measurement = (RENDER_PIXEL_BYTES * samples + MEASURED_PIXEL_BYTES) * plan.largest_px;
        let gradients = match is_in_channels {
            // Channels, features and values of networks, and gradients by them, fewer than that.
            true => 2,
            // Those of each view, their mean, and messages where several processes train.
            false if train.batch > 1 => u64::from(train.batch) + 4,
            false => 0,
        };
        let (limit, most_splats) = (train.splat_limit(plan.train_px) as u64, train.most_splats(plan.train_px) as u64);
        // A scene is not cut to a limit.
        let first = scene_splats.unwrap_or(u64::from(train.init_points).min(limit));
        let (splats, most_splats) = match train.freezes_geometry() {
            true => (first, first),
            false => (train.max_splats.map_or(first, |most| first.max(most.into())), most_splats.max(first)),
        };
        // A scene brings its colours, unless it keeps its geometry alone.
        let first_colors = match scene_splats.is_some() && !train.freezes_geometry() {
            true => 0,
            false => first_colors_bytes(first, plan.images as u64),
        };
        // Whether the data set has points is not known yet.
        let stereo = match scene_splats.is_none() && train.stereo_points_for(plan.images, false) > 0 {
            true => stereo_bytes(plan.images as u64, plan.largest_px),
            false => 0,
        };
        let rows = ParameterRows { color_model: train.color_model() }.count() as u64;
        // Both moments of a parameter share its four bytes.
        let saved = u64::from(train.packs_moments());
        Self {
            images_bytes: plan.memory_bytes(),
            buffers_bytes: BASE_BYTES + step.max(measurement).max(first_colors).max(stereo),
            splat_bytes: 4 * (COPIES + gradients - saved) * rows + SPLAT_BYTES,
            splats,
            most_splats,
            is_most_in_steps: step > measurement,
        }
    }

    /// Returns the sum.
    pub fn total_bytes(&self) -> u64 {
        self.images_bytes.saturating_add(self.buffers_bytes).saturating_add(self.splat_bytes.saturating_mul(self.splats))
    }

    /// Says what the run takes, and what the system allows.
    pub fn line(&self) -> String {
        let system = system_memory().map_or_else(String::new, |bytes| format!("; the system allows {}", text::bytes(bytes)));
        format!("memory: {}{system}", self.parts())
    }

    fn parts(&self) -> String {
        let [images, buffers, splats] = [self.images_bytes, self.buffers_bytes, self.splat_bytes * self.splats].map(text::bytes);
        let more = match self.most_splats > self.splats && self.most_splats < u64::from(u32::MAX) {
            true => format!(
                ", and {} for each further 100,000 of at most {}",
                text::bytes(100_000 * self.splat_bytes),
                text::count(self.most_splats as usize)
            ),
            false => String::new(),
        };
        let splat_count = text::count(self.splats as usize);
        format!("images {images}, buffers {buffers}, {splat_count} splats {splats}{more}: about {}", text::bytes(self.total_bytes()))
    }

    /// Refuses a run that cannot fit.
    ///
    /// # Errors
    /// More memory than the system allows, with what helps.
    pub fn check(&self, plan: &ImagePlan, limit_bytes: Option<u64>) -> Result<(), IoError> {
        let Some(limit) = limit_bytes.filter(|limit| self.total_bytes() > *limit) else { return Ok(()) };
        let message = format!("training takes more memory than the system allows, {}: {}", text::bytes(limit), self.parts());
        let splats = self.splat_bytes.saturating_mul(self.splats);
        let lower_images = Remedy::lower("image_memory");
        let remedy = match () {
            () if splats > self.total_bytes() / 2 => Remedy::lower("max_splats"),
            () if self.buffers_bytes > self.total_bytes() / 2 && self.is_most_in_steps => {
                Remedy::raise("downscale").or(Remedy::give("crop"))
            }
            () if self.buffers_bytes > self.total_bytes() / 2 => Remedy::raise("downscale"),
            () => lower_images.or(Remedy::raise("downscale")),
        };
        Err(IoError::unsupported(&plan.path, message).with_remedy(remedy))
    }
}

#[cfg(test)]
mod tests {
    use luxel_train::Freeze;

    use super::*;

    fn plan(images: usize, px: u64, limit_bytes: u64) -> ImagePlan {
        ImagePlan {
            path: "data".into(),
            images,
            decoded_bytes: 12 * px * images as u64,
            largest_bytes: 12 * px,
            largest_px: px,
            train_px: px * images as u64,
            limit_bytes,
            cache: None,
        }
    }

    #[test]
    fn what_cannot_fit_is_refused_with_what_helps() {
        let config = TrainConfig { max_splats: Some(1_000_000), ..TrainConfig::default() };
        let of = |plan: &ImagePlan, config: &TrainConfig| RunMemory::estimate(plan, config, None, false, 1 << 30);
        let helps = |plan: &ImagePlan, config: &TrainConfig, limit| {
            let error = of(plan, config).check(plan, Some(limit)).unwrap_err();
            assert!(error.message.contains("more memory than the system allows"), "{error}");
            error.remedy.unwrap().options().map(str::to_owned).collect::<Vec<_>>()
        };
        let small = plan(10, 1_000_000, u64::MAX);
        assert!(of(&small, &config).check(&small, Some(16 << 30)).is_ok() && of(&small, &config).check(&small, None).is_ok());
        assert_eq!(helps(&small, &config, 1 << 30), ["max_splats"]);
        let few = TrainConfig { max_splats: Some(1000), ..config };
        assert_eq!(helps(&plan(100, 24_000_000, u64::MAX), &few, 8 << 30), ["image_memory", "downscale"]);
        assert_eq!(helps(&plan(300, 100_000_000, 1 << 30), &few, 8 << 30), ["downscale"]);
        let sampled = TrainConfig { samples: Some(2), ..few.clone() };
        assert_eq!(helps(&plan(300, 100_000_000, 1 << 30), &sampled, 8 << 30), ["downscale", "crop"]);
        // The bound by the pixels is no request.
        let unbounded = TrainConfig { max_splats: None, ..few };
        let large = plan(300, 24_000_000, 1 << 30);
        assert!(of(&large, &unbounded).check(&large, Some(32 << 30)).is_ok());
        assert!(of(&large, &unbounded).line().contains("for each further 100,000"));
        // Crops need less where steps hold the most, and so does a GPU.
        let of_tiles = |config: &TrainConfig| RunMemory::estimate(&large, config, None, false, 8 << 30).total_bytes();
        let crops = TrainConfig { crop: Some(1024), ..unbounded.clone() };
        assert!(of_tiles(&crops) < of_tiles(&unbounded));
        assert!(RunMemory::estimate(&large, &unbounded, None, true, 1 << 30).total_bytes() < of(&large, &unbounded).total_bytes());
    }

    #[test]
    fn a_scene_counts_with_its_splats_and_without_first_colors() {
        // Images so small that finding colours takes more than a step.
        let plan = plan(100, 10_000, u64::MAX);
        let config = TrainConfig { max_splats: None, stereo_points: Some(0), ..TrainConfig::default() };
        let of = |config: &TrainConfig, scene| RunMemory::estimate(&plan, config, scene, false, 0);
        let (anew, from_scene) = (of(&config, None), of(&config, Some(3_000_000)));
        assert_eq!(
            (anew.splats, from_scene.splats),
            (u64::from(config.init_points).min(config.splat_limit(plan.train_px) as u64), 3_000_000)
        );
        assert!(from_scene.most_splats >= 3_000_000 && from_scene.buffers_bytes < anew.buffers_bytes, "{from_scene:?} {anew:?}");
        // A limit is for what the run may grow to: it starts with no more splats than without it.
        let bounded = TrainConfig { max_splats: Some(5_000_000), init_points: 1000, ..config.clone() };
        assert_eq!([None, Some(3_000_000), Some(6_000_000)].map(|scene| of(&bounded, scene).splats), [5_000_000, 5_000_000, 6_000_000]);
        let few = TrainConfig { init_points: 1000, ..config.clone() };
        assert_eq!(of(&bounded, None).buffers_bytes, of(&few, None).buffers_bytes);
        assert!(of(&bounded, None).buffers_bytes < anew.buffers_bytes);
        // Stereo counts as long as it may find points.
        let stereo = TrainConfig { stereo_points: Some(1), ..few.clone() };
        assert!(of(&stereo, None).buffers_bytes > of(&few, None).buffers_bytes);
        assert_eq!(of(&stereo, Some(10)).buffers_bytes, of(&few, Some(10)).buffers_bytes);
        // Frozen geometry stays as it is, and gets its colours from the images.
        let frozen = of(&TrainConfig { freeze: Freeze::Geometry, ..bounded }, Some(3_000_000));
        assert_eq!((frozen.splats, frozen.most_splats), (3_000_000, 3_000_000));
        assert!(frozen.buffers_bytes > from_scene.buffers_bytes);
    }
}
