//! Kinds of scenes that are not stored as splats, and their names in a run folder.

use luxel_train::{Method, Representation};

/// A kind of scene that is not stored as splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NonSplatKind {
    /// A radiance field.
    Field,
    /// Anchors.
    Anchors,
}

impl NonSplatKind {
    /// All kinds.
    pub const ALL: [Self; 2] = [Self::Field, Self::Anchors];

    /// Returns the kind of scene that a method trains; `None` for splats.
    pub fn of(method: Method) -> Option<Self> {
        match method.spec().representation {
            Representation::Splats => None,
            Representation::Anchors => Some(Self::Anchors),
            Representation::Field => Some(Self::Field),
        }
    }

    /// Returns the name of its folder and file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Field => "field",
            Self::Anchors => "anchors",
        }
    }
}
