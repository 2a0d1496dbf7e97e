//! Components of an alignment: groups of cameras whose coordinates nothing relates to one another.
//!
//! Photogrammetry that does not connect all photographs leaves several components, each in
//! coordinates of its own, which a file may hold together. Read as one they are a scene of two
//! unrelated halves. In: cameras with the coordinates they are in. Out: those of the group with the
//! most cameras, and a warning that names the others.

use std::collections::BTreeMap;

use luxel_core::text::plural;

use super::posed::PosedCamera;

/// Names that a warning lists.
const MAX_LISTED: usize = 3;

/// Coordinates that cameras are in.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Coordinates {
    /// Those of the world, by a transform of the file.
    World,
    /// Those of a component, with its name for people.
    Own(String),
}

impl Coordinates {
    fn label(&self) -> &str {
        match self {
            Self::World => "those with coordinates in the world",
            Self::Own(name) => name,
        }
    }
}

/// A camera in its coordinates.
#[derive(Clone, Debug)]
pub(super) struct ComponentCamera {
    pub(super) camera: PosedCamera,
    pub(super) coordinates: Coordinates,
}

/// Returns the cameras of the component with the most of them, the first of equal ones, in the order
/// of the file; and what is left out.
pub(super) fn largest(cameras: Vec<ComponentCamera>) -> (Vec<PosedCamera>, Option<String>) {
    let mut counts: BTreeMap<Coordinates, Vec<String>> = BTreeMap::new();
    for found in &cameras {
        counts.entry(found.coordinates.clone()).or_default().push(found.camera.name.clone());
    }
    let most = counts.values().map(Vec::len).max().unwrap_or(0);
    let Some(kept) = counts.iter().find(|(_, names)| names.len() == most).map(|(coordinates, _)| coordinates.clone()) else {
        return (Vec::new(), None);
    };
    let others: Vec<String> =
        counts.iter().filter(|(coordinates, _)| **coordinates != kept).map(|(c, names)| described(c, names)).collect();
    let warning = (!others.is_empty()).then(|| {
        format!(
            "components whose coordinates nothing relates: {} is read, left out: {}; join them in the alignment, or export each one alone",
            described(&kept, &counts[&kept]),
            others.join(", ")
        )
    });
    let kept = cameras.into_iter().filter(|found| found.coordinates == kept).map(|found| found.camera).collect();
    (kept, warning)
}

fn described(coordinates: &Coordinates, names: &[String]) -> String {
    let listed = names.iter().take(MAX_LISTED).cloned().collect::<Vec<_>>().join(", ");
    let more = if names.len() > MAX_LISTED { ", ..." } else { "" };
    format!("{} ({}: {listed}{more})", coordinates.label(), plural(names.len(), "camera"))
}
