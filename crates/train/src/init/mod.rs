//! The scene before the first step.
//!
//! In: training views (data-set units), points of structure from motion if there are any, the
//! radiance scale. Out: isotropic splats in normalised units, at the points and at those that
//! stereo between the views finds, or spread over the space that the cameras see. The cameras
//! decide, too, where they see few of the points or all points are at one place
//! ([`PointCoverage`]).
//!
//! The colour of a splat is a median of HDR pixels over its point's track, or over the views it
//! projects into. Unless options set other values, its scale is the root mean squared distance to
//! the 3 nearest neighbours and its opacity is 0.1 (Kerbl et al. 2023). MCMC has 0.3 of that scale,
//! a tenth with 3DGS's dilation, and opacity 0.5 (Kheradmand et al. 2024).

mod color;
mod neighbours;
mod stereo;
mod volume;

use luxel_core::{ColorModel, Dataset, Knots, Point, PointCoverage, RadianceScale, Splat, Splats, luminance_sum};
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::TrainError;
use crate::camera_response::CameraResponse;
use crate::config::TrainConfig;
use crate::recorded::is_recorded;
use crate::scale::{Luminances, Sampling};
use crate::start_views::StartViews;
use crate::views::pixels;

pub use self::neighbours::distances as spacing;

/// Smallest initial R + G + B of a splat, normalised units: half of where the mu-law turns linear.
/// Lower values look black to the loss, and the gradient of an activation almost vanishes.
const MIN_LUMINANCE: f32 = 1e-4;

/// Largest coordinate of a point; larger ones are failures of structure from motion, and their
/// squares would exceed f32.
const MAX_COORDINATE: f32 = 1e9;

/// Constant that separates the random stream of the initialisation from others of the same seed.
const INIT_STREAM: u64 = 0x6c75_7865_6c01;

/// The scene before the first step.
#[derive(Debug, PartialEq)]
pub struct Initial {
    /// The splats, normalised units.
    pub splats: Splats,
    /// The radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
}

/// Returns the initial scene. Images that are read on demand are read once, and once for stereo;
/// more often if the points have more samples than memory holds at a time, or tracks that show no
/// valid pixel. Captured values become radiance by `knots`.
///
/// # Errors
/// Returns [`TrainError::NoTrainViews`], [`TrainError::NoSplats`] if the cameras see no common
/// volume, [`TrainError::NoPixels`] or [`TrainError::AllBlack`] if the images tell no scale, and
/// [`TrainError::Read`] for an image that cannot be read again.
pub fn initialise(dataset: &Dataset, config: &TrainConfig, knots: Option<Knots>) -> Result<Initial, TrainError> {
    if dataset.train.is_empty() {
        return Err(TrainError::NoTrainViews);
    }
    let points = starting_points(dataset, config, knots)?;
    let (colors, radiance_scale) = colors_at(&points, dataset, config, knots)?;
    Ok(Initial { splats: splats_at(&points, &colors, config), radiance_scale })
}

/// Returns the radiance of one normalised unit that the options state.
fn given_scale(config: &TrainConfig) -> Result<Option<RadianceScale>, TrainError> {
    let given = config.radiance_scale.map(RadianceScale::try_from).transpose();
    given.map_err(|e| TrainError::config("radiance-scale", e.to_string()))
}

/// Returns the radiance of one normalised unit, from the images unless the options state it.
/// `knots` are of the camera's response, where images are captured values.
///
/// # Errors
/// Those of [`initialise`].
pub fn radiance_scale_of(dataset: &Dataset, config: &TrainConfig, knots: Option<Knots>) -> Result<RadianceScale, TrainError> {
    if let Some(given) = given_scale(config)? {
        return Ok(given);
    }
    let views = StartViews::new(dataset, knots);
    let sampling = Sampling::new(&dataset.train, config.scale_rule);
    let luminances = views.look(&views.all(), |_, view| Luminances::new(view, sampling))?;
    Luminances::of_all(luminances, &views, sampling)?.radiance_scale(config.scale_rule)
}

/// Returns the radiance of one normalised unit for a training without splats: from the images
/// unless the options state it.
///
/// # Errors
/// Those of [`initialise`]; views of which some are radiance and others captured values.
pub fn start_scale(dataset: &Dataset, config: &TrainConfig) -> Result<RadianceScale, TrainError> {
    if dataset.train.is_empty() {
        return Err(TrainError::NoTrainViews);
    }
    let response = is_recorded(&dataset.train)?.then(|| CameraResponse::new(config.unit_exposure, &dataset.train));
    radiance_scale_of(dataset, config, response.as_ref().map(CameraResponse::knots))
}

/// Returns the colours of points in the images, normalised units, and the radiance of one such
/// unit.
fn colors_at(
    points: &[Point],
    dataset: &Dataset,
    config: &TrainConfig,
    knots: Option<Knots>,
) -> Result<(Vec<[f32; 3]>, RadianceScale), TrainError> {
    let given = given_scale(config)?;
    let views = StartViews::new(dataset, knots);
    let sampling = Sampling::new(&dataset.train, config.scale_rule);
    let (colors, luminances) = color::of_points(points, views, |view| Luminances::new(view, sampling))?;
    let luminances = Luminances::of_all(luminances, &views, sampling)?;
    let radiance_scale = given.map_or_else(|| luminances.radiance_scale(config.scale_rule), Ok)?;
    // If all images are black, there is no typical luminance, and the floor of colours applies to
    // all splats.
    let fallback = color::Fallback::new(points, luminances.median().unwrap_or(0.0));
    let colors = colors.into_par_iter().zip(points).map(|(color, point)| color.unwrap_or_else(|| fallback.of_point(point)));
    Ok((colors.map(|rgb| at_least(MIN_LUMINANCE, radiance_scale.normalised(rgb))).collect(), radiance_scale))
}

/// Returns the most memory that finding the colours of so many first splats takes, bytes, without
/// the images.
pub fn first_colors_bytes(splats: u64, views: u64) -> u64 {
    color::memory_bytes(splats, views)
}

/// Returns the most memory that stereo between so many views of so many pixels takes at the start,
/// bytes, without the images.
pub fn stereo_bytes(views: u64, view_px: u64) -> u64 {
    stereo::memory_bytes(views, view_px)
}

/// Returns the points where splats start.
fn starting_points(dataset: &Dataset, config: &TrainConfig, knots: Option<Knots>) -> Result<Vec<Point>, TrainError> {
    let mut rng = Pcg64Mcg::seed_from_u64(config.seed ^ INIT_STREAM);
    let is_usable = |point: &&Point| point.position.iter().all(|v| v.is_finite() && v.abs() < MAX_COORDINATE);
    let mut points: Vec<Point> = dataset.points.iter().filter(is_usable).cloned().collect();
    if points.len() < dataset.points.len() {
        tracing::warn!(
            dropped = dataset.points.len() - points.len(),
            "points left out: not finite or beyond {MAX_COORDINATE:e} world units"
        );
    }
    // The reader of the data set has warned of points that are no start.
    if !PointCoverage::new(&points, &dataset.train).is_useful() {
        points.clear();
    }
    let limit = config.splat_limit(pixels(&dataset.train));
    let without = (config.init_points as usize).min(limit);
    // Half is left to the points of the data set, or to random ones, and to densification.
    let most_found = if points.is_empty() { without / 2 } else { limit / 2 };
    let most_found = most_found.min(config.stereo_points_for(dataset.train.len(), !points.is_empty()) as usize);
    let found = stereo::stereo_points(StartViews::new(dataset, knots), &points, most_found, &mut rng)?;
    if points.is_empty() {
        points = volume::random_points(&dataset.train, without - found.len(), &mut rng);
    }
    points.extend(found);
    if points.len() > limit {
        let mut chosen = sample(&mut rng, points.len(), limit).into_vec();
        chosen.sort_unstable();
        points = chosen.into_iter().map(|i| points[i].clone()).collect();
    }
    if points.is_empty() {
        return Err(TrainError::NoSplats("the cameras see no common volume; give a point cloud with the data set"));
    }
    Ok(points)
}

fn splats_at(points: &[Point], colors: &[[f32; 3]], config: &TrainConfig) -> Splats {
    let color_model = config.color_model();
    let positions: Vec<[f32; 3]> = points.iter().map(|point| point.position).collect();
    let (opacity, shrink) = (config.initial_opacity(), config.initial_scale());
    let mut splats = Splats::empty(color_model);
    let mut sh = vec![0.0; 3 * color_model.sh_coefficients()];
    let mut raw_luminance = vec![0.0; color_model.luminance_coefficients()];
    for ((position, rgb), distance) in positions.iter().zip(colors).zip(neighbours::distances(&positions)) {
        write_color(color_model, *rgb, &mut sh, &mut raw_luminance);
        splats.push(&Splat {
            position: *position,
            rotation: [1.0, 0.0, 0.0, 0.0],
            log_scale: [(distance * shrink).ln(); 3],
            opacity_logit: luxel_core::logit(opacity),
            sh: &sh,
            raw_luminance: &raw_luminance,
        });
    }
    splats
}

/// Returns the splats with colours from the images, of the colour model of `config`; their geometry
/// and opacity stay as they are.
///
/// # Errors
/// Those of [`initialise`].
pub(crate) fn recolored(splats: &Splats, dataset: &Dataset, config: &TrainConfig, knots: Option<Knots>) -> Result<Initial, TrainError> {
    let points: Vec<Point> =
        splats.position.iter().map(|position| Point { position: *position, rgb8: None, observations: Vec::new() }).collect();
    let color_model = config.color_model();
    let mut colored = Splats { color_model, sh: Vec::new(), raw_luminance: Vec::new(), gain: Vec::new(), ..splats.clone() };
    let mut sh = vec![0.0; 3 * color_model.sh_coefficients()];
    let mut raw_luminance = vec![0.0; color_model.luminance_coefficients()];
    let (colors, radiance_scale) = colors_at(&points, dataset, config, knots)?;
    for rgb in colors {
        write_color(color_model, rgb, &mut sh, &mut raw_luminance);
        colored.sh.extend_from_slice(&sh);
        colored.raw_luminance.extend_from_slice(&raw_luminance);
    }
    Ok(Initial { splats: colored, radiance_scale })
}

fn write_color(color_model: ColorModel, rgb: [f32; 3], sh: &mut [f32], raw_luminance: &mut [f32]) {
    let (dc, luminance) = color_model.constant(rgb);
    for (out, value) in sh.iter_mut().zip(dc) {
        *out = value;
    }
    if let Some(first) = raw_luminance.first_mut() {
        *first = luminance;
    }
}

/// Returns `rgb` with a luminance of at least `floor` and the same chromaticity; black becomes
/// grey.
fn at_least(floor: f32, rgb: [f32; 3]) -> [f32; 3] {
    let luminance = luminance_sum(rgb);
    if luminance >= floor {
        rgb
    } else if luminance > 0.0 {
        rgb.map(|c| c / luminance * floor)
    } else {
        [floor / 3.0; 3]
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{Image, Observation};

    use super::*;
    use crate::config::{Method, Strategy};
    use crate::testing::{camera_at, dataset_of, view_of};

    /// Two views of a wall at z = 4, with a dark left half and a bright right half.
    fn wall() -> Dataset {
        let image = || {
            let pixels = (0..64 * 64).map(|i| if i % 64 < 32 { [0.2, 0.1, 0.1] } else { [200.0, 400.0, 100.0] }).collect();
            Image::from_pixels(64, 64, pixels).unwrap()
        };
        dataset_of(vec![view_of("a", camera_at([0.0; 3], [64, 64]), image()), view_of("b", camera_at([0.0, 0.1, 0.0], [64, 64]), image())])
    }

    /// The first splats where a normalised unit is `scale`.
    fn splats_of(data: &Dataset, config: &TrainConfig, scale: f32) -> Splats {
        let config = TrainConfig { radiance_scale: Some(scale), ..config.clone() };
        let initial = initialise(data, &config, None).unwrap();
        assert_eq!(initial.radiance_scale.get(), scale);
        initial.splats
    }

    fn point(position: [f32; 3]) -> Point {
        Point { position, rgb8: None, observations: Vec::new() }
    }

    #[test]
    fn colors_are_those_of_the_pixels_the_point_projects_to() {
        let mut data = wall();
        data.points = vec![point([-0.5, 0.0, 4.0]), point([0.5, 0.0, 4.0])];
        data.points[0].observations = vec![Observation { view: 0, pixel_px: [10.0, 10.0] }];
        for method in [Method::Lcd, Method::Sh3] {
            let config = TrainConfig { method, ..TrainConfig::default() };
            let splats = splats_of(&data, &config, 10.0);
            splats.validate().unwrap();
            for (i, expected) in [[0.02, 0.01, 0.01], [20.0, 40.0, 10.0]].into_iter().enumerate() {
                let rgb = splats.radiance(i, [0.0, 0.0, 1.0]);
                for c in 0..3 {
                    assert!((rgb[c] - expected[c]).abs() < 5e-3 * (expected[0] + expected[1] + expected[2]), "{method:?} {i}: {rgb:?}");
                }
            }
        }
    }

    #[test]
    fn point_outside_of_all_views_takes_its_files_colour_at_a_typical_luminance() {
        let mut data = wall();
        data.points = vec![Point { rgb8: Some([255, 0, 0]), ..point([0.0, 0.0, -4.0]) }, point([0.0, 0.0, -5.0]), point([0.0, 0.0, 4.0])];
        let splats = splats_of(&data, &TrainConfig::default(), 1.0);
        // The median of the pixels of both halves.
        let typical = 700.0 / 3.0;
        let red = splats.radiance(0, [0.0, 0.0, 1.0]);
        assert!((luminance_sum(red) / (3.0 * typical) - 1.0).abs() < 1e-3 && red[1] < 0.01 * red[0], "{red:?}");
        let grey = splats.radiance(1, [0.0, 0.0, 1.0]);
        assert!((grey[0] / typical - 1.0).abs() < 1e-3 && (grey[0] - grey[2]).abs() < 1e-3 * typical);
    }

    #[test]
    fn without_points_splats_lie_where_cameras_look() {
        let mut data = wall();
        data.points.clear();
        let config = TrainConfig { init_points: 500, ..TrainConfig::default() };
        let splats = splats_of(&data, &config, 1.0);
        assert_eq!(splats.len(), 500);
        for position in &splats.position {
            let at = glam::DVec3::new(position[0].into(), position[1].into(), position[2].into());
            assert!(data.train.iter().all(|view| view.camera.project(at).is_some()), "{position:?} is behind a camera");
        }
        assert_eq!(splats, splats_of(&data, &config, 1.0));
        assert_ne!(splats, splats_of(&data, &TrainConfig { seed: 1, ..config }, 1.0));
    }

    #[test]
    fn cameras_are_the_start_where_they_see_few_points_or_all_are_at_one_place() {
        let config = TrainConfig { init_points: 300, ..TrainConfig::default() };
        let mut data = wall();
        data.points.clear();
        let from_cameras = splats_of(&data, &config, 1.0);
        let behind = |i: usize| point([0.1 * i as f32, 0.0, -4.0]);
        let before = |i: usize| point([0.01 * i as f32, 0.0, 4.0]);
        for points in [(0..90).map(behind).chain((0..40).map(before)).collect(), vec![point([0.0, 0.0, 4.0]); 50]] {
            data.points = points;
            assert_eq!(splats_of(&data, &config, 1.0), from_cameras);
        }
        // A scan that reaches beyond what the cameras see.
        data.points = (0..90).map(behind).chain((0..60).map(before)).collect();
        assert_eq!(splats_of(&data, &config, 1.0).len(), 150);
    }

    #[test]
    fn limit_of_splats_holds_from_the_start() {
        let mut data = wall();
        data.points = (0..50).map(|i| point([i as f32 * 0.01, 0.0, 4.0])).collect();
        let config = TrainConfig { max_splats: Some(20), ..TrainConfig::default() };
        assert_eq!(splats_of(&data, &config, 1.0).len(), 20);
    }

    #[test]
    fn limit_of_splats_follows_the_pixels_unless_it_is_given() {
        let data = wall();
        let pixels = pixels(&data.train);
        let config = TrainConfig { pixels_per_splat: Some(7), ..TrainConfig::default() };
        assert_eq!(config.splat_limit(7_000_000), 1_000_000);
        assert_eq!(config.splat_limit(pixels), 40_000, "a few pixels are no reason for fewer splats than that");
        assert_eq!(TrainConfig { max_splats: Some(20), ..config.clone() }.splat_limit(pixels), 20);
        assert_eq!(config.splat_limit(u64::MAX), u32::MAX as usize);
    }

    #[test]
    fn hostile_points_make_a_finite_scene() {
        let mut data = wall();
        data.points = vec![point([f32::NAN, 0.0, 0.0]), point([1e30, 0.0, 0.0]), point([1e8, 0.0, 4.0])];
        data.points.extend((0..40).map(|_| point([0.0, 0.0, 4.0])));
        data.points[5].observations = vec![Observation { view: 77, pixel_px: [f32::NAN, 3.0] }];
        for strategy in [Strategy::Adc, Strategy::Mcmc] {
            let config = TrainConfig { strategy, ..TrainConfig::default() };
            let splats = splats_of(&data, &config, 1.0);
            splats.validate().unwrap();
            assert_eq!(splats.len(), 41);
        }
    }

    #[test]
    fn black_is_lifted_to_the_floor_with_its_hue() {
        assert_eq!(at_least(1.0, [0.0; 3]), [1.0 / 3.0; 3]);
        assert_eq!(at_least(1.0, [0.25, 0.25, 0.0]), [0.5, 0.5, 0.0]);
        assert_eq!(at_least(1.0, [2.0, 0.0, 0.0]), [2.0, 0.0, 0.0]);
    }
}
