//! Remedies of the libraries' errors, worded with the options of the command line.

use std::error::Error as StdError;

use anyhow::Error;
use luxel::Remedy;
use luxel_train::TrainError;

use crate::args::flag;

/// Returns the remedy of the outermost error in the chain that has one.
pub(crate) fn of_error(error: &Error) -> Option<&Remedy> {
    error.chain().find_map(luxel::remedy_of)
}

/// Returns the text of one error in a chain, with the flag where it is about an option of training.
pub(crate) fn text_of(error: &(dyn StdError + 'static)) -> String {
    let text = error.to_string();
    let wrapped = || error.downcast_ref::<luxel::Error>()?.find::<TrainError>();
    // An error of the library that adds a message has that message for its text.
    match error.downcast_ref::<TrainError>().or_else(wrapped).filter(|below| below.to_string() == text) {
        Some(TrainError::Config { option, reason }) => format!("{}: {reason}", flag(option)),
        Some(TrainError::Misplaced { option, condition, .. }) => {
            let choice = format!("{} {}", flag(condition.option()), condition.value());
            format!("{}: has an effect with {} only", flag(option), choice.trim_end())
        }
        _ => text,
    }
}

/// Words a remedy: `give --device cpu, or lower --threads`.
pub(crate) fn word(remedy: &Remedy) -> String {
    match remedy {
        Remedy::Set { option, value } if option == "resume" && value == "true" => "continue the run with luxel train --resume".to_owned(),
        Remedy::Set { option, value } if value == "true" => format!("give {}", flag(option)),
        Remedy::Set { option, value } => format!("give {} {value}", flag(option)),
        // The one that has no flag.
        Remedy::Give { option } if option == "dataset" => "name its new folder: luxel train DATASET --resume -o RUN".to_owned(),
        Remedy::Give { option } => format!("give {}", flag(option)),
        Remedy::Lower { option } => format!("lower {}", flag(option)),
        Remedy::Raise { option } => format!("raise {}", flag(option)),
        Remedy::LeaveOut { option } => format!("leave {} out", flag(option)),
        Remedy::AnyOf(any) => any.iter().map(word).collect::<Vec<_>>().join(", or "),
        other => other.to_string(),
    }
}

/// Returns a text with its remedy behind it.
pub(crate) fn with_remedy(text: &str, remedy: Option<&Remedy>) -> String {
    remedy.map_or_else(|| text.to_owned(), |remedy| format!("{text}; {}", word(remedy)))
}

#[cfg(test)]
mod tests {
    use luxel_train::{Strategy, TrainConfig};

    use super::*;

    #[test]
    fn remedies_name_flags() {
        let remedy = Remedy::advice("give another name").or(Remedy::set("overwrite", "true")).or(Remedy::lower("max_splats"));
        assert_eq!(word(&remedy), "give another name, or give --overwrite, or lower --max-splats");
        assert_eq!(word(&Remedy::set("device", "cpu")), "give --device cpu");
    }

    #[test]
    fn a_text_without_a_remedy_stays_as_it_is() {
        assert_eq!(with_remedy("too many", None), "too many");
        assert_eq!(with_remedy("too many", Some(&Remedy::leave_out("masks"))), "too many; leave --masks out");
    }

    #[test]
    fn the_remedy_of_a_file_is_found() {
        let below = luxel_io::IoError::invalid("a.png", "no curve").with_remedy(Remedy::give("transfer"));
        let error = Error::new(below).context("cannot read the data set");
        assert_eq!(of_error(&error), Some(&Remedy::give("transfer")));
    }

    #[test]
    fn an_option_of_training_is_named_by_its_flag() {
        let text = |config: TrainConfig| {
            let error = Error::from(luxel::Error::from(config.validate().unwrap_err()));
            text_of(error.chain().next().unwrap())
        };
        assert_eq!(text(TrainConfig { turnover: 2.0, ..TrainConfig::default() }), "--turnover: found 2, expected 0 to 1");
        let misplaced = TrainConfig { strategy: Strategy::Mcmc, absgrad: true, ..TrainConfig::default() };
        assert_eq!(text(misplaced), "--absgrad: has an effect with --strategy adc only");
    }

    #[test]
    fn the_remedy_of_a_cause_is_found() {
        let error = luxel::Error::new("a.ply: exists already").with_remedy(Remedy::give("output"));
        let error = Error::from(error.context("cannot export")).context("luxel export");
        assert_eq!(of_error(&error), Some(&Remedy::give("output")));
    }
}
