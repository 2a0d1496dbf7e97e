//! Scale and heading from positions by GPS.
//!
//! In: cameras' places in the world and where GPS says that they are. Out: [`GpsFit`], or why there
//! is none. Phones place a photograph to a few metres, so a fit counts only where positions are far
//! apart compared with what is left of it. Fits are robust: the one with the least median residual
//! through a few positions, then reweighted.
//!
//! Units: degrees on WGS 84; metres east, up and north of the middle position.

use glam::{DMat3, DQuat, DVec3};
use luxel_core::Similarity;
use luxel_core::photo::GpsPosition;
use serde::{Deserialize, Serialize};

use super::choice::Choice;
use super::eigen::{eigen, eigen3, median, median_point, outer};

/// Fit of the cameras' places to their positions by GPS.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GpsFit {
    /// Number of views with a position.
    pub views: usize,
    /// Number of them that agree with the fit.
    pub used: usize,
    /// Median distance between a camera and its position, metres.
    pub residual_m: f64,
    /// Root mean square distance of the cameras from their middle, metres.
    pub spread_m: f64,
    /// Metres in a unit of the model.
    pub metres_per_unit: f64,
    /// Standard error of that, as a share, if positions are off independently.
    pub relative_error: f64,
}

/// A camera's place with its position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub(super) world: DVec3,
    /// Metres along x, down and north, as the world's axes will be.
    pub(super) metres: DVec3,
}

/// Semi-major axis of WGS 84, metres.
const EQUATOR_M: f64 = 6_378_137.0;
/// Square of its first eccentricity.
const ECCENTRICITY_2: f64 = 6.694_379_990_141_317e-3;
/// Trials of a fit.
const TRIALS: usize = 400;
const ROUNDS: usize = 20;
/// Least number of positions.
const LEAST_POSITIONS: usize = 3;
/// Least spread of positions, metres.
const LEAST_SPREAD_M: f64 = 2.0;
/// Least spread over the residual's standard deviation.
const LEAST_RATIO: f64 = 4.0;
/// From the median of residuals in a plane to a standard deviation along one axis, of a normal
/// distribution.
const DEVIATION_PER_MEDIAN: f64 = 0.849;

/// Returns metres east, down and north of the middle position, as x, y and z.
pub fn metres_of(positions: &[GpsPosition]) -> Vec<DVec3> {
    let middle = |f: fn(&GpsPosition) -> f64| median(positions.iter().map(f));
    // Without an altitude all are level.
    let altitude = |p: &GpsPosition| p.altitude_m.unwrap_or(0.0);
    let has_all = positions.iter().all(|p| p.altitude_m.is_some());
    let height = |p: &GpsPosition| if has_all { altitude(p) } else { 0.0 };
    let (lat0, lon0) = (middle(|p| p.latitude_deg), middle(|p| p.longitude_deg));
    let (sin0, cos0) = lat0.to_radians().sin_cos();
    let at = |lat_deg: f64, lon_deg: f64, height: f64| {
        let (sin, cos) = lat_deg.to_radians().sin_cos();
        // From the middle's meridian: positions on both sides of 180 degrees are near each other.
        let (east, toward) = (lon_deg - lon0).to_radians().sin_cos();
        let n = EQUATOR_M / (1.0 - ECCENTRICITY_2 * sin * sin).sqrt();
        DVec3::new((n + height) * cos * toward, (n + height) * cos * east, (n * (1.0 - ECCENTRICITY_2) + height) * sin)
    };
    let origin = at(lat0, lon0, 0.0);
    let local = |p: &GpsPosition| {
        let d = at(p.latitude_deg, p.longitude_deg, height(p)) - origin;
        DVec3::new(d.y, -(cos0 * d.x + sin0 * d.z), cos0 * d.z - sin0 * d.x)
    };
    positions.iter().map(local).collect()
}

/// Whether a fit turns about the vertical only, or any way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Freedom {
    Level,
    Free,
}

/// Fits a world that is level, -y up: scale and heading by east and north alone, because GPS is
/// worse in altitude.
pub(super) fn level_fit(pairs: &[Pair]) -> Result<(GpsFit, Similarity), String> {
    let flat = |p: DVec3| DVec3::new(p.x, 0.0, p.z);
    let flat: Vec<Pair> = pairs.iter().map(|pair| Pair { world: flat(pair.world), metres: flat(pair.metres) }).collect();
    let (fit, similarity, _) = robust_fit(&flat, Freedom::Level)?;
    Ok((fit, similarity))
}

/// Returns the up direction by positions in three dimensions; `None` unless they extend in two
/// directions far beyond their errors.
pub(super) fn up_by_positions(pairs: &[Pair]) -> Option<DVec3> {
    let (fit, similarity, weights) = robust_fit(pairs, Freedom::Free).ok()?;
    let middle = median_point(&pairs.iter().map(|p| p.metres).collect::<Vec<_>>());
    let spread = pairs.iter().zip(&weights).map(|(p, w)| outer(p.metres - middle) * *w).fold(DMat3::ZERO, |a, b| a + b);
    let second = (eigen3(&spread)[1].0 / weights.iter().sum::<f64>()).max(0.0).sqrt();
    let deviation = DEVIATION_PER_MEDIAN * fit.residual_m;
    (second > LEAST_SPREAD_M && second > 2.0 * LEAST_RATIO * deviation).then(|| similarity.rotation().transpose() * DVec3::NEG_Y)
}

fn robust_fit(pairs: &[Pair], freedom: Freedom) -> Result<(GpsFit, Similarity, Vec<f64>), String> {
    if pairs.len() < LEAST_POSITIONS {
        return Err(format!("{} of the views with a pose have a GPS position, expected {LEAST_POSITIONS} or more", pairs.len()));
    }
    let one = "all GPS positions are one";
    let mut similarity = least_median(pairs, freedom).ok_or(one)?;
    let mut weights = vec![1.0; pairs.len()];
    for _ in 0..ROUNDS {
        let residuals = residuals(&similarity, pairs);
        // Beyond three times the usual distance a position has no weight.
        let usual = 3.0 * median(residuals.iter().copied()).max(1e-3);
        weights = residuals.iter().map(|r| (1.0 - (r / usual).powi(2)).max(0.0).powi(2)).collect();
        similarity = weighted_fit(pairs, &weights, freedom).ok_or(one)?;
    }
    let used: Vec<usize> = (0..pairs.len()).filter(|i| weights[*i] > 0.0).collect();
    let residuals = residuals(&similarity, pairs);
    let residual_m = median(used.iter().map(|i| residuals[*i]));
    let middle = used.iter().map(|i| pairs[*i].metres).sum::<DVec3>() / used.len().max(1) as f64;
    let square = used.iter().map(|i| pairs[*i].metres.distance_squared(middle)).sum::<f64>() / used.len().max(1) as f64;
    let (spread_m, deviation) = (square.sqrt(), DEVIATION_PER_MEDIAN * residual_m);
    if spread_m < LEAST_SPREAD_M || spread_m < LEAST_RATIO * deviation {
        return Err(format!(
            "GPS positions are {spread_m:.1} m apart (root mean square from their middle) and {residual_m:.1} m off the cameras (median), \
             expected {LEAST_SPREAD_M:.0} m or more and {LEAST_RATIO:.0} times as far apart as they are off"
        ));
    }
    if 2 * used.len() <= pairs.len() {
        return Err(format!("{} of {} GPS positions agree with the cameras, expected more than half", used.len(), pairs.len()));
    }
    let fit = GpsFit {
        views: pairs.len(),
        used: used.len(),
        residual_m,
        spread_m,
        metres_per_unit: similarity.scale(),
        relative_error: deviation / (spread_m * (used.len() as f64).sqrt()),
    };
    Ok((fit, similarity, weights))
}

fn residuals(similarity: &Similarity, pairs: &[Pair]) -> Vec<f64> {
    pairs.iter().map(|pair| similarity.point(pair.world).distance(pair.metres)).collect()
}

/// Returns the fit through a few pairs whose median residual is least.
fn least_median(pairs: &[Pair], freedom: Freedom) -> Option<Similarity> {
    let needed = if freedom == Freedom::Level { 2 } else { 3 };
    let mut choice = Choice(7);
    let mut best: Option<(f64, Similarity)> = None;
    for trial in 0..TRIALS {
        let mut weights = vec![if trial == 0 { 1.0 } else { 0.0 }; pairs.len()];
        (0..needed).for_each(|_| weights[choice.below(pairs.len())] = 1.0);
        let Some(similarity) = weighted_fit(pairs, &weights, freedom) else { continue };
        let residual = median(residuals(&similarity, pairs));
        if best.is_none_or(|(least, _)| residual < least) {
            best = Some((residual, similarity));
        }
    }
    best.map(|(_, similarity)| similarity)
}

/// Returns the similarity with the least weighted sum of squares (Horn 1987); `None` where places
/// coincide.
fn weighted_fit(pairs: &[Pair], weights: &[f64], freedom: Freedom) -> Option<Similarity> {
    let total: f64 = weights.iter().sum();
    let mean = |f: fn(&Pair) -> DVec3| pairs.iter().zip(weights).map(|(p, w)| f(p) * *w).sum::<DVec3>() / total;
    let (from, to) = (mean(|p| p.world), mean(|p| p.metres));
    let mut s = [[0.0; 3]; 3];
    let mut square = 0.0;
    for (pair, w) in pairs.iter().zip(weights) {
        let (a, b) = (pair.world - from, pair.metres - to);
        square += w * a.length_squared();
        (0..3).for_each(|i| (0..3).for_each(|j| s[i][j] += w * a[i] * b[j]));
    }
    let rotation = match freedom {
        Freedom::Level => DMat3::from_rotation_y((s[2][0] - s[0][2]).atan2(s[0][0] + s[2][2])),
        Freedom::Free => horn(&s),
    };
    let along = pairs.iter().zip(weights).map(|(pair, w)| w * (pair.metres - to).dot(rotation * (pair.world - from))).sum::<f64>();
    let scale = along / square;
    Similarity::new(rotation, scale, to - scale * (rotation * from))
}

/// Returns the rotation that a covariance of places determines, by the largest eigenvector of
/// Horn's matrix.
fn horn(s: &[[f64; 3]; 3]) -> DMat3 {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *s;
    let matrix = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    let [w, x, y, z] = eigen(matrix)[0].vector;
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
}
