//! The search for windows and lamps, and what is found in the coordinates of the world.
//!
//! In: a scene and renders of its training views. Out: lamps, strongest first, with their splats.
//! Windows are looked for first, so that their brightest splats are no lamps.

use std::f64::consts::PI;

use glam::DVec3;
use luxel_core::{ColorSpace, Conversion, Engine, RenderOptions, Scene, text};
use luxel_io::LightShape;

use super::emitters::{self, Emitter, SeenView};
use super::fit::{self, Distribution, Fit, Sample};
use super::mesh_light::{MeshFit, mesh_fit};
use super::placing::{LEAST_CAMERAS, LEAST_PARALLAX_DEG, place, widest_angle_deg};
use super::windows::{self, Rectangle, Window};
use super::{AreaLight, LightOptions, Portal, measure};
use crate::{FrameProgress, Observer, Result};

/// Relative error of a fit from which on a lamp has no clear shape.
const UNCLEAR: f64 = 0.5;
/// Length over width from which on a flat lamp is a rectangle.
const LEAST_ASPECT: f64 = 1.6;
/// Weaker lamps than this part of the strongest stay in the map.
const LEAST_PART: f64 = 1e-3;

/// The lamps and portals of a scene, in the world.
pub(super) struct Lamps {
    /// Strongest first.
    pub(super) lights: Vec<AreaLight>,
    /// Their splats.
    pub(super) splats: Vec<u32>,
    pub(super) portals: Vec<Portal>,
    /// Bright groups that stay in the map, with the reason.
    pub(super) left_in_map: Vec<String>,
}

/// Finds windows, lamps, and what stays in the map; `engine` holds the scene.
pub(super) fn find(
    scene: &Scene,
    views: &[SeenView],
    options: &LightOptions,
    engine: &mut dyn Engine,
    observer: &dyn Observer,
) -> Result<Lamps> {
    let render = scene.render_options();
    let black = RenderOptions { background: [0.0; 3], ..render };
    let mut shining = emitters::shining(scene, views, emitters::threshold(views, options.medians), &render, engine)?;
    let (mut found, mut left_in_map, mut portals, mut refused) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    if let Some(wanted) = options.windows {
        let bright = emitters::shining(scene, views, emitters::threshold(views, wanted.medians), &render, engine)?;
        let (windows, others) = windows::windows(scene, views, &bright, &black, engine)?;
        refused = others;
        for window in windows {
            shining.splats.retain(|i| window.splats.binary_search(&(*i as u32)).is_err());
            let light = window_in_world(&window, scene, options.color_space);
            if wanted.are_portals {
                portals.push(Portal { middle: light.middle, shape: light.shape });
            } else {
                found.push((light, window.splats));
            }
        }
    }
    let groups = emitters::emitters(scene, views, &shining);
    let mut progress = FrameProgress { observer, done: 0, total: groups.len() as u32 };
    for emitter in groups {
        let samples = measure::samples(scene, &emitter, views, &black, engine)?;
        progress.add(&format!("lamp {}", progress.done + 1), Vec::new());
        match clear(scene, &emitter, &samples) {
            Ok(clear) => {
                let light = in_world(&emitter, &clear, samples.len(), scene, options.color_space);
                found.push((light, emitter.splats));
            }
            Err(why) => {
                left_in_map.push(format!("{} around {}: {why}", text::plural(emitter.splats.len(), "splat"), place(scene, &emitter)));
            }
        }
    }
    let strength = |light: &AreaLight| light.intensity.iter().sum::<f64>();
    found.sort_by(|(a, _), (b, _)| strength(b).total_cmp(&strength(a)));
    let least = LEAST_PART * found.first().map_or(0.0, |(light, _)| strength(light));
    found.retain(|(light, _)| strength(light) >= least);
    found.truncate(options.most);
    let (lights, splats): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    let splats: Vec<u32> = splats.concat();
    // Lamps are no windows, and not in the map.
    refused.retain(|group| !splats.iter().any(|i| group.splats.binary_search(i).is_ok()));
    left_in_map.extend(refused.into_iter().map(|group| group.reason));
    Ok(Lamps { lights, splats, portals, left_in_map })
}

/// A lamp's light and shape.
enum Clear {
    Fitted(Fit),
    Mesh(MeshFit),
}

/// Returns the light of a lamp that can be placed and has a clear shape, or why it has none.
fn clear(scene: &Scene, emitter: &Emitter, samples: &[Sample]) -> std::result::Result<Clear, String> {
    if samples.len() < LEAST_CAMERAS {
        return Err(format!("seen whole by {} of the cameras, expected {LEAST_CAMERAS} or more", samples.len()));
    }
    let angle = widest_angle_deg(&samples.iter().map(|sample| sample.towards).collect::<Vec<_>>());
    if angle < LEAST_PARALLAX_DEG {
        return Err(format!("all cameras see it within {angle:.1} degrees of one direction, too few to place it"));
    }
    let fit = fit::fit(samples).ok_or_else(|| "no light towards any camera".to_owned())?;
    match mesh_fit(scene, emitter, samples, &fit) {
        Some(mesh) if mesh.error <= UNCLEAR => Ok(Clear::Mesh(mesh)),
        _ if fit.error <= UNCLEAR => Ok(Clear::Fitted(fit)),
        _ => Err(format!("its light differs from camera to camera by {:.0} %, as that of reflections does", 100.0 * fit.error)),
    }
}

/// Returns a window as a lamp in the world, in the units of the data set.
fn window_in_world(window: &Window, scene: &Scene, color_space: ColorSpace) -> AreaLight {
    let (frame, Rectangle { middle, normal, along, size }) = (&scene.world_from_local, window.rectangle);
    let turn = frame.rotation();
    let shape = LightShape::Rect { size: size.map(|side| frame.scale() * side), normal: turn * normal, along: turn * along };
    let conversion = Conversion::between(scene.color_space, color_space);
    let radiance = conversion.apply(scene.radiance_scale.restored(window.radiance.map(|l| l as f32))).map(f64::from);
    let intensity = radiance.map(|l| l * shape.area());
    AreaLight {
        middle: frame.point(middle).to_array(),
        shape,
        radiance,
        intensity,
        power: intensity.map(|i| PI * i),
        error: window.error,
        cameras: window.cameras,
        splats: window.splats.len(),
    }
}

/// Returns a lamp in the world, in the units of the data set.
fn in_world(emitter: &Emitter, clear: &Clear, cameras: usize, scene: &Scene, color_space: ColorSpace) -> AreaLight {
    let frame = &scene.world_from_local;
    let (shape, radiance, error) = match clear {
        Clear::Fitted(fit) => {
            let area = fit.area * frame.scale() * frame.scale();
            let shape = match fit.distribution {
                Distribution::Ball => LightShape::Sphere { radius: (area / PI).sqrt() },
                Distribution::Flat(normal) => flat_shape(emitter, scene, normal, area),
            };
            (shape, fit.intensity.map(|i| i / fit.area), fit.error)
        }
        Clear::Mesh(fit) => (LightShape::Mesh(fit.mesh.clone().turned(frame.rotation()).scaled(frame.scale())), fit.radiance, fit.error),
    };
    let conversion = Conversion::between(scene.color_space, color_space);
    let radiance = conversion.apply(scene.radiance_scale.restored(radiance.map(|l| l as f32))).map(f64::from);
    let intensity = radiance.map(|l| l * shape.area());
    let solid_angle = match shape {
        LightShape::Sphere { .. } | LightShape::Mesh(_) => 4.0 * PI,
        LightShape::Disk { .. } | LightShape::Rect { .. } => PI,
    };
    AreaLight {
        middle: frame.point(emitter.middle).to_array(),
        shape,
        radiance,
        intensity,
        power: intensity.map(|i| solid_angle * i),
        error,
        cameras,
        splats: emitter.splats.len(),
    }
}

/// Returns the disc of an area (world), or the rectangle of it along the group's longer axis.
fn flat_shape(emitter: &Emitter, scene: &Scene, normal: DVec3, area: f64) -> LightShape {
    let side = normal.any_orthonormal_vector();
    let other = normal.cross(side);
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for (p, weight) in emitter.placed(scene) {
        let (x, y) = ((p - emitter.middle).dot(side), (p - emitter.middle).dot(other));
        (xx, xy, yy) = (xx + weight * x * x, xy + weight * x * y, yy + weight * y * y);
    }
    let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    let aspect = ((mean + half) / (mean - half).max(1e-6 * mean)).sqrt();
    let turn = scene.world_from_local.rotation();
    let normal = turn * normal;
    if !(LEAST_ASPECT..1e3).contains(&aspect) {
        return LightShape::Disk { radius: (area / PI).sqrt(), normal };
    }
    let (sin, cos) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
    let along = turn * (cos * side + sin * other);
    LightShape::Rect { size: [(area * aspect).sqrt(), (area / aspect).sqrt()], normal, along }
}
