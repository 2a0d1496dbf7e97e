//! Local coordinates of scenes in files: which ones a scene gets as it is read, and the record of
//! them as it is written.
//!
//! Positions in a file are 32-bit numbers relative to the origin, in units of the world. Files
//! written here state the origin and the unit of local coordinates where they are not those of the
//! world; for a file of another program they are chosen from its splats.

use glam::{DMat3, DVec3};
use luxel_core::{Scene, SceneBounds, Similarity, Splats};
use serde::{Deserialize, Serialize};

/// Splats that the bounds of a scene are taken from; more would take memory and tell no more.
const MOST_SAMPLES: usize = 1 << 17;

/// The record of local coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LocalFrame {
    /// Place of the local origin, world.
    origin: [f64; 3],
    /// Length of one local unit, world units.
    unit: f64,
}

impl LocalFrame {
    /// Returns the record of a transform without a rotation; `None` for the identity.
    pub(crate) fn from_similarity(world_from_local: &Similarity) -> Option<Self> {
        let frame = Self { origin: world_from_local.translation().to_array(), unit: world_from_local.scale() };
        (!world_from_local.is_identity()).then_some(frame)
    }

    /// Returns the transform; `None` if the record describes none.
    pub(crate) fn world_from_local(&self) -> Option<Similarity> {
        Similarity::new(DMat3::IDENTITY, self.unit, DVec3::from_array(self.origin))
    }

    /// Parses a record from JSON.
    pub(crate) fn parse(json: &str) -> Option<Self> {
        serde_json::from_str::<Self>(json).ok().filter(|frame| frame.world_from_local().is_some())
    }
}

/// Returns the transform that only moves the origin to that of `world_from_local`.
pub(crate) fn origin_of(world_from_local: &Similarity) -> Similarity {
    Similarity::new(DMat3::IDENTITY, 1.0, world_from_local.translation()).unwrap_or(Similarity::IDENTITY)
}

/// Returns the local coordinates that suit splats of a file of another program, whose positions
/// `world_from_file` takes to the world; `exact` are positions of more digits than the splats have.
pub(crate) fn suitable(splats: &Splats, exact: Option<&[[f64; 3]]>, world_from_file: &Similarity) -> Similarity {
    let bounds = SceneBounds::from_points(&samples(splats, exact, world_from_file));
    bounds.map_or(Similarity::IDENTITY, |bounds| bounds.world_from_local())
}

/// Returns the positions of some of the splats, world.
pub(crate) fn samples(splats: &Splats, exact: Option<&[[f64; 3]]>, world_from_file: &Similarity) -> Vec<DVec3> {
    let step = splats.len().div_ceil(MOST_SAMPLES).max(1);
    let position = |i: usize| exact.and_then(|exact| exact.get(i)).copied().unwrap_or_else(|| splats.position[i].map(f64::from));
    (0..splats.len()).step_by(step).map(|i| world_from_file.point(position(i).into())).collect()
}

/// Takes a scene's splats from the coordinates of a file to local ones.
pub(crate) fn settle(scene: &mut Scene, exact: Option<&[[f64; 3]]>, world_from_file: &Similarity, world_from_local: Similarity) {
    scene.world_from_local = world_from_local;
    let local_from_file = world_from_file.then(&world_from_local.inverse());
    if local_from_file.is_identity() {
        return;
    }
    local_from_file.apply(&mut scene.splats);
    for (position, exact) in scene.splats.position.iter_mut().zip(exact.into_iter().flatten()) {
        *position = local_from_file.point(DVec3::from_array(*exact)).as_vec3().to_array();
    }
}

/// Takes a scene of another program to the local coordinates that suit it.
pub(crate) fn settled(mut scene: Scene, exact: Option<&[[f64; 3]]>) -> Scene {
    let frame = suitable(&scene.splats, exact, &Similarity::IDENTITY);
    settle(&mut scene, exact, &Similarity::IDENTITY, frame);
    scene
}
