//! The splats of a layer that are shown: those of prims that are active, visible and rendered.
//! What other layers and copies would add is not composed; a warning names it.

use std::collections::BTreeMap;

/// A reason why a prim and all below it are not shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Hidden {
    /// `active = false`.
    Inactive,
    /// `visibility = "invisible"`.
    Invisible,
    /// `purpose` of another use than a final render.
    Purpose,
    /// Below a `PointInstancer`, which shows copies of it.
    Prototype,
}

/// Type of prims that show copies of others.
pub(super) const INSTANCER: &str = "PointInstancer";
/// Fields of prims by which other layers and parts are composed into them.
pub(super) const ARCS: [&str; 5] = ["references", "payload", "inherits", "specializes", "variants"];

impl Hidden {
    /// Returns what an attribute's value hides its prim for; `None` if it does not.
    pub(super) fn by_attribute(name: &str, value: &str) -> Option<Self> {
        match (name, value) {
            ("visibility", "invisible") => Some(Self::Invisible),
            ("purpose", "guide" | "proxy") => Some(Self::Purpose),
            _ => None,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Inactive => "is not active",
            Self::Invisible => "is invisible",
            Self::Purpose => "is a guide or a proxy",
            Self::Prototype => "is copied by a point instancer, which is not followed",
        }
    }
}

/// The parts of a layer that do not become splats.
#[derive(Debug, Default)]
pub(super) struct Unshown {
    counts: BTreeMap<Hidden, usize>,
    /// Whether other layers or variants are composed into it.
    is_composed: bool,
}

impl Unshown {
    /// Counts particle fields that are not shown.
    pub(super) fn hide(&mut self, reason: Hidden, fields: usize) {
        if fields > 0 {
            *self.counts.entry(reason).or_default() += fields;
        }
    }

    /// Notes that other layers, or variants, are composed into this one.
    pub(super) fn compose(&mut self) {
        self.is_composed = true;
    }

    /// Returns a line for people about each kind of part.
    pub(super) fn lines(&self) -> Vec<String> {
        let count = |(reason, count): (&Hidden, &usize)| {
            let prims = if *count == 1 { "a prim of splats, which".to_owned() } else { format!("{count} prims of splats, each of which") };
            format!("left out: {prims} {}", reason.words())
        };
        let mut lines: Vec<String> = self.counts.iter().map(count).collect();
        if self.is_composed {
            lines.push(
                "references, payloads, sublayers, inherited prims and variants are not followed: splats there are missing; usdcat --flatten \
                 composes a stage"
                    .to_owned(),
            );
        }
        lines
    }
}
