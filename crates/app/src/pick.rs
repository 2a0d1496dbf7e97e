//! The content of a pixel of a view.
//!
//! In: a scene, a view of a data set, a pixel. Out: [`Pick`]: the radiance that the scene has
//! there, the point in the world, and the splats that contribute most. A splat's weight is its
//! alpha times the transmittance in front of it: weights add up to the coverage. Degenerate: where
//! nothing covers the pixel there is no point and no depth.

use glam::{DVec2, DVec3};
use luxel_core::tone::rec709_of;
use luxel_core::{Camera, ColorSpace, Engine, PixelValues, RenderOptions, Scene, View, luminance_rec709, luminance_sum, sigmoid};
use serde::Serialize;

use luxel::Result;
use luxel::error::{Context, bail};

/// Coverage below which a pixel shows nothing.
const LEAST_COVERAGE: f32 = 1e-3;

/// A picked pixel. Radiance is in the units of the data set, in the scene's colour space; points
/// and lengths are in its world.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pick {
    /// Name of the view.
    pub view: String,
    /// Column and row, counted from 0 at the top left.
    pub pixel: [u32; 2],
    /// Colour space of the radiance.
    pub color_space: ColorSpace,
    /// Rendered radiance.
    pub radiance: [f32; 3],
    /// Luminance Y of it.
    pub luminance: f32,
    /// R + G + B of it, the L of selections.
    pub luminance_sum: f32,
    /// Radiance of the view's image; `None` for captured values and masked pixels.
    pub ground_truth: Option<[f32; 3]>,
    /// Part of the pixel that splats cover, 0 to 1.
    pub coverage: f32,
    /// Mean distance of the splats along the viewing axis, by weight.
    pub depth: Option<f64>,
    /// Distance along the viewing axis at which half of the weight lies in front: that of a
    /// surface.
    pub depth_of_point: Option<f64>,
    /// The point at that distance.
    pub point: Option<[f64; 3]>,
    /// Number of splats that contribute.
    pub contributing: usize,
    /// Splats that contribute most, greatest weight first.
    pub splats: Vec<PickedSplat>,
}

/// A splat of a picked pixel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PickedSplat {
    /// Index in the scene, counted from 0 in the order of its file.
    pub index: usize,
    /// Weight in the pixel, 0 to 1.
    pub weight: f32,
    /// Centre, world.
    pub position: [f64; 3],
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Standard deviations, largest first.
    pub scale: [f32; 3],
    /// Distance of the centre along the viewing axis.
    pub depth: f64,
    /// Radiance towards the camera.
    pub radiance: [f32; 3],
    /// R + G + B at degree 0, by which selections test the splat.
    pub luminance_sum: f32,
}

/// Returns what a pixel of a view is made of, with at most `count` splats.
///
/// # Errors
/// A pixel outside of the view's image; a device that gave up.
pub fn pick(scene: &Scene, view: &View, pixel: [u32; 2], background: [f32; 3], count: usize, engine: &mut dyn Engine) -> Result<Pick> {
    let camera = &view.camera;
    let ([x, y], [width, height]) = (pixel, camera.size_px);
    if x >= width || y >= height {
        bail!("pixel {x},{y} is outside of view {}, which has {width} x {height} pixels, counted from 0", view.name);
    }
    let at = y as usize * width as usize + x as usize;
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = RenderOptions { background, ..scene.render_options() };
    let image = engine.render(camera, &options).context("cannot render the view")?;
    let radiance = scene.radiance_scale.restored(image.pixels[at]);
    let mut found = hits(scene, camera, at, &options, engine)?;
    let unit = scene.world_from_local.scale();
    let coverage: f32 = found.iter().map(|hit| hit.weight).sum();
    let is_covered = coverage >= LEAST_COVERAGE;
    let depth = is_covered.then(|| found.iter().map(|hit| f64::from(hit.weight) * hit.depth).sum::<f64>() / f64::from(coverage));
    let depth_of_point = is_covered.then(|| median(&found, coverage)).flatten();
    let contributing = found.len();
    // Stable: of equal weights the nearer comes first.
    found.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let is_known = view.values == PixelValues::Radiance && view.is_valid(at);
    Ok(Pick {
        view: view.name.clone(),
        pixel,
        color_space: scene.color_space,
        radiance,
        luminance: luminance_rec709(rec709_of(scene.color_space, radiance)),
        luminance_sum: luminance_sum(radiance),
        ground_truth: is_known.then(|| view.image.pixels[at]),
        coverage,
        depth,
        depth_of_point,
        point: depth_of_point.map(|depth| scene.world_from_local.point(point_at(view, pixel, depth / unit)).to_array()),
        contributing,
        splats: found.iter().take(count).map(|hit| picked(scene, view, hit)).collect(),
    })
}

/// Returns the distance along the viewing axis, world, at which half of the weight of a pixel lies
/// in front; `None` where nothing covers it. The engine has the scene.
///
/// # Errors
/// A pixel outside of the camera's image; a device that gave up, or that cannot tell.
pub fn surface_distance(
    scene: &Scene,
    camera: &Camera,
    [x, y]: [u32; 2],
    options: &RenderOptions,
    engine: &mut dyn Engine,
) -> Result<Option<f64>> {
    let [width, height] = camera.size_px;
    if x >= width || y >= height {
        bail!("pixel {x},{y} is outside of the image, which has {width} x {height} pixels, counted from 0");
    }
    let found = hits(scene, camera, y as usize * width as usize + x as usize, options, engine)?;
    let coverage: f32 = found.iter().map(|hit| hit.weight).sum();
    Ok((coverage >= LEAST_COVERAGE).then(|| median(&found, coverage)).flatten())
}

/// Returns the splats of a pixel, nearest first.
fn hits(scene: &Scene, camera: &Camera, at: usize, options: &RenderOptions, engine: &mut dyn Engine) -> Result<Vec<Hit>> {
    let pixels = camera.size_px.map(|side| side as usize).iter().product();
    let mut mask = vec![0.0; pixels];
    mask[at] = 1.0;
    let weights = engine.contributions(camera, options, &mask).context("cannot measure the splats' contributions")?.masked;
    let unit = scene.world_from_local.scale();
    let depth_of = |i: usize| unit * camera.camera_from_world.transform_point3(DVec3::from(scene.splats.position[i].map(f64::from))).z;
    let found = weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0);
    let mut found: Vec<Hit> = found.map(|(index, weight)| Hit { index, weight: *weight, depth: depth_of(index) }).collect();
    found.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    Ok(found)
}

/// A splat in the pixel.
#[derive(Clone, Copy, Debug)]
struct Hit {
    index: usize,
    weight: f32,
    depth: f64,
}

/// Returns the depth at which half of the weight lies in front; splats are sorted by depth.
fn median(found: &[Hit], coverage: f32) -> Option<f64> {
    let mut sum = 0.0;
    let is_beyond = |hit: &&Hit| {
        sum += hit.weight;
        sum >= 0.5 * coverage
    };
    found.iter().find(is_beyond).or(found.last()).map(|hit| hit.depth)
}

/// Returns the point that is seen in the middle of a pixel at a depth, in the view's coordinates.
fn point_at(view: &View, [x, y]: [u32; 2], depth: f64) -> DVec3 {
    let camera = &view.camera;
    let at_depth_1 = camera.unproject(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).unwrap_or_default();
    camera.camera_from_world.inverse().transform_point3(at_depth_1 * depth)
}

fn picked(scene: &Scene, view: &View, hit: &Hit) -> PickedSplat {
    let Hit { index, weight, depth } = *hit;
    let splats = &scene.splats;
    let position = splats.position[index];
    let direction = (DVec3::from(position.map(f64::from)) - view.camera.eye()).try_normalize().unwrap_or(DVec3::Z);
    let unit = scene.world_from_local.scale() as f32;
    let mut scale = splats.log_scale[index].map(|s| unit * s.exp());
    scale.sort_by(|a, b| b.total_cmp(a));
    PickedSplat {
        index,
        weight,
        position: world_position(scene, index),
        opacity: sigmoid(splats.opacity_logit[index]),
        scale,
        depth,
        radiance: scene.radiance_scale.restored(splats.radiance(index, direction.as_vec3().to_array())),
        luminance_sum: scene.luminance(index),
    }
}

/// Returns the centre of a splat in the world, with the digits that it has there.
fn world_position(scene: &Scene, index: usize) -> [f64; 3] {
    let position = scene.world_position(index).to_array();
    let shortest = |v: f64| (v as f32).to_string().parse().unwrap_or(v);
    if scene.world_from_local.translation() == DVec3::ZERO { position.map(shortest) } else { position }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_weight_lies_before_the_point() {
        let found = [(0.2, 1.0), (0.5, 2.0), (0.2, 9.0)].map(|(weight, depth)| Hit { index: 0, weight, depth });
        assert_eq!(median(&found, 0.9), Some(2.0));
        assert_eq!(median(&found[..1], 0.2), Some(1.0));
        assert_eq!(median(&[], 0.0), None);
    }
}
