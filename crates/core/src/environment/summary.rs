//! The light of an environment map, summed up.

use super::{FACES, Projection};
use crate::Image;

/// A summary of the light of an environment.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Mean radiance over all directions.
    pub mean_radiance: [f64; 3],
    /// Largest channel of any pixel.
    pub peak_radiance: f32,
    /// Direction of that pixel, a unit vector in the environment's axes.
    pub peak_direction: [f64; 3],
    /// Irradiance of surfaces that face +x, -x, +y, -y, +z, -z: the integral of radiance times
    /// cosine over solid angle.
    pub irradiance: [[f64; 3]; 6],
}

impl Summary {
    /// Returns the summary of a map in `projection`.
    pub fn new(image: &Image, projection: Projection) -> Self {
        let width = image.width;
        let mut sum = [0f64; 3];
        let mut irradiance = [[0f64; 3]; 6];
        let (mut peak_radiance, mut peak_direction) = (f32::NEG_INFINITY, [0.0; 3]);
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = (i % width, i / width);
            let direction = projection.direction([x as f64 + 0.5, y as f64 + 0.5], width).normalize();
            let solid_angle = projection.solid_angle([x, y], width);
            let light = pixel.map(|c| f64::from(c) * solid_angle);
            sum.iter_mut().zip(light).for_each(|(sum, c)| *sum += c);
            for (irradiance, [normal, ..]) in irradiance.iter_mut().zip(FACES) {
                let cosine = direction.dot(normal).max(0.0);
                irradiance.iter_mut().zip(light).for_each(|(sum, c)| *sum += c * cosine);
            }
            let brightest = pixel.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            if brightest > peak_radiance {
                (peak_radiance, peak_direction) = (brightest, direction.to_array());
            }
        }
        let all = 4.0 * std::f64::consts::PI;
        Self { mean_radiance: sum.map(|c| c / all), peak_radiance, peak_direction, irradiance }
    }
}
