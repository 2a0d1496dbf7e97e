//! The pose of a panorama from those of its cut-outs.
//!
//! In: [`CutoutPose`]s, one for each cut-out that was found. Out: [`PanoramaPose`]. Cut-outs of a
//! rig agree exactly; where they were found one by one, each is off, and some may be wrong:
//! rotations and places are weighted means in which one that is far from the others loses its
//! weight. Degenerate: one cut-out is the pose; none has no pose.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::Face;
use crate::world::median;

/// Rounds of reweighting.
const ROUNDS: usize = 20;
/// Deviation of a rotation that costs no weight, radians.
const USUAL_TURN_RAD: f64 = 1e-3;
/// Deviation of a place that costs no weight, as a share of the largest distance.
const USUAL_SHARE: f64 = 1e-3;

/// A cut-out that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutoutPose {
    /// Its direction.
    pub face: Face,
    /// Its pose.
    pub camera_from_world: DAffine3,
    /// Number of points that it sees.
    pub points: usize,
}

/// A panorama that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PanoramaPose {
    /// Its pose.
    pub camera_from_world: DAffine3,
    /// Largest angle between its rotation and that by one cut-out, degrees.
    pub turn_deg: f64,
    /// Largest distance between its place and that by one cut-out, world units.
    pub distance: f64,
}

/// A rotation and a place with their weight.
struct Sample {
    rotation: DQuat,
    eye: DVec3,
    weight: f64,
}

/// Returns the pose of the panorama that cut-outs belong to; `None` without any.
pub fn panorama_pose(cutouts: &[CutoutPose]) -> Option<PanoramaPose> {
    let samples: Vec<Sample> = cutouts
        .iter()
        .map(|cutout| {
            let pose = cutout.camera_from_world;
            let rotation = DQuat::from_mat3(&(cutout.face.panorama_from_cutout() * pose.matrix3)).normalize();
            Sample { rotation, eye: -(pose.matrix3.transpose() * pose.translation), weight: 1.0 + cutout.points as f64 }
        })
        .collect();
    // Begins where most of the others are near.
    let by_nearness = |distance: &dyn Fn(&Sample, &Sample) -> f64| {
        let sum = |a: &Sample| samples.iter().map(|b| b.weight * distance(a, b)).sum::<f64>();
        samples.iter().min_by(|a, b| sum(a).total_cmp(&sum(b)))
    };
    let mut rotation = by_nearness(&|a, b| a.rotation.angle_between(b.rotation))?.rotation;
    let mut eye = by_nearness(&|a, b| a.eye.distance(b.eye))?.eye;
    let reach = samples.iter().map(|sample| sample.eye.distance(eye)).fold(0.0, f64::max);
    for _ in 0..ROUNDS {
        let turns: Vec<f64> = samples.iter().map(|sample| sample.rotation.angle_between(rotation)).collect();
        let distances: Vec<f64> = samples.iter().map(|sample| sample.eye.distance(eye)).collect();
        let usual_turn = median(turns.iter().copied()).max(USUAL_TURN_RAD);
        let usual_distance = median(distances.iter().copied()).max(USUAL_SHARE * reach).max(f64::MIN_POSITIVE);
        let mut sum = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        let (mut place, mut total) = (DVec3::ZERO, 0.0);
        for ((sample, turn), distance) in samples.iter().zip(&turns).zip(&distances) {
            let sign = if sample.rotation.dot(rotation) < 0.0 { -1.0 } else { 1.0 };
            sum += sample.rotation * (sign * sample.weight / (1.0 + (turn / usual_turn).powi(2)));
            let weight = sample.weight / (1.0 + (distance / usual_distance).powi(2));
            place += weight * (sample.eye - eye);
            total += weight;
        }
        rotation = sum.normalize();
        eye += place / total;
    }
    let matrix3 = DMat3::from_quat(rotation);
    let largest = |value: &dyn Fn(&Sample) -> f64| samples.iter().map(value).fold(0.0, f64::max);
    Some(PanoramaPose {
        camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * eye) },
        turn_deg: largest(&|sample| sample.rotation.angle_between(rotation)).to_degrees(),
        distance: largest(&|sample| sample.eye.distance(eye)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose() -> DAffine3 {
        let matrix3 = DMat3::from_quat(DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize());
        DAffine3 { matrix3, translation: DVec3::new(0.4, -1.5, 2.0) }
    }

    /// The cut-out of a panorama with a pose that is off by a small rotation.
    fn cutout(face: Face, off: DVec3) -> CutoutPose {
        let exact = pose();
        let turned = DMat3::from_quat(DQuat::from_scaled_axis(off)) * exact.matrix3;
        let eye = -(exact.matrix3.transpose() * exact.translation) + off;
        let matrix3 = face.panorama_from_cutout().transpose() * turned;
        CutoutPose { face, camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * eye) }, points: 50 }
    }

    #[test]
    fn a_rig_gives_its_pose_back() {
        let found = panorama_pose(&Face::ALL.map(|face| cutout(face, DVec3::ZERO))).unwrap();
        assert!(found.camera_from_world.abs_diff_eq(pose(), 1e-12) && found.distance < 1e-12 && found.turn_deg < 1e-5, "{found:?}");
        let one = panorama_pose(&[cutout(Face::Down, DVec3::ZERO)]).unwrap();
        assert!(one.camera_from_world.abs_diff_eq(pose(), 1e-12));
        assert_eq!(panorama_pose(&[]), None);
    }

    #[test]
    fn cut_outs_that_were_found_one_by_one_are_averaged_without_the_wrong_one() {
        let off = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z].map(|axis| 0.01 * axis);
        let mut cutouts: Vec<CutoutPose> = Face::ALL.into_iter().zip(off).map(|(face, off)| cutout(face, off)).collect();
        cutouts.push(cutout(Face::Down, DVec3::new(1.0, 2.0, -0.5)));
        let found = panorama_pose(&cutouts).unwrap();
        let off = found.camera_from_world * pose().inverse();
        let turn = DQuat::from_mat3(&off.matrix3).to_scaled_axis().length();
        // The one without an opposite moves the mean by its share, 0.002.
        assert!(turn < 0.003 && off.translation.length() < 0.006, "{turn} {off:?}");
        assert!(found.distance > 2.0 && found.turn_deg > 90.0, "{found:?}");
    }
}
