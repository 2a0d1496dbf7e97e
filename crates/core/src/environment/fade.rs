//! The weights by which the cameras of a rig fade into each other. They are products: of the face,
//! of the column in the face, and of the row, each of which adds up to one.

use glam::{DVec2, DVec3};

use super::{ACROSS, FACES, REACH, border_angle};

/// A direction on the plane of a face, and the weight of the face there.
pub(super) struct FacePoint {
    pub(super) weight: f64,
    /// Tangents to the right and down.
    pub(super) at: DVec2,
}

/// The weight of what lies below a border: one up to `low`, zero from `high` on (tangents), with a
/// continuous slope.
#[derive(Clone, Copy, Debug)]
struct Fade {
    low: f64,
    high: f64,
}

impl Fade {
    /// Returns the fade over the reach of both neighbours of a border.
    fn across(border_angle: f64) -> Self {
        Self { low: (border_angle - REACH).tan(), high: (border_angle + REACH).tan() }
    }

    fn weight(self, tangent: f64) -> f64 {
        let t = ((self.high - tangent) / (self.high - self.low)).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }
}

/// The fades of all borders of a rig.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fades {
    face: Fade,
    /// Between the columns, or rows, of a face.
    parts: [Fade; ACROSS - 1],
}

impl Fades {
    pub(super) fn new() -> Self {
        Self { face: Fade::across(std::f64::consts::FRAC_PI_4), parts: std::array::from_fn(|part| Fade::across(border_angle(part + 1))) }
    }

    /// Returns where a direction meets a face, if the face has a share in it. The shares of all
    /// faces add up to one.
    pub(super) fn face_point(&self, face: usize, direction: DVec3) -> Option<FacePoint> {
        let place = |[front, right, down]: [DVec3; 3]| {
            let depth = direction.dot(front);
            (depth > 0.0).then(|| DVec2::new(direction.dot(right), direction.dot(down)) / depth)
        };
        let share = |at: DVec2| self.face.weight(at.x.abs()) * self.face.weight(at.y.abs());
        let at = place(FACES[face])?;
        let own = share(at);
        if own <= 0.0 {
            return None;
        }
        let all: f64 = FACES.into_iter().filter_map(place).map(share).sum();
        Some(FacePoint { weight: own / all, at })
    }

    /// Returns the weights of the columns (or rows) of cameras at a tangent; they add up to one.
    pub(super) fn part_weights(&self, tangent: f64) -> [f64; ACROSS] {
        let mut before = 0.0;
        std::array::from_fn(|part| {
            let up_to = self.parts.get(part).map_or(1.0, |fade| fade.weight(tangent));
            let own = up_to - before;
            before = up_to;
            own
        })
    }
}
