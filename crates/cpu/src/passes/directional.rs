//! Passes `color` and `color_backward` for arrays `[N, K, 3]` of coefficients, splat by splat.
//!
//! In: [`DirectionalColors`]. Out: colours `[C, N, 3]`; backward, gradients by coefficients,
//! positions and eyes. Sixteen splats are transposed to rows, on which core's formulas run.
//! Degenerate: a splat at the eye is seen from no direction; its gradient is finite.

mod rows;

use std::ops::Range;

use fearless_simd::Simd;
use luxel_core::engine::{ColorGradient, DirectionalColors};
use luxel_core::{ColorBasis, ColorModel, Real, each};
use luxel_lanes::Level;
use rayon::prelude::*;

use self::rows::{FEW_ROWS, load_rows, row_count, store_rows};
use crate::lanes::{LANES, Lanes, V, dot, outlined, with_simd};
use crate::prefetch::fetch;

/// Blocks of splats per chunk.
const CHUNK: usize = 8;

/// The coefficients and positions of a block, or the gradients by them.
struct BlockRows {
    position: [Lanes; LANES],
    sh: Vec<Lanes>,
    luminance: Vec<Lanes>,
}

/// A colour model, up to a degree.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Formula {
    model: ColorModel,
    active_degree: usize,
}

impl Formula {
    /// The formula of 3D Gaussian splatting. Where it is a constant, its loops are unrolled.
    const HARMONICS: Self = Self { model: ColorModel::Sh { degree: 3 }, active_degree: 3 };

    /// Returns the formula of colours.
    fn of(colors: &DirectionalColors<'_>) -> Self {
        Self { model: colors.model, active_degree: colors.active_degree.min(colors.model.max_degree()) }
    }
}

/// The places of a block's numbers.
struct Layout {
    /// Numbers of a splat's harmonics, and how many of them are used.
    sh_stride: usize,
    sh_width: usize,
    luminance: usize,
    /// Whether each camera has its own harmonics.
    per_camera: bool,
}

impl Layout {
    fn new(colors: &DirectionalColors<'_>) -> Self {
        let sh_stride = 3 * colors.sh_per_splat;
        Self {
            sh_stride,
            sh_width: 3 * luxel_core::sh::coefficients(colors.active_degree.min(colors.model.sh_degree())),
            luminance: colors.model.luminance_coefficients(),
            per_camera: colors.sh.len() != sh_stride * colors.position.len(),
        }
    }

    fn rows(&self) -> BlockRows {
        let zeros = |width: usize| vec![Lanes::ZERO; row_count(width)];
        BlockRows { position: [Lanes::ZERO; LANES], sh: zeros(self.sh_width), luminance: zeros(self.luminance) }
    }

    /// Reads the harmonics of a chunk at once, unless none or few of them will be used.
    fn fetch(&self, colors: &DirectionalColors<'_>, camera: usize, splats: Range<usize>) {
        let count = colors.position.len();
        let flags = camera * count + splats.start..camera * count + splats.end;
        if self.sh_width > FEW_ROWS && colors.visible.is_none_or(|visible| visible[flags].contains(&true)) {
            fetch(&colors.sh[self.sh_of(camera, count, splats.start)..][..splats.len() * self.sh_stride]);
        }
    }

    /// Returns where the harmonics of a camera's splats begin.
    fn sh_of(&self, camera: usize, splats: usize, first: usize) -> usize {
        (if self.per_camera { camera * splats } else { 0 } + first) * self.sh_stride
    }
}

impl BlockRows {
    fn clear(&mut self) {
        self.position.fill(Lanes::ZERO);
        self.sh.fill(Lanes::ZERO);
        self.luminance.fill(Lanes::ZERO);
    }

    /// Loads the splats from `first` to before `end`, for a camera.
    #[inline(always)]
    fn load<S: Simd>(&mut self, simd: S, colors: &DirectionalColors<'_>, layout: &Layout, camera: usize, first: usize, end: usize) {
        let position = &colors.position[first..end];
        load_rows(simd, position.as_flattened(), 3, 3, &mut self.position);
        let sh = &colors.sh[layout.sh_of(camera, colors.position.len(), first)..][..(end - first) * layout.sh_stride];
        load_rows(simd, sh, layout.sh_stride, layout.sh_width, &mut self.sh);
        if layout.luminance > 0 {
            let raw = &colors.raw_luminance[first * layout.luminance..end * layout.luminance];
            load_rows(simd, raw, layout.luminance, layout.luminance, &mut self.luminance);
        }
    }

    /// Returns the radiance towards an eye.
    #[inline(always)]
    fn radiance<S: Simd>(&self, simd: S, formula: Formula, eye: [f32; 3]) -> [V<S>; 3] {
        outlined!(simd => match formula {
                        Formula::HARMONICS => self.radiance_of(simd, Formula::HARMONICS, eye),
                        formula => self.radiance_of(simd, formula, eye),
        })
    }

    #[inline(always)]
    fn radiance_of<S: Simd>(&self, simd: S, formula: Formula, eye: [f32; 3]) -> [V<S>; 3] {
        let (basis, _) = self.basis(simd, formula, eye);
        formula.model.radiance(&basis, |m, c| V::load(simd, &self.sh[3 * m + c]), |m| V::load(simd, &self.luminance[m]))
    }

    /// Returns the basis at the direction from an eye, and the reciprocal of the distance.
    #[inline(always)]
    fn basis<S: Simd>(&self, simd: S, formula: Formula, eye: [f32; 3]) -> (ColorBasis<V<S>>, V<S>) {
        let offset = each!([0, 1, 2] i => V::load(simd, &self.position[i]) - eye[i]);
        let inverse = V::splat(simd, 1.0) / dot(offset, offset).max(V::splat(simd, 1e-30)).sqrt();
        let direction = each!([0, 1, 2] i => { let v = offset[i]; v * inverse });
        (ColorBasis::new(formula.active_degree, direction), inverse)
    }
}

/// Returns the bits of the splats from `first` to before `end` that a camera sees.
fn visible_bits(colors: &DirectionalColors<'_>, camera: usize, first: usize, end: usize) -> u16 {
    let all = ((1u32 << (end - first)) - 1) as u16;
    let start = camera * colors.position.len();
    colors.visible.map_or(all, |visible| {
        visible[start + first..start + end].iter().enumerate().fold(0, |bits, (lane, visible)| bits | u16::from(*visible) << lane)
    })
}

/// Evaluates all colours into `out`, whose contents are arbitrary.
pub(crate) fn directional_colors(level: Level, colors: &DirectionalColors<'_>, mut out: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    let (count, layout) = (colors.position.len(), Layout::new(colors));
    if count == 0 {
        return out;
    }
    for (camera, (out, eye)) in out.chunks_mut(count).zip(colors.eye).enumerate() {
        let rows = || layout.rows();
        out.par_chunks_mut(CHUNK * LANES).enumerate().for_each_init(rows, |rows, (chunk, out)| {
            let start = chunk * CHUNK * LANES;
            layout.fetch(colors, camera, start..start + out.len());
            with_simd!(level, simd => {
                for (n, out) in out.chunks_mut(LANES).enumerate() {
                    let first = start + n * LANES;
                    let end = first + out.len();
                    let bits = visible_bits(colors, camera, first, end);
                    if bits == 0 {
                        out.fill([0.0; 3]);
                        continue;
                    }
                    rows.load(simd, colors, &layout, camera, first, end);
                    let radiance = rows.radiance(simd, Formula::of(colors), *eye);
                    let radiance = each!([0, 1, 2] c => radiance[c].lanes());
                    for (lane, out) in out.iter_mut().enumerate() {
                        *out = if bits >> lane & 1 == 1 { each!([0, 1, 2] c => radiance[c][lane]) } else { [0.0; 3] };
                    }
                }
            });
        });
    }
    out
}

/// The slices of a chunk of splats: gradients by positions, and by raw luminance.
struct ChunkGradient<'a> {
    position: &'a mut [[f32; 3]],
    luminance: &'a mut [f32],
    /// For each camera with harmonics of its own, or for all together.
    sh: Vec<&'a mut [f32]>,
}

/// Differentiates all colours into `out`, whose contents are arbitrary.
pub(crate) fn directional_backward(
    level: Level,
    colors: &DirectionalColors<'_>,
    gradient: &[[f32; 3]],
    mut out: ColorGradient,
) -> ColorGradient {
    let (count, layout) = (colors.position.len(), Layout::new(colors));
    if count == 0 || colors.eye.is_empty() {
        out.position.fill([0.0; 3]);
        out.sh.fill(0.0);
        out.raw_luminance.fill(0.0);
        return out;
    }
    let splats = CHUNK * LANES;
    let mut rest: Vec<&mut [f32]> = out.sh.chunks_mut(count * layout.sh_stride).collect();
    let mut luminance = out.raw_luminance.as_mut_slice();
    let chunks: Vec<ChunkGradient<'_>> = out
        .position
        .chunks_mut(splats)
        .map(|position| ChunkGradient {
            luminance: luminance.split_off_mut(..position.len() * layout.luminance).unwrap_or_default(),
            sh: rest.iter_mut().map(|sh| sh.split_off_mut(..position.len() * layout.sh_stride).unwrap_or_default()).collect(),
            position,
        })
        .collect();
    let by_eye: Vec<Vec<[f64; 3]>> = chunks
        .into_par_iter()
        .enumerate()
        .map_init(
            || [layout.rows(), layout.rows(), layout.rows()],
            |rows, (chunk, out)| with_simd!(level, simd => chunk_backward(simd, colors, &layout, gradient, chunk * splats, rows, out)),
        )
        .collect();
    for (camera, eye) in out.eye.iter_mut().enumerate() {
        *eye = each!([0, 1, 2] i => -by_eye.iter().map(|sums| sums[camera][i]).sum::<f64>() as f32);
    }
    out
}

/// Differentiates a chunk of splats from `start` on. Returns the sums of the gradients by the
/// positions for each camera.
#[inline(always)]
fn chunk_backward<S: Simd>(
    simd: S,
    colors: &DirectionalColors<'_>,
    layout: &Layout,
    gradient: &[[f32; 3]],
    start: usize,
    [rows, d, buffer]: &mut [BlockRows; 3],
    mut out: ChunkGradient<'_>,
) -> Vec<[f64; 3]> {
    let count = colors.position.len();
    let mut sums = vec![[0.0; 3]; colors.eye.len()];
    let end = start + out.position.len();
    (0..colors.eye.len()).for_each(|camera| layout.fetch(colors, camera, start..end));
    // Stores wait for memory as loads do.
    out.sh.iter().for_each(|sh| fetch(sh));
    for first in (start..end).step_by(LANES) {
        let end = (first + LANES).min(end);
        let place = first - start..end - start;
        d.clear();
        let mut is_first = true;
        for (camera, eye) in colors.eye.iter().enumerate() {
            let bits = visible_bits(colors, camera, first, end);
            if bits != 0 {
                rows.load(simd, colors, layout, camera, first, end);
                let mut d_radiance = [Lanes::ZERO; 3];
                for lane in (0..end - first).filter(|lane| bits >> lane & 1 == 1) {
                    let numbers = gradient[camera * count + first + lane];
                    each!([0, 1, 2] c => d_radiance[c].0[lane] = numbers[c]);
                }
                let out = if is_first { &mut *d } else { &mut *buffer };
                let d_position = block_backward(simd, Formula::of(colors), rows, *eye, &d_radiance, out);
                if !is_first {
                    for (sum, part) in d.sh.iter_mut().zip(&buffer.sh).chain(d.luminance.iter_mut().zip(&buffer.luminance)) {
                        (V::load(simd, sum) + V::load(simd, part)).store(sum);
                    }
                }
                is_first = false;
                for i in 0..3 {
                    // Lanes beyond the last splat have no gradient.
                    sums[camera][i] += d_position[i].sum_f64();
                    let sum = V::load(simd, &d.position[i]) + d_position[i];
                    sum.store(&mut d.position[i]);
                }
            }
            if layout.per_camera {
                // The harmonics of the next camera are others.
                let sh = &mut out.sh[camera][place.start * layout.sh_stride..place.end * layout.sh_stride];
                store_rows(simd, &d.sh, layout.sh_width, layout.sh_stride, sh);
                d.sh.fill(Lanes::ZERO);
            }
        }
        if !layout.per_camera {
            let sh = &mut out.sh[0][place.start * layout.sh_stride..place.end * layout.sh_stride];
            store_rows(simd, &d.sh, layout.sh_width, layout.sh_stride, sh);
        }
        if layout.luminance > 0 {
            let raw = &mut out.luminance[place.start * layout.luminance..place.end * layout.luminance];
            store_rows(simd, &d.luminance, layout.luminance, layout.luminance, raw);
        }
        store_rows(simd, &d.position, 3, 3, out.position[place].as_flattened_mut());
    }
    sums
}

/// Differentiates a block's colours towards an eye. Writes the gradients by coefficients to `out`,
/// and returns that by the position.
#[inline(always)]
fn block_backward<S: Simd>(
    simd: S,
    formula: Formula,
    rows: &BlockRows,
    eye: [f32; 3],
    d_radiance: &[Lanes; 3],
    out: &mut BlockRows,
) -> [V<S>; 3] {
    outlined!(simd => match formula {
                Formula::HARMONICS => block_backward_of(simd, Formula::HARMONICS, rows, eye, d_radiance, out),
                formula => block_backward_of(simd, formula, rows, eye, d_radiance, out),
    })
}

#[inline(always)]
fn block_backward_of<S: Simd>(
    simd: S,
    formula: Formula,
    rows: &BlockRows,
    eye: [f32; 3],
    d_radiance: &[Lanes; 3],
    out: &mut BlockRows,
) -> [V<S>; 3] {
    let (basis, inverse) = rows.basis(simd, formula, eye);
    let d_radiance = each!([0, 1, 2] c => { let d = &d_radiance[c]; V::load(simd, d) });
    let (sh, luminance) = (&rows.sh, &rows.luminance);
    let (sh_out, luminance_out) = (&mut out.sh, &mut out.luminance);
    let d_direction = formula.model.backward(
        &basis,
        |m, c| V::load(simd, &sh[3 * m + c]),
        |m| V::load(simd, &luminance[m]),
        d_radiance,
        |m, c, gradient| gradient.store(&mut sh_out[3 * m + c]),
        |m, gradient| gradient.store(&mut luminance_out[m]),
    );
    each!([0, 1, 2] i => { let d = d_direction[i]; d * inverse })
}
