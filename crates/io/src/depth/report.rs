//! The depth maps of a data set in a few numbers, and what they are as far as points tell.
//!
//! In: maps, and points with the places where views saw them. Out: how many, their range and
//! coverage, their kind and factor. Where points are seen on maps, the order of both tells depth
//! from disparity (Spearman's rank correlation in each view, the median of views), and the median
//! quotient of each view tells whether one factor holds for all.

use std::path::Path;

use luxel_core::{Dataset, View};
use rayon::prelude::*;

use super::statement::Statement;
use super::{DepthFolder, DepthKind, DepthMap};
use crate::IoError;

/// Unit of 16-bit PNGs that state none, in metres: millimetres, as RGBD cameras and phones write.
const PNG_SCALE: f64 = 0.001;
/// Deviation of a map's shape from its view's that is rounding.
const SHAPE_TOLERANCE: f64 = 0.03;
/// Points on a map from which on it is compared with them.
const LEAST_POINTS: usize = 12;
/// Rank correlation from which on map and points agree.
const AGREEMENT: f64 = 0.6;
/// Spread of the views' factors, as a share of their median, below which one holds for all.
const ONE_FACTOR: f64 = 0.1;
/// Share of the values that a range leaves out at each end.
const TAIL: f64 = 0.01;

/// Facts about the depth maps of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthReport {
    /// Maps.
    pub maps: usize,
    /// Views.
    pub views: usize,
    /// Kind, if it is stated or found.
    pub kind: Option<DepthKind>,
    /// Why the kind is that, for people.
    pub kind_from: String,
    /// Units of the data set for one of the file, if it is stated or found.
    pub scale: Option<f64>,
    /// Range of the values, in the unit of the files, without a hundredth at each end.
    pub range: [f32; 2],
    /// Share of the pixels with a value.
    pub coverage: f64,
    /// Sizes of the maps, each once.
    pub sizes_px: Vec<[usize; 2]>,
    /// Lines for people.
    pub warnings: Vec<String>,
}

/// One map in numbers.
struct Measured {
    size_px: [usize; 2],
    integer_bits: Option<u8>,
    /// Sorted sample of the values above 0.
    values: Vec<f32>,
    covered: usize,
    /// Agreement with the points, if enough are seen on it.
    agreement: Option<Agreement>,
}

/// How a map agrees with points.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Agreement {
    rank_correlation: f64,
    /// Median of the points' depths over the map's.
    factor: f64,
}

/// A point on a map.
#[derive(Clone, Copy, Debug)]
struct Pair {
    /// Value of the map.
    value: f64,
    /// Depth of the point, units of the data set.
    depth: f64,
}

pub(super) fn report(folder: &DepthFolder, dataset: &Dataset) -> Result<DepthReport, IoError> {
    let views: Vec<&View> = dataset.train.iter().chain(&dataset.test).collect();
    let seen = seen_points(dataset);
    let measure = |(index, view): (usize, &&View)| -> Result<Option<Measured>, IoError> {
        let (Some(map), Some(Some(path))) = (folder.read(index)?, folder.files.get(index)) else { return Ok(None) };
        check_shape(path, &map, view)?;
        Ok(Some(measured(&map, seen.get(index).map_or(&[][..], Vec::as_slice), folder.statement)))
    };
    let found: Vec<Option<Measured>> = views.par_iter().enumerate().map(measure).collect::<Result<_, _>>()?;
    let maps: Vec<Measured> = found.into_iter().flatten().collect();
    let mut warnings = Vec::new();
    if maps.len() < views.len() {
        let without = views.len() - maps.len();
        warnings.push(format!("{}: no depth map for {without} of {} views", folder.folder.display(), views.len()));
    }
    let integers = maps.iter().filter(|map| map.integer_bits.is_some()).count();
    if integers > 0 && integers < maps.len() {
        warnings.push(format!(
            "{}: {integers} of {} depth maps hold integers, the others floating-point numbers, which are probably of another \
             unit: save all in one format",
            folder.folder.display(),
            maps.len()
        ));
    }
    let pixels: usize = maps.iter().map(|map| map.size_px[0] * map.size_px[1]).sum();
    let covered: usize = maps.iter().map(|map| map.covered).sum();
    let mut values: Vec<f32> = maps.iter().flat_map(|map| map.values.iter().copied()).collect();
    values.sort_by(f32::total_cmp);
    let at = |share: f64| values.get((share * values.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or(0.0);
    let mut sizes_px: Vec<[usize; 2]> = maps.iter().map(|map| map.size_px).collect();
    sizes_px.sort_unstable();
    sizes_px.dedup();
    let Meaning { kind, kind_from, scale } = meaning(folder, &maps, &mut warnings);
    Ok(DepthReport {
        maps: maps.len(),
        views: views.len(),
        kind,
        kind_from,
        scale,
        range: [at(TAIL), at(1.0 - TAIL)],
        coverage: covered as f64 / pixels.max(1) as f64,
        sizes_px,
        warnings,
    })
}

struct Meaning {
    kind: Option<DepthKind>,
    kind_from: String,
    scale: Option<f64>,
}

/// Returns what the numbers are: as stated, else as points show, else by the format.
fn meaning(folder: &DepthFolder, maps: &[Measured], warnings: &mut Vec<String>) -> Meaning {
    let statement = folder.statement;
    let agreements: Vec<Agreement> = maps.iter().filter_map(|map| map.agreement).collect();
    let correlation = median(agreements.iter().map(|a| a.rank_correlation).collect());
    let factors: Vec<f64> = agreements.iter().map(|a| a.factor).collect();
    let factor = median(factors.clone());
    let spread = factor.and_then(|factor| median(factors.iter().map(|f| (f / factor - 1.0).abs()).collect()));
    let shown = match (correlation, spread) {
        (Some(r), Some(spread)) if r >= AGREEMENT && spread <= ONE_FACTOR => Some(DepthKind::Metric),
        (Some(r), _) if r >= AGREEMENT => Some(DepthKind::Relative),
        (Some(r), _) if r <= -AGREEMENT => Some(DepthKind::Disparity),
        _ => None,
    };
    let views = agreements.len();
    let is_png = !maps.is_empty() && maps.iter().all(|map| map.integer_bits == Some(16));
    if let Some(r) = correlation.filter(|_| shown.is_none()) {
        warnings.push(format!("depth maps do not agree with the points of {views} views (rank correlation {r:.2}): check names and kind"));
    }
    let of_points = || format!("as the points of {views} views show");
    match (statement.kind, shown) {
        (Some(kind), _) => {
            if let Some(shown) = shown.filter(|shown| (*shown == DepthKind::Disparity) != (kind == DepthKind::Disparity)) {
                warnings.push(format!("depth.json says {kind}, but the points of {views} views show {shown}"));
            }
            let found = factor.filter(|_| [DepthKind::Metric, DepthKind::Distance].contains(&kind) && shown == Some(DepthKind::Metric));
            Meaning { kind: Some(kind), kind_from: "as depth.json says".to_owned(), scale: statement.scale.or(found) }
        }
        (None, Some(DepthKind::Metric)) => Meaning { kind: shown, kind_from: of_points(), scale: statement.scale.or(factor) },
        (None, Some(_)) => Meaning { kind: shown, kind_from: of_points(), scale: statement.scale },
        (None, None) if is_png => {
            let from = "16-bit PNG, millimetres by convention".to_owned();
            Meaning { kind: Some(DepthKind::Metric), kind_from: from, scale: statement.scale.or(Some(PNG_SCALE)) }
        }
        (None, None) => Meaning { kind: None, kind_from: "not stated: depth.json may say so".to_owned(), scale: statement.scale },
    }
}

/// Refuses a map that cannot be of its view.
fn check_shape(path: &Path, map: &DepthMap, view: &View) -> Result<(), IoError> {
    let ([w, h], [vw, vh]) = (map.size_px.map(|side| side as f64), view.camera.size_px.map(f64::from));
    if (w * vh / (h * vw) - 1.0).abs() <= SHAPE_TOLERANCE {
        return Ok(());
    }
    Err(IoError::invalid(
        path,
        format!("a depth map of {w} x {h} pixels, its view {:?} has {vw} x {vh}: expected the same shape", view.name),
    ))
}

/// A point in a view, as shares of the image's sides, with its depth.
struct SeenPoint {
    at: [f64; 2],
    depth: f64,
    /// Length of its ray over the depth.
    slant: f64,
}

/// Returns the points that each training view sees.
fn seen_points(dataset: &Dataset) -> Vec<Vec<SeenPoint>> {
    let mut seen: Vec<Vec<SeenPoint>> = dataset.train.iter().map(|_| Vec::new()).collect();
    let unit = dataset.world_from_local.scale();
    for point in &dataset.points {
        for observation in &point.observations {
            let index = observation.view as usize;
            let (Some(view), Some(list)) = (dataset.train.get(index), seen.get_mut(index)) else { continue };
            let position = glam::Vec3::from(point.position).as_dvec3();
            let Some((_, depth)) = view.camera.project(position) else { continue };
            let slant = (position - view.camera.eye()).length() / depth;
            let [w, h] = view.camera.size_px.map(f64::from);
            let [x, y] = observation.pixel_px.map(f64::from);
            list.push(SeenPoint { at: [x / w, y / h], depth: depth * unit, slant });
        }
    }
    seen
}

fn measured(map: &DepthMap, points: &[SeenPoint], statement: Statement) -> Measured {
    /// Values of a map that a range is taken from.
    const SAMPLE: usize = 1 << 14;
    let [width, height] = map.size_px;
    let covered = map.values.iter().filter(|v| **v > 0.0).count();
    let step = covered.div_ceil(SAMPLE).max(1);
    let mut values: Vec<f32> = map.values.iter().copied().filter(|v| *v > 0.0).step_by(step).collect();
    values.sort_by(f32::total_cmp);
    let pair = |point: &SeenPoint| {
        let (x, y) = ((point.at[0] * width as f64) as usize, (point.at[1] * height as f64) as usize);
        let value = map.values.get(y.min(height - 1) * width + x.min(width - 1)).copied().filter(|v| *v > 0.0)?;
        let value = f64::from(value);
        let is_distance = statement.kind == Some(DepthKind::Distance);
        // Of a ray that begins at a plane, what is before it has the same slant.
        let value = if is_distance { value / point.slant + statement.near.unwrap_or(0.0) } else { value };
        Some(Pair { value, depth: point.depth })
    };
    let pairs: Vec<Pair> = points.iter().filter_map(pair).collect();
    let agreement = (pairs.len() >= LEAST_POINTS).then(|| agreement(&pairs)).flatten();
    Measured { size_px: map.size_px, integer_bits: map.integer_bits, values, covered, agreement }
}

fn agreement(pairs: &[Pair]) -> Option<Agreement> {
    let factor = median(pairs.iter().map(|pair| pair.depth / pair.value).collect())?;
    let [a, b] = [ranks(pairs, |pair| pair.value), ranks(pairs, |pair| pair.depth)];
    let mean = 0.5 * (pairs.len() as f64 - 1.0);
    let (mut product, mut squares) = (0.0, [0.0; 2]);
    for (a, b) in a.iter().zip(&b) {
        let (a, b) = (a - mean, b - mean);
        product += a * b;
        squares = [squares[0] + a * a, squares[1] + b * b];
    }
    let norm = (squares[0] * squares[1]).sqrt();
    (norm > 0.0).then(|| Agreement { rank_correlation: product / norm, factor })
}

/// Returns the rank of each entry, the mean of those that are equal.
fn ranks(pairs: &[Pair], of: impl Fn(&Pair) -> f64) -> Vec<f64> {
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by(|a, b| of(&pairs[*a]).total_cmp(&of(&pairs[*b])));
    let mut ranks = vec![0.0; pairs.len()];
    let mut start = 0;
    while start < order.len() {
        let same = order[start..].iter().take_while(|i| of(&pairs[**i]) == of(&pairs[order[start]])).count();
        for i in &order[start..start + same] {
            ranks[*i] = start as f64 + 0.5 * (same as f64 - 1.0);
        }
        start += same;
    }
    ranks
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().filter(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_tells_depth_from_disparity() {
        let pairs = |of: fn(f64) -> f64| (1..40).map(|i| Pair { value: of(f64::from(i)), depth: f64::from(i) }).collect::<Vec<_>>();
        let depth = agreement(&pairs(|z| 4.0 * z)).unwrap();
        assert!((depth.rank_correlation - 1.0).abs() < 1e-12 && (depth.factor - 0.25).abs() < 1e-12);
        assert!((agreement(&pairs(|z| 3.0 + 1.0 / z)).unwrap().rank_correlation + 1.0).abs() < 1e-12);
        assert_eq!(agreement(&pairs(|_| 2.0)), None);
        assert_eq!(ranks(&pairs(|z| (z / 2.0).floor())[..4], |pair| pair.value), [0.0, 1.5, 1.5, 3.0]);
    }
}
