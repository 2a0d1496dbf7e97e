//! Exposures as text, for photographs that do not state theirs.
//!
//! In: a line for each photograph: name (with or without extension), seconds (`0.01` or `1/100`),
//! ISO and f-number if known, separated by spaces, tabs, commas or semicolons; a name with such
//! characters in quotation marks. Lines that begin with # are notes. Out: exposures by name. A line
//! that is none, and a name that comes twice with two exposures, is an error with its number.

use std::collections::BTreeMap;

use crate::Exposure;

/// Explains what is wrong with a list, and in which line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct ExposureListError {
    /// Counted from 1.
    pub line: usize,
    /// Expected and found.
    pub message: String,
}

/// The characters that separate words.
const SEPARATORS: [char; 4] = [' ', '\t', ',', ';'];

/// Reads a list of exposures.
///
/// ```
/// let text = "# name, seconds, ISO, f-number\ndesk_1 1/100 100 8\n";
/// let list = luxel_capture::parse_exposure_list(text)?;
/// assert_eq!(list["desk_1"].seconds, 0.01);
/// let error = luxel_capture::parse_exposure_list("desk_1 fast").unwrap_err();
/// assert_eq!(error.line, 1);
/// # Ok::<(), luxel_capture::ExposureListError>(())
/// ```
///
/// # Errors
/// A line that is not a name with an exposure.
pub fn parse_exposure_list(text: &str) -> Result<BTreeMap<String, Exposure>, ExposureListError> {
    let mut out: BTreeMap<String, Exposure> = BTreeMap::new();
    // Editors of one system begin a file with a mark of its encoding.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (line, content) in (1..).zip(text.lines()) {
        let content = content.trim_matches(SEPARATORS);
        if content.is_empty() || content.starts_with('#') {
            continue;
        }
        let error = |message: String| ExposureListError { line, message };
        let exposure = named_exposure(content).filter(|(_, exposure)| exposure.is_valid());
        let Some((name, exposure)) = exposure else {
            return Err(error(format!(
                "\"{content}\", expected a name, seconds such as 0.01 or 1/100, and perhaps ISO and f-number, all above 0"
            )));
        };
        if out.insert(name.to_owned(), exposure).is_some_and(|before| before != exposure) {
            return Err(error(format!("\"{name}\" occurs twice with different exposures, expected one for each photograph")));
        }
    }
    Ok(out)
}

fn named_exposure(line: &str) -> Option<(&str, Exposure)> {
    let (name, rest) = match line.strip_prefix('"') {
        Some(quoted) => quoted.split_once('"')?,
        None => line.split_once(SEPARATORS)?,
    };
    let numbers: Vec<f64> = rest.split(SEPARATORS).filter(|word| !word.is_empty()).map(fraction).collect::<Option<_>>()?;
    let exposure = match *numbers {
        [seconds] => Exposure { seconds, iso: None, f_number: None },
        [seconds, iso] => Exposure { seconds, iso: Some(iso), f_number: None },
        [seconds, iso, f_number] => Exposure { seconds, iso: Some(iso), f_number: Some(f_number) },
        _ => return None,
    };
    (!name.is_empty()).then_some((name, exposure))
}

fn fraction(word: &str) -> Option<f64> {
    match word.split_once('/') {
        Some((a, b)) => Some(a.parse::<f64>().ok()? / b.parse::<f64>().ok()?),
        None => word.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_hold_seconds_iso_and_aperture() {
        let text = "\u{feff}# name s\r\na.jpg 1/100\r\n b 0.5, 200 \n\nc\t2 100 5.6\n\"my desk_1\";1/4\nb,0.5,200\n";
        let list = parse_exposure_list(text).unwrap();
        assert_eq!(list["a.jpg"], Exposure { seconds: 0.01, iso: None, f_number: None });
        assert_eq!(list["c"], Exposure { seconds: 2.0, iso: Some(100.0), f_number: Some(5.6) });
        assert_eq!(list["my desk_1"].seconds, 0.25);
        assert_eq!(list.len(), 4);
    }

    #[test]
    fn lines_that_are_none_are_named() {
        for bad in ["a", "a x", "a 0", "a 1/0", "a -1", "a 1 2 3 4", "a 1 nan", "\"a 1", "\"\" 1", "ok 2"] {
            let error = parse_exposure_list(&format!("ok 1\n{bad}")).unwrap_err();
            assert_eq!(error.line, 2, "{bad}: {error}");
        }
    }
}
