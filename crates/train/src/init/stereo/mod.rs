//! Dense points by stereo between the training views.
//!
//! In: posed pinhole views (data-set units), points of structure from motion if there are any. Out:
//! points with the views that agree on them. Each view is compared with its neighbours at planes of
//! equal distance in inverse depth (plane sweep, Collins 1996), by the zero-mean normalised
//! cross-correlation of log radiance, which neither exposure nor the range of a scene changes. A
//! pixel's depth is kept if its best plane is unambiguous, and if the depths of other views agree
//! (Schoenberger et al. 2016). The depths of what is left are then refined in larger images.
//! Degenerate: views without a neighbour, ambiguous and missing texture, fisheyes and panoramas
//! give no points.

mod agree;
mod neighbours;
mod panel;
mod refine;
mod sweep;

use luxel_core::{CameraProjection, Point, ReadError, View};
use rand::Rng;
use rand::seq::index::sample;

use self::agree::agreed;
use self::neighbours::neighbours;
use self::panel::{Panel, REFINED_PX, SWEPT_PX};
use self::refine::refined;
use self::sweep::DepthMap;
use super::volume;
use crate::start_views::StartViews;

/// Largest number of views that are compared, spread evenly: more of them see little that is new.
const MOST_VIEWS: usize = 96;

/// Returns the most memory that stereo between so many views of so many pixels takes, bytes,
/// without the images.
pub(super) fn memory_bytes(views: u64, view_px: u64) -> u64 {
    let pixels = |side_px: u32| u64::from(side_px).pow(2).min(view_px);
    views.min(MOST_VIEWS as u64) * (panel::BYTES * (pixels(SWEPT_PX) + pixels(REFINED_PX)) + sweep::DEPTH_BYTES * pixels(SWEPT_PX))
        + sweep::MOST_COST_BYTES * pixels(SWEPT_PX)
}

/// Returns up to `count` points, in the order of the views and their pixels.
///
/// # Errors
/// An image that cannot be read.
pub(super) fn stereo_points(views: StartViews<'_>, points: &[Point], count: usize, rng: &mut impl Rng) -> Result<Vec<Point>, ReadError> {
    let train = views.train;
    if count == 0 || train.len() < 2 {
        return Ok(Vec::new());
    }
    if train.iter().any(|view| view.camera.projection != CameraProjection::Pinhole) {
        tracing::info!("no points of stereo: it compares views of pinhole cameras only, and some are fisheyes or panoramas");
        return Ok(Vec::new());
    }
    let ranges = volume::depth_ranges(train);
    let range = |i: usize| ranges.as_ref().and_then(|ranges| ranges.get(i).copied());
    let stride = train.len().div_ceil(MOST_VIEWS);
    let compared: Vec<usize> = (0..train.len()).step_by(stride).collect();
    // Refining searches around depths that are there, so its panels need no range.
    let both = |i: usize, view: &View| (Panel::new(view, i, points, range(i), SWEPT_PX), Panel::new(view, i, &[], None, REFINED_PX));
    let (panels, fine): (Vec<Panel>, Vec<Panel>) = views.look(&compared, both)?.into_iter().unzip();
    let near = neighbours(&panels);
    let maps: Vec<DepthMap> = panels.iter().zip(&near).map(|(panel, near)| sweep::depth_map(panel, near, &panels)).collect();
    let found = agreed(&panels, &maps, &near);
    let agreed = found.len();
    let ratio = panels.iter().zip(&fine).map(|(panel, fine)| panel.factor / fine.factor).fold(1.0, f64::max);
    let mut found = refined(&fine, found, ratio);
    tracing::info!(pixels = panels.iter().map(Panel::len).sum::<usize>(), agreed, refined = found.len(), "stereo");
    if found.len() > count {
        let mut chosen = sample(rng, found.len(), count).into_vec();
        chosen.sort_unstable();
        found = chosen.into_iter().map(|i| found[i].clone()).collect();
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use glam::{DVec2, DVec3};
    use luxel_core::{Dataset, Image, Mask};
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::TrainConfig;
    use crate::init::initialise;
    use crate::testing::{camera_at, camera_looking_at, dataset_of, view_of};

    const SIDE_PX: u32 = 96;
    const EYES: [[f64; 3]; 4] = [[-0.4, 0.0, 0.0], [0.0, 0.1, 0.0], [0.4, -0.1, 0.2], [0.0, 0.4, -0.2]];

    /// Radiance over four decades that changes from place to place.
    fn texture(x: f64, y: f64) -> f32 {
        let wave = |a: f64, b: f64, c: f64| (a * x + b * y + c).sin();
        let sum = wave(9.0, 3.0, 0.1) + wave(-4.0, 11.0, 1.3) + wave(17.0, -13.0, 0.7) + wave(23.0, 19.0, 2.1) + wave(31.0, -7.0, 0.4);
        (0.9 * sum).exp() as f32
    }

    /// A view of the wall at z = 4.
    fn view(eye: [f64; 3], radiance: impl Fn(f64, f64) -> f32) -> View {
        view_of_side(SIDE_PX, eye, radiance)
    }

    fn view_of_side(side_px: u32, eye: [f64; 3], radiance: impl Fn(f64, f64) -> f32) -> View {
        let camera = camera_at(eye, [side_px; 2]);
        let pixel = |i: u32| {
            let flat = (DVec2::new(f64::from(i % side_px), f64::from(i / side_px)) + 0.5 - camera.center_px) / camera.focal_px;
            let at = camera.eye() + camera.camera_from_world.matrix3.transpose() * DVec3::new(flat.x, flat.y, 1.0) * (4.0 - eye[2]);
            [radiance(at.x, at.y); 3]
        };
        let pixels = (0..side_px * side_px).map(pixel).collect();
        view_of(&format!("{eye:?}"), camera.clone(), Image::from_pixels(side_px as usize, side_px as usize, pixels).unwrap())
    }

    fn views(radiance: impl Fn(f64, f64) -> f32) -> Vec<View> {
        EYES.map(|eye| view(eye, &radiance)).into()
    }

    /// Points before and behind the wall, which say where to look for it.
    fn hints() -> Vec<Point> {
        let point = |i: usize| Point { position: [0.02 * i as f32 - 0.2, 0.0, 3.0 + 0.1 * i as f32], rgb8: None, observations: Vec::new() };
        (0..24).map(point).collect()
    }

    fn found(train: &[View], points: &[Point], count: usize) -> Vec<Point> {
        let data = dataset_of(train.to_vec());
        stereo_points(StartViews::new(&data, None), points, count, &mut Pcg64Mcg::seed_from_u64(1)).unwrap()
    }

    #[test]
    fn a_textured_wall_is_found_where_it_is_with_the_pixels_that_show_it() {
        let train = views(texture);
        let points = found(&train, &hints(), 100_000);
        assert!(points.len() > 2000, "{}", points.len());
        let off = points.iter().filter(|point| (point.position[2] - 4.0).abs() > 0.02).count();
        assert!(off * 100 < points.len(), "{off} of {}", points.len());
        for point in &points {
            let at = DVec3::from_array(point.position.map(f64::from));
            assert!(point.observations.len() >= 3);
            for seen in &point.observations {
                let (px, _) = train[seen.view as usize].camera.project(at).unwrap();
                assert!((px - glam::Vec2::from_array(seen.pixel_px).as_dvec2()).length() < 1.0);
            }
        }
    }

    /// The sweep sees these images at half their size.
    #[test]
    fn depths_are_those_of_images_larger_than_the_sweep_sees() {
        let train = EYES.map(|eye| view_of_side(396, eye, |x, y| texture(0.5 * x, 0.5 * y)));
        let points = found(&train, &hints(), 100_000);
        let mut off: Vec<f32> = points.iter().map(|point| (point.position[2] / 4.0 - 1.0).abs()).collect();
        off.sort_unstable_by(f32::total_cmp);
        let quantiles = [0.5, 0.9].map(|part| off[(off.len() as f64 * part) as usize]);
        assert!(off.len() > 2000 && quantiles[0] < 4e-4 && quantiles[1] < 1.2e-3, "{} {quantiles:?}", off.len());
    }

    #[test]
    fn no_more_points_than_asked_for_and_the_same_for_the_same_seed() {
        let train = views(texture);
        let points = found(&train, &hints(), 500);
        assert_eq!(points.len(), 500);
        assert_eq!(points, found(&train, &hints(), 500));
        assert_eq!(found(&train, &hints(), 0), []);
    }

    #[test]
    fn the_start_has_them_beside_the_points_of_the_data_set_or_as_half_of_the_initial_ones() {
        let positions_within = |points: Vec<Point>, stereo_points: Option<u32>, max_splats: Option<u32>| {
            let data = Dataset { points, ..dataset_of(views(texture)) };
            let config = TrainConfig { stereo_points, init_points: 300, max_splats, ..TrainConfig::default() };
            initialise(&data, &config, None).unwrap().splats.position
        };
        let positions = |points: Vec<Point>, stereo_points| positions_within(points, stereo_points, None);
        let on_wall = |positions: &[[f32; 3]]| positions.iter().filter(|at| (at[2] - 4.0).abs() < 0.05).count();
        assert_eq!(positions(hints(), Some(0)).len(), 24);
        let beside = positions(hints(), Some(500));
        assert!(beside.len() == 524 && on_wall(&beside) > 490);
        // Densification has room.
        assert_eq!(positions_within(hints(), Some(500), Some(400)).len(), 224);
        let alone = positions(Vec::new(), Some(20_000));
        assert!(alone.len() == 300 && on_wall(&alone) > 140);
        // Where nothing is asked for, few views add nothing to points that are there.
        assert_eq!(positions(hints(), None).len(), 24);
        assert_eq!(positions(Vec::new(), None), alone);
    }

    #[test]
    fn exposure_changes_no_depth() {
        let mut train = views(texture);
        let points = found(&train, &hints(), 100_000).len();
        for (i, view) in train.iter_mut().enumerate() {
            let gain = [1.0, 3.0, 0.5, 8.0][i];
            let pixels = view.image.pixels.iter().map(|pixel| pixel.map(|v| gain * v)).collect();
            view.image = Image::from_pixels(SIDE_PX as usize, SIDE_PX as usize, pixels).unwrap().into();
        }
        let changed = found(&train, &hints(), 100_000).len();
        assert!(changed.abs_diff(points) * 50 < points, "{changed} {points}");
    }

    #[test]
    fn bare_walls_stripes_and_masks_give_no_points() {
        assert_eq!(found(&views(|_, _| 0.3), &hints(), 1000), []);
        // Stripes along the only direction in which the cameras differ.
        let stripes = |x: f64, _: f64| (3.0 * (40.0 * x).sin()).exp() as f32;
        let along = [[-0.4, 0.0, 0.0], [0.0, 0.0, 0.0], [0.4, 0.0, 0.0]].map(|eye| view(eye, stripes));
        let wrong = found(&along, &hints(), 1000).iter().filter(|point| (point.position[2] - 4.0).abs() > 0.05).count();
        assert!(wrong < 20, "{wrong}");
        let mut train = views(texture);
        for view in &mut train {
            view.mask = Some(Mask::from_valid(vec![false; (SIDE_PX * SIDE_PX) as usize]).into());
        }
        assert_eq!(found(&train, &hints(), 1000), []);
    }

    #[test]
    fn views_that_share_nothing_give_no_points() {
        let ahead = view([0.0; 3], texture);
        assert_eq!(found(std::slice::from_ref(&ahead), &hints(), 1000), []);
        let back = View { camera: camera_looking_at(DVec3::ZERO, DVec3::new(0.1, 0.0, -1.0), [SIDE_PX; 2]), ..ahead.clone() };
        assert_eq!(found(&[ahead, back], &hints(), 1000), []);
    }
}
