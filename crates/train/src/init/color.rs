//! Radiance of a point from the HDR pixels that show it.
//!
//! In: a point, training views (data-set units). Out: linear RGB (data-set units). Its luminance is
//! the median R + G + B of the pixels, and its chromaticity that of the medians of the channels.
//! Medians are robust to views in which the point is occluded or in a highlight. `None` if no valid
//! pixel shows the point.

use glam::{DVec2, DVec3};
use luxel_core::{Point, ReadError, View, luminance_sum};
use rayon::prelude::*;

use crate::start_views::StartViews;

/// Views that a point without a track is looked for in. A median of as many is exact enough, and
/// all views of a large set would be read again and again, since samples have to fit into memory.
const MAX_VIEWS: usize = 32;

/// Samples of points that are held at the same time.
const MAX_SAMPLES: usize = 1 << 22;

/// Most bytes of a sample while colours are found: the place and the radiance, and what vectors
/// that grow have to spare.
const SAMPLE_BYTES: u64 = 96;

/// Points whose places are computed together.
const BLOCK: usize = 1 << 12;

/// Returns the most memory that finding the colours of so many points takes, bytes, without the
/// images.
pub(super) fn memory_bytes(points: u64, views: u64) -> u64 {
    SAMPLE_BYTES * (MAX_SAMPLES as u64).min(points.saturating_mul(views.min(MAX_VIEWS as u64)))
}

/// The radiance of each point, if any view shows it.
pub(super) type Colors = Vec<Option<[f32; 3]>>;

/// Returns the radiance of each point over its track or, without a track, over the views it
/// projects into, and what `also` returns for each view. All views are read once for `also` and as
/// many points as [`MAX_SAMPLES`] allow; what remains reads the views again that show it.
///
/// # Errors
/// An image that cannot be read.
pub(super) fn of_points<T: Send>(
    points: &[Point],
    views: StartViews<'_>,
    also: impl Fn(&View) -> T + Sync,
) -> Result<(Colors, Vec<T>), ReadError> {
    let train = views.train;
    let has_track = |point: &Point| track(point, train).next().is_some();
    let places = |point: &Point| if has_track(point) { track(point, train).collect() } else { projections(point, train) };
    let first = Part::new(points, train, &places);
    let looked = views.look(&views.all(), |i, view| (also(view), first.samples(i, view)))?;
    let (told, samples): (Vec<T>, Vec<_>) = looked.into_iter().unzip();
    let taken = first.points;
    let mut colors = first.colors(views.all(), samples);
    colors.extend(streamed(&points[taken..], views, &places)?);
    // Those whose track shows no valid pixel.
    let missing: Vec<usize> = (0..points.len()).filter(|i| colors[*i].is_none() && has_track(&points[*i])).collect();
    let without: Vec<Point> = missing.iter().map(|i| Point { observations: Vec::new(), ..points[*i].clone() }).collect();
    let found = streamed(&without, views, &places)?;
    missing.into_iter().zip(found).for_each(|(i, color)| colors[i] = color);
    Ok((colors, told))
}

/// A place in a view where a point is seen.
struct PointInView {
    view: usize,
    at_px: DVec2,
}

fn track<'a>(point: &'a Point, train: &'a [View]) -> impl Iterator<Item = PointInView> + 'a {
    let inside = point.observations.iter().filter(|seen| (seen.view as usize) < train.len());
    inside.map(|seen| PointInView { view: seen.view as usize, at_px: DVec2::new(seen.pixel_px[0].into(), seen.pixel_px[1].into()) })
}

/// Returns the places in the views that a point projects into: all of them, or [`MAX_VIEWS`] that
/// are spread evenly.
fn projections(point: &Point, train: &[View]) -> Vec<PointInView> {
    let at = DVec3::from_array(point.position.map(f64::from));
    let inside = |(view, of): (usize, &View)| {
        let (at_px, _) = of.camera.project(at)?;
        let [width, height] = of.camera.size_px.map(f64::from);
        let is_inside = at_px.x >= 0.0 && at_px.y >= 0.0 && at_px.x <= width && at_px.y <= height;
        is_inside.then_some(PointInView { view, at_px })
    };
    let all: Vec<PointInView> = train.iter().enumerate().filter_map(inside).collect();
    let count = all.len();
    // The multiples of count / MAX_VIEWS, rounded down, are where this product passes a whole
    // number.
    let is_taken = |i: usize| count <= MAX_VIEWS || (i + 1) * MAX_VIEWS / count > i * MAX_VIEWS / count;
    all.into_iter().enumerate().filter(|(i, _)| is_taken(*i)).map(|(_, seen)| seen).collect()
}

/// Returns the colours of points over the places where they are seen, in parts whose samples stay
/// within [`MAX_SAMPLES`]; each part reads the views that show it.
fn streamed(points: &[Point], views: StartViews<'_>, places: &Places<'_>) -> Result<Vec<Option<[f32; 3]>>, ReadError> {
    let mut colors = Vec::with_capacity(points.len());
    while colors.len() < points.len() {
        let part = Part::new(&points[colors.len()..], views.train, places);
        let seen: Vec<usize> = views.all().into_iter().filter(|i| !part.by_view[*i].is_empty()).collect();
        let samples = views.look(&seen, |i, view| part.samples(i, view))?;
        colors.extend(part.colors(seen, samples));
    }
    Ok(colors)
}

type Places<'a> = dyn Fn(&Point) -> Vec<PointInView> + Sync + 'a;

/// The first of some points, and where each view shows them.
struct Part {
    /// Number of points.
    points: usize,
    /// Index and place of the points in each view.
    by_view: Vec<Vec<(usize, DVec2)>>,
}

impl Part {
    /// Takes points from the front, blocks of them, until their samples reach [`MAX_SAMPLES`].
    fn new(points: &[Point], train: &[View], places: &Places<'_>) -> Self {
        let mut by_view: Vec<Vec<(usize, DVec2)>> = train.iter().map(|_| Vec::new()).collect();
        let (mut count, mut taken) = (0, 0);
        for block in points.chunks(BLOCK) {
            let seen: Vec<Vec<PointInView>> = block.par_iter().map(places).collect();
            for (point, seen) in (taken..).zip(seen) {
                count += seen.len();
                seen.into_iter().for_each(|seen| by_view[seen.view].push((point, seen.at_px)));
            }
            taken += block.len();
            if count >= MAX_SAMPLES {
                break;
            }
        }
        Self { points: taken, by_view }
    }

    /// Returns what a view shows at its places.
    fn samples(&self, index: usize, view: &View) -> Vec<Option<[f32; 3]>> {
        self.by_view[index].iter().map(|(_, at_px)| sample(view, *at_px)).collect()
    }

    /// Returns the colours of the points by the samples of the views of these indices.
    fn colors(mut self, views: Vec<usize>, samples: Vec<Vec<Option<[f32; 3]>>>) -> Vec<Option<[f32; 3]>> {
        let mut of_point: Vec<Vec<[f32; 3]>> = vec![Vec::new(); self.points];
        for (view, samples) in views.into_iter().zip(samples) {
            let places = std::mem::take(&mut self.by_view[view]);
            places.into_iter().zip(samples).for_each(|((point, _), sample)| of_point[point].extend(sample));
        }
        of_point.into_par_iter().map(median_color).collect()
    }
}

/// Samples an image bilinearly at pixel coordinates (pixel centres at +0.5), from valid pixels
/// only. Returns `None` outside the image.
fn sample(view: &View, at_px: DVec2) -> Option<[f32; 3]> {
    let image = &view.image;
    let (width, height) = (image.width as f64, image.height as f64);
    // The comparisons are written so that NaN counts as outside.
    if !(at_px.x >= 0.0 && at_px.x <= width && at_px.y >= 0.0 && at_px.y <= height) || image.pixels.is_empty() {
        return None;
    }
    let corner = (at_px - 0.5).floor();
    let fraction = at_px - 0.5 - corner;
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let x = (corner.x as i64 + dx).clamp(0, image.width as i64 - 1) as usize;
        let y = (corner.y as i64 + dy).clamp(0, image.height as i64 - 1) as usize;
        let along = |d: i64, f: f64| if d == 0 { 1.0 - f } else { f };
        let weight = along(dx, fraction.x) * along(dy, fraction.y);
        let i = y * image.width + x;
        let rgb = image.pixels[i];
        if view.is_valid(i) && rgb.iter().all(|v| v.is_finite()) {
            sum = std::array::from_fn(|c| sum[c] + weight * f64::from(rgb[c]));
            total += weight;
        }
    }
    (total > 1e-3).then(|| sum.map(|s| (s / total).max(0.0) as f32))
}

fn median_color(samples: Vec<[f32; 3]>) -> Option<[f32; 3]> {
    // The sum is in f64, because the sum of three f32 channels may exceed f32.
    let sum = |rgb: [f64; 3]| rgb.iter().sum::<f64>();
    let luminance = median(samples.iter().map(|rgb| sum(rgb.map(f64::from))).collect())?;
    let mut rgb = [0.0; 3];
    for (c, out) in rgb.iter_mut().enumerate() {
        *out = median(samples.iter().map(|sample| sample[c].into()).collect())?;
    }
    let sum = sum(rgb);
    let color = if sum > 0.0 { rgb.map(|v| v / sum * luminance) } else { [luminance / 3.0; 3] };
    Some(color.map(|v| v.min(f32::MAX.into()) as f32))
}

/// Returns the median, which for an even count is the mean of the two middle values, or `None`
/// without values.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = *values.get((values.len() - 1) / 2)?;
    Some(0.5 * lower + 0.5 * upper)
}

/// The colour of points that no view shows: the file's display colour, scaled to the images'
/// typical luminance.
pub(super) struct Fallback {
    /// Radiance (R + G + B) / 3 of a typical pixel, data-set units.
    typical: f32,
    /// Factor on linearised display colours.
    display_gain: f32,
}

impl Fallback {
    pub(super) fn new(points: &[Point], typical: f32) -> Self {
        let luminances = points.iter().filter_map(|point| point.rgb8).map(|rgb| luminance_sum(rgb.map(srgb_to_linear)) / 3.0);
        let display = median(luminances.filter(|l| *l > 0.0).map(f64::from).collect()).unwrap_or(1.0) as f32;
        Self { typical, display_gain: typical / display }
    }

    pub(super) fn of_point(&self, point: &Point) -> [f32; 3] {
        match point.rgb8 {
            Some(rgb) => rgb.map(|v| srgb_to_linear(v) * self.display_gain),
            None => [self.typical; 3],
        }
    }
}

/// Returns the linear value of an sRGB byte (IEC 61966-2-1).
fn srgb_to_linear(byte: u8) -> f32 {
    let v = f32::from(byte) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {

    use luxel_core::{Image, Mask};

    use super::*;
    use crate::testing::{camera_at, dataset_of, on_demand, view_of};

    fn two_pixels() -> View {
        let image = Image::from_pixels(2, 1, vec![[1.0; 3], [3.0; 3]]).unwrap();
        view_of("two", camera_at([0.0; 3], [2, 1]), image)
    }

    #[test]
    fn samples_lie_between_pixel_centres() {
        let view = two_pixels();
        let at = |x: f64| sample(&view, DVec2::new(x, 0.5)).map(|rgb| rgb[0]);
        assert_eq!([at(0.0), at(0.5), at(1.0), at(1.5), at(2.0)], [Some(1.0), Some(1.0), Some(2.0), Some(3.0), Some(3.0)]);
        assert_eq!([at(-0.1), at(2.1), at(f64::NAN)], [None; 3]);
    }

    #[test]
    fn a_point_in_many_views_is_looked_for_in_some_that_are_spread_evenly() {
        let forward = camera_at([0.0; 3], [2, 1]).forward().as_vec3().to_array();
        let point = Point { position: forward, rgb8: None, observations: Vec::new() };
        let seen = |count: usize| -> Vec<usize> {
            let views = vec![two_pixels(); count];
            projections(&point, &views).into_iter().map(|seen| seen.view).collect()
        };
        assert_eq!(seen(MAX_VIEWS), (0..MAX_VIEWS).collect::<Vec<_>>());
        let some = seen(300);
        assert_eq!((some.len(), some.last()), (MAX_VIEWS, Some(&299)));
        assert!(some.windows(2).all(|pair| (9..=10).contains(&(pair[1] - pair[0]))), "{some:?}");
    }

    #[test]
    fn masked_pixels_are_not_sampled() {
        let mut view = two_pixels();
        view.mask = Some(Mask::from_valid(vec![false, true]).into());
        assert_eq!(sample(&view, DVec2::new(1.0, 0.5)), Some([3.0; 3]));
        assert_eq!(sample(&view, DVec2::new(0.5, 0.5)), None);
    }

    #[test]
    fn one_highlight_does_not_change_the_color() {
        let color = median_color(vec![[0.2, 0.1, 0.1], [90.0, 90.0, 90.0], [0.2, 0.1, 0.1]]).unwrap();
        assert!((color[0] - 0.2).abs() < 1e-6 && (color[1] - 0.1).abs() < 1e-6, "{color:?}");
        assert_eq!(median_color(Vec::new()), None);
    }

    #[test]
    fn a_sum_beyond_the_largest_number_is_a_color_all_the_same() {
        let huge = [3e38, 1.5e38, 3e38];
        let color = median_color(vec![huge; 3]).unwrap();
        assert!(color.iter().zip(huge).all(|(found, expected)| (found / expected - 1.0).abs() < 1e-6), "{color:?}");
        // The medians of the channels may sum to less than the median of the sums.
        let mixed =
            median_color(vec![[3e38, 3e38, 0.0], [3e38, 0.0, 3e38], [0.0, 3e38, 3e38], [3e38, 0.0, 0.0], [1e38, 0.0, 0.0]]).unwrap();
        assert!(mixed.iter().all(|v| v.is_finite()), "{mixed:?}");
    }

    #[test]
    fn images_on_demand_give_the_same_colors() {
        let pixels = (0..64 * 64).map(|i| [i as f32, (i % 64) as f32, 1.0]).collect();
        let image = Image::from_pixels(64, 64, pixels).unwrap();
        let train: Vec<View> =
            (0..3).map(|i| view_of(&format!("v{i}"), camera_at([0.1 * f64::from(i), 0.0, 0.0], [64, 64]), image.clone())).collect();
        let seen = |view, pixel_px| luxel_core::Observation { view, pixel_px };
        let point = |x: f32, observations| Point { position: [x, 0.1, 4.0], rgb8: None, observations };
        let mut points: Vec<Point> = (0..40).map(|i| point(0.1 * i as f32 - 2.0, Vec::new())).collect();
        points.push(point(0.0, vec![seen(0, [3.5, 4.5]), seen(2, [9.0, 8.0]), seen(7, [1.0; 2])]));
        points.push(point(0.3, vec![seen(1, [-5.0, 0.0])]));
        points.push(point(1e6, Vec::new()));
        let later: Vec<View> = train.iter().map(on_demand).collect();
        let [(now, names), (later, _)] = [train, later].map(|train| {
            let data = dataset_of(train);
            of_points(&points, StartViews::new(&data, None), |view| view.name.clone()).unwrap()
        });
        assert_eq!(now, later);
        assert_eq!(names, ["v0", "v1", "v2"]);
        assert!(now[40].is_some() && now[41].is_some() && now[42].is_none());
    }

    #[test]
    fn the_middle_of_an_even_number_is_the_mean_of_two() {
        assert_eq!(median(vec![4.0, 1.0]), Some(2.5));
    }
}
