//! The ranges of the options' numbers.
//!
//! In: a number. Out: whether it is in the range, with an error that says what was expected.
//! Degenerate: NaN is in no range but [`Range::Any`].

use std::fmt;

/// The range of an option's numbers. `Display` words it: `at least 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Range {
    /// No bound, or not a number.
    Any,
    /// Integers from `min` to `max`. Text beyond them is refused when parsed.
    Limits {
        /// The least.
        min: u64,
        /// The largest.
        max: u64,
    },
    /// Integers from 0 to this one.
    UpTo(u64),
    /// Finite numbers of at least this one.
    AtLeast(u16),
    /// Normal numbers above 0.
    Positive,
    /// Numbers from 0 to 1.
    Share,
    /// Numbers of at least 0 and below 1.
    ShareBelowOne,
    /// Numbers above 0 and below 1.
    Between,
}

impl Range {
    /// Checks a number.
    pub(super) fn check(self, number: Number) -> Result<(), String> {
        let is_in = match (self, number) {
            (Self::Any, _) => true,
            (Self::Limits { min, max }, Number::Integer(n)) => (min..=max).contains(&n),
            (Self::UpTo(max), Number::Integer(n)) => n <= max,
            (Self::AtLeast(min), Number::Integer(n)) => n >= u64::from(min),
            (Self::Positive, Number::Integer(n)) => n > 0,
            (Self::AtLeast(min), Number::Real(v)) => v.is_finite() && v >= f32::from(min),
            (Self::Positive, Number::Real(v)) => v.is_normal() && v > 0.0,
            (Self::Share, Number::Real(v)) => (0.0..=1.0).contains(&v),
            (Self::ShareBelowOne, Number::Real(v)) => (0.0..1.0).contains(&v),
            (Self::Between, Number::Real(v)) => v > 0.0 && v < 1.0,
            (Self::Limits { .. } | Self::UpTo(_), Number::Real(_)) => false,
            (Self::Share | Self::ShareBelowOne | Self::Between, Number::Integer(_)) => false,
        };
        if let (Self::Positive, Number::Real(v)) = (self, number)
            && v.is_subnormal()
            && v > 0.0
        {
            return Err(format!("found {number}, expected a number of at least {:.1e}", f32::MIN_POSITIVE));
        }
        if is_in { Ok(()) } else { Err(format!("found {number}, expected {}", self.expected(number))) }
    }

    fn expected(self, number: Number) -> String {
        let is_listed = matches!(self, Self::Share | Self::UpTo(_) | Self::Limits { .. });
        if is_listed || matches!(number, Number::Integer(_)) { self.to_string() } else { format!("a number {}", self.of_number()) }
    }

    /// Returns the range as it follows "a number".
    fn of_number(self) -> String {
        match self {
            Self::AtLeast(min) => format!("of at least {min}"),
            Self::ShareBelowOne => "of at least 0 and below 1".to_owned(),
            other => other.to_string(),
        }
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Any => Ok(()),
            Self::Limits { min: 0, max } if *max == super::MAX_SEED => write!(f, "at most {max}"),
            Self::Limits { min, max } => write!(f, "{min} to {max}"),
            Self::UpTo(max) => write!(f, "0 to {max}"),
            Self::AtLeast(min) => write!(f, "at least {min}"),
            Self::Positive => f.write_str("above 0"),
            Self::Share => f.write_str("0 to 1"),
            Self::ShareBelowOne => f.write_str("at least 0 and below 1"),
            Self::Between => f.write_str("above 0 and below 1"),
        }
    }
}

/// A number that a range is about.
#[derive(Clone, Copy, Debug)]
pub(super) enum Number {
    Integer(u64),
    Real(f32),
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(n) => n.fmt(f),
            // Without rows of zeros.
            Self::Real(v) if *v != 0.0 && v.is_finite() && !(1e-6..1e16).contains(&v.abs()) => write!(f, "{v:e}"),
            Self::Real(v) => v.fmt(f),
        }
    }
}
