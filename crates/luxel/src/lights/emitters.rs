//! Which splats shine, and which of them belong together.
//!
//! In: renders of the training views. Out: groups of splats whose light stands out of the scene:
//! pixels brighter than a number of medians are lit by them, and neighbours within a few pixels
//! are one lamp. Degenerate: a scene of even light has none.

use std::collections::BTreeMap;

use glam::{DMat3, DQuat, DVec3, IVec3};
use luxel_core::edit::Contributions;
use luxel_core::{Camera, Engine, Image, RenderOptions, Scene, luminance_sum};

use crate::Result;
use crate::error::Context;

/// Part of a splat's blending weight that lies in bright pixels, from which on it shines.
const LEAST_SHARE: f32 = 0.5;
/// Distance of neighbours of one lamp, in sizes of a pixel at their depth.
const LINK_PX: f64 = 4.0;
/// Groups with less than this part of the strongest one's light are no lamps.
const LEAST_PART: f64 = 1e-3;
/// Most groups that are looked at.
const MOST_GROUPS: usize = 64;

/// A camera and what it sees of the scene, in normalised units.
pub(super) struct SeenView {
    pub(super) camera: Camera,
    pub(super) image: Image,
}

/// A group of splats that shine.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Emitter {
    /// The splats, ascending.
    pub(super) splats: Vec<u32>,
    /// The light that each adds to the images, the same order.
    pub(super) weights: Vec<f64>,
    /// Mean place, by weight, local coordinates of the scene.
    pub(super) middle: DVec3,
    /// Distance of neighbours, local.
    pub(super) link: f64,
}

impl Emitter {
    /// Returns a group of splats, whose light is among that of all splats.
    pub(super) fn new(scene: &Scene, mut splats: Vec<u32>, light: &[f64], link: f64) -> Self {
        splats.sort_unstable();
        let weights: Vec<f64> = splats.iter().map(|i| light[*i as usize]).collect();
        let whole: f64 = weights.iter().sum();
        let middle = splats.iter().zip(&weights).map(|(i, weight)| place(scene, *i) * *weight).sum::<DVec3>() / whole;
        Self { splats, weights, middle, link }
    }

    /// Returns the light that the group adds to the images.
    pub(super) fn weight(&self) -> f64 {
        self.weights.iter().sum()
    }

    /// Returns the root mean square distance of the splats from the middle.
    pub(super) fn spread(&self, scene: &Scene) -> f64 {
        let squares = self.placed(scene).map(|(p, weight)| weight * p.distance_squared(self.middle));
        (squares.sum::<f64>() / self.weight()).sqrt()
    }

    /// Returns the covariance of the light.
    pub(super) fn covariance(&self, scene: &Scene) -> DMat3 {
        let whole = self.weight();
        let part = |((p, weight), i): ((DVec3, f64), &u32)| {
            let d = p - self.middle;
            (DMat3::from_cols(d * d.x, d * d.y, d * d.z) + covariance(scene, *i)) * (weight / whole)
        };
        self.placed(scene).zip(&self.splats).map(part).sum()
    }

    /// Returns the splats' places and weights.
    pub(super) fn placed<'a>(&'a self, scene: &'a Scene) -> impl Iterator<Item = (DVec3, f64)> + 'a {
        self.splats.iter().zip(&self.weights).map(|(i, weight)| (place(scene, *i), *weight))
    }
}

fn place(scene: &Scene, i: u32) -> DVec3 {
    DVec3::from_array(scene.splats.position[i as usize].map(f64::from))
}

/// Returns the covariance of a splat.
pub(super) fn covariance(scene: &Scene, i: u32) -> DMat3 {
    let [w, x, y, z] = scene.splats.rotation[i as usize].map(f64::from);
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let squares = DVec3::from_array(scene.splats.log_scale[i as usize].map(|s| (2.0 * f64::from(s)).exp()));
    axes * DMat3::from_diagonal(squares) * axes.transpose()
}

/// Returns the luminance above which a pixel shows a lamp: `medians` times the median of the
/// pixels that show anything.
pub(super) fn threshold(views: &[SeenView], medians: f64) -> f32 {
    let median = median(views, |pixel| luminance_sum(*pixel));
    if median > 0.0 { (medians * f64::from(median)) as f32 } else { f32::INFINITY }
}

/// Returns the median radiance of the views, by channel: what a direction that none of them shows
/// is likely to have.
pub(super) fn typical(views: &[SeenView]) -> [f32; 3] {
    [0, 1, 2].map(|c| median(views, |pixel| pixel[c]))
}

/// Returns the median of a value of the pixels where it is above 0; 0 without any.
fn median(views: &[SeenView], value: impl Fn(&[f32; 3]) -> f32) -> f32 {
    let mut lit: Vec<f32> = views.iter().flat_map(|view| &view.image.pixels).map(value).filter(|y| *y > 0.0).collect();
    if lit.is_empty() {
        return 0.0;
    }
    let middle = lit.len() / 2;
    *lit.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// The splats that shine.
pub(super) struct Shining {
    /// Their numbers, ascending.
    pub(super) splats: Vec<usize>,
    /// The light that each splat of the scene adds to the images.
    pub(super) light: Vec<f64>,
}

/// Finds the splats that pixels above a luminance are lit by; `engine` holds the scene.
pub(super) fn shining(
    scene: &Scene,
    views: &[SeenView],
    threshold: f32,
    options: &RenderOptions,
    engine: &mut dyn Engine,
) -> Result<Shining> {
    let mut sums = [const { Vec::new() }; 3];
    sums.iter_mut().for_each(|sum: &mut Vec<f64>| sum.resize(scene.splats.len(), 0.0));
    for SeenView { camera, image } in views {
        let mask: Vec<f32> = image.pixels.iter().map(|p| f32::from(u8::from(luminance_sum(*p) > threshold))).collect();
        if mask.iter().all(|m| *m == 0.0) {
            continue;
        }
        let Contributions { masked, blended, light, .. } =
            engine.contributions(camera, options, &mask).context("cannot measure the splats' contributions")?;
        for (sum, part) in sums.iter_mut().zip([masked, blended, light]) {
            sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += f64::from(part));
        }
    }
    let [masked, blended, light] = sums;
    let shines = |i: &usize| light[*i] > 0.0 && masked[*i] > f64::from(LEAST_SHARE) * blended[*i];
    Ok(Shining { splats: (0..scene.splats.len()).filter(shines).collect(), light })
}

/// Divides shining splats into groups of neighbours, strongest first.
pub(super) fn emitters(scene: &Scene, views: &[SeenView], shining: &Shining) -> Vec<Emitter> {
    groups(scene, &shining.splats, &shining.light, LINK_PX * pixel_size(scene, views, &shining.splats))
}

/// Returns the median size of a pixel at the depth of the splats.
pub(super) fn pixel_size(scene: &Scene, views: &[SeenView], splats: &[usize]) -> f64 {
    let middle = splats.iter().map(|i| place(scene, *i as u32)).sum::<DVec3>() / splats.len().max(1) as f64;
    let mut sizes: Vec<f64> = views.iter().map(|SeenView { camera, .. }| camera.eye().distance(middle) / camera.focal_px.x).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).copied().unwrap_or(0.0)
}

/// Divides splats into groups of neighbours: cells of the size of `link` that touch.
fn groups(scene: &Scene, splats: &[usize], light: &[f64], link: f64) -> Vec<Emitter> {
    if !(link.is_finite() && link > 0.0) {
        return Vec::new();
    }
    let mut cells: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
    for i in splats {
        let cell = (place(scene, *i as u32) / link).floor().as_ivec3();
        cells.entry(cell.to_array()).or_default().push(*i as u32);
    }
    let mut found = Vec::new();
    while let Some((first, members)) = cells.pop_first() {
        let (mut reached, mut group, mut next) = (vec![first], members, 0);
        while let Some(&cell) = reached.get(next) {
            next += 1;
            for n in 0..27 {
                let near = IVec3::from_array(cell).wrapping_add(IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1));
                if let Some(members) = cells.remove(&near.to_array()) {
                    reached.push(near.to_array());
                    group.extend(members);
                }
            }
        }
        found.push(Emitter::new(scene, group, light, link));
    }
    found.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
    let least = LEAST_PART * found.first().map_or(0.0, Emitter::weight);
    found.retain(|emitter| emitter.weight() >= least);
    found.truncate(MOST_GROUPS);
    found
}
