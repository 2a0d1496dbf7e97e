//! Similarity transforms of a scene: rotation, uniform scale and translation of splats and cameras.
//!
//! In: [`Splats`] or a [`Camera`], in place. Out: the same in the new world. Positions are
//! p' = s R p + t, rotations q' = q_R q; standard deviations and the 3D filter are multiplied by s.
//! Harmonics are rotated band by band ([`BandRotation`]), so that a splat has the same colour from
//! the rotated direction as before. Quarter turns about an axis keep positions bit-identical, up to
//! sign and order.
//!
//! Degenerate: [`Similarity::new`] refuses a matrix that is not a rotation.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::sh::{self, MAX_COEFFICIENTS};
use crate::{Camera, Component, Splats, least_squares};

/// The transform p' = scale rotation p + translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    rotation: DMat3,
    scale: f64,
    translation: DVec3,
}

impl Default for Similarity {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Similarity {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, scale: 1.0, translation: DVec3::ZERO };

    /// Returns the transform; `None` if `rotation` is not a rotation to 1e-5, `scale` is not
    /// positive or a value is not finite.
    pub fn new(rotation: DMat3, scale: f64, translation: DVec3) -> Option<Self> {
        let is_rotation = (rotation * rotation.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-5) && rotation.determinant() > 0.0;
        let is_usable = is_rotation && scale.is_normal() && scale > 0.0 && translation.is_finite();
        is_usable.then_some(Self { rotation, scale, translation })
    }

    /// Returns the transform that only multiplies lengths; the identity for a factor that is not
    /// positive.
    pub fn scaling(scale: f64) -> Self {
        Self::new(DMat3::IDENTITY, scale, DVec3::ZERO).unwrap_or(Self::IDENTITY)
    }

    /// Returns the transform that only rotates; `None` if `rotation` is not a rotation.
    pub fn turn(rotation: DMat3) -> Option<Self> {
        Self::new(rotation, 1.0, DVec3::ZERO)
    }

    /// Returns the transform without its translation.
    #[must_use]
    pub fn linear(&self) -> Self {
        Self { translation: DVec3::ZERO, ..*self }
    }

    /// Returns the place of the old origin in the new world.
    pub fn translation(&self) -> DVec3 {
        self.translation
    }

    /// Returns the transform that applies `self` first and `next` after it.
    pub fn then(&self, next: &Self) -> Self {
        if self.is_identity() {
            return *next;
        }
        let rotation = next.rotation * self.rotation;
        Self { rotation, scale: next.scale * self.scale, translation: next.point(self.translation) }
    }

    /// Returns the rotation's matrix.
    pub fn rotation(&self) -> DMat3 {
        self.rotation
    }

    /// Returns the factor of lengths.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Returns directions, turned.
    pub fn turned(&self, directions: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let rotation = self.rotation().as_mat3();
        directions.iter().map(|direction| (rotation * glam::Vec3::from(*direction)).to_array()).collect()
    }

    /// Returns whether the transform changes nothing.
    pub fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// Returns the inverse transform.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        let scale = 1.0 / self.scale;
        Self { rotation, scale, translation: -(scale * (rotation * self.translation)) }
    }

    /// Returns the point `p` in the new world.
    pub fn point(&self, p: DVec3) -> DVec3 {
        if self.is_identity() {
            // The sign of zeros, too.
            return p;
        }
        self.scale * (self.rotation * p) + self.translation
    }

    /// Moves a camera so that it sees the same in the new world as in the old one, with depths
    /// multiplied by the scale.
    pub fn apply_to_camera(&self, camera: &mut Camera) {
        self.apply_to_pose(&mut camera.camera_from_world);
    }

    /// Changes a pose as [`Self::apply_to_camera`] does.
    pub fn apply_to_pose(&self, camera_from_world: &mut DAffine3) {
        if self.is_identity() {
            return;
        }
        let matrix3 = camera_from_world.matrix3 * self.rotation.transpose();
        // Not by way of the eye: a matrix of few digits would displace a camera far from the
        // origin.
        let translation = self.scale * camera_from_world.translation - matrix3 * self.translation;
        *camera_from_world = DAffine3 { matrix3, translation };
    }

    /// Transforms splats.
    pub fn apply(&self, splats: &mut Splats) {
        if self.is_identity() {
            return;
        }
        for position in &mut splats.position {
            *position = self.point(DVec3::from_array(position.map(f64::from))).to_array().map(|v| v as f32);
        }
        let log = self.scale.ln() as f32;
        splats.log_scale.as_flattened_mut().iter_mut().for_each(|s| *s += log);
        splats.smoothing.iter_mut().for_each(|s| *s = (f64::from(*s) * self.scale) as f32);
        if self.rotation == DMat3::IDENTITY {
            return;
        }
        let turn = DQuat::from_mat3(&self.rotation);
        for rotation in &mut splats.rotation {
            let [w, x, y, z] = rotation.map(f64::from);
            let q = turn * DQuat::from_xyzw(x, y, z, w);
            *rotation = [q.w, q.x, q.y, q.z].map(|v| v as f32);
        }
        let model = splats.color_model;
        let bands = BandRotation::new(model.max_degree(), self.rotation);
        // A model without luminance has M = 0, which is no valid chunk length.
        let (k, m) = (model.sh_coefficients(), model.luminance_coefficients().max(1));
        for Component { light, sh: first_sh, luminance: first_luminance, .. } in model.components() {
            splats.sh.chunks_exact_mut(3 * k).for_each(|sh| bands.apply(&mut sh[3 * first_sh..], 3, light.sh_degree()));
            let raw = splats.raw_luminance.chunks_exact_mut(m);
            raw.for_each(|raw| bands.apply(&mut raw[first_luminance..], 1, light.luminance_degree()));
        }
    }
}

/// Matrices that rotate the harmonics of each band: f'(v) = f(R^T v) for f = sum k_m Y_m.
///
/// They come from a least-squares fit over fixed directions. A band is closed under rotations, so
/// the fit is exact, and the signs and order of the basis are written down once only.
pub struct BandRotation {
    /// Square matrix of each band l from 1 on, `[2 l + 1, 2 l + 1]`, row by row.
    bands: Vec<Vec<f64>>,
}

/// Number of directions of the fit: more than four times the harmonics of any one band.
const DIRECTIONS: usize = 64;

impl BandRotation {
    /// Returns the matrices for bands up to `degree`.
    pub fn new(degree: usize, rotation: DMat3) -> Self {
        let inverse = rotation.transpose();
        let values = |v: DVec3| {
            let mut y = [0f64; MAX_COEFFICIENTS];
            sh::basis(degree, v.to_array(), &mut y);
            y
        };
        let directions: Vec<DVec3> = sh::lattice(DIRECTIONS).into_iter().map(|v| DVec3::from_array(v.map(f64::from)).normalize()).collect();
        let pairs: Vec<_> = directions.into_iter().map(|v| [v, inverse * v].map(values)).collect();
        Self { bands: (1..=degree).map(|band| fit_band(band, &pairs)).collect() }
    }

    /// Rotates harmonics `[K, width]` of `degree`; the constant term stays.
    pub fn apply(&self, coefficients: &mut [f32], width: usize, degree: usize) {
        for (band, matrix) in (1..=degree).zip(&self.bands) {
            let size = 2 * band + 1;
            let start = width * sh::coefficients(band - 1);
            let Some(part) = coefficients.get_mut(start..start + width * size) else { return };
            for channel in 0..width {
                let mut turned = [0f64; 2 * sh::MAX_DEGREE + 1];
                for (sum, row) in turned.iter_mut().zip(matrix.chunks_exact(size)) {
                    *sum = row.iter().zip(part.iter().skip(channel).step_by(width)).map(|(d, k)| d * f64::from(*k)).sum();
                }
                part.iter_mut().skip(channel).step_by(width).zip(turned).for_each(|(k, sum)| *k = sum as f32);
            }
        }
    }
}

/// Returns (B^T B)^-1 B^T C, where B and C are the basis values at the directions and at those
/// rotated back.
fn fit_band(band: usize, pairs: &[[[f64; MAX_COEFFICIENTS]; 2]]) -> Vec<f64> {
    let (first, size) = (sh::coefficients(band - 1), 2 * band + 1);
    let sum = |i: usize, j: usize, of: usize| pairs.iter().map(|pair| pair[0][first + i] * pair[of][first + j]).sum::<f64>();
    // Rows of [B^T B | B^T C].
    let row = |i: usize| (0..size).map(|j| sum(i, j, 0)).chain((0..size).map(|j| sum(i, j, 1))).collect();
    least_squares::solve((0..size).map(row).collect()).concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Activation, ColorModel, synthetic};

    fn some_turn() -> DMat3 {
        DMat3::from_quat(DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize())
    }

    #[test]
    fn a_turned_splat_has_its_colour_in_the_turned_direction() {
        let lcd = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 2, activation: Activation::Exp };
        for model in [ColorModel::Sh { degree: 3 }, ColorModel::Sh { degree: 5 }, lcd] {
            let mut before = synthetic::room(20, 2).with_color_model(model).unwrap();
            before.raw_luminance.iter_mut().enumerate().for_each(|(i, l)| *l += 0.1 * (i as f32).sin());
            let mut after = before.clone();
            let turn = Similarity::turn(some_turn()).unwrap();
            turn.apply(&mut after);
            after.validate().unwrap();
            for i in 0..before.len() {
                for v in [DVec3::X, DVec3::new(0.0, 0.6, 0.8), DVec3::new(-0.48, 0.64, -0.6)] {
                    let (a, b) = (before.radiance(i, v.to_array().map(|c| c as f32)), turn.rotation * v);
                    let b = after.radiance(i, b.to_array().map(|c| c as f32));
                    assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-5 * (1.0 + a[c])), "{}: {a:?} {b:?}", model.name());
                }
            }
            turn.inverse().apply(&mut after);
            let error = after.sh.iter().zip(&before.sh).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(error < 1e-5, "{error}");
        }
    }

    #[test]
    fn quarter_turns_keep_positions_to_the_bit() {
        let before = synthetic::room(20, 2);
        let mut after = before.clone();
        let quarter = Similarity::turn(DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z)).unwrap();
        quarter.apply(&mut after);
        for (a, b) in after.position.iter().zip(&before.position) {
            assert_eq!(*a, [b[0], -b[1], -b[2]]);
        }
    }

    #[test]
    fn cameras_follow_the_scene() {
        let similarity = Similarity::new(some_turn(), 2.5, DVec3::new(1.0, -2.0, 0.5)).unwrap();
        let camera = synthetic::room_camera([64, 48]);
        let mut moved = camera.clone();
        similarity.apply_to_camera(&mut moved);
        let point = DVec3::new(0.3, -0.2, 3.0);
        let ((a, depth), (b, moved_depth)) = (camera.project(point).unwrap(), moved.project(similarity.point(point)).unwrap());
        assert!((a - b).length() < 1e-9 && (moved_depth - 2.5 * depth).abs() < 1e-9);
        assert!((similarity.inverse().point(similarity.point(point)) - point).length() < 1e-12);
    }

    #[test]
    fn what_is_no_similarity_is_refused() {
        assert_eq!(Similarity::turn(DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))), None);
        assert_eq!(Similarity::turn(DMat3::from_diagonal(DVec3::splat(2.0))), None);
        assert_eq!(Similarity::new(DMat3::IDENTITY, 0.0, DVec3::ZERO), None);
        assert_eq!(Similarity::new(DMat3::IDENTITY, 1.0, DVec3::NAN), None);
    }
}
