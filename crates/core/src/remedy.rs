//! Remedies: structured advice on an error, which every front end words in its own terms.
//!
//! A library's error text names file, place, expected and found. It names no command-line flag: a
//! program that links the library has none. What helps is a [`Remedy`] beside the text. It names
//! options by their library names, which are field names such as `device` or `max_splats`; the
//! command line turns them into flags, another front end into its own controls.
//!
//! To use it, give the error type a field `remedy: Option<Remedy>` and a method that returns it,
//! and leave the remedy out of the error's `Display`.

use std::borrow::Cow;
use std::fmt;

/// Says what to do about an error.
///
/// `Display` words it neutrally.
///
/// ```
/// use luxel_core::Remedy;
///
/// let remedy = Remedy::set("device", "cpu").or(Remedy::lower("max_splats"));
/// assert_eq!(remedy.to_string(), "set device to cpu, or lower max_splats");
/// assert_eq!(remedy.options().collect::<Vec<_>>(), ["device", "max_splats"]);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Remedy {
    /// Set an option to this value.
    Set {
        /// Library name of the option.
        option: Cow<'static, str>,
        /// Its value, as text.
        value: Cow<'static, str>,
    },
    /// Give an option a value of the user's choice.
    Give {
        /// Library name of the option.
        option: Cow<'static, str>,
    },
    /// Lower an option's value.
    Lower {
        /// Library name of the option.
        option: Cow<'static, str>,
    },
    /// Raise an option's value.
    Raise {
        /// Library name of the option.
        option: Cow<'static, str>,
    },
    /// Leave an option out.
    LeaveOut {
        /// Library name of the option.
        option: Cow<'static, str>,
    },
    /// Do what this sentence says: imperative, lower case, no full stop and no flag.
    Advice(Cow<'static, str>),
    /// Do any one of these.
    AnyOf(Vec<Remedy>),
}

impl Remedy {
    /// Returns the remedy of setting `option` to `value`.
    pub fn set(option: impl Into<Cow<'static, str>>, value: impl Into<Cow<'static, str>>) -> Self {
        Self::Set { option: option.into(), value: value.into() }
    }

    /// Returns the remedy of giving `option` a value.
    pub fn give(option: impl Into<Cow<'static, str>>) -> Self {
        Self::Give { option: option.into() }
    }

    /// Returns the remedy of lowering `option`.
    pub fn lower(option: impl Into<Cow<'static, str>>) -> Self {
        Self::Lower { option: option.into() }
    }

    /// Returns the remedy of raising `option`.
    pub fn raise(option: impl Into<Cow<'static, str>>) -> Self {
        Self::Raise { option: option.into() }
    }

    /// Returns the remedy of leaving `option` out.
    pub fn leave_out(option: impl Into<Cow<'static, str>>) -> Self {
        Self::LeaveOut { option: option.into() }
    }

    /// Returns a remedy in a sentence: imperative, lower case, no full stop and no flag.
    pub fn advice(sentence: impl Into<Cow<'static, str>>) -> Self {
        Self::Advice(sentence.into())
    }

    /// Returns the remedy of doing either this or `other`.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        let mut any = match self {
            Self::AnyOf(any) => any,
            one => vec![one],
        };
        match other {
            Self::AnyOf(others) => any.extend(others),
            one => any.push(one),
        }
        Self::AnyOf(any)
    }

    /// Returns the library names of the options that the remedy is about, in order.
    pub fn options(&self) -> impl Iterator<Item = &str> {
        let parts = match self {
            Self::AnyOf(any) => any.as_slice(),
            one => std::slice::from_ref(one),
        };
        parts.iter().filter_map(|part| match part {
            Self::Set { option, .. }
            | Self::Give { option }
            | Self::Lower { option }
            | Self::Raise { option }
            | Self::LeaveOut { option } => Some(option.as_ref()),
            Self::Advice(_) | Self::AnyOf(_) => None,
        })
    }
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Set { option, value } => write!(f, "set {option} to {value}"),
            Self::Give { option } => write!(f, "set {option}"),
            Self::Lower { option } => write!(f, "lower {option}"),
            Self::Raise { option } => write!(f, "raise {option}"),
            Self::LeaveOut { option } => write!(f, "leave {option} out"),
            Self::Advice(sentence) => f.write_str(sentence),
            Self::AnyOf(any) => any.iter().enumerate().try_for_each(|(i, remedy)| {
                let separator = if i == 0 { "" } else { ", or " };
                write!(f, "{separator}{remedy}")
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alternatives_stay_in_one_flat_list() {
        let both = Remedy::give("a").or(Remedy::raise("b").or(Remedy::leave_out("c")));
        assert_eq!(both.to_string(), "set a, or raise b, or leave c out");
        assert_eq!(both.or(Remedy::advice("shoot RAW")).to_string(), "set a, or raise b, or leave c out, or shoot RAW");
    }
}
