//! How much light each camera gets from a lamp.
//!
//! In: a group of splats. Out: its radiant intensity and projected area towards every camera that
//! sees it whole. The scene is rendered with the light of all other splats at 0: they hide, and do
//! not shine, so that pixels hold the lamp's light alone, at its edges, too. A camera that
//! something farther away hides the lamp from is left out: the same render without what is far
//! from the lamp tells. What is near (a shade) is part of the lamp.

use glam::{DVec2, DVec3};
use luxel_core::{Camera, Engine, Image, RenderOptions, Scene, Splats};

use super::emitters::{Emitter, SeenView};
use super::fit::Sample;
use crate::Result;
use crate::error::Context;

/// Part of a lamp's light that must be within the image.
const LEAST_INSIDE: f64 = 0.95;
/// Part of a lamp's light that far things must let pass.
const LEAST_UNHIDDEN: f64 = 0.8;
/// Size of what belongs to a lamp, in root mean square distances of its splats.
const NEAR_SPREADS: f64 = 4.0;

/// Returns what the cameras see of a lamp, in normalised units of radiance and local lengths.
pub(super) fn samples(
    scene: &Scene,
    emitter: &Emitter,
    views: &[SeenView],
    options: &RenderOptions,
    engine: &mut dyn Engine,
) -> Result<Vec<Sample>> {
    let seeing: Vec<&Camera> =
        views.iter().map(|view| &view.camera).filter(|camera| inside(scene, emitter, camera) >= LEAST_INSIDE).collect();
    let dark = alone(&scene.splats, &emitter.splats);
    let reach = NEAR_SPREADS * emitter.spread(scene) + emitter.link;
    let is_near = |i: &u32| DVec3::from_array(dark.position[*i as usize].map(f64::from)).distance(emitter.middle) <= reach;
    let near = dark.select((0..dark.len() as u32).filter(is_near));
    let mut measure = |splats: &Splats| -> Result<Vec<Sample>> {
        engine.load(splats, None).context("cannot load the lamp")?;
        let mut image = Image::default();
        let sample = |camera: &&Camera| {
            engine.render_into(camera, options, &mut image).context("cannot render the lamp")?;
            Ok(sample(camera, &image, emitter))
        };
        seeing.iter().map(sample).collect()
    };
    let (whole, unhidden) = (measure(&dark)?, measure(&near)?);
    let sum = |sample: &Sample| sample.intensity.iter().sum::<f64>();
    let kept = whole.into_iter().zip(unhidden).filter(|(whole, free)| sum(whole) >= LEAST_UNHIDDEN * sum(free));
    Ok(kept.map(|(whole, _)| whole).collect())
}

/// Returns the splats with the light of all but some at 0.
pub(super) fn alone(splats: &Splats, shining: &[u32]) -> Splats {
    let mut gain = vec![0.0; splats.len()];
    shining.iter().for_each(|i| gain[*i as usize] = splats.gain_of(*i as usize));
    Splats { gain, ..splats.clone() }
}

/// Returns the part of a lamp's light that is in an image.
fn inside(scene: &Scene, emitter: &Emitter, camera: &Camera) -> f64 {
    let [width, height] = camera.size_px.map(f64::from);
    let is_inside =
        |p: DVec3| camera.project(p).is_some_and(|(pixel, _)| (0.0..=width).contains(&pixel.x) && (0.0..=height).contains(&pixel.y));
    let seen = emitter.placed(scene).filter(|(p, _)| is_inside(*p)).map(|(_, weight)| weight);
    seen.sum::<f64>() / emitter.weight()
}

/// Sums an image of the lamp up.
fn sample(camera: &Camera, image: &Image, emitter: &Emitter) -> Sample {
    let offset = camera.eye() - emitter.middle;
    let (mut intensity, mut sum, mut square) = ([0.0; 3], 0.0, 0.0);
    for (i, pixel) in image.pixels.iter().enumerate().filter(|(_, pixel)| **pixel != [0.0; 3]) {
        let part = solid_angle(camera, [i % image.width, i / image.width]) * offset.length_squared();
        let whole: f64 = pixel.iter().map(|c| f64::from(*c)).sum();
        for (to, from) in intensity.iter_mut().zip(pixel) {
            *to += f64::from(*from) * part;
        }
        sum += whole * part;
        square += whole * whole * part;
    }
    Sample { towards: offset.normalize_or_zero(), intensity, area: if square > 0.0 { sum * sum / square } else { 0.0 } }
}

/// Returns the solid angle of a pixel.
pub(super) fn solid_angle(camera: &Camera, [x, y]: [usize; 2]) -> f64 {
    let at = |dx: f64, dy: f64| camera.unproject(DVec2::new(x as f64 + dx, y as f64 + dy)).map(DVec3::normalize);
    match (at(0.0, 0.5), at(1.0, 0.5), at(0.5, 0.0), at(0.5, 1.0)) {
        (Some(left), Some(right), Some(top), Some(bottom)) => (right - left).cross(bottom - top).length(),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::room_camera;

    #[test]
    fn pixels_fill_the_field_of_view() {
        let camera = room_camera([64, 48]);
        let whole: f64 = (0..64 * 48).map(|i| solid_angle(&camera, [i % 64, i / 64])).sum();
        let [a, b] = [32.0 / camera.focal_px.x, 24.0 / camera.focal_px.y];
        let expected = 4.0 * (a * b / (1.0 + a * a + b * b + a * a * b * b).sqrt()).asin();
        assert!((whole / expected - 1.0).abs() < 1e-3, "{whole} {expected}");
    }
}
