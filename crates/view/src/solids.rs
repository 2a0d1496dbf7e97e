//! Splats as solid bodies: each an opaque ellipsoid, or a dot at its centre, to see what a scene is
//! made of.
//!
//! In: a scene, a camera in its local coordinates, the shape. Out: radiance in the units of the
//! data set, coverage (0 or 1) and depth (world units). The nearest body wins; nothing is blended,
//! and a body has the radiance of its splat towards the camera, without shading. An ellipsoid is
//! the surface at a number of standard deviations; rays are intersected with it exactly.
//! Degenerate: bodies that reach behind the camera are left out; flat splats get a small thickness.

use glam::{DMat3, DQuat, DVec2, DVec3};
use luxel_core::{Camera, Image, Layers, sigmoid};
use rayon::prelude::*;

use luxel::error::ensure;
use luxel::{RadianceLayers, Result, Scene, memory};

/// Rows of an image that are drawn together.
const BAND_ROWS: usize = 16;
/// Least standard deviation along an axis, as a part of the longest one.
const LEAST_THICKNESS: f64 = 1e-4;

/// The shape that splats are drawn in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Ellipsoids whose surface is at this number of standard deviations.
    Ellipsoids {
        /// Standard deviations from the centre, above 0.
        deviations: f64,
    },
    /// Dots at the centres.
    Centres {
        /// Radius in pixels, above 0.
        radius_px: f64,
    },
}

/// Options of drawing splats as bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidOptions {
    /// The shape.
    pub shape: Shape,
    /// Opacity below which a splat is left out, 0 to 1.
    pub least_opacity: f32,
}

/// A body in camera axes (z ahead), and the pixels that it may touch.
struct Body {
    center: DVec3,
    /// Maps an ellipsoid to the unit sphere; `None` for a dot.
    sphere_from_camera: Option<DMat3>,
    /// Place of a dot, and its squared radius; pixels.
    dot_px: DVec2,
    radius_squared: f64,
    radiance: [f32; 3],
    columns: [usize; 2],
    rows: [usize; 2],
}

impl Body {
    /// Returns the depth at which the ray through a pixel meets the body.
    fn depth_at(&self, pixel: DVec2, ray: DVec3) -> Option<f64> {
        let Some(to_sphere) = self.sphere_from_camera else {
            return (pixel.distance_squared(self.dot_px) <= self.radius_squared).then_some(self.center.z);
        };
        let (a, b) = (to_sphere * ray, to_sphere * self.center);
        let (aa, ab) = (a.length_squared(), a.dot(b));
        let discriminant = ab * ab - aa * (b.length_squared() - 1.0);
        (discriminant >= 0.0).then(|| (ab - discriminant.sqrt()) / aa)
    }
}

/// Draws the splats of a scene as `camera` sees them, which is in the scene's local coordinates.
///
/// ```
/// use luxel::synthetic;
/// use luxel_view::solids::{Shape, SolidOptions, render};
///
/// # fn main() -> luxel::Result<()> {
/// let options = SolidOptions { shape: Shape::Ellipsoids { deviations: 1.0 }, least_opacity: 0.1 };
/// let layers = render(&synthetic::room(200, 1), &synthetic::room_camera([32, 24]), options)?;
/// assert!(layers.alpha.iter().all(|alpha| *alpha == 0.0 || *alpha == 1.0));
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// An image that does not fit into memory.
pub fn render(scene: &Scene, camera: &Camera, options: SolidOptions) -> Result<RadianceLayers> {
    memory::check_render(camera.size_px, 1)?;
    let name = camera.projection.name();
    ensure!(camera.projection.is_pinhole(), "splats are drawn as bodies for pinhole cameras, found {name} projection");
    let [width, height] = camera.size_px.map(|side| side as usize);
    let bodies: Vec<Body> = (0..scene.splats.len()).into_par_iter().filter_map(|i| body(scene, camera, options, i)).collect();
    let mut image = Image { width, height, pixels: vec![[0.0; 3]; width * height] };
    let mut depth = vec![f32::INFINITY; width * height];
    let bands = image.pixels.par_chunks_mut(BAND_ROWS * width).zip(depth.par_chunks_mut(BAND_ROWS * width)).enumerate();
    bands.for_each(|(band, (pixels, depth))| {
        let first = band * BAND_ROWS;
        let end = first + depth.len() / width;
        for body in bodies.iter().filter(|body| body.rows[0] < end && body.rows[1] > first) {
            draw(body, camera, [first.max(body.rows[0]), end.min(body.rows[1])], |at, z| {
                let at = at - first * width;
                if z < depth[at] {
                    (pixels[at], depth[at]) = (body.radiance, z);
                }
            });
        }
    });
    let unit = scene.world_from_local.scale() as f32;
    let alpha = depth.iter().map(|z| if z.is_finite() { 1.0 } else { 0.0 }).collect();
    depth.iter_mut().for_each(|z| *z *= unit);
    let layers = Layers { image, alpha, depth };
    Ok(RadianceLayers::from_normalised(layers, scene.radiance_scale, scene.color_space, &scene.world_camera(camera)))
}

/// Calls `put` with the pixels of some rows that a body covers, and their depths.
fn draw(body: &Body, camera: &Camera, rows: [usize; 2], mut put: impl FnMut(usize, f32)) {
    for y in rows[0]..rows[1] {
        for x in body.columns[0]..body.columns[1] {
            let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let ray = ((pixel - camera.center_px) / camera.focal_px).extend(1.0);
            if let Some(z) = body.depth_at(pixel, ray) {
                put(y * camera.size_px[0] as usize + x, z as f32);
            }
        }
    }
}

/// Returns a splat as a body; `None` where it is faint, or not wholly in front of the camera.
fn body(scene: &Scene, camera: &Camera, options: SolidOptions, i: usize) -> Option<Body> {
    let splats = &scene.splats;
    if sigmoid(splats.opacity_logit[i]) < options.least_opacity {
        return None;
    }
    let position = DVec3::from_array(splats.position[i].map(f64::from));
    let center = camera.camera_from_world.transform_point3(position);
    let (sphere_from_camera, [low, high], dot_px, radius) = match options.shape {
        Shape::Centres { radius_px } => {
            let (pixel, _) = camera.project(position)?;
            (None, [pixel - radius_px, pixel + radius_px], pixel, radius_px)
        }
        Shape::Ellipsoids { deviations } => {
            let (to_sphere, to_camera) = ellipsoid(scene, camera, i, deviations)?;
            let slopes = silhouette(to_camera, center)?;
            (Some(to_sphere), slopes.map(|slope| slope * camera.focal_px + camera.center_px), DVec2::ZERO, 0.0)
        }
    };
    let range = |low: f64, high: f64, side: u32| [low.floor().max(0.0) as usize, high.ceil().clamp(0.0, f64::from(side)) as usize];
    let [columns, rows] = [range(low.x, high.x, camera.size_px[0]), range(low.y, high.y, camera.size_px[1])];
    if columns[0] >= columns[1] || rows[0] >= rows[1] {
        return None;
    }
    let direction = (position - camera.eye()).normalize_or_zero().as_vec3().to_array();
    Some(Body {
        center,
        sphere_from_camera,
        dot_px,
        radius_squared: radius * radius,
        radiance: splats.radiance(i, direction),
        columns,
        rows,
    })
}

/// Returns the matrices from camera axes to the unit sphere of a splat's ellipsoid, and back.
fn ellipsoid(scene: &Scene, camera: &Camera, i: usize, deviations: f64) -> Option<(DMat3, DMat3)> {
    let splats = &scene.splats;
    let [w, x, y, z] = splats.rotation[i].map(f64::from);
    let turn = DQuat::from_xyzw(x, y, z, w);
    if turn.length_squared() == 0.0 {
        return None;
    }
    let smoothing = splats.smoothing.get(i).map_or(0.0, |s| f64::from(*s));
    let extent = DVec3::from_array(splats.log_scale[i].map(|s| f64::from(s).exp().hypot(smoothing))) * deviations;
    let extent = extent.max(DVec3::splat(extent.max_element() * LEAST_THICKNESS));
    let axes = camera.camera_from_world.matrix3 * DMat3::from_quat(turn.normalize());
    let to_sphere = DMat3::from_diagonal(extent.recip()) * axes.transpose();
    (extent.is_finite() && extent.min_element() > 0.0).then(|| (to_sphere, axes * DMat3::from_diagonal(extent)))
}

/// Returns the least and the greatest x/z and y/z of an ellipsoid; `None` if it reaches behind the
/// camera. A plane through the eye touches it where its normal n meets nᵀ (M Mᵀ - c cᵀ) n = 0.
fn silhouette(to_camera: DMat3, center: DVec3) -> Option<[DVec2; 2]> {
    let row = |axis: usize| to_camera.row(axis);
    if center.z <= row(2).length() {
        return None;
    }
    let dual = |a: usize, b: usize| row(a).dot(row(b)) - center[a] * center[b];
    let slopes = [0, 1].map(|axis| {
        let (mixed, last) = (dual(axis, 2), dual(2, 2));
        let root = (mixed * mixed - dual(axis, axis) * last).max(0.0).sqrt();
        // The last is negative in front of the camera.
        [(mixed + root) / last, (mixed - root) / last]
    });
    Some([DVec2::new(slopes[0][0], slopes[1][0]), DVec2::new(slopes[0][1], slopes[1][1])])
}

#[cfg(test)]
mod tests {
    use luxel_core::{ColorModel, Splat, Splats};

    use super::*;

    /// A ball of radius 0.1 at two units before the camera, in a scene of its own.
    fn ball(logit: f32) -> (Scene, Camera) {
        let camera = luxel::synthetic::room_camera([640, 480]);
        let mut scene = luxel::synthetic::room(1, 1).into_core();
        let at = camera.eye() + 2.0 * camera.forward();
        scene.splats = Splats::empty(ColorModel::Sh { degree: 0 });
        let log = 0.1f32.ln();
        let position = at.as_vec3().to_array();
        let splat = Splat {
            position,
            rotation: [1.0, 0.0, 0.0, 0.0],
            log_scale: [log; 3],
            opacity_logit: logit,
            sh: &[1.0; 3],
            raw_luminance: &[],
        };
        scene.splats.push(&splat);
        (scene.into(), camera)
    }

    #[test]
    fn a_ball_is_a_disc_whose_nearest_point_is_a_radius_before_its_centre() {
        let (scene, camera) = ball(9.0);
        for deviations in [1.0, 2.0] {
            let options = SolidOptions { shape: Shape::Ellipsoids { deviations }, least_opacity: 0.1 };
            let layers = render(&scene, &camera, options).unwrap();
            let nearest = layers.depth.iter().copied().fold(f32::INFINITY, f32::min);
            assert!((f64::from(nearest) - (2.0 - 0.1 * deviations)).abs() < 2e-3, "{nearest}");
            // The silhouette of a ball is a cone with this tangent.
            let radius_px = camera.focal_px.x * 0.1 * deviations / (4.0f64 - (0.1 * deviations).powi(2)).sqrt();
            let (area, covered) = (std::f64::consts::PI * radius_px * radius_px, layers.alpha.iter().filter(|a| **a == 1.0).count());
            assert!((covered as f64 - area).abs() < 0.02 * area + 4.0, "{covered} pixels, expected {area}");
            let center = 240 * 640 + 320;
            let expected = scene.splats.radiance(0, camera.forward().as_vec3().to_array()).map(|v| v * scene.radiance_scale.get());
            assert_eq!(layers.radiance.pixels()[center], expected);
        }
    }

    #[test]
    fn dots_have_their_size_and_faint_splats_none() {
        let (scene, camera) = ball(-9.0);
        let draw = |least_opacity| {
            let options = SolidOptions { shape: Shape::Centres { radius_px: 2.0 }, least_opacity };
            render(&scene, &camera, options).unwrap().depth.iter().filter(|z| (**z - 2.0).abs() < 1e-4).count()
        };
        assert!((9..=16).contains(&draw(0.0)), "{}", draw(0.0));
        assert_eq!(draw(0.1), 0);
    }
}
