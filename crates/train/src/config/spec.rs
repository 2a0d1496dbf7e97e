//! The description of an option: its names, help, range and conditions, and how text becomes its
//! value.
//!
//! In: text, as a command line or another front end has it; out: values of [`TrainConfig`]. Ranges
//! are checked by [`TrainConfig::validate`], whatever the values came from; names of choices, the
//! form of numbers and [`Range::Limits`] are checked when text is parsed.

use std::sync::LazyLock;

use super::range::{Number, Range};
use super::{ColorValues, Colors, Method, MethodSpec, NamedChoice, Representation, Scheme, Strategy, TrainConfig};

/// An option of training. [`super::OPTIONS`] lists them all.
///
/// ```
/// use luxel_train::{OptionSpec, TrainConfig};
///
/// let turnover = OptionSpec::find("turnover").unwrap();
/// assert_eq!(turnover.default_text().as_deref(), Some("0.1"));
/// assert_eq!(turnover.range.to_string(), "0 to 1");
///
/// let mut config = TrainConfig::default();
/// turnover.set(&mut config, "0.25").unwrap();
/// assert_eq!(config.turnover, 0.25);
/// assert_eq!(turnover.get(&config).as_deref(), Some("0.25"));
/// ```
#[derive(Debug)]
pub struct OptionSpec {
    /// Name of the option, which is that of the field of [`TrainConfig`].
    pub name: &'static str,
    /// Group of options that it is listed with.
    pub heading: &'static str,
    /// Name of its value, such as `N`; empty for a switch.
    pub value_name: &'static str,
    /// Range of its numbers.
    pub range: Range,
    /// Default in words, if the option is unset by default and its effective value follows from
    /// something else.
    pub default_note: Option<&'static str>,
    /// Name that configurations of earlier programs have, which are still read.
    pub old_name: Option<&'static str>,
    /// Conditions under which the option has an effect; all have to hold.
    pub conditions: &'static [Condition],
    pub(super) help: &'static str,
    pub(super) access: Access,
}

/// Functions that read and write the option.
#[derive(Debug)]
pub(super) struct Access {
    pub(super) is_switch: bool,
    pub(super) values: fn() -> Vec<ValueHelp>,
    pub(super) set: fn(&mut TrainConfig, &str, Range) -> Result<(), String>,
    pub(super) get: fn(&TrainConfig) -> Option<String>,
    pub(super) is_set: fn(&TrainConfig) -> Option<bool>,
    pub(super) check: fn(&TrainConfig, Range) -> Result<(), String>,
}

/// A named value and its help.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ValueHelp {
    /// Name of the value.
    pub name: &'static str,
    /// Help, in one sentence without a full stop.
    pub help: &'static str,
}

impl OptionSpec {
    /// Finds an option by its name.
    pub fn find(name: &str) -> Option<&'static Self> {
        super::OPTIONS.iter().find(|option| option.name == name)
    }

    /// Returns a sentence on what the option does. Names of options stand in backticks.
    pub fn help(&self) -> &'static str {
        self.help.trim()
    }

    /// Returns whether the option is a switch, which has no value on a command line.
    pub fn is_switch(&self) -> bool {
        self.access.is_switch
    }

    /// Returns the values by name; empty if the option takes other values.
    pub fn values(&self) -> Vec<ValueHelp> {
        (self.access.values)()
    }

    /// Returns the default as text, or `None` if the option is unset by default.
    pub fn default_text(&self) -> Option<String> {
        (self.access.get)(&TrainConfig::base())
    }

    /// Sets the option to the value that `text` gives.
    ///
    /// # Errors
    /// Returns the reason why the text is no value of the option. Only the range [`Range::Limits`]
    /// is checked here; [`TrainConfig::validate`] checks the others.
    pub fn set(&self, config: &mut TrainConfig, text: &str) -> Result<(), String> {
        (self.access.set)(config, text, self.range)
    }

    /// Returns the option's value as text, or `None` if it is unset.
    pub fn get(&self, config: &TrainConfig) -> Option<String> {
        (self.access.get)(config)
    }

    /// Checks the option's numbers against its range.
    pub(super) fn check(&self, config: &TrainConfig) -> Result<(), String> {
        (self.access.check)(config, self.range)
    }

    /// Returns the first condition of the configuration that does not hold although the option is
    /// set. An option that always has a value is never set in this sense.
    pub(super) fn unmet_although_set(&self, config: &TrainConfig) -> Option<Condition> {
        let is_set = (self.access.is_set)(config).unwrap_or(false);
        self.conditions.iter().copied().find(|condition| is_set && condition.is_met(config) == Some(false))
    }
}

/// A choice that an option depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// Splats are stored, and their colour model is LCD of chosen degrees.
    Lcd,
    /// The colour model of splats, stored or decoded, is LCD.
    LcdColors,
    /// A radiance field is trained.
    Field,
    /// A radiance field is trained on radiance.
    FieldOnRadiance,
    /// Splats are added by adaptive density control.
    Adc,
    /// Splats are added by MCMC.
    Mcmc,
    /// Splats are split by absolute gradients.
    Absgrad,
    /// A step has more than one view.
    Batch,
    /// Pixels are supersampled.
    Supersampling,
    /// Poses are optimised.
    RefinePoses,
    /// The training images are radiance.
    RadianceImages,
    /// The training images are captured LDR images.
    CapturedImages,
    /// The method trains on captured LDR images beside radiance.
    Pairs,
    /// The method maps radiance to captured values by networks.
    ToneNetworks,
    /// This method is trained.
    Method(Method),
}

/// The texts of [`Condition::value`] that are names of several methods.
static NAMES_OF_METHODS: LazyLock<Vec<(Condition, String)>> = LazyLock::new(|| {
    let names = |condition: Condition| Method::names_where(|method| condition.is_met_by(method.spec()) == Some(true));
    Condition::GENERAL.into_iter().map(|condition| (condition, names(condition))).collect()
});

impl Condition {
    /// The conditions that are not about one method alone.
    const GENERAL: [Self; 14] = [
        Self::Lcd,
        Self::LcdColors,
        Self::Field,
        Self::FieldOnRadiance,
        Self::Adc,
        Self::Mcmc,
        Self::Absgrad,
        Self::Batch,
        Self::Supersampling,
        Self::RefinePoses,
        Self::RadianceImages,
        Self::CapturedImages,
        Self::Pairs,
        Self::ToneNetworks,
    ];

    /// Returns all conditions.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::GENERAL.into_iter().chain(Method::VALUES.iter().map(|(method, _)| Self::Method(*method)))
    }

    /// Returns the name of the option that makes the choice.
    pub fn option(self) -> &'static str {
        match self {
            Self::Lcd | Self::LcdColors | Self::Field | Self::FieldOnRadiance | Self::Pairs | Self::ToneNetworks | Self::Method(_) => {
                "method"
            }
            Self::Adc | Self::Mcmc => "strategy",
            Self::Absgrad => "absgrad",
            Self::Batch => "batch",
            Self::Supersampling => "samples",
            Self::RefinePoses => "refine_poses",
            Self::RadianceImages | Self::CapturedImages => "supervision",
        }
    }

    /// Returns the value that makes the choice, for people; empty for a switch.
    pub fn value(self) -> &'static str {
        match self {
            Self::Method(method) => method.name(),
            Self::Adc => "adc",
            Self::Mcmc => "mcmc",
            Self::Absgrad | Self::RefinePoses => "",
            Self::Batch | Self::Supersampling => "above 1",
            Self::RadianceImages => "hdr",
            Self::CapturedImages => "ldr",
            Self::Lcd | Self::LcdColors | Self::Field | Self::FieldOnRadiance | Self::Pairs | Self::ToneNetworks => {
                NAMES_OF_METHODS.iter().find(|(condition, _)| *condition == self).map_or("", |(_, names)| names)
            }
        }
    }

    /// Returns whether the condition holds, or `None` if that depends on the data set.
    pub fn is_met(self, config: &TrainConfig) -> Option<bool> {
        match self {
            Self::Method(method) => Some(config.method == method),
            Self::Adc => Some(config.strategy == Strategy::Adc),
            Self::Mcmc => Some(config.strategy == Strategy::Mcmc),
            Self::Absgrad => Some(config.absgrad),
            Self::Batch => Some(config.batch > 1),
            Self::Supersampling => Some(config.samples != Some(1)),
            Self::RefinePoses => Some(config.refine_poses),
            _ => self.is_met_by(config.method.spec()),
        }
    }

    /// Returns whether a method meets the condition, or `None` if the condition is about something
    /// else than what the row of a method says.
    fn is_met_by(self, method: &MethodSpec) -> Option<bool> {
        let is_field = method.representation == Representation::Field;
        match self {
            Self::Lcd => Some(method.colors == Colors::Lcd),
            Self::LcdColors => Some(matches!(method.colors, Colors::Lcd | Colors::LcdConstants)),
            Self::Field => Some(is_field),
            Self::FieldOnRadiance => Some(is_field && method.scheme == Scheme::Radiance),
            Self::Pairs => Some(method.scheme == Scheme::Pairs),
            Self::ToneNetworks => Some(!is_field && method.scheme.has_networks() && method.values == ColorValues::Radiance),
            _ => None,
        }
    }
}

/// A type of option values.
pub(super) trait OptionValue: Sized {
    const IS_SWITCH: bool = false;

    fn parse(text: &str) -> Result<Self, String>;

    /// Returns the value as text, or `None` if it is unset.
    fn format(&self) -> Option<String>;

    /// Returns the numbers that the option's range is about.
    fn numbers(&self) -> Vec<Number> {
        Vec::new()
    }

    /// Returns whether the option is set, or `None` if it always is.
    fn is_set(&self) -> Option<bool> {
        None
    }

    fn values() -> Vec<ValueHelp> {
        Vec::new()
    }
}

/// Parses a value and checks what is checked before the whole configuration is there.
pub(super) fn parse_in<T: OptionValue>(text: &str, range: Range) -> Result<T, String> {
    let value = T::parse(text)?;
    if matches!(range, Range::Limits { .. }) {
        check_in(&value, range)?;
    }
    Ok(value)
}

/// Checks a value against a range.
pub(super) fn check_in<T: OptionValue>(value: &T, range: Range) -> Result<(), String> {
    value.numbers().into_iter().try_for_each(|number| range.check(number))
}

macro_rules! number_options {
    ($($type:ty, $expected:literal => $number:expr;)+) => {
        $(impl OptionValue for $type {
            fn parse(text: &str) -> Result<Self, String> {
                text.parse().map_err(|_| format!("\"{text}\": expected {}", $expected))
            }

            fn format(&self) -> Option<String> {
                Some(self.to_string())
            }

            fn numbers(&self) -> Vec<Number> {
                vec![$number(*self)]
            }
        })+
    };
}

number_options! {
    u8, "a whole number of 0 to 255" => |n| Number::Integer(u64::from(n));
    u32, "a whole number of 0 to 4294967295" => |n| Number::Integer(u64::from(n));
    u64, "a whole number of at least 0" => Number::Integer;
    f32, "a number" => Number::Real;
}

impl OptionValue for bool {
    const IS_SWITCH: bool = true;

    fn parse(text: &str) -> Result<Self, String> {
        text.parse().map_err(|_| format!("\"{text}\": expected true or false"))
    }

    fn format(&self) -> Option<String> {
        Some(self.to_string())
    }

    fn is_set(&self) -> Option<bool> {
        Some(*self)
    }
}

impl<T: OptionValue> OptionValue for Option<T> {
    fn parse(text: &str) -> Result<Self, String> {
        T::parse(text).map(Some)
    }

    fn format(&self) -> Option<String> {
        self.as_ref().and_then(T::format)
    }

    fn numbers(&self) -> Vec<Number> {
        self.as_ref().map(T::numbers).unwrap_or_default()
    }

    fn is_set(&self) -> Option<bool> {
        Some(self.is_some())
    }

    fn values() -> Vec<ValueHelp> {
        T::values()
    }
}

/// A colour of radiance.
impl OptionValue for [f32; 3] {
    fn parse(text: &str) -> Result<Self, String> {
        super::parse_rgb(text)
    }

    fn format(&self) -> Option<String> {
        let [r, g, b] = self;
        Some(format!("{r},{g},{b}"))
    }

    fn numbers(&self) -> Vec<Number> {
        self.map(Number::Real).to_vec()
    }
}

macro_rules! text_options {
    ($($type:ty),+) => {
        $(impl OptionValue for $type {
            fn parse(text: &str) -> Result<Self, String> {
                text.parse()
            }

            fn format(&self) -> Option<String> {
                Some(self.to_string())
            }
        })+
    };
}

text_options!(crate::ResolutionSchedule, crate::NoiseChoice, super::FieldNetworkChoice);
