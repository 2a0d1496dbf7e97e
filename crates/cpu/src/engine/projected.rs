//! [`Projected`]: splats on the screens of cameras, with what blending and the backward pass need.

use std::sync::Arc;

use fearless_simd::Simd;
use luxel_core::engine::{
    ActivatedSplats, BlendOptions, BlendedPixels, BlendedSplats, CameraMatrices, Channels, EllipseGradient, MatrixCamera, ParameterRows,
    ProjectedSplats, ScreenEllipses, ShapeParameters, SplatGradient, check_len,
};
use luxel_core::{EngineError, Remedy, each};
use rayon::prelude::*;

use super::blended::Blended;
use super::screens::{ScreenView, Screens, Shared, ViewBuffers};
use crate::lanes::{LANES, Lanes, V, fill_rows, with_simd};
use crate::passes::activated::{
    ActivatedStore, EllipseLanes, EllipseRows, ROWS, SplatLanes, WantedParts, project_activated, project_activated_backward,
};
use crate::passes::project::Footprint;
use crate::view::ScreenCamera;

/// Blocks of splats per chunk.
const CHUNK: usize = 16;

/// Splats on the screens of cameras.
pub(super) struct Projected(Arc<Screens>);

impl Projected {
    /// Projects valid splats to the screens of valid cameras.
    pub(super) fn new(
        shared: Shared,
        splats: &ActivatedSplats<'_>,
        cameras: &[MatrixCamera],
        options: &BlendOptions,
    ) -> (ScreenEllipses, Self) {
        let (store, count) = (ActivatedStore::new(shared.level, splats), splats.len());
        let total = count * cameras.len();
        let numbers = &shared.spare.numbers;
        let mut ellipses = ScreenEllipses {
            mean_px: numbers.take(total),
            covariance_px2: numbers.take(total),
            conic: numbers.take(total),
            depth: numbers.take(total),
            opacity: numbers.take(total),
            radius_px: numbers.take(total),
        };
        let mut views = Vec::new();
        for (n, camera) in cameras.iter().enumerate() {
            let camera = ScreenCamera::from_matrix(camera, options);
            let mut buffers = shared.spare.views.take();
            let ViewBuffers { footprints, bins, visible } = &mut buffers;
            footprints.resize(store.blocks.len() * LANES, Footprint::default());
            visible.resize(store.blocks.len(), 0);
            let blocks = EllipseRows::blocks(&mut ellipses, n * count..(n + 1) * count);
            let outs = blocks.zip(footprints.par_chunks_mut(LANES)).zip(&mut *visible);
            outs.zip(&store.blocks).with_min_len(64).for_each(|(((out, footprints), visible), rows)| {
                *visible = with_simd!(shared.level, simd => project_activated(simd, &camera, options, rows, out, footprints));
            });
            bins.fill(shared.level, &camera, footprints);
            views.push(ScreenView { camera, buffers });
        }
        let size_px = options.size_px.map(|side| side as usize);
        (ellipses, Self(Arc::new(Screens { shared, splats: store, size_px, views })))
    }
}

impl ProjectedSplats for Projected {
    fn blend(&self, channels: &Channels<'_>) -> Result<(BlendedPixels, Box<dyn BlendedSplats>), EngineError> {
        let screens = &self.0;
        let (cameras, shared_len) = (screens.views.len(), screens.splats.count * channels.count);
        if channels.count == 0 {
            return Err(EngineError::invalid("channels: expected at least 1, found 0"));
        }
        if channels.values.len() != shared_len * cameras {
            check_len("channels", channels.values.len(), shared_len)?;
        }
        if let Some(background) = channels.background {
            check_len("background", background.len(), cameras * channels.count)?;
        }
        let [width, height] = screens.size_px;
        let numbers = (cameras * channels.count).saturating_mul(width * height);
        if Vec::<f32>::new().try_reserve_exact(numbers).is_err() {
            let message =
                format!("cpu: images of {cameras} x {height} x {width} x {} numbers take more memory than there is", channels.count);
            return Err(EngineError::device(message).with_remedy(Remedy::advice("render fewer channels or smaller images")));
        }
        let (pixels, blended) = screens.shared.pool.install(|| Blended::new(screens.clone(), channels));
        Ok((pixels, Box::new(blended)))
    }

    fn backward(&self, gradient: &EllipseGradient<'_>) -> Result<SplatGradient, EngineError> {
        let screens = &self.0;
        let total = screens.splats.count * screens.views.len();
        let lengths = [
            ("gradient by means", gradient.mean_px.map(<[_]>::len)),
            ("gradient by covariances", gradient.covariance_px2.map(<[_]>::len)),
            ("gradient by conics", gradient.conic.map(<[_]>::len)),
            ("gradient by depths", gradient.depth.map(<[_]>::len)),
            ("gradient by opacities", gradient.opacity.map(<[_]>::len)),
        ];
        lengths.into_iter().try_for_each(|(name, len)| len.map_or(Ok(()), |len| check_len(name, len, total)))?;
        Ok(screens.shared.pool.install(|| screens.backward(gradient)))
    }
}

/// The slices of a chunk of splats.
struct ChunkGradient<'a> {
    position: &'a mut [[f32; 3]],
    rotation: &'a mut [[f32; 4]],
    scale: &'a mut [[f32; 3]],
    covariance: &'a mut [[f32; 6]],
    opacity: &'a mut [f32],
}

impl Screens {
    /// Differentiates all splats, chunk by chunk.
    fn backward(&self, gradient: &EllipseGradient<'_>) -> SplatGradient {
        let count = self.splats.count;
        let numbers = &self.shared.spare.numbers;
        let mut out = SplatGradient {
            position: numbers.take(count),
            rotation: numbers.take(count),
            scale: numbers.take(count),
            covariance: numbers.take(count),
            opacity: numbers.take(count),
            camera_from_world: Vec::new(),
        };
        let splats = CHUNK * LANES;
        let chunks = (
            out.position.par_chunks_mut(splats),
            out.rotation.par_chunks_mut(splats),
            out.scale.par_chunks_mut(splats),
            out.covariance.par_chunks_mut(splats),
            out.opacity.par_chunks_mut(splats),
        );
        let by_camera: Vec<Vec<[f64; 12]>> = chunks
            .into_par_iter()
            .enumerate()
            .map(|(chunk, (position, rotation, scale, covariance, opacity))| {
                let out = ChunkGradient { position, rotation, scale, covariance, opacity };
                with_simd!(self.shared.level, simd => self.chunk_backward(simd, gradient, chunk, out))
            })
            .collect();
        match gradient.shape {
            ShapeParameters::RotationAndScale => numbers.give_back(std::mem::take(&mut out.covariance).into_flattened()),
            ShapeParameters::Covariance => {
                numbers.give_back(std::mem::take(&mut out.rotation).into_flattened());
                numbers.give_back(std::mem::take(&mut out.scale).into_flattened());
            }
        }
        if gradient.cameras == CameraMatrices::Differentiate {
            let number = |camera: usize, n: usize| by_camera.iter().map(|sums| sums[camera][n]).sum::<f64>() as f32;
            let map = |camera| std::array::from_fn(|row| std::array::from_fn(|column| number(camera, 4 * row + column)));
            out.camera_from_world = (0..self.views.len()).map(map).collect();
        }
        out
    }

    /// Differentiates a chunk. Returns the sums by the cameras' numbers.
    #[inline(always)]
    fn chunk_backward<S: Simd>(&self, simd: S, gradient: &EllipseGradient<'_>, chunk: usize, out: ChunkGradient<'_>) -> Vec<[f64; 12]> {
        let mut sums = vec![[0.0; 12]; self.views.len()];
        let count = self.splats.count;
        let wanted = WantedParts { shape: gradient.shape, cameras: gradient.cameras };
        for n in 0..out.opacity.len().div_ceil(LANES) {
            let block = chunk * CHUNK + n;
            let (first, end) = (block * LANES, count.min((block + 1) * LANES));
            let (mut total, mut by_covariance) = ([Lanes::ZERO; ROWS], [Lanes::ZERO; 6]);
            for ((camera, view), sums) in self.views.iter().enumerate().zip(&mut sums) {
                let visible = view.buffers.visible[block];
                if visible == 0 {
                    continue;
                }
                let lanes = ellipse_lanes(gradient, camera * count + first..camera * count + end);
                let SplatLanes { rows, covariance, camera } =
                    project_activated_backward(simd, &view.camera, &self.splats.blocks[block], visible, &lanes, wanted);
                for (total, row) in total.iter_mut().zip(rows) {
                    (V::load(simd, total) + row).store(total);
                }
                for (total, row) in by_covariance.iter_mut().zip(covariance.into_iter().flatten()) {
                    (V::load(simd, total) + row).store(total);
                }
                for (sum, row) in sums.iter_mut().zip(camera.into_iter().flatten()) {
                    *sum += row.sum_f64();
                }
            }
            for (lane, i) in (n * LANES..out.opacity.len().min((n + 1) * LANES)).enumerate() {
                let at = |row: usize| total[row].0[lane];
                out.position[i] = each!([0, 1, 2] c => at(ParameterRows::POSITION + c));
                match gradient.shape {
                    ShapeParameters::RotationAndScale => {
                        out.rotation[i] = each!([0, 1, 2, 3] c => at(ParameterRows::ROTATION + c));
                        out.scale[i] = each!([0, 1, 2] c => at(ParameterRows::LOG_SCALE + c));
                    }
                    ShapeParameters::Covariance => out.covariance[i] = each!([0, 1, 2, 3, 4, 5] c => by_covariance[c].0[lane]),
                }
                out.opacity[i] = at(ParameterRows::OPACITY);
            }
        }
        sums
    }
}

/// Loads the gradient by the ellipses of a range, at most sixteen.
#[inline(always)]
fn ellipse_lanes(gradient: &EllipseGradient<'_>, range: std::ops::Range<usize>) -> EllipseLanes {
    #[inline(always)]
    fn rows<const N: usize>(numbers: &[[f32; N]]) -> [Lanes; N] {
        let mut rows = [Lanes::ZERO; N];
        fill_rows(&mut rows, numbers);
        rows
    }
    let one = |numbers: Option<&[f32]>| {
        let mut row = Lanes::ZERO;
        if let Some(numbers) = numbers {
            row.0[..range.len()].copy_from_slice(&numbers[range.clone()]);
        }
        row
    };
    EllipseLanes {
        mean: gradient.mean_px.map_or([Lanes::ZERO; 2], |numbers| rows(&numbers[range.clone()])),
        covariance: gradient.covariance_px2.map_or([Lanes::ZERO; 3], |numbers| rows(&numbers[range.clone()])),
        conic: gradient.conic.map(|numbers| rows(&numbers[range.clone()])),
        depth: one(gradient.depth),
        opacity: one(gradient.opacity),
    }
}
