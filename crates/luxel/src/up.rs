//! Which direction of a scene is up, and the turn from there to a format's axes.
//!
//! In: the user's choice, or the cameras of a data set. Out: rotations by quarters. Degenerate:
//! cameras without a common up direction leave -y.

use glam::{DMat3, DVec3};
use luxel_core::{Dataset, Similarity};

use crate::Result;
use crate::error::Context;

/// The direction of the scene that is up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Up {
    /// The axis nearest to the cameras' up direction, -y without a data set; formats whose axes are
    /// those of 3D Gaussian splatting are not rotated.
    #[default]
    Default,
    /// The axes stay as they are.
    AsIs,
    /// This axis: a unit vector along x, y or z.
    Axis(DVec3),
}

/// The up axis of a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpAxis {
    /// PLY as 3D Gaussian splatting writes it, and SPZ: right, down, forward.
    MinusY,
    /// USD as written here, glTF, environment maps: right, up, back.
    PlusY,
}

/// Returns the rotation that takes the scene's up axis to the format's, and the factor of lengths.
///
/// # Errors
/// A factor that is not a positive finite number.
pub fn file_from_world(up: Up, target: UpAxis, dataset: Option<&Dataset>, scale: f32) -> Result<Similarity> {
    let rotation = turn_to_up(up, target, dataset, &DMat3::IDENTITY);
    Similarity::new(rotation, f64::from(scale), DVec3::ZERO).context("the factor of lengths is out of range")
}

/// Returns the quarter turn that takes the up axis of a scene that was `turned` to the format's.
pub(crate) fn turn_to_up(up: Up, target: UpAxis, dataset: Option<&Dataset>, turned: &DMat3) -> DMat3 {
    let up = match (up, target) {
        (Up::Axis(axis), _) => Some(axis),
        (Up::AsIs, _) | (Up::Default, UpAxis::MinusY) => None,
        (Up::Default, UpAxis::PlusY) => Some(nearest_axis(*turned * dataset.and_then(up_of_cameras).unwrap_or(DVec3::NEG_Y))),
    };
    let to = match target {
        UpAxis::MinusY => DVec3::NEG_Y,
        UpAxis::PlusY => DVec3::Y,
    };
    up.map_or(DMat3::IDENTITY, |up| quarter_turn(up, to))
}

/// Returns the mean up direction of the cameras.
pub fn up_of_cameras(dataset: &Dataset) -> Option<DVec3> {
    let views = dataset.train.iter().chain(&dataset.test);
    let mean: DVec3 = views.map(|view| -view.camera.camera_from_world.matrix3.row(1)).sum();
    (mean.length() > 1e-6).then_some(mean)
}

/// Returns the axis nearest to a direction.
fn nearest_axis(direction: DVec3) -> DVec3 {
    let axis = direction.abs().max_position();
    let sign = if direction[axis] < 0.0 { -1.0 } else { 1.0 };
    sign * DVec3::AXES[axis]
}

/// Returns the shortest rotation from one axis to another, in numbers of -1, 0 and 1; half turns
/// are about x (about z for x itself).
fn quarter_turn(from: DVec3, to: DVec3) -> DMat3 {
    if from == to {
        return DMat3::IDENTITY;
    }
    if from == -to {
        let about_x = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        return if from.x == 0.0 { about_x } else { DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)) };
    }
    // R = [to, side, to x side] [from, side, from x side]^T takes `from` to `to` about their common
    // normal.
    let side = from.cross(to);
    let frame = |first: DVec3| DMat3::from_cols(first, side, first.cross(side));
    frame(to) * frame(from).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_turns_to_every_other_in_whole_numbers() {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
        for from in axes {
            for to in axes {
                let turn = quarter_turn(from, to);
                assert_eq!(turn * from, to);
                assert!((turn.determinant() - 1.0).abs() < 1e-12);
                assert!(turn.to_cols_array().iter().all(|v| v.fract() == 0.0));
            }
        }
    }
}
