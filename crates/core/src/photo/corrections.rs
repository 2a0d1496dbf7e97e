//! Corrections that a RAW file asks for: gains that undo the vignette of a lens, and warps that
//! undo its distortion.
//!
//! Places are pixels of the sensor's active area, whose width and height `area_px` are; pixel
//! centres are at +0.5. Centres and maps are relative to that area, from 0 to 1. Radii are
//! relative to the distance from the centre to the area's furthest corner. Source: DNG 1.7.1,
//! chapter 7. Degenerate: planes beyond those that are stated have the last one's numbers.

/// The corrections of a photograph, and the part of the sensor that its samples are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawCorrections {
    /// Width and height of the active area, pixels.
    pub area_px: [usize; 2],
    /// Column and row of the first sample in the active area.
    pub origin_px: [usize; 2],
    /// Gains of the samples before their mosaic is interpolated.
    pub gains: Vec<Gain>,
    /// Operations on the colours after that, in order; with any, the samples are those of the whole
    /// active area.
    pub steps: Vec<LensStep>,
    /// Part of the samples that is the picture, after the steps.
    pub crop: CropRect,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CropRect {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
}

/// An operation on the colours of all pixels.
#[derive(Clone, Debug, PartialEq)]
pub enum LensStep {
    /// Multiplies colours.
    Gain(Gain),
    /// Takes colours from elsewhere.
    Warp(Warp),
}

/// The samples of the active area that a correction covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleRegion {
    /// First row.
    pub top: usize,
    /// First column.
    pub left: usize,
    /// Row after the last.
    pub bottom: usize,
    /// Column after the last.
    pub right: usize,
    /// First plane.
    pub plane: usize,
    /// Number of planes.
    pub planes: usize,
    /// Distance of the rows that are covered.
    pub row_pitch: usize,
    /// Distance of the columns that are covered.
    pub column_pitch: usize,
}

impl SampleRegion {
    /// The region of everything.
    pub const ALL: Self =
        Self { top: 0, left: 0, bottom: usize::MAX, right: usize::MAX, plane: 0, planes: usize::MAX, row_pitch: 1, column_pitch: 1 };

    /// Returns whether a sample is covered.
    #[inline]
    pub fn contains(&self, [x, y]: [usize; 2], plane: usize) -> bool {
        self.has_row(y)
            && (self.left..self.right).contains(&x)
            && (x - self.left).is_multiple_of(self.column_pitch.max(1))
            && plane >= self.plane
            && plane - self.plane < self.planes
    }

    /// Returns whether samples of a row are covered.
    #[inline]
    pub fn has_row(&self, y: usize) -> bool {
        (self.top..self.bottom).contains(&y) && (y - self.top).is_multiple_of(self.row_pitch.max(1))
    }
}

/// Gains, all above 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Gain {
    /// The samples that are multiplied.
    pub region: SampleRegion,
    /// The gain by place.
    pub shape: GainShape,
    /// Whether planes are colours; else the samples of a mosaic are of plane 0.
    pub is_by_color: bool,
}

/// Gains by place.
#[derive(Clone, Debug, PartialEq)]
pub enum GainShape {
    /// 1 + k0 r^2 + k1 r^4 + ... about a centre (x, y).
    Radial {
        /// k0 to k4.
        coefficients: [f64; 5],
        /// Relative centre.
        center: [f64; 2],
    },
    /// Values on a grid, between which gains are bilinear, and beyond which they stay.
    Map(GainMap),
    /// One gain for each covered row.
    Rows(Vec<f32>),
    /// One gain for each covered column.
    Columns(Vec<f32>),
}

/// Gains on a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GainMap {
    /// Columns and rows of the grid.
    pub points: [usize; 2],
    /// Relative distance of columns and rows.
    pub spacing: [f64; 2],
    /// Relative place of the first point.
    pub origin: [f64; 2],
    /// Number of planes.
    pub planes: usize,
    /// `[rows, columns, planes]`.
    pub values: Vec<f32>,
}

impl GainMap {
    /// Returns the gain at a relative place.
    fn at(&self, place: [f64; 2], plane: usize) -> f32 {
        let plane = plane.min(self.planes.saturating_sub(1));
        let along = [0, 1].map(|i| {
            let last = self.points[i].saturating_sub(1);
            let at = ((place[i] - self.origin[i]) / self.spacing[i]).clamp(0.0, last as f64);
            // A grid of one point has no spacing.
            let at = if at.is_finite() { at } else { 0.0 };
            (at as usize, (at as usize + 1).min(last), at.fract())
        });
        let value = |x: usize, y: usize| self.values.get((y * self.points[0] + x) * self.planes + plane).copied().unwrap_or(1.0);
        let [(x0, x1, fx), (y0, y1, fy)] = along;
        let mix = |a: f32, b: f32, f: f64| f64::from(a) + (f64::from(b) - f64::from(a)) * f;
        let (top, bottom) = (mix(value(x0, y0), value(x1, y0), fx), mix(value(x0, y1), value(x1, y1), fx));
        (top + (bottom - top) * fy) as f32
    }
}

impl Gain {
    /// Multiplies `out`, the gains of a row's samples (`per_pixel` for each pixel from column
    /// `left` of the active area on); `plane` is the plane of sample `i` of the row.
    pub fn multiply_row(
        &self,
        area_px: [usize; 2],
        [left, y]: [usize; 2],
        per_pixel: usize,
        plane: impl Fn(usize) -> usize,
        out: &mut [f32],
    ) {
        if !self.region.has_row(y) {
            return;
        }
        let radii = self.radii(area_px);
        let (region, rows) = (&self.region, (y - self.region.top) / self.region.row_pitch.max(1));
        for (i, out) in out.iter_mut().enumerate() {
            let (x, plane) = (left + i / per_pixel.max(1), plane(i));
            if !region.contains([x, y], plane) {
                continue;
            }
            let place = [x as f64 + 0.5, y as f64 + 0.5];
            *out *= match &self.shape {
                GainShape::Radial { coefficients, .. } => radial_gain(coefficients, radii.squared(place)) as f32,
                GainShape::Map(map) => map.at([place[0] / area_px[0] as f64, place[1] / area_px[1] as f64], plane - region.plane),
                GainShape::Rows(values) => values.get(rows).copied().unwrap_or(1.0),
                GainShape::Columns(values) => values.get((x - region.left) / region.column_pitch.max(1)).copied().unwrap_or(1.0),
            };
        }
    }

    fn radii(&self, area_px: [usize; 2]) -> Radii {
        match &self.shape {
            GainShape::Radial { center, .. } => Radii::new(area_px, *center),
            _ => Radii::new(area_px, [0.5; 2]),
        }
    }

    /// Returns whether all gains are finite and above 0.
    pub fn is_valid(&self) -> bool {
        let is_good = |gain: f64| gain.is_finite() && gain > 0.0;
        match &self.shape {
            GainShape::Radial { coefficients, center } => {
                let steps = 1 << 10;
                center.iter().all(|v| v.is_finite())
                    && (0..=steps).all(|i| is_good(radial_gain(coefficients, f64::from(i) / f64::from(steps))))
            }
            GainShape::Map(GainMap { values, .. }) | GainShape::Rows(values) | GainShape::Columns(values) => {
                values.iter().all(|v| is_good(f64::from(*v)))
            }
        }
    }
}

fn radial_gain(coefficients: &[f64; 5], r2: f64) -> f64 {
    1.0 + coefficients.iter().rev().fold(0.0, |sum, k| r2 * (sum + k))
}

/// Radii about a centre.
#[derive(Clone, Copy, Debug)]
struct Radii {
    center_px: [f64; 2],
    furthest_px: f64,
}

impl Radii {
    fn new(area_px: [usize; 2], center: [f64; 2]) -> Self {
        let center_px = [0, 1].map(|i| center[i] * area_px[i] as f64);
        let furthest = |i: usize| center_px[i].abs().max((area_px[i] as f64 - center_px[i]).abs());
        Self { center_px, furthest_px: furthest(0).hypot(furthest(1)).max(f64::MIN_POSITIVE) }
    }

    /// Returns a place from the centre, relative.
    fn relative(&self, place: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|i| (place[i] - self.center_px[i]) / self.furthest_px)
    }

    /// Returns the square of a place's radius, at most 1.
    fn squared(&self, place: [f64; 2]) -> f64 {
        let [x, y] = self.relative(place);
        (x * x + y * y).min(1.0)
    }
}

/// The places in a distorted picture that the colours of one without distortion come from.
#[derive(Clone, Debug, PartialEq)]
pub struct Warp {
    /// Numbers of each plane, at least one.
    pub planes: Vec<WarpPlane>,
    /// Relative centre, x and y.
    pub center: [f64; 2],
    /// How numbers make a factor of radii.
    pub kind: WarpKind,
}

/// How the numbers of a warp make the factor by which a radius r grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WarpKind {
    /// The polynomial.
    Rectilinear,
    /// One over the polynomial.
    Reciprocal,
    /// k0 t + k1 t^3 + k2 t^5 + k3 t^7 over r, of the angle t = atan(r).
    Fisheye,
}

/// Numbers of a warp for one plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WarpPlane {
    /// Coefficients of r^0, r^1 and so on.
    pub radial: [f64; 15],
    /// Tangential coefficients.
    pub tangential: [f64; 2],
    /// Radii within which the polynomial holds; beyond, the factor stays.
    pub valid: [f64; 2],
}

impl Warp {
    /// Returns whether all numbers are finite and the valid radii a range.
    pub fn is_valid(&self) -> bool {
        let plane = |p: &WarpPlane| {
            let is_range = p.valid[0] >= 0.0 && p.valid[0] < p.valid[1] && p.valid[1] <= 1.0;
            is_range && p.radial.iter().chain(&p.tangential).all(|v| v.is_finite())
        };
        !self.planes.is_empty() && self.planes.iter().all(plane) && self.center.iter().all(|v| (0.0..=1.0).contains(v))
    }

    /// Returns whether all planes move alike, so that each pixel moves as a whole.
    pub fn is_of_all_planes(&self) -> bool {
        self.planes.windows(2).all(|pair| pair[0] == pair[1])
    }

    /// Returns the place that the colour of `plane` at `place` comes from.
    pub fn source(&self, area_px: [usize; 2], plane: usize, place: [f64; 2]) -> [f64; 2] {
        let Some(numbers) = self.planes.get(plane).or(self.planes.last()) else { return place };
        let radii = Radii::new(area_px, self.center);
        let [x, y] = radii.relative(place);
        let r2 = radii.squared(place);
        let factor = self.factor(numbers, r2);
        let [t0, t1] = numbers.tangential;
        let bent = [x * factor + t1 * (r2 + 2.0 * x * x) + 2.0 * t0 * x * y, y * factor + t0 * (r2 + 2.0 * y * y) + 2.0 * t1 * x * y];
        [0, 1].map(|i| radii.center_px[i] + radii.furthest_px * bent[i])
    }

    fn factor(&self, numbers: &WarpPlane, r2: f64) -> f64 {
        let r = r2.sqrt();
        if self.kind == WarpKind::Fisheye {
            let [k0, k1, k2, k3, ..] = numbers.radial;
            let t = r.atan();
            let t2 = t * t;
            let bent = t * (k0 + t2 * (k1 + t2 * (k2 + t2 * k3)));
            return if r < 1e-6 { k0 } else { bent / r };
        }
        let r = r.clamp(numbers.valid[0], numbers.valid[1]);
        let polynomial = numbers.radial.iter().rev().fold(0.0, |sum, k| sum * r + k);
        if self.kind == WarpKind::Reciprocal { 1.0 / polynomial } else { polynomial }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(gain: &Gain, area_px: [usize; 2], y: usize) -> Vec<f32> {
        let mut out = vec![1.0; area_px[0]];
        gain.multiply_row(area_px, [0, y], 1, |_| 0, &mut out);
        out
    }

    #[test]
    fn radial_gains_grow_with_the_distance_to_the_furthest_corner() {
        let shape = GainShape::Radial { coefficients: [1.0, 2.0, 0.0, 0.0, 4.0], center: [0.0, 0.5] };
        let gain = Gain { region: SampleRegion::ALL, shape, is_by_color: true };
        assert!(gain.is_valid());
        // Centre (0, 2), furthest corners (4, 0) and (4, 4): r^2 is (dx^2 + dy^2) / 20.
        let r2 = (3.5f64 * 3.5 + 0.25) / 20.0;
        let expected = 1.0 + r2 + 2.0 * r2.powi(2) + 4.0 * r2.powi(5);
        assert!((f64::from(row(&gain, [4, 4], 2)[3]) - expected).abs() < 1e-6);
        let dark = GainShape::Radial { coefficients: [-2.0, 0.0, 0.0, 0.0, 0.0], center: [0.5; 2] };
        assert!(!Gain { shape: dark, ..gain }.is_valid());
    }

    #[test]
    fn maps_are_bilinear_within_and_constant_beyond() {
        // Points at x = 0.25 and 0.75, y = 0 and 1, on an area of 8 x 2.
        let map = GainMap { points: [2, 2], spacing: [0.5, 1.0], origin: [0.25, 0.0], planes: 1, values: vec![1.0, 3.0, 5.0, 7.0] };
        let gain = Gain { region: SampleRegion::ALL, shape: GainShape::Map(map), is_by_color: false };
        // Row 0 is at y = 0.25: a quarter from the first row of points to the second.
        assert_eq!(row(&gain, [8, 2], 0), [2.0, 2.0, 2.25, 2.75, 3.25, 3.75, 4.0, 4.0]);
    }

    #[test]
    fn regions_cover_every_second_sample() {
        let region = SampleRegion { top: 1, left: 1, bottom: 4, right: 6, plane: 0, planes: 1, row_pitch: 2, column_pitch: 2 };
        let gain = Gain { region, shape: GainShape::Columns(vec![2.0, 3.0, 4.0]), is_by_color: false };
        assert_eq!(row(&gain, [8, 4], 0), [1.0; 8]);
        assert_eq!(row(&gain, [8, 4], 3), [1.0, 2.0, 1.0, 3.0, 1.0, 4.0, 1.0, 1.0]);
        let rows = Gain { shape: GainShape::Rows(vec![2.0, 5.0]), ..gain };
        assert_eq!(row(&rows, [8, 4], 3), [1.0, 5.0, 1.0, 5.0, 1.0, 5.0, 1.0, 1.0]);
    }

    fn plane(even: [f64; 4], tangential: [f64; 2]) -> WarpPlane {
        let mut radial = [0.0; 15];
        even.iter().enumerate().for_each(|(i, k)| radial[2 * i] = *k);
        WarpPlane { radial, tangential, valid: [0.0, 1.0] }
    }

    #[test]
    fn warps_are_those_of_the_specification() {
        let area = [30, 40];
        let warp = Warp { planes: vec![plane([1.0, -0.1, 0.02, 0.0], [0.01, -0.02])], center: [0.5; 2], kind: WarpKind::Rectilinear };
        // Half a diagonal is 25 pixels, and (24, 12) is (0.36, -0.32) from the centre.
        let (x, y) = (0.36, -0.32);
        let r2: f64 = 0.36 * 0.36 + 0.32 * 0.32;
        let factor = 1.0 - 0.1 * r2 + 0.02 * r2 * r2;
        let expected = [
            15.0 + 25.0 * (factor * x - 0.02 * (r2 + 2.0 * x * x) + 0.02 * x * y),
            20.0 + 25.0 * (factor * y + 0.01 * (r2 + 2.0 * y * y) - 0.04 * x * y),
        ];
        let found = warp.source(area, 2, [24.0, 12.0]);
        assert!((0..2).all(|i| (found[i] - expected[i]).abs() < 1e-12), "{found:?} {expected:?}");
        assert!(warp.is_valid() && !Warp { center: [0.5, 1.5], ..warp.clone() }.is_valid());
        let reciprocal = Warp { planes: vec![plane([2.0, 0.0, 0.0, 0.0], [0.0; 2])], kind: WarpKind::Reciprocal, ..warp.clone() };
        assert_eq!(reciprocal.source(area, 0, [25.0, 30.0]), [20.0, 25.0]);
        // An equidistant fisheye whose focal length is the furthest radius.
        let fisheye = Warp { planes: vec![plane([1.0, 0.0, 0.0, 0.0], [0.0; 2])], kind: WarpKind::Fisheye, ..warp };
        // The fisheye's coefficients are consecutive.
        assert!((fisheye.source(area, 0, [30.0, 20.0])[0] - (15.0 + 25.0 * 0.6f64.atan())).abs() < 1e-12);
    }
}
