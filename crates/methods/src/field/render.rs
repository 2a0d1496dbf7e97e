//! Images of a field.
//!
//! In: a [`Field`], a camera. Out: radiance in normalised units, coverage and depth. Each pixel is
//! one ray through its middle, marched until its transmittance is below [`MIN_TRANSMITTANCE`], with
//! [longer intervals](Spacing) as long as the field is fog.

use fearless_simd::Simd;
use glam::DVec2;
use luxel_core::{Camera, Image, Layers};
use luxel_lanes::Level;
use rayon::prelude::*;

use crate::field::lift::Lifts;
use crate::field::march::{March, Spacing};
use crate::field::networks::{Room, Samples, from_blocks};
use crate::field::radiance_field::Field;
use crate::field::sampling::MIN_TRANSMITTANCE;

/// Pixels that a thread renders at a time.
const CHUNK: usize = 256;
/// Samples of a ray that are evaluated at a time.
const ROUND: usize = 8;

/// A pixel in the making.
#[derive(Clone, Copy, Default)]
struct Pixel {
    color: [f32; 3],
    /// Sum of weight times distance.
    moment: f32,
    transmittance: f32,
}

/// Pixels of an image, one after another.
struct Part<'a> {
    /// Number of the first.
    first: usize,
    pixels: &'a mut [Pixel],
}

impl Field {
    /// Renders what `camera` sees, over a background in normalised units, with `samples` rays along
    /// each side of a pixel. The camera is in the data set's local coordinates.
    pub fn render(&self, camera: &Camera, background: [f32; 3], samples: u8) -> Layers {
        let factor = u32::from(samples.max(1));
        let fine = camera.upscaled(factor);
        let layers = self.render_once(&fine, background);
        if factor == 1 {
            return layers;
        }
        let size = fine.size_px.map(|side| side as usize);
        let mean = |plane: &[f32]| {
            let pixels = plane.iter().map(|value| [*value; 3]).collect();
            let plane = Image::from_pixels(size[0], size[1], pixels).unwrap_or_default();
            plane.block_means(factor as usize).pixels.into_iter().map(|pixel| pixel[0]).collect::<Vec<f32>>()
        };
        // Depth is the mean over what is covered.
        let covered: Vec<f32> =
            layers.alpha.iter().zip(&layers.depth).map(|(alpha, z)| if *alpha > 0.0 { alpha * z } else { 0.0 }).collect();
        let (alpha, moment) = (mean(&layers.alpha), mean(&covered));
        let depth = alpha.iter().zip(moment).map(|(alpha, moment)| if *alpha > 0.0 { moment / alpha } else { f32::INFINITY }).collect();
        Layers { image: layers.image.block_means(factor as usize), alpha, depth }
    }

    fn render_once(&self, camera: &Camera, background: [f32; 3]) -> Layers {
        let [width, height] = camera.size_px.map(|side| side as usize);
        let (level, lifts) = (Level::best(), self.networks.head.lifts(self.networks.of_head(&self.weights)));
        let mut pixels = vec![Pixel::default(); width * height];
        pixels.par_chunks_mut(CHUNK).enumerate().for_each_init(
            || (Samples::default(), Room::default()),
            |(samples, room), (chunk, pixels)| {
                luxel_lanes::dispatch!(level, simd => self.render_pixels(simd, camera, lifts.as_ref(), Part { first: chunk * CHUNK, pixels }, samples, room));
            },
        );
        let mut layers = Layers { image: Image::filled(width, height, [0.0; 3]), alpha: Vec::new(), depth: Vec::new() };
        for (index, (pixel, out)) in pixels.iter().zip(&mut layers.image.pixels).enumerate() {
            for c in 0..3 {
                out[c] = pixel.color[c] + pixel.transmittance * background[c];
            }
            let alpha = 1.0 - pixel.transmittance;
            layers.alpha.push(alpha);
            layers.depth.push(if alpha > 0.0 {
                self.depth(camera, [index % width, index / width], pixel.moment / alpha)
            } else {
                f32::INFINITY
            });
        }
        layers
    }

    /// Returns the depth of a point at a distance, sides of the cube, on a pixel's ray: along the
    /// axis for a pinhole, else the distance itself, in local units.
    fn depth(&self, camera: &Camera, [x, y]: [usize; 2], distance: f32) -> f32 {
        let distance = f64::from(distance) * self.shape().space.side;
        let along = match camera.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)) {
            Some(toward) if camera.projection.is_pinhole() => toward.normalize().z,
            _ => 1.0,
        };
        (distance * along) as f32
    }

    #[inline(always)]
    fn render_pixels<S: Simd>(
        &self,
        simd: S,
        camera: &Camera,
        lifts: Option<&Lifts>,
        part: Part<'_>,
        samples: &mut Samples,
        room: &mut Room,
    ) {
        let Part { first, pixels } = part;
        let (space, width) = (self.shape().space, camera.size_px[0] as usize);
        let mut active: Vec<(usize, March, [f32; 3])> = Vec::with_capacity(pixels.len());
        for (i, pixel) in pixels.iter_mut().enumerate() {
            *pixel = Pixel { transmittance: 1.0, ..Pixel::default() };
            let at = DVec2::new(((first + i) % width) as f64 + 0.5, ((first + i) / width) as f64 + 0.5);
            if let Some(ray) = space.ray(camera, at) {
                active.push((i, March::new(ray, space.near, 0.5), ray.direction));
            }
        }
        let (mut densities, mut raw, mut pieces, mut colors) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let head = &self.networks.head;
        let channels = head.kind.channels();
        while !active.is_empty() {
            samples.clear();
            for (_, march, direction) in &mut active {
                samples.begin(*direction);
                for _ in 0..ROUND {
                    let Some(interval) = march.next(&self.occupancy, Spacing::ByDensity) else { break };
                    samples.push(interval.position, interval.middle, interval.length);
                }
            }
            samples.end();
            self.networks.densities(simd, &self.grid, self.parameters(), &samples.positions, room, &mut densities);
            from_blocks(self.networks.colors(simd, self.parameters(), samples, room), samples.len(), &mut raw);
            head.forward(lifts, &raw, &mut pieces, &mut colors);
            let mut ray = 0;
            active.retain(|(i, ..)| {
                let (of_ray, pixel) = (samples.of_ray(ray), &mut pixels[*i]);
                ray += 1;
                let has_more = of_ray.len() == ROUND;
                for sample in of_ray {
                    let alpha = -(-densities[sample] * samples.lengths[sample]).exp_m1();
                    let weight = pixel.transmittance * alpha;
                    pixel.transmittance *= 1.0 - alpha;
                    pixel.moment += weight * samples.middles[sample];
                    for c in 0..3 {
                        pixel.color[c] += weight * colors[channels * sample + c];
                    }
                }
                has_more && pixel.transmittance > MIN_TRANSMITTANCE
            });
        }
    }
}
