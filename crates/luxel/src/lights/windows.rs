//! Windows: large flat parts of a scene that shine evenly.
//!
//! In: renders of the training views. Out: rectangles with the radiance that the cameras see in
//! them. Their splats are brighter than a number of medians, touch each other, lie in a plane and
//! fill the rectangle. A window is not measured as a lamp is, which cameras must see whole: each
//! camera that sees a part of the rectangle gives the mean radiance of that part. Bars before it
//! lower that mean, as they lower the window's light.
//!
//! Degenerate: parts that are small, bent, uneven, or so far that all cameras see them from one
//! direction are no windows; their light stays where it is. A patch of sun on a floor is an even
//! flat light as well, and lights like one.

use glam::{DMat3, DVec2, DVec3};
use luxel_core::{Camera, Engine, Image, RenderOptions, Scene, text};

use super::emitters::{Emitter, SeenView, Shining, pixel_size};
use super::measure::{alone, solid_angle};
use super::placing::{LEAST_CAMERAS, LEAST_PARALLAX_DEG, place, widest_angle_deg};
use crate::Result;
use crate::error::Context;

/// Most shining splats that are looked at, the brightest ones.
const MOST_SPLATS: usize = 20_000;
/// Most candidates that are measured.
const MOST_CANDIDATES: usize = 16;
/// Candidates with less than this part of the strongest one's light are none.
const LEAST_PART: f64 = 1e-2;
/// Splats touch within this many standard deviations, and pixels beyond these.
const REACH_SIGMAS: f64 = 2.0;
const LINK_PX: f64 = 4.0;
/// Largest reach of a splat, pixels: huge ones would join everything.
const MOST_REACH_PX: f64 = 32.0;
/// Length of the shorter side over the distance of the nearest camera that looks at it, from which
/// on the place of a window counts.
const LEAST_SIDE: f64 = 0.1;
/// Largest thickness over the shorter side.
const MOST_THICKNESS: f64 = 0.15;
/// Part of its light that must be within the rectangle.
const LEAST_WITHIN: f64 = 0.7;
/// Part of the rectangle that shines: bars before a window leave the most of it free.
const LEAST_FILL: f64 = 0.5;
/// Largest relative error of the radiance among cameras.
const MOST_ERROR: f64 = 0.35;
/// Largest median of what is around a rectangle over its own radiance: lit parts of a surface fade,
/// windows end.
const MOST_AROUND: f64 = 0.25;
/// The ring around a rectangle, between these multiples of its sides.
const AROUND: [f64; 2] = [1.2, 1.6];
/// Part of the image's solid angle from which on a camera counts.
const LEAST_SEEN: f64 = 1e-3;
/// Standard deviations of an even distribution over its width: the square root of 12.
const WIDTH_SIGMAS: f64 = 3.464_101_615_137_754_4;
/// Directions in the plane that are tried, within a quarter turn.
const TURNS: u32 = 45;

/// A rectangle that shines, local coordinates of the scene and normalised radiance.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// Its splats, ascending.
    pub(super) splats: Vec<u32>,
    pub(super) rectangle: Rectangle,
    /// Mean radiance.
    pub(super) radiance: [f64; 3],
    /// Root mean square error of the cameras' radiance over its mean.
    pub(super) error: f64,
    /// Cameras that see a part of it.
    pub(super) cameras: usize,
}

/// A rectangle in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    pub(super) middle: DVec3,
    /// Unit normal, towards the cameras.
    pub(super) normal: DVec3,
    /// Unit vector along the first side.
    pub(super) along: DVec3,
    pub(super) size: [f64; 2],
}

/// A large group of splats that is no window.
pub(super) struct NoWindow {
    /// The splats, ascending.
    pub(super) splats: Vec<u32>,
    /// Its place, and the reason why it is none.
    pub(super) reason: String,
}

/// Finds windows among shining splats, strongest first, and large groups that are none; `engine`
/// holds any scene afterwards.
pub(super) fn windows(
    scene: &Scene,
    views: &[SeenView],
    shining: &Shining,
    options: &RenderOptions,
    engine: &mut dyn Engine,
) -> Result<(Vec<Window>, Vec<NoWindow>)> {
    let pixel = pixel_size(scene, views, &shining.splats);
    let (mut found, mut refused) = (Vec::new(), Vec::new());
    for emitter in touching(scene, shining, pixel) {
        let Some(mut rectangle) = rectangle(scene, &emitter).filter(|rectangle| is_large(rectangle, views)) else { continue };
        let outcome = match shape_fault(scene, &emitter, &rectangle, views) {
            Some(fault) => Err(fault),
            None => {
                face_cameras(&mut rectangle, views);
                measured(scene, &emitter, rectangle, views, options, engine)?
            }
        };
        match outcome {
            Ok(window) => found.push(window),
            Err(why) => {
                let splats = text::plural(emitter.splats.len(), "splat");
                let reason = format!("{splats} around {}: no window: {why}", place(scene, &emitter));
                refused.push(NoWindow { splats: emitter.splats, reason });
            }
        }
    }
    Ok((found, refused))
}

/// Divides shining splats into groups that touch, strongest first.
fn touching(scene: &Scene, shining: &Shining, pixel: f64) -> Vec<Emitter> {
    let mut splats = shining.splats.clone();
    splats.sort_by(|a, b| shining.light[*b].total_cmp(&shining.light[*a]));
    splats.truncate(MOST_SPLATS);
    let position = |i: usize| DVec3::from_array(scene.splats.position[i].map(f64::from));
    splats.sort_by(|a, b| scene.splats.position[*a][0].total_cmp(&scene.splats.position[*b][0]));
    let reach: Vec<f64> = splats.iter().map(|i| (REACH_SIGMAS * middle_sigma(scene, *i)).min(MOST_REACH_PX * pixel)).collect();
    let most = reach.iter().copied().fold(0.0, f64::max) + LINK_PX * pixel;
    let mut parent: Vec<usize> = (0..splats.len()).collect();
    for a in 0..splats.len() {
        let at = position(splats[a]);
        for b in a + 1..splats.len() {
            let offset = position(splats[b]) - at;
            if offset.x > reach[a] + most {
                break;
            }
            if offset.length() <= reach[a] + reach[b] + LINK_PX * pixel {
                let (a, b) = (root(&mut parent, a), root(&mut parent, b));
                parent[a.max(b)] = a.min(b);
            }
        }
    }
    let mut groups: Vec<Vec<u32>> = vec![Vec::new(); splats.len()];
    for (i, splat) in splats.iter().enumerate() {
        groups[root(&mut parent, i)].push(*splat as u32);
    }
    let emitters = groups.into_iter().filter(|group| !group.is_empty()).map(|group| Emitter::new(scene, group, &shining.light, pixel));
    let mut emitters: Vec<Emitter> = emitters.collect();
    emitters.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
    let least = LEAST_PART * emitters.first().map_or(0.0, Emitter::weight);
    emitters.retain(|emitter| emitter.weight() >= least);
    emitters.truncate(MOST_CANDIDATES);
    emitters
}

/// Returns the first of a group, and shortens the way to it.
fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

/// Returns the second of a splat's three standard deviations.
fn middle_sigma(scene: &Scene, i: usize) -> f64 {
    let mut scale = scene.splats.log_scale[i];
    scale.sort_by(f32::total_cmp);
    f64::from(scale[1]).exp()
}

/// Returns the rectangle of even light with the place and extent of a group's light.
fn rectangle(scene: &Scene, emitter: &Emitter) -> Option<Rectangle> {
    let (middle, spread) = (emitter.middle, emitter.covariance(scene));
    let normal = least_axis(&spread)?;
    let (side, other) = normal.any_orthonormal_pair();
    // The direction in which the light is within the smallest rectangle.
    let points: Vec<(DVec2, f64)> =
        emitter.placed(scene).map(|(p, weight)| (DVec2::new((p - middle).dot(side), (p - middle).dot(other)), weight)).collect();
    let turned = |i: u32| DVec2::from_angle(std::f64::consts::FRAC_PI_2 * f64::from(i) / f64::from(TURNS));
    let area = |axis: DVec2| extent(&points, axis) * extent(&points, axis.perp());
    let axis = (0..TURNS).map(turned).min_by(|a, b| area(*a).total_cmp(&area(*b)))?;
    let along = side * axis.x + other * axis.y;
    let across = normal.cross(along);
    let width = |axis: DVec3| WIDTH_SIGMAS * axis.dot(spread * axis).max(0.0).sqrt();
    Some(Rectangle { middle, normal, along, size: [width(along), width(across)] })
}

/// Returns the direction of least spread.
pub(super) fn least_axis(spread: &DMat3) -> Option<DVec3> {
    let trace = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
    if !(trace.is_finite() && trace > 0.0) {
        return None;
    }
    // Inverse iteration; the start is along no axis.
    let inverse = (*spread + DMat3::from_diagonal(DVec3::splat(1e-9 * trace))).inverse();
    let start = DVec3::new(0.61, 0.53, 0.59).normalize();
    (0..64).try_fold(start, |v, _| (inverse * v).try_normalize())
}

/// Returns the length along an axis that holds all but a twentieth of the light at each end.
fn extent(points: &[(DVec2, f64)], axis: DVec2) -> f64 {
    let mut along: Vec<(f64, f64)> = points.iter().map(|(p, weight)| (p.dot(axis), *weight)).collect();
    along.sort_by(|a, b| a.0.total_cmp(&b.0));
    let whole: f64 = along.iter().map(|(_, weight)| weight).sum();
    let quantile = |share: f64| {
        let mut sum = 0.0;
        let past = |(_, weight): &&(f64, f64)| {
            sum += weight;
            sum >= share * whole
        };
        along.iter().find(past).map_or(0.0, |(at, _)| *at)
    };
    quantile(0.95) - quantile(0.05)
}

/// Returns whether a rectangle is so large to the nearest camera that its place counts.
fn is_large(rectangle: &Rectangle, views: &[SeenView]) -> bool {
    let looking = views.iter().filter(|view| view.camera.project(rectangle.middle).is_some());
    let nearest = looking.map(|view| view.camera.eye().distance(rectangle.middle)).fold(f64::INFINITY, f64::min);
    rectangle.size[0].min(rectangle.size[1]) >= LEAST_SIDE * nearest
}

/// Returns why a group's shape or place is not that of a window near the cameras.
fn shape_fault(scene: &Scene, emitter: &Emitter, rectangle: &Rectangle, views: &[SeenView]) -> Option<String> {
    let short = rectangle.size[0].min(rectangle.size[1]);
    let squares = emitter.placed(scene).map(|(p, weight)| weight * (p - rectangle.middle).dot(rectangle.normal).powi(2));
    let thickness = (squares.sum::<f64>() / emitter.weight()).sqrt();
    if thickness > MOST_THICKNESS * short {
        return Some("it is not flat".to_owned());
    }
    let towards: Vec<DVec3> = views.iter().map(|view| (view.camera.eye() - rectangle.middle).normalize_or_zero()).collect();
    let angle = widest_angle_deg(&towards);
    (angle < LEAST_PARALLAX_DEG).then(|| format!("all cameras are within {angle:.1} degrees of one direction"))
}

/// Turns the normal to the side of most cameras.
fn face_cameras(rectangle: &mut Rectangle, views: &[SeenView]) {
    let behind = views.iter().filter(|view| (view.camera.eye() - rectangle.middle).dot(rectangle.normal) < 0.0).count();
    if 2 * behind > views.len() {
        rectangle.normal = -rectangle.normal;
    }
}

/// The light that a camera sees of a window.
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    /// Solid angle of the rectangle in the image.
    seen: f64,
    /// Radiance times solid angle of the splats within it, and of all of them.
    within: [f64; 3],
    all: [f64; 3],
    /// Square of the radiance times solid angle of the splats within it.
    squares: f64,
}

/// Measures a rectangle's radiance in all cameras before it, or says why it is no window.
fn measured(
    scene: &Scene,
    emitter: &Emitter,
    rectangle: Rectangle,
    views: &[SeenView],
    options: &RenderOptions,
    engine: &mut dyn Engine,
) -> Result<std::result::Result<Window, String>> {
    engine.load(&alone(&scene.splats, &emitter.splats), None).context("cannot load the window")?;
    let (mut parts, mut around, mut light) = (Vec::new(), Vec::new(), Image::default());
    for SeenView { camera, image } in views {
        engine.render_into(camera, options, &mut light).context("cannot render the window")?;
        parts.push(part(camera, [&light, image], &rectangle, &mut around));
    }
    let sum = |pick: &dyn Fn(&Part) -> [f64; 3]| [0, 1, 2].map(|c| parts.iter().map(|part| pick(part)[c]).sum::<f64>());
    let (within, all) = (sum(&|part| part.within), sum(&|part| part.all));
    let total = |rgb: [f64; 3]| rgb.iter().sum::<f64>();
    if total(within) < LEAST_WITHIN * total(all) {
        return Ok(Err(format!("{:.0} % of its light are within a rectangle", 100.0 * total(within) / total(all).max(f64::MIN_POSITIVE))));
    }
    parts.retain(|part| part.seen > 0.0);
    // Of even light in a part of the rectangle, the part.
    let fills: f64 = parts.iter().map(|part| total(part.within).powi(2) / part.squares.max(f64::MIN_POSITIVE)).sum();
    if parts.len() < LEAST_CAMERAS {
        return Ok(Err(format!("seen by {} of the cameras, expected {LEAST_CAMERAS} or more", parts.len())));
    }
    let seen: f64 = parts.iter().map(|part| part.seen).sum();
    if fills < LEAST_FILL * seen {
        return Ok(Err(format!("its light fills {:.0} % of a rectangle", 100.0 * fills / seen)));
    }
    let radiance = [0, 1, 2].map(|c| parts.iter().map(|part| part.all[c]).sum::<f64>() / seen);
    let mean = total(radiance);
    let middle = around.len() / 2;
    let edge = if around.is_empty() { 0.0 } else { f64::from(*around.select_nth_unstable_by(middle, f32::total_cmp).1) };
    if edge > MOST_AROUND * mean {
        return Ok(Err(format!("what is around it is {:.0} % as bright, as on a lit surface", 100.0 * edge / mean)));
    }
    let square = |part: &Part| part.seen * (total(part.all) / part.seen / mean - 1.0).powi(2);
    let error = (parts.iter().map(square).sum::<f64>() / seen).sqrt();
    if error > MOST_ERROR {
        return Ok(Err(format!("its radiance differs from camera to camera by {:.0} %", 100.0 * error)));
    }
    Ok(Ok(Window { splats: emitter.splats.clone(), rectangle, radiance, error, cameras: parts.len() }))
}

/// Sums up what the first image, of the window's light alone, shows of its rectangle, and collects
/// what the second one, of all light, has around it.
fn part(camera: &Camera, [light, all]: [&Image; 2], rectangle: &Rectangle, around: &mut Vec<f32>) -> Part {
    let (world_from_camera, eye) = (camera.camera_from_world.matrix3.transpose(), camera.eye());
    let height = (eye - rectangle.middle).dot(rectangle.normal);
    let (mut found, mut whole) = (Part::default(), 0.0);
    if height <= 0.0 {
        return found;
    }
    let across = rectangle.normal.cross(rectangle.along);
    for (i, pixel) in light.pixels.iter().enumerate() {
        let at = [i % light.width, i / light.width];
        let solid_angle = solid_angle(camera, at);
        whole += solid_angle;
        let Some(ray) = camera.unproject(DVec2::new(at[0] as f64 + 0.5, at[1] as f64 + 0.5)) else { continue };
        let ray = world_from_camera * ray;
        let towards = -ray.dot(rectangle.normal);
        let hit = eye + ray * (height / towards) - rectangle.middle;
        // 1 at the edge.
        let reach = (2.0 * hit.dot(rectangle.along).abs() / rectangle.size[0]).max(2.0 * hit.dot(across).abs() / rectangle.size[1]);
        let is_within = towards > 0.0 && reach <= 1.0;
        if towards > 0.0 && (AROUND[0]..=AROUND[1]).contains(&reach) {
            around.push(all.pixels[i].iter().sum());
        }
        for ((within, sum), value) in found.within.iter_mut().zip(&mut found.all).zip(pixel) {
            let light = f64::from(*value) * solid_angle;
            *sum += light;
            *within += if is_within { light } else { 0.0 };
        }
        if is_within {
            found.seen += solid_angle;
            found.squares += f64::from(pixel.iter().sum::<f32>()).powi(2) * solid_angle;
        }
    }
    found.seen = if found.seen >= LEAST_SEEN * whole { found.seen } else { 0.0 };
    found
}
