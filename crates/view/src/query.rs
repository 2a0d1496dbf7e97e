//! The query of a URL: percent-encoded names and values to text, with what is wrong in words.
//!
//! Degenerate: a name that comes twice is an error, as is one that nobody asked for, so that a
//! misspelt option is noticed.

use std::collections::BTreeMap;

/// Names and values of a query, which are taken one by one.
#[derive(Debug, Default)]
pub(crate) struct Query(BTreeMap<String, String>);

impl Query {
    /// Parses `a=1&b=two%20words`.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut values = BTreeMap::new();
        for pair in text.split('&').filter(|pair| !pair.is_empty()) {
            let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
            let (name, value) = (decode(name)?, decode(value)?);
            if values.insert(name.clone(), value).is_some() {
                return Err(format!("\"{}\" is given twice", name.escape_default()));
            }
        }
        Ok(Self(values))
    }

    /// Takes a value out.
    pub(crate) fn take(&mut self, name: &str) -> Option<String> {
        self.0.remove(name)
    }

    /// Takes a number out.
    pub(crate) fn number<T: std::str::FromStr>(&mut self, name: &str) -> Result<Option<T>, String> {
        let Some(text) = self.take(name) else { return Ok(None) };
        text.parse().map(Some).map_err(|_| format!("\"{name}\" is \"{}\", expected a number", text.escape_default()))
    }

    /// Returns an error if a value is left that nothing took.
    pub(crate) fn finish(self) -> Result<(), String> {
        match self.0.into_keys().next() {
            Some(name) => Err(format!("unknown parameter \"{}\"", name.escape_default())),
            None => Ok(()),
        }
    }
}

/// Decodes percent escapes and `+`.
fn decode(text: &str) -> Result<String, String> {
    let malformed = || format!("\"{}\" is not percent-encoded UTF-8", text.escape_default());
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'%' => {
                let mut digit = || rest.next().and_then(|digit| char::from(digit).to_digit(16));
                let (high, low) = (digit().ok_or_else(malformed)?, digit().ok_or_else(malformed)?);
                (high * 16 + low) as u8
            }
            b'+' => b' ',
            other => other,
        });
    }
    String::from_utf8(bytes).map_err(|_| malformed())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_decoded_and_taken_once() {
        let mut query = Query::parse("view=images%2F000&edit=gain+0.5&width=640").unwrap();
        assert_eq!(query.take("view").as_deref(), Some("images/000"));
        assert_eq!(query.take("edit").as_deref(), Some("gain 0.5"));
        assert_eq!(query.number("width"), Ok(Some(640u32)));
        assert_eq!(query.number::<u32>("width"), Ok(None));
        assert_eq!(query.finish(), Ok(()));
    }

    #[test]
    fn what_is_wrong_is_said() {
        assert!(Query::parse("a=1&a=2").unwrap_err().contains("twice"));
        for text in ["a=%", "a=%4", "a=%zz", "a=%ff"] {
            assert!(Query::parse(text).unwrap_err().contains("percent-encoded"), "{text}");
        }
        assert!(Query::parse("wdith=3").unwrap().finish().unwrap_err().contains("wdith"));
        assert!(Query::parse("width=a").unwrap().number::<u32>("width").unwrap_err().contains("expected a number"));
    }
}
