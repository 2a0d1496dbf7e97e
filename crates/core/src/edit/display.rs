//! Conversion of edits to text, in the form that [`super::text`] reads.

use std::fmt;

use super::{Comparison, Edit, Level, Quantity, Selection};

impl fmt::Display for Edit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "where {}", self.selection)?;
        self.maps.iter().try_for_each(|map| write!(f, "; {map}"))
    }
}

impl fmt::Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let joined = |parts: &[Self], word: &str| parts.iter().map(Self::operand).collect::<Vec<_>>().join(word);
        match self {
            Self::All => write!(f, "all"),
            Self::Compare { quantity, comparison, level, .. } => write!(f, "{quantity} {comparison} {level}"),
            Self::Within { quantity, low, high, .. } => write!(f, "{quantity} in {low}..{high}"),
            Self::Cuboid { min: [x0, y0, z0], max: [x1, y1, z1], .. } => write!(f, "box({x0},{y0},{z0},{x1},{y1},{z1})"),
            Self::Sphere { center: [x, y, z], radius, .. } => write!(f, "sphere({x},{y},{z},{radius})"),
            Self::Mask { name, .. } => write!(f, "mask({}, {})", quoted(&name.file), quoted(&name.view)),
            Self::Not(inner) => write!(f, "not {}", inner.operand()),
            Self::And(parts) if parts.is_empty() => write!(f, "all"),
            Self::Or(parts) if parts.is_empty() => write!(f, "not all"),
            Self::And(parts) => write!(f, "{}", joined(parts, " and ")),
            Self::Or(parts) => write!(f, "{}", joined(parts, " or ")),
        }?;
        match self.feather() {
            feather if feather > 0.0 => write!(f, " ~{feather}"),
            _ => Ok(()),
        }
    }
}

impl Selection {
    /// Returns the text as an operand of a larger selection.
    fn operand(&self) -> String {
        if matches!(self, Self::And(_) | Self::Or(_)) { format!("({self})") } else { self.to_string() }
    }

    fn feather(&self) -> f32 {
        match self {
            Self::Compare { feather, .. }
            | Self::Within { feather, .. }
            | Self::Cuboid { feather, .. }
            | Self::Sphere { feather, .. }
            | Self::Mask { feather, .. } => *feather,
            Self::All | Self::Not(_) | Self::And(_) | Self::Or(_) => 0.0,
        }
    }
}

fn quoted(name: &str) -> String {
    if name.contains('"') { format!("'{name}'") } else { format!("\"{name}\"") }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Luminance => "L",
            Self::Hue => "hue",
            Self::Saturation => "saturation",
        })
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Below => "<",
            Self::AtMost => "<=",
            Self::Above => ">",
            Self::AtLeast => ">=",
        })
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absolute(value) => write!(f, "{value}"),
            Self::Percentile(percent) => write!(f, "p{percent}"),
        }
    }
}
