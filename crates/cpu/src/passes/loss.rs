//! Pass `loss`: mu-law L1 + SSIM against the view's image, and its gradient by the pixels' radiance.
//!
//! In: the tiles' radiance, target image and mask, [`LossConfig`]. Out: L1 and SSIM means, [`TileGradient`] per tile.
//! Source: LCD-GS eq. 5; SSIM as in 3DGS: 11x11 Gaussian window of sigma 1.5, zero padding, mean over pixels and channels.
//! The window is symmetric and the padding zero, so the convolution is its own adjoint. Masked pixels take the target's value for the
//! prediction in the windows, and add nothing to L1.
//!
//! Three sweeps over rows: mu-law and horizontal moments; vertical moments, SSIM, its derivatives and their horizontal convolution;
//! vertical convolution and the gradient.

use fearless_simd::{Level, Simd};
use luxel_core::metrics::{SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};
use luxel_core::{LossConfig, Real, View, each};
use rayon::prelude::*;

use super::rasterize::TilePixels;
use super::rasterize_backward::TileGradient;
use crate::lanes::{LANES, Lanes, M, V, with_simd};
use crate::view::{BLOCK_PX, ScreenCamera, TILE_PX, block_of};

const RADIUS: usize = SSIM_RADIUS;
const TAPS: usize = 2 * RADIUS + 1;
/// Zeros on both sides of a row, so that windows need no bounds: a whole vector, at least the radius.
const PAD: usize = LANES;
/// Moments SSIM needs.
const MOMENTS: usize = 4;
/// Derivatives of SSIM by moments.
const DERIVATIVES: usize = 3;

/// Buffers of the pass, kept between steps.
#[derive(Default)]
pub(crate) struct LossBuffers {
    /// mu-law prediction and target: `[H, 3, 2, stride]`.
    values: Vec<f32>,
    /// Horizontal convolutions of x, y, x^2 + y^2, xy: `[H, 3, 4, stride]`. SSIM needs the variances only as their sum.
    moments: Vec<f32>,
    /// Horizontal convolutions of the derivatives of SSIM by the means of x, x^2, xy: `[H, 3, 3, stride]`.
    derivatives: Vec<f32>,
    /// Per row: sum of absolute differences, sum of SSIM.
    sums: Vec<[f64; 2]>,
    /// Gradient by the pixels' radiance.
    pub(crate) gradient: Vec<TileGradient>,
}

/// What the pass found.
pub(crate) struct LossSums {
    pub(crate) l1: f32,
    pub(crate) ssim: f32,
}

/// Geometry of the rows and constants.
struct Rows<'a> {
    width: usize,
    height: usize,
    /// Numbers in a padded row.
    stride: usize,
    config: &'a LossConfig,
    window: [f32; TAPS],
    /// Weight of the sign of a difference, and of the derivative of the sum of SSIM.
    l1_factor: f32,
    ssim_factor: f32,
}

impl LossBuffers {
    /// Evaluates the loss.
    pub(crate) fn loss(&mut self, level: Level, camera: &ScreenCamera, pixels: &[TilePixels], view: &View, config: &LossConfig) -> LossSums {
        let [width, height] = camera.size_px;
        let stride = width.next_multiple_of(LANES) + 2 * PAD;
        let valid = view.mask.as_ref().map_or(width * height, |m| m.valid.iter().filter(|v| **v).count());
        let rows = Rows {
            width,
            height,
            stride,
            config,
            window: ssim_window().map(|w| w as f32),
            l1_factor: (1.0 - config.ssim_weight) / (3 * valid.max(1)) as f32,
            ssim_factor: -config.ssim_weight / (3 * width * height) as f32,
        };
        self.values.resize(height * 3 * 2 * stride, 0.0);
        self.moments.resize(height * 3 * MOMENTS * stride, 0.0);
        self.derivatives.resize(height * 3 * 3 * stride, 0.0);
        self.sums.resize(height, [0.0; 2]);
        let across = camera.tiles()[0];
        self.gradient.resize(across * camera.tiles()[1], TileGradient::default());

        self.values
            .par_chunks_mut(6 * stride)
            .zip(self.moments.par_chunks_mut(3 * MOMENTS * stride))
            .zip(&mut self.sums)
            .enumerate()
            .for_each(|(y, ((values, moments), sums))| {
                with_simd!(level, simd => {
                    load_row(simd, &rows, (pixels, across), view, y, values);
                    sums[0] = absolute_difference(simd, &rows, values);
                    horizontal_moments(simd, &rows, values, moments);
                });
            });
        let moments = &self.moments;
        self.derivatives.par_chunks_mut(9 * stride).zip(&mut self.sums).enumerate().for_each_init(
            || vec![0.0; (DERIVATIVES + MOMENTS) * stride],
            |scratch, (y, (derivatives, sums))| {
                sums[1] = with_simd!(level, simd => similarity_row(simd, &rows, moments, y, scratch, derivatives));
            },
        );
        let (values, derivatives) = (&self.values, &self.derivatives);
        self.gradient.par_chunks_mut(across).enumerate().for_each_init(
            || vec![0.0; (1 + DERIVATIVES) * stride],
            |scratch, (tile_row, tiles)| {
                for y in tile_row * TILE_PX..((tile_row + 1) * TILE_PX).min(height) {
                    with_simd!(level, simd => gradient_row(simd, &rows, values, derivatives, y, scratch, tiles));
                }
            },
        );
        mask_gradient(camera, view, &mut self.gradient);
        let totals = self.sums.iter().fold([0.0; 2], |t, s| [t[0] + s[0], t[1] + s[1]]);
        LossSums { l1: (totals[0] / (3 * valid.max(1)) as f64) as f32, ssim: (totals[1] / (3 * width * height) as f64) as f32 }
    }
}

/// mu-law values of one row: prediction and target for each channel.
#[inline(always)]
fn load_row<S: Simd>(simd: S, rows: &Rows<'_>, (pixels, across): (&[TilePixels], usize), view: &View, y: usize, out: &mut [f32]) {
    let stride = rows.stride;
    let target = &view.image.pixels[y * rows.width..(y + 1) * rows.width];
    let tiles = &pixels[y / TILE_PX * across..][..across];
    for channel in 0..3 {
        let (x_row, y_row) = out[channel * 2 * stride..][..2 * stride].split_at_mut(stride);
        // Of an image of another width, other numbers lie here.
        x_row[..PAD].fill(0.0);
        y_row[..PAD].fill(0.0);
        let (x_row, y_row) = (&mut x_row[PAD..], &mut y_row[PAD..]);
        load_pixels(tiles, channel, y, x_row);
        for (value, pixel) in y_row.iter_mut().zip(target) {
            *value = pixel[channel];
        }
        if let Some(mask) = &view.mask {
            let valid = &mask.valid[y * rows.width..(y + 1) * rows.width];
            for ((x, y), valid) in x_row.iter_mut().zip(y_row.iter()).zip(valid) {
                if !valid {
                    *x = *y;
                }
            }
        }
        let (mu, scale) = (V::splat(simd, rows.config.mu), 1.0 / rows.config.mu.ln_1p());
        for row in [x_row, y_row] {
            for chunk in row[..rows.width.next_multiple_of(LANES)].chunks_exact_mut(LANES) {
                let p = V::load_slice(simd, chunk).max(V::splat(simd, 0.0));
                ((p * mu).ln_1p() * scale).store_slice(chunk);
            }
            // What lies beyond the image within the last vector counts as padding.
            row[rows.width..].fill(0.0);
        }
    }
}

#[inline(always)]
fn absolute_difference<S: Simd>(simd: S, rows: &Rows<'_>, values: &[f32]) -> f64 {
    let mut sum = V::splat(simd, 0.0);
    for channel in values.chunks_exact(2 * rows.stride) {
        let (x, y) = channel.split_at(rows.stride);
        for (x, y) in x.chunks_exact(LANES).zip(y.chunks_exact(LANES)) {
            sum = sum + (V::load_slice(simd, x) - V::load_slice(simd, y)).abs();
        }
    }
    sum.lanes().iter().map(|v| f64::from(*v)).sum()
}

/// Convolves one row of each channel's x, y, x^2 + y^2, xy.
#[inline(always)]
fn horizontal_moments<S: Simd>(simd: S, rows: &Rows<'_>, values: &[f32], out: &mut [f32]) {
    let stride = rows.stride;
    for channel in 0..3 {
        let (x, y) = values[channel * 2 * stride..][..2 * stride].split_at(stride);
        let out = &mut out[channel * MOMENTS * stride..][..MOMENTS * stride];
        for at in (PAD..stride - PAD).step_by(LANES) {
            let mut sums = [V::splat(simd, 0.0); MOMENTS];
            for (tap, weight) in rows.window.iter().enumerate() {
                let weight = V::splat(simd, *weight);
                let vx = V::load_slice(simd, &x[at + tap - RADIUS..]);
                let vy = V::load_slice(simd, &y[at + tap - RADIUS..]);
                let (wx, wy) = (weight * vx, weight * vy);
                sums[0] = sums[0] + wx;
                sums[1] = sums[1] + wy;
                sums[2] = wx.mul_add(vx, wy.mul_add(vy, sums[2]));
                sums[3] = wx.mul_add(vy, sums[3]);
            }
            for (k, sum) in sums.into_iter().enumerate() {
                sum.store_slice(&mut out[k * stride + at..]);
            }
        }
    }
}

/// Vertical convolution of all `kinds` rows of a channel into `out` `[kinds, stride]`: a sweep along each of the window's rows in
/// turn, as the hardware fetches runs ahead but not columns. `offset` is where the channel starts in an image row, `block` the
/// distance between image rows.
#[inline(always)]
fn vertical<S: Simd>(simd: S, rows: &Rows<'_>, data: &[f32], (y, kinds): (usize, usize), (offset, block): (usize, usize), out: &mut [f32]) {
    let length = kinds * rows.stride;
    let first = RADIUS.saturating_sub(y);
    let last = (rows.height + RADIUS - y).min(TAPS);
    let source = |tap: usize| &data[(y + tap - RADIUS) * block + offset..][..length];
    let out = &mut out[..length];
    out.fill(0.0);
    // Four rows of the window a sweep: fewer trips of the sums to memory and back.
    let mut tap = first;
    while tap < last {
        let weight = |i: usize| V::splat(simd, if tap + i < last { rows.window[tap + i] } else { 0.0 });
        let row = |i: usize| source((tap + i).min(last - 1));
        let (weights, sources) = (each!([0, 1, 2, 3] i => weight(i)), each!([0, 1, 2, 3] i => row(i)));
        for (at, sum) in out.chunks_exact_mut(LANES).enumerate() {
            let at = at * LANES;
            let mut value = V::load_slice(simd, sum);
            for (weight, source) in weights.iter().zip(&sources) {
                value = V::load_slice(simd, &source[at..]).mul_add(*weight, value);
            }
            value.store_slice(sum);
        }
        tap += 4;
    }
}

/// SSIM of a row (returned as a sum) and the horizontal convolution of its derivatives.
#[inline(always)]
fn similarity_row<S: Simd>(simd: S, rows: &Rows<'_>, moments: &[f32], y: usize, scratch: &mut [f32], out: &mut [f32]) -> f64 {
    let stride = rows.stride;
    let c = |value: f32| V::splat(simd, value);
    let (c1, c2) = (c(SSIM_C1 as f32), c(SSIM_C2 as f32));
    let mut total = c(0.0);
    let (scratch, blurred) = scratch.split_at_mut(DERIVATIVES * stride);
    for channel in 0..3 {
        vertical(simd, rows, moments, (y, MOMENTS), (channel * MOMENTS * stride, 3 * MOMENTS * stride), blurred);
        for at in (PAD..stride - PAD).step_by(LANES) {
            let [mx, my, squares, exy] = each!([0, 1, 2, 3] k => V::load_slice(simd, &blurred[k * stride + at..]));
            let inside = inside_mask(simd, rows, at);
            let (mxx, myy, mxy) = (mx * mx, my * my, mx * my);
            let a = mxy + mxy + c1;
            let covariance = exy - mxy;
            let b = covariance + covariance + c2;
            let d = mxx + myy + c1;
            let e = squares - (mxx + myy) + c2;
            let inverse = c(1.0) / (d * e);
            let ssim = a * b * inverse;
            total = total + V::select(inside, ssim, c(0.0));
            let by_exx = -(ssim / e);
            let by_exy = (a + a) * inverse;
            let two_mx = mx + mx;
            let by_mx = (my + my) * (b - a) * inverse - two_mx * (ssim / d) - two_mx * by_exx;
            for (k, value) in [by_mx, by_exx, by_exy].into_iter().enumerate() {
                V::select(inside, value, c(0.0)).store_slice(&mut scratch[k * stride + at..]);
            }
        }
        let out = &mut out[channel * 3 * stride..][..3 * stride];
        for k in 0..3 {
            let row = &scratch[k * stride..][..stride];
            for at in (PAD..stride - PAD).step_by(LANES) {
                let mut sum = c(0.0);
                for (tap, weight) in rows.window.iter().enumerate() {
                    sum = V::load_slice(simd, &row[at + tap - RADIUS..]).mul_add(c(*weight), sum);
                }
                sum.store_slice(&mut out[k * stride + at..]);
            }
        }
    }
    total.lanes().iter().map(|v| f64::from(*v)).sum()
}

/// Lanes within the image of the vector that starts at padded column `at`.
#[inline(always)]
fn inside_mask<S: Simd>(simd: S, rows: &Rows<'_>, at: usize) -> M<S> {
    const RAMP: Lanes = Lanes([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0]);
    (V::load(simd, &RAMP) + (at - PAD) as f32).lt(V::splat(simd, rows.width as f32))
}

/// Gradient of one row, written to the row's tiles.
#[inline(always)]
fn gradient_row<S: Simd>(
    simd: S,
    rows: &Rows<'_>,
    values: &[f32],
    derivatives: &[f32],
    y: usize,
    scratch: &mut [f32],
    tiles: &mut [TileGradient],
) {
    let stride = rows.stride;
    let c = |value: f32| V::splat(simd, value);
    // T'(p) = mu / ((1 + mu p) ln(1 + mu)) and 1 + mu p = e^(T ln(1 + mu)).
    let log = rows.config.mu.ln_1p();
    let slope = rows.config.mu / log;
    let (scratch, blurred) = scratch.split_at_mut(stride);
    for channel in 0..3 {
        let (x_row, y_row) = values[(y * 3 + channel) * 2 * stride..][..2 * stride].split_at(stride);
        let place = (channel * DERIVATIVES * stride, 3 * DERIVATIVES * stride);
        vertical(simd, rows, derivatives, (y, DERIVATIVES), place, blurred);
        for at in (PAD..stride - PAD).step_by(LANES) {
            let [by_mx, by_exx, by_exy] = each!([0, 1, 2] k => V::load_slice(simd, &blurred[k * stride + at..]));
            let (x, target) = (V::load_slice(simd, &x_row[at..]), V::load_slice(simd, &y_row[at..]));
            let difference = x - target;
            let sign = difference.if_positive(c(1.0), (-difference).if_positive(c(-1.0), c(0.0)));
            let by_ssim = by_exx.mul_add(x + x, by_exy.mul_add(target, by_mx));
            let by_value = sign.mul_add(c(rows.l1_factor), by_ssim * rows.ssim_factor);
            (by_value * slope * (x * -log).exp()).store_slice(&mut scratch[at..]);
        }
        // Beyond the image the gradient is zero.
        scratch[PAD + rows.width..].fill(0.0);
        store_gradient(&scratch[PAD..], channel, y, tiles);
    }
}

/// Row `y` of a channel from the row's tiles. What lies beyond the image is the caller's to overwrite.
#[inline(always)]
fn load_pixels(tiles: &[TilePixels], channel: usize, y: usize, row: &mut [f32]) {
    // Four pixels of a tile's row are four lanes of a block.
    for (tile, row) in tiles.iter().zip(row.chunks_mut(TILE_PX)) {
        for (column, quad) in row.as_chunks_mut::<BLOCK_PX>().0.iter_mut().enumerate() {
            let (block, lane) = block_of(column * BLOCK_PX, y % TILE_PX);
            *quad = tile.0[block].radiance[channel].0.as_chunks().0[lane / BLOCK_PX];
        }
    }
}

/// The inverse of [`load_pixels`] for the gradient.
#[inline(always)]
fn store_gradient(row: &[f32], channel: usize, y: usize, tiles: &mut [TileGradient]) {
    for (tile, row) in tiles.iter_mut().zip(row.chunks(TILE_PX)) {
        for (column, quad) in row.as_chunks::<BLOCK_PX>().0.iter().enumerate() {
            let (block, lane) = block_of(column * BLOCK_PX, y % TILE_PX);
            tile.0[block][channel].0.as_chunks_mut().0[lane / BLOCK_PX] = *quad;
        }
    }
}

/// Zeroes the gradient of masked pixels: they entered the windows as the target's values, which do not move with the prediction.
fn mask_gradient(camera: &ScreenCamera, view: &View, gradient: &mut [TileGradient]) {
    let Some(mask) = &view.mask else { return };
    let [width, _] = camera.size_px;
    let across = camera.tiles()[0];
    for (i, _) in mask.valid.iter().enumerate().filter(|(_, valid)| !**valid) {
        let (x, y) = (i % width, i / width);
        let (block, lane) = block_of(x % TILE_PX, y % TILE_PX);
        for channel in &mut gradient[y / TILE_PX * across + x / TILE_PX].0[block] {
            channel.0[lane] = 0.0;
        }
    }
}
