//! The lights of an environment map: the peaks that a renderer should sample as lamps.
//!
//! In: a map. Out: [`Light`]s, brightest irradiance first. A light is a connected region around a
//! peak: pixels above a tenth of the peak, and far above the mean of the map. Degenerate: a map
//! without contrast has none.

use glam::DVec3;

use super::{MapSize, Projection};
use crate::{Image, luminance_sum};

/// A peak must be this many times as bright as the mean over all directions.
const LEAST_PEAK: f64 = 12.0;
/// A pixel of a light must be this many times as bright as the mean.
const LEAST_PIXEL: f64 = 4.0;
/// Share of the peak that a pixel of the light has at least.
const SHARE_OF_PEAK: f64 = 0.1;
/// Most lights that are reported.
const MOST_LIGHTS: usize = 32;

/// A bright region.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Middle of its light, a unit vector in the environment's axes.
    pub direction: [f64; 3],
    /// Solid angle, steradians.
    pub solid_angle: f64,
    /// Mean radiance.
    pub radiance: [f64; 3],
    /// Largest channel of any of its pixels.
    pub peak_radiance: f32,
    /// Irradiance of a surface that faces it: the integral of radiance times cosine over the solid
    /// angle.
    pub irradiance: [f64; 3],
}

/// Finds the lights of a map.
pub fn lights(image: &Image, projection: Projection) -> Vec<Light> {
    let map = MapSize { projection, width: image.width };
    let count = image.pixels.len();
    let brightness: Vec<f64> = image.pixels.iter().map(|pixel| f64::from(luminance_sum(*pixel))).collect();
    let solid_angle = |i: usize| projection.solid_angle([i % image.width, i / image.width], image.width);
    let mean = (0..count).map(|i| brightness[i] * solid_angle(i)).sum::<f64>() / (4.0 * std::f64::consts::PI);
    let mut peaks: Vec<usize> = (0..count).filter(|i| brightness[*i] > LEAST_PEAK * mean).collect();
    peaks.sort_by(|a, b| brightness[*b].total_cmp(&brightness[*a]).then(a.cmp(b)));
    let mut taken = vec![false; count];
    let mut found: Vec<(Light, Vec<usize>)> = Vec::new();
    for peak in peaks {
        if taken[peak] {
            continue;
        }
        let floor = (SHARE_OF_PEAK * brightness[peak]).max(LEAST_PIXEL * mean);
        let mut region = vec![peak];
        taken[peak] = true;
        let mut next = 0;
        while let Some(&i) = region.get(next) {
            next += 1;
            for neighbour in neighbours(i, image, map) {
                if !taken[neighbour] && brightness[neighbour] >= floor {
                    taken[neighbour] = true;
                    region.push(neighbour);
                }
            }
        }
        let light = light(image, projection, &region);
        // The skirt of a brighter light, and parts of one on two faces of a cube.
        let same = found.iter_mut().find(|(other, _)| touch(other, &light, map));
        match same {
            Some((other, pixels)) => {
                pixels.extend(region);
                *other = self::light(image, projection, pixels);
            }
            None => found.push((light, region)),
        }
    }
    let mut lights: Vec<Light> = found.into_iter().map(|(light, _)| light).collect();
    let strength = |light: &Light| light.irradiance.iter().sum::<f64>();
    lights.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    lights.truncate(MOST_LIGHTS);
    lights
}

/// Returns the pixels around a pixel, within a face of a cube and around the horizon of a panorama.
fn neighbours(i: usize, image: &Image, map: MapSize) -> impl Iterator<Item = usize> {
    let (width, rows) = (image.width, if map.is_round() { image.height } else { image.width });
    let (x, y, face) = (i % width, i / width % rows, i / width / rows);
    let columns = move |dx: usize| match map.is_round() {
        true => Some((x + width + dx - 1) % width),
        false => (x + dx).checked_sub(1).filter(|x| *x < width),
    };
    (0..3usize).flat_map(move |dy| {
        let row = (y + dy).checked_sub(1).filter(|row| *row < rows);
        (0..3usize).filter_map(move |dx| Some((face * rows + row?) * width + columns(dx)?))
    })
}

/// Returns whether two regions are so near to each other that they are one light.
fn touch(a: &Light, b: &Light, map: MapSize) -> bool {
    let radius = |light: &Light| (light.solid_angle / std::f64::consts::PI).sqrt();
    let angle = DVec3::from_array(a.direction).dot(DVec3::from_array(b.direction)).clamp(-1.0, 1.0).acos();
    angle <= radius(a) + radius(b) + 2.0 / map.density()
}

fn light(image: &Image, projection: Projection, region: &[usize]) -> Light {
    let width = image.width;
    let direction = |i: usize| projection.direction([(i % width) as f64 + 0.5, (i / width) as f64 + 0.5], width).normalize();
    let solid_angle = |i: usize| projection.solid_angle([i % width, i / width], width);
    let middle: DVec3 = region.iter().map(|i| direction(*i) * f64::from(luminance_sum(image.pixels[*i])) * solid_angle(*i)).sum();
    let middle = middle.normalize_or_zero();
    let (mut whole, mut sum, mut irradiance, mut peak_radiance) = (0.0, [0.0; 3], [0.0; 3], 0f32);
    for i in region {
        let part = solid_angle(*i);
        whole += part;
        let facing = direction(*i).dot(middle).max(0.0);
        for (c, value) in image.pixels[*i].into_iter().enumerate() {
            peak_radiance = peak_radiance.max(value);
            sum[c] += f64::from(value) * part;
            irradiance[c] += f64::from(value) * part * facing;
        }
    }
    Light { direction: middle.to_array(), solid_angle: whole, radiance: sum.map(|c| c / whole), peak_radiance, irradiance }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map of radiance 0.5 with discs of the given directions, radii and radiances.
    fn map(projection: Projection, width: usize, discs: &[(DVec3, f64, f32)]) -> Image {
        let mut image = Image::filled(width, projection.height(width), [0.5; 3]);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let direction = projection.direction([(i % width) as f64 + 0.5, (i / width) as f64 + 0.5], width).normalize();
            for (middle, radius, radiance) in discs {
                if direction.dot(middle.normalize()) > radius.cos() {
                    *pixel = [*radiance, 0.5 * radiance, 0.25 * radiance];
                }
            }
        }
        image
    }

    #[test]
    fn lamps_are_found_with_their_light() {
        // One across the border of the panorama, one over a pole, one at an edge of the cube.
        let discs = [(DVec3::new(0.02, 0.1, -1.0), 0.1, 400.0), (DVec3::Y, 0.12, 150.0), (DVec3::new(1.0, 0.0, 1.0), 0.08, 60.0)];
        for (projection, width) in [(Projection::LatitudeLongitude, 512), (Projection::Cube, 128)] {
            let found = lights(&map(projection, width, &discs), projection);
            assert_eq!(found.len(), 3, "{projection:?} {found:#?}");
            for (light, (middle, radius, radiance)) in found.iter().zip(&discs) {
                let direction = DVec3::from_array(light.direction);
                assert!(direction.dot(middle.normalize()) > 0.9999, "{direction} {middle}");
                let solid_angle = std::f64::consts::TAU * (1.0 - radius.cos());
                assert!((light.solid_angle / solid_angle - 1.0).abs() < 0.05, "{light:?} {solid_angle}");
                let irradiance = f64::from(*radiance) * std::f64::consts::PI * radius.sin().powi(2);
                assert!((light.irradiance[0] / irradiance - 1.0).abs() < 0.05, "{light:?} {irradiance}");
                assert_eq!(light.peak_radiance, *radiance);
            }
        }
    }

    #[test]
    fn a_map_without_contrast_has_no_lights() {
        assert_eq!(lights(&map(Projection::LatitudeLongitude, 32, &[]), Projection::LatitudeLongitude), []);
        assert_eq!(lights(&Image::filled(4, 2, [0.0; 3]), Projection::LatitudeLongitude), []);
    }
}
