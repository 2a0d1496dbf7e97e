//! Fields of JSON objects, checked: numbers, strings, image sides, angles, matrices.
//!
//! In: an object of a file, with defaults from the object around it. Out: values, or an error that
//! names file, place, key, expected and found. Degenerate: a missing key is `None`.

use std::path::Path;

use luxel_core::MAX_SIDE_PX;
use serde_json::{Map, Value};

use crate::IoError;
use crate::byte_order_mark::bytes_without_mark;

/// Parses JSON of any shape; numbers that JSON does not have are an error with a remedy.
pub(super) fn parse_json(path: &Path, bytes: &[u8]) -> Result<Value, IoError> {
    let bytes = bytes_without_mark(bytes);
    serde_json::from_slice(bytes).map_err(|e| {
        let has = |token: &[u8]| bytes.windows(token.len()).any(|window| window == token);
        let hint = if has(b"NaN") || has(b"Infinity") { "; NaN and Infinity are not JSON numbers" } else { "" };
        IoError::invalid(path, format!("not JSON: {e}{hint}"))
    })
}

/// Describes a value for people: "a list", "null" and so on.
pub(super) fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

/// An object of the file, with its place and the object that gives its defaults.
pub(super) struct Fields<'a> {
    pub(super) path: &'a Path,
    /// Empty, or `frame 3: `.
    pub(super) place: String,
    pub(super) own: &'a Map<String, Value>,
    pub(super) shared: Option<&'a Map<String, Value>>,
}

impl Fields<'_> {
    pub(super) fn error(&self, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.path, format!("{}{message}", self.place))
    }

    pub(super) fn unsupported(&self, message: impl std::fmt::Display) -> IoError {
        IoError::unsupported(self.path, format!("{}{message}", self.place))
    }

    pub(super) fn get(&self, key: &str) -> Option<&Value> {
        self.own.get(key).or_else(|| self.shared.and_then(|shared| shared.get(key)))
    }

    /// Returns the frame's own fields, where it has one of these keys: numbers that make a lens
    /// together are never mixed with the file's.
    pub(super) fn group(&self, keys: &[&str]) -> Self {
        let has_own = keys.iter().any(|key| self.own.contains_key(*key));
        Self { path: self.path, place: self.place.clone(), own: self.own, shared: self.shared.filter(|_| !has_own) }
    }

    /// Returns a finite number, if the key is there.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>, IoError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match value.as_f64() {
            Some(number) if number.is_finite() => Ok(Some(number)),
            _ => Err(self.error(format!("\"{key}\" is {}, expected a finite number", kind_of(value)))),
        }
    }

    /// Returns a number above 0, if the key is there.
    pub(super) fn positive(&self, key: &str) -> Result<Option<f64>, IoError> {
        match self.number(key)? {
            // No exposure, sensitivity or radiance of a photograph is beyond f32.
            Some(number) if !(number as f32).is_normal() || number < 0.0 => {
                Err(self.error(format!("\"{key}\" is {number}, expected a number above 0")))
            }
            number => Ok(number),
        }
    }

    pub(super) fn string(&self, key: &str) -> Result<Option<String>, IoError> {
        match self.get(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text.clone())),
            Some(other) => Err(self.error(format!("\"{key}\" is {}, expected a string", kind_of(other)))),
        }
    }

    /// Returns the image side, if the key is there: a whole number, also when written as 400.0.
    pub(super) fn side(&self, key: &str) -> Result<Option<u32>, IoError> {
        let Some(number) = self.number(key)? else { return Ok(None) };
        if number.fract() != 0.0 || !(1.0..=f64::from(MAX_SIDE_PX)).contains(&number) {
            return Err(self.error(format!("\"{key}\" is {number}, expected a whole number of pixels from 1 to {MAX_SIDE_PX}")));
        }
        Ok(Some(number as u32))
    }

    /// Returns the angle of view, if the key is there.
    pub(super) fn angle(&self, key: &str) -> Result<Option<f64>, IoError> {
        let angle = self.number(key)?;
        match angle {
            Some(angle) if angle <= 0.0 || angle >= std::f64::consts::PI => {
                Err(self.error(format!("\"{key}\" is {angle}, expected radians between 0 and pi")))
            }
            _ => Ok(angle),
        }
    }

    /// Returns the matrix of `R` rows of 4 finite numbers.
    pub(super) fn matrix<const R: usize>(&self, key: &str, value: &Value) -> Result<[[f64; 4]; R], IoError> {
        let Value::Array(rows) = value else {
            return Err(self.error(format!("\"{key}\" is {}, expected {R} rows of 4 numbers", kind_of(value))));
        };
        if rows.len() != R {
            return Err(self.error(format!("\"{key}\" has {} rows, expected {R}", rows.len())));
        }
        let mut matrix = [[0.0; 4]; R];
        for (r, (row, out)) in rows.iter().zip(&mut matrix).enumerate() {
            let Value::Array(row) = row else {
                return Err(self.error(format!("\"{key}\" row {r} is {}, expected 4 numbers", kind_of(row))));
            };
            if row.len() != 4 {
                return Err(self.error(format!("\"{key}\" row {r} has {} numbers, expected 4", row.len())));
            }
            for (c, (value, out)) in row.iter().zip(out).enumerate() {
                *out = value
                    .as_f64()
                    .filter(|v| v.is_finite())
                    .ok_or_else(|| self.error(format!("\"{key}\" row {r} column {c} is {}, expected a finite number", kind_of(value))))?;
            }
        }
        Ok(matrix)
    }
}

/// Returns a list of strings, or an error that describes what was found.
pub(super) fn string_list(value: &Value) -> Result<Vec<String>, String> {
    let Value::Array(items) = value else { return Err(format!("is {}, expected a list of names", kind_of(value))) };
    let name = |(i, item): (usize, &Value)| {
        item.as_str().map(str::to_owned).ok_or_else(|| format!("item {i} is {}, expected a name", kind_of(item)))
    };
    items.iter().enumerate().map(name).collect()
}
