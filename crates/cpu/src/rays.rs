//! The rays of an image's pixels, for projections other than the pinhole.
//!
//! In: a camera (of the samples, with supersampling). Out: [`RayTable`]: for every pixel of every
//! tile a unit vector in camera space, zero where the image shows nothing; cones around the rays of
//! tiles, of groups of tiles and of blocks, by which splats are found. Splats are compared with
//! rays only, so panoramas have no seam and no poles. Degenerate: a cone without rays is never
//! touched.

use std::sync::Arc;

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use glam::{DVec2, DVec3};
use luxel_core::engine::{PIXEL_ANGLE_TERMS, PixelAngle};
use luxel_core::{Camera, CameraProjection, Real, each};
use rayon::prelude::*;

use crate::lanes::{LANES, Lanes, M, V, dot};
use crate::tiles::{BLOCK_PX, BLOCKS, TILE_BLOCKS, TILE_PX};

/// Tiles along the side of a group.
const GROUP_TILES: usize = 4;
/// Vectors of cones that hold a tile's blocks.
const BLOCK_CONES: usize = BLOCKS / LANES;
/// Enlarges cones against rounding of rays.
const MARGIN: f64 = 2e-6;
/// The radius of a cone without rays.
const EMPTY: f32 = -1.0;

/// Sixteen cones: unit vectors of their axes, and the largest distance of a ray from the axis.
#[derive(Clone, Copy, Debug, Default)]
struct Cones {
    axis: [Lanes; 3],
    radius: Lanes,
}

/// The rays of all pixels.
#[derive(Debug)]
pub(crate) struct RayTable {
    /// By tile and block.
    rays: Vec<[Lanes; 3]>,
    /// By tile.
    blocks: Vec<[Cones; BLOCK_CONES]>,
    /// By group, its tiles row by row.
    tiles: Vec<Cones>,
    groups: Vec<Cones>,
    groups_across: usize,
    tiles_across_down: [usize; 2],
    /// Squared side of a pixel: see [`PixelAngle`].
    middle: f32,
    inverse_half_range: f32,
    coefficients: [f32; PIXEL_ANGLE_TERMS],
    /// Least cosine between a ray and the axis.
    pub(crate) least_cosine: f32,
}

/// The part of a splat that decides which rays touch it.
pub(crate) struct Touch {
    rows: [[f32; 3]; 2],
    lengths: [f32; 2],
    radius2: f32,
    front: [f32; 3],
    front_length: f32,
}

impl Touch {
    /// Takes the rows of a footprint's matrix, and u^2 + v^2 at its threshold; `None` if it is
    /// culled.
    #[inline(always)]
    pub(crate) fn new(rows: [[f32; 3]; 2], radius2: f32) -> Option<Self> {
        let length = |v: [f32; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        let front = cross(rows[0], rows[1]);
        let touch = Self { rows, lengths: rows.map(length), radius2, front, front_length: length(front) };
        (radius2 > 0.0).then_some(touch)
    }

    /// Returns which of sixteen cones may hold a ray that the splat touches.
    #[inline(always)]
    fn touches<S: Simd>(&self, simd: S, cones: &Cones) -> M<S> {
        let c = |value: f32| V::splat(simd, value);
        let axis = each!([0, 1, 2] i => V::load(simd, &cones.axis[i]));
        let radius = V::load(simd, &cones.radius);
        let vector = |v: [f32; 3]| each!([0, 1, 2] i => c(v[i]));
        let least = each!([0, 1] i => (dot(vector(self.rows[i]), axis).abs() - radius * self.lengths[i]).max(c(0.0)));
        let front = radius.mul_add(c(self.front_length), dot(vector(self.front), axis));
        least[0].mul_add(least[0], least[1] * least[1]).lt(c(self.radius2)) & front.gt(c(0.0))
    }
}

/// Returns the cross product.
#[inline(always)]
pub(crate) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

impl RayTable {
    /// Computes the rays of a valid camera.
    pub(crate) fn new(camera: &Camera) -> Self {
        let tiles_across_down = camera.size_px.map(|side| (side as usize).div_ceil(TILE_PX));
        let [across, down] = tiles_across_down;
        let mut rays = vec![[Lanes::ZERO; 3]; across * down * BLOCKS];
        let mut blocks = vec![[Cones::default(); BLOCK_CONES]; across * down];
        let tile_cones: Vec<Cone> = (rays.par_chunks_mut(BLOCKS), &mut blocks)
            .into_par_iter()
            .enumerate()
            .map(|(tile, (rays, cones))| tile_rays(camera, [tile % across * TILE_PX, tile / across * TILE_PX], rays, cones))
            .collect();
        let [groups_across, groups_down] = tiles_across_down.map(|side| side.div_ceil(GROUP_TILES));
        let mut tiles = vec![Cones::default(); groups_across * groups_down];
        let mut groups = vec![Cones::default(); (groups_across * groups_down).div_ceil(LANES)];
        groups.iter_mut().for_each(|cones| cones.radius = Lanes([EMPTY; LANES]));
        for (group, cones) in tiles.iter_mut().enumerate() {
            let mut inside = Vec::new();
            for lane in 0..LANES {
                let (column, row) =
                    (group % groups_across * GROUP_TILES + lane % GROUP_TILES, group / groups_across * GROUP_TILES + lane / GROUP_TILES);
                let cone = if column < across && row < down { tile_cones[row * across + column] } else { Cone::EMPTY };
                cone.put(cones, lane);
                inside.push(cone);
            }
            Cone::around_cones(&inside).put(&mut groups[group / LANES], group % LANES);
        }
        let size = PixelAngle::new(camera);
        let least_cosine = match camera.projection {
            CameraProjection::Fisheye(lens) => lens.max_angle_rad.cos() as f32,
            CameraProjection::Pinhole | CameraProjection::Equirectangular => -1.0,
        };
        Self {
            rays,
            blocks,
            tiles,
            groups,
            groups_across,
            tiles_across_down,
            middle: size.middle as f32,
            inverse_half_range: (1.0 / size.half_range) as f32,
            coefficients: size.coefficients.map(|c| c as f32),
            least_cosine,
        }
    }

    /// Returns about how much memory the table takes.
    fn bytes(&self) -> usize {
        size_of_val(self.rays.as_slice()) + size_of_val(self.blocks.as_slice())
    }

    /// Returns the rays of a block of a tile.
    #[inline(always)]
    pub(crate) fn block<S: Simd>(&self, simd: S, tile: usize, block: usize) -> [V<S>; 3] {
        let rays = &self.rays[tile * BLOCKS + block];
        each!([0, 1, 2] i => V::load(simd, &rays[i]))
    }

    /// Returns the squared side of a pixel in radians, and its derivative by the cosine.
    #[inline(always)]
    pub(crate) fn pixel_angle<S: Simd>(&self, cosine: V<S>) -> [V<S>; 2] {
        let c = |value: f32| cosine.lift(value);
        let t = (cosine - self.middle) * self.inverse_half_range;
        let inside = t.abs().lt(c(1.0));
        let t = t.max(c(-1.0)).min(c(1.0));
        let (mut value, mut slope) = (c(0.0), c(0.0));
        for coefficient in self.coefficients.iter().rev() {
            slope = slope.mul_add(t, value);
            value = value.mul_add(t, c(*coefficient));
        }
        [value, V::select(inside, slope * self.inverse_half_range, c(0.0))]
    }

    /// Calls `visit` with each tile that the splat touches, group by group.
    #[inline(always)]
    pub(crate) fn touched_tiles<S: Simd>(&self, simd: S, splat: &Touch, mut visit: impl FnMut(usize)) {
        for (n, cones) in self.groups.iter().enumerate() {
            let mut groups = splat.touches(simd, cones).to_bitmask();
            while groups != 0 {
                let group = n * LANES + groups.trailing_zeros() as usize;
                groups &= groups - 1;
                let origin = [group % self.groups_across * GROUP_TILES, group / self.groups_across * GROUP_TILES];
                let mut tiles = splat.touches(simd, &self.tiles[group]).to_bitmask();
                while tiles != 0 {
                    let lane = tiles.trailing_zeros() as usize;
                    tiles &= tiles - 1;
                    visit((origin[1] + lane / GROUP_TILES) * self.tiles_across_down[0] + origin[0] + lane % GROUP_TILES);
                }
            }
        }
    }

    /// Returns a bit for each block of a tile that the splat touches.
    #[inline(always)]
    pub(crate) fn touched_blocks<S: Simd>(&self, simd: S, splat: &Touch, tile: usize) -> u64 {
        let mut bits = 0;
        for (n, cones) in self.blocks[tile].iter().enumerate() {
            bits |= u64::from(splat.touches(simd, cones).to_bitmask() as u16) << (n * LANES);
        }
        bits
    }
}

/// Rays of the lenses that were used last: views of one camera share them, whatever their poses.
#[derive(Default)]
pub(crate) struct Lenses(Vec<(Camera, Arc<RayTable>)>);

/// Memory that the tables of other lenses than the present one may take, bytes.
const KEPT_BYTES: usize = 512 << 20;

impl Lenses {
    /// Returns the rays of a valid camera.
    pub(crate) fn rays(&mut self, camera: &Camera) -> Arc<RayTable> {
        let lens = Camera { camera_from_world: glam::DAffine3::IDENTITY, ..camera.clone() };
        let found = self.0.iter().position(|(kept, _)| *kept == lens);
        let entry = match found {
            Some(at) => self.0.remove(at),
            None => {
                let mut bytes = 0;
                self.0.retain(|(_, rays)| {
                    bytes += rays.bytes();
                    bytes <= KEPT_BYTES
                });
                let rays = Arc::new(RayTable::new(&lens));
                (lens, rays)
            }
        };
        let rays = Arc::clone(&entry.1);
        self.0.insert(0, entry);
        rays
    }
}

/// A cone around rays.
#[derive(Clone, Copy, Debug)]
struct Cone {
    axis: DVec3,
    radius: f64,
}

impl Cone {
    const EMPTY: Self = Self { axis: DVec3::ZERO, radius: EMPTY as f64 };

    /// Returns the cone around rays.
    fn around(rays: &[DVec3]) -> Self {
        let axis = rays.iter().sum::<DVec3>().normalize_or_zero();
        let radius = rays.iter().map(|ray| ray.distance(axis)).fold(f64::from(EMPTY), f64::max);
        Self { axis, radius: if rays.is_empty() { radius } else { radius + MARGIN } }
    }

    /// Returns the cone around cones.
    fn around_cones(cones: &[Self]) -> Self {
        let axis = cones.iter().map(|cone| cone.axis).sum::<DVec3>().normalize_or_zero();
        let filled = cones.iter().filter(|cone| cone.radius >= 0.0);
        Self { axis, radius: filled.map(|cone| cone.axis.distance(axis) + cone.radius).fold(f64::from(EMPTY), f64::max) }
    }

    fn put(&self, cones: &mut Cones, lane: usize) {
        for (row, value) in cones.axis.iter_mut().zip(self.axis.to_array()) {
            row.0[lane] = value as f32;
        }
        cones.radius.0[lane] = self.radius as f32;
    }
}

/// Writes the rays and the blocks' cones of a tile, and returns the tile's cone.
fn tile_rays(camera: &Camera, origin_px: [usize; 2], rays: &mut [[Lanes; 3]], cones: &mut [Cones; BLOCK_CONES]) -> Cone {
    let mut all = Vec::new();
    for (block, out) in rays.iter_mut().enumerate() {
        let mut inside = Vec::new();
        for lane in 0..LANES {
            let x = origin_px[0] + block % TILE_BLOCKS * BLOCK_PX + lane % BLOCK_PX;
            let y = origin_px[1] + block / TILE_BLOCKS * BLOCK_PX + lane / BLOCK_PX;
            let is_in_image = x < camera.size_px[0] as usize && y < camera.size_px[1] as usize;
            let Some(ray) = camera.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).filter(|_| is_in_image) else { continue };
            for (row, value) in out.iter_mut().zip(ray.to_array()) {
                row.0[lane] = value as f32;
            }
            inside.push(ray);
        }
        Cone::around(&inside).put(&mut cones[block / LANES], block % LANES);
        all.extend(inside);
    }
    Cone::around(&all)
}
