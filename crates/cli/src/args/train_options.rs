//! Arguments for the options of training, built from the table of [`luxel_train::OPTIONS`].

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser, ValueParser};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use luxel_train::{NamedChoice, OPTIONS, OptionSpec, Range, TrainConfig, ValueHelp};

use super::flag;

/// The options of training.
#[derive(Clone, Debug)]
pub(crate) struct TrainOptions {
    /// The defaults with the options that were given; presets are not applied yet.
    pub(crate) config: TrainConfig,
}

/// Heading of the options that every run has.
const FIRST: &str = "Training";

/// Arguments of the options that every run has, which a command lists before its own;
/// [`TrainOptions`] adds the others and has the values of all.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FirstTrainOptions;

impl Args for FirstTrainOptions {
    fn augment_args(command: Command) -> Command {
        OPTIONS.iter().filter(|option| option.heading == FIRST).map(arg).fold(command, Command::arg)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for FirstTrainOptions {
    fn from_arg_matches(_: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self)
    }

    fn update_from_arg_matches(&mut self, _: &ArgMatches) -> Result<(), clap::Error> {
        Ok(())
    }
}

impl Args for TrainOptions {
    fn augment_args(command: Command) -> Command {
        let is_there = |command: &Command, name: &str| command.get_arguments().any(|arg| arg.get_id().as_str() == name);
        let add = |command, option: &'static OptionSpec| if is_there(&command, option.name) { command } else { command.arg(arg(option)) };
        OPTIONS.iter().fold(command, add)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for TrainOptions {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut options = Self { config: TrainConfig::default() };
        options.update_from_arg_matches(matches)?;
        Ok(options)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        for option in OPTIONS {
            let text = if option.is_switch() {
                matches.get_flag(option.name).then_some("true")
            } else {
                matches.get_one::<String>(option.name).map(String::as_str)
            };
            if let Some(text) = text {
                let error = |reason| clap::Error::raw(ErrorKind::ValueValidation, format!("{}: {reason}\n", flag(option.name)));
                option.set(&mut self.config, text).map_err(error)?;
            }
        }
        Ok(())
    }
}

/// Returns the argument of an option.
fn arg(option: &'static OptionSpec) -> Arg {
    let arg = Arg::new(option.name).long(option.name.replace('_', "-")).help(help(option)).help_heading(option.heading);
    if option.is_switch() {
        return arg.action(ArgAction::SetTrue);
    }
    let arg = arg.value_name(option.value_name).value_parser(value_parser(option));
    match option.default_text() {
        Some(default) => arg.default_value(default),
        None => arg,
    }
}

/// Returns a parser of the option's text, which stays text.
fn value_parser(option: &'static OptionSpec) -> ValueParser {
    let values = option.values();
    if !values.is_empty() {
        return PossibleValuesParser::new(values.into_iter().map(possible_value)).into();
    }
    ValueParser::from(move |text: &str| option.set(&mut TrainConfig::default(), text).map(|()| text.to_owned()))
}

/// Returns a parser of a choice with named values, for commands that have one such option.
pub(crate) fn choice_parser<T: NamedChoice + Send + Sync>() -> impl TypedValueParser<Value = T> {
    let values = T::VALUES.iter().map(|(_, value)| possible_value(*value));
    PossibleValuesParser::new(values).try_map(|name| T::from_name(&name).ok_or("not one of the values"))
}

fn possible_value(value: ValueHelp) -> PossibleValue {
    let named = PossibleValue::new(value.name);
    if value.help.is_empty() { named } else { named.help(with_flags(value.help)) }
}

/// Returns the help: a sentence on what the option does, then in brackets the choices that it
/// depends on, the range, and the default in words where it has no value.
fn help(option: &OptionSpec) -> String {
    let mut help = with_flags(option.help());
    if !option.conditions.is_empty() {
        let choice = |(option, value): (&str, &str)| format!("{} {value}", flag(option)).trim_end().to_owned();
        let choices: Vec<_> = option.conditions.iter().map(|c| choice((c.option(), c.value()))).collect();
        help += &format!(" [only with: {}]", choices.join(" and "));
    }
    // A range of several parts stands in the text.
    if option.range != Range::Any && !help.contains("[range: ") {
        help += &format!(" [range: {}]", option.range);
    }
    if let Some(note) = option.default_note {
        help += &format!(" [default: {}]", with_flags(note));
    }
    help
}

/// Replaces the names of options, which stand in backticks, by their flags.
fn with_flags(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts.map(|(i, part)| if i % 2 == 1 { flag(part) } else { part.to_owned() }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn helps_name_flags_ranges_and_conditions() {
        let help_of = |name| help(OptionSpec::find(name).unwrap());
        assert!(help_of("radiance_scale").ends_with("overrides --scale-rule [range: above 0]"), "{}", help_of("radiance_scale"));
        assert!(help_of("turnover").ends_with("[only with: --strategy adc] [range: 0 to 1]"), "{}", help_of("turnover"));
        assert!(help_of("chroma_degree").contains(
            "[only with: --method lcd] [range: 0 to 5] [default: 3; 1 for developed photographs where --luminance-degree is unset, too"
        ));
        assert!(help_of("absgrad_threshold").contains("[only with: --strategy adc and --absgrad]"));
    }

    #[test]
    fn every_name_in_backticks_is_an_option() {
        for option in OPTIONS {
            let values = option.values();
            let texts = values.iter().map(|value| value.help).chain([option.help()]).chain(option.default_note);
            for text in texts {
                for name in text.split('`').skip(1).step_by(2) {
                    assert!(OptionSpec::find(name).is_some(), "{}: {name}", option.name);
                }
            }
        }
    }
}
