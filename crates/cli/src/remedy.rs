//! Remedies of the libraries' errors, worded with the options of the command line.

use anyhow::Error;
use luxel::Remedy;

use crate::args::flag;

/// Returns the remedy of the outermost error in the chain that has one.
pub(crate) fn of_error(error: &Error) -> Option<&Remedy> {
    error.chain().find_map(luxel::remedy_of)
}

/// Words a remedy: `give --device cpu, or lower --threads`.
pub(crate) fn word(remedy: &Remedy) -> String {
    match remedy {
        Remedy::Set { option, value } if option == "resume" && value == "true" => "continue the run with luxel train --resume".to_owned(),
        Remedy::Set { option, value } if value == "true" => format!("give {}", flag(option)),
        Remedy::Set { option, value } => format!("give {} {value}", flag(option)),
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
    fn the_remedy_of_a_cause_is_found() {
        let error = luxel::Error::new("a.ply: exists already").with_remedy(Remedy::give("output"));
        let error = Error::from(error.context("cannot export")).context("luxel export");
        assert_eq!(of_error(&error), Some(&Remedy::give("output")));
    }
}
