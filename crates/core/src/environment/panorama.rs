//! Maps from a panorama that is rendered in one piece: all pixels are rays of one camera, and every
//! splat is projected once, whatever the direction, so there is no border that could be seen.
//!
//! In: renders of the bands of [`PanoramaRig`], from top to bottom. Out: a map in either
//! projection, averaged over each pixel in linear light, with its coverage. The bands are parts of
//! the same panorama, cut so that little is in memory at a time; each has a row more on both
//! sides, which interpolation reads. Degenerate: see [`super`] on focal lengths.

use glam::{DAffine3, DMat3, DVec3};

use super::MapSize;
use crate::{Camera, Image};

/// Smallest and largest number of samples across a pixel of the map.
const SAMPLES: [f64; 2] = [3.0, 32.0];
/// Pixels of the panorama per pixel of the map if no focal length is known.
const OVERSAMPLING: f64 = 1.5;
/// Pixels of a band, about.
const BAND_PIXELS: usize = 4 << 20;
/// Least number of bands: other work is done between them.
const LEAST_BANDS: usize = 12;
/// Longest side of a panorama, pixels.
const MAX_WIDTH_PX: f64 = 32768.0;

/// A panorama in bands, and the map that is made of it.
#[derive(Clone, Debug)]
pub struct PanoramaRig {
    /// Cameras of the bands in the scene's world, from top to bottom.
    pub cameras: Vec<Camera>,
    whole: Camera,
    camera_from_environment: DMat3,
    rows_of_band: usize,
    map: MapSize,
    /// Number of samples across a pixel of the map.
    samples: usize,
}

/// A map of which some bands are still missing.
#[derive(Clone, Debug)]
pub struct PartialPanorama {
    /// Radiance and coverage, summed over the samples of each pixel.
    sums: Vec<[f64; 4]>,
}

impl PanoramaRig {
    /// Returns the rig for a map at the point `at` of the world.
    ///
    /// `environment_from_world` is a rotation. `focal_px` is the focal length of the training
    /// views, if known: a pixel of the panorama spans as much as theirs.
    pub fn new(at: DVec3, environment_from_world: DMat3, map: MapSize, focal_px: Option<f64>) -> Self {
        let density = map.density();
        let focal = focal_px.unwrap_or(OVERSAMPLING * density);
        let width = (std::f64::consts::TAU * focal).clamp(16.0, MAX_WIDTH_PX);
        let width = 2 * (0.5 * width).round() as u32;
        // Right, down and forward: the middle of the map looks along +z, with +x to its left.
        let camera_from_environment = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
        let matrix3 = camera_from_environment * environment_from_world;
        let whole = Camera::panorama(DAffine3 { matrix3, translation: -(matrix3 * at) }, width);
        let [columns, rows] = whole.size_px.map(|side| side as usize);
        let rows_of_band = (BAND_PIXELS / columns).clamp(1, rows.div_ceil(LEAST_BANDS));
        let cameras = (0..rows.div_ceil(rows_of_band)).map(|band| {
            let (first, end) = Self::rows(band, rows_of_band, rows);
            let mut camera = whole.clone();
            camera.center_px.y -= first as f64;
            camera.size_px[1] = (end - first) as u32;
            camera
        });
        let samples = (f64::from(width) / (std::f64::consts::TAU * density) + 1.0).ceil().clamp(SAMPLES[0], SAMPLES[1]) as usize;
        Self { cameras: cameras.collect(), whole, camera_from_environment, rows_of_band, map, samples }
    }

    /// Returns the rows of a band with its margin: first, and one beyond the last.
    fn rows(band: usize, rows_of_band: usize, rows: usize) -> (usize, usize) {
        ((band * rows_of_band).saturating_sub(1), ((band + 1) * rows_of_band + 1).min(rows))
    }

    /// Returns a map to which bands are added one by one.
    pub fn empty_map(&self) -> PartialPanorama {
        let MapSize { projection, width } = self.map;
        PartialPanorama { sums: vec![[0.0; 4]; width * projection.height(width)] }
    }

    /// Returns the place of a direction of the environment in the whole panorama, in pixels from
    /// the middle of the first.
    fn place(&self, direction: DVec3) -> [f64; 2] {
        let placed = self.whole.projection.plane_from_point(self.camera_from_environment * direction);
        let px = placed.map_or(self.whole.center_px, |placed| placed.plane * self.whole.focal_px + self.whole.center_px);
        let last_row = f64::from(self.whole.size_px[1]) - 1.0;
        [px.x - 0.5, (px.y - 0.5).clamp(0.0, last_row)]
    }
}

impl PartialPanorama {
    /// Adds what a band shows. Its coverage is 1 where none is given.
    pub fn add_band(&mut self, rig: &PanoramaRig, band: usize, render: &Image, alpha: Option<&[f32]>) {
        let MapSize { projection, width } = rig.map;
        let [columns, rows] = rig.whole.size_px.map(|side| side as usize);
        let (first, _) = PanoramaRig::rows(band, rig.rows_of_band, rows);
        let own = (band * rig.rows_of_band) as f64..((band + 1) * rig.rows_of_band) as f64;
        let step = 1.0 / rig.samples as f64;
        // Rows that samples of a pixel may be away from its middle.
        let reach = rig.whole.focal_px.y * 6.0 / width as f64 + 1.0;
        let pixel = |x: usize, y: usize| -> [f64; 4] {
            let at = (y - first).min(render.height - 1) * render.width + x;
            let [r, g, b] = render.pixels[at].map(f64::from);
            [r, g, b, alpha.map_or(1.0, |alpha| f64::from(alpha[at]))]
        };
        for (i, sum) in self.sums.iter_mut().enumerate() {
            let (x, y) = ((i % width) as f64, (i / width) as f64);
            let middle = rig.place(projection.direction([x + 0.5, y + 0.5], width))[1];
            if middle + reach < own.start || middle - reach >= own.end {
                continue;
            }
            for sample in 0..rig.samples * rig.samples {
                let [column, row] = [sample % rig.samples, sample / rig.samples].map(|part| (part as f64 + 0.5) * step);
                let [px, py] = rig.place(projection.direction([x + column, y + row], width));
                if !own.contains(&py) {
                    continue;
                }
                let (left, top) = (px.floor(), py.floor());
                let (fx, fy) = (px - left, py - top);
                let columns_px = [left, left + 1.0].map(|x| (x as i64).rem_euclid(columns as i64) as usize);
                let rows_px = [top as usize, (top as usize + 1).min(rows - 1)];
                for (y, wy) in rows_px.into_iter().zip([1.0 - fy, fy]) {
                    for (x, wx) in columns_px.into_iter().zip([1.0 - fx, fx]) {
                        let value = pixel(x, y);
                        sum.iter_mut().zip(value).for_each(|(sum, v)| *sum += wx * wy * v);
                    }
                }
            }
        }
    }

    /// Returns the map of the bands that were added, and its coverage.
    pub fn into_map(self, rig: &PanoramaRig) -> (Image, Vec<f32>) {
        let share = 1.0 / (rig.samples * rig.samples) as f64;
        let MapSize { projection, width } = rig.map;
        let pixels = self.sums.iter().map(|[r, g, b, _]| [r, g, b].map(|c| (c * share) as f32)).collect();
        let alpha = self.sums.iter().map(|sum| (sum[3] * share) as f32).collect();
        (Image { width, height: projection.height(width), pixels }, alpha)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Projection;
    use super::*;

    /// A radiance that changes smoothly with the direction in the environment.
    fn light(direction: DVec3) -> [f32; 3] {
        [1.0 + direction.x, 2.0 + direction.y * direction.z, 1.5 + direction.z].map(|v| v as f32)
    }

    #[test]
    fn a_map_shows_the_directions_that_the_panorama_saw() {
        let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(1.1);
        for (projection, width) in [(Projection::LatitudeLongitude, 64), (Projection::Cube, 16)] {
            let mut rig = PanoramaRig::new(DVec3::new(1.0, 2.0, 3.0), turn, MapSize { projection, width }, Some(40.0));
            let rows = rig.whole.size_px[1] as usize;
            // In one band, and in many, to the bit.
            let mut maps = Vec::new();
            for rows_of_band in [rows, 7] {
                rig.rows_of_band = rows_of_band;
                let mut map = rig.empty_map();
                for band in 0..rows.div_ceil(rows_of_band) {
                    let (first, end) = PanoramaRig::rows(band, rows_of_band, rows);
                    let mut image = Image::filled(rig.whole.size_px[0] as usize, end - first, [0.0; 3]);
                    for (i, pixel) in image.pixels.iter_mut().enumerate() {
                        let at = glam::DVec2::new((i % image.width) as f64 + 0.5, (i / image.width + first) as f64 + 0.5);
                        let ray = rig.whole.unproject(at).unwrap();
                        let world = rig.whole.camera_from_world.matrix3.transpose() * ray;
                        *pixel = light(turn * world);
                    }
                    map.add_band(&rig, band, &image, None);
                }
                maps.push(map.into_map(&rig));
            }
            assert_eq!(maps[0], maps[1]);
            let (map, alpha) = &maps[0];
            assert!(alpha.iter().all(|a| (a - 1.0).abs() < 1e-6));
            for (i, pixel) in map.pixels.iter().enumerate() {
                let expected = light(projection.direction([(i % width) as f64 + 0.5, (i / width) as f64 + 0.5], width).normalize());
                for c in 0..3 {
                    assert!((pixel[c] - expected[c]).abs() < 0.02, "{projection:?} {i}: {pixel:?} {expected:?}");
                }
            }
        }
    }

    #[test]
    fn bands_are_parts_of_one_panorama() {
        let map = MapSize { projection: Projection::LatitudeLongitude, width: 4096 };
        let rig = PanoramaRig::new(DVec3::ZERO, DMat3::IDENTITY, map, Some(900.0));
        assert!(rig.cameras.len() > 2);
        let direction = DVec3::new(0.3, 0.5, -0.8);
        let at = rig.whole.project(direction).unwrap().0;
        for (band, camera) in rig.cameras.iter().enumerate() {
            assert_eq!(camera.validate(), Ok(()));
            let (first, end) = PanoramaRig::rows(band, rig.rows_of_band, rig.whole.size_px[1] as usize);
            assert_eq!(camera.size_px[1] as usize, end - first);
            let found = camera.project(direction).unwrap().0;
            assert!((found.y + first as f64 - at.y).abs() < 1e-9 && found.x == at.x);
        }
    }
}
