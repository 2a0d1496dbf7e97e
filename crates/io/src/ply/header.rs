//! The head of a PLY file: format, comments, elements and their properties, up to `end_header`.

use std::io::BufRead;

use crate::IoError;
use crate::ply::source::PlySource;
use crate::splat_model::SplatModel;

/// Longest header that is believed to be one, bytes.
const MAX_HEADER: u64 = 1 << 20;

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Returns the size in bytes.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// The content of a property in each row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    /// Rows claimed.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Returns the index of a property.
    pub(super) fn position(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name)
    }

    /// Returns the number that stands for white in a property of a colour: the largest of an
    /// unsigned type, 1 of floats; `None` for other types.
    pub(super) fn white(&self, property: &str) -> Option<f32> {
        match self.properties.get(self.position(property)?)?.kind {
            Kind::Scalar(Scalar::U8) => Some(255.0),
            Kind::Scalar(Scalar::U16) => Some(65535.0),
            Kind::Scalar(Scalar::F32 | Scalar::F64) => Some(1.0),
            _ => None,
        }
    }

    /// Returns whether a property has 64-bit numbers.
    pub(super) fn is_double(&self, property: usize) -> bool {
        self.properties.get(property).is_some_and(|p| p.kind == Kind::Scalar(Scalar::F64))
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) format: Format,
    /// Texts behind `comment `.
    pub(super) comments: Vec<String>,
    pub(super) elements: Vec<Element>,
}

/// Returns the model that a comment of Brush (`SplatRenderMode: mip`) or Postshot (`antialiased 1`)
/// states, in any case.
fn stated_model(comment: &str) -> Option<SplatModel> {
    let comment = comment.to_ascii_lowercase();
    let words: Vec<&str> = comment.split_whitespace().collect();
    match words[..] {
        ["splatrendermode:", name] => Some(SplatModel::from_name(name)),
        ["antialiased", "1"] => Some(SplatModel::Antialiased),
        ["antialiased", "0"] => Some(SplatModel::Plain),
        _ => None,
    }
}

impl Header {
    /// Returns the model of the splats as the last comment about it states it.
    pub(super) fn splat_model(&self) -> SplatModel {
        self.comments.iter().rev().find_map(|comment| stated_model(comment)).unwrap_or_default()
    }

    /// Reads up to and including `end_header`.
    pub(super) fn read<R: BufRead>(source: &mut PlySource<'_, R>) -> Result<Self, IoError> {
        let mut buffer = Vec::new();
        source.skip_mark()?;
        if source.line(&mut buffer)? != Some(b"ply".as_slice()) {
            return Err(source.invalid("line 1", "expected \"ply\": this is not a PLY file"));
        }
        let mut format = None;
        let mut header = Self { format: Format::Ascii, comments: Vec::new(), elements: Vec::new() };
        for number in 2u32.. {
            let place = format!("line {number}");
            if source.position > MAX_HEADER {
                return Err(source.invalid(place, "header longer than 1 MiB, expected \"end_header\""));
            }
            let Some(line) = source.line(&mut buffer)? else {
                return Err(source.invalid(place, "file ends within the header, expected \"end_header\"; the file is truncated"));
            };
            let line = String::from_utf8_lossy(line);
            let (keyword, rest) = line.split_once([' ', '\t']).unwrap_or((&line, ""));
            let parsed = match keyword {
                "end_header" => break,
                "comment" => {
                    header.comments.push(rest.to_owned());
                    Ok(())
                }
                "obj_info" | "" => Ok(()),
                "format" => parse_format(rest).map(|f| format = Some(f)),
                "element" => header.add_element(rest),
                "property" => header.add_property(rest),
                other => Err(format!("unknown keyword {other:?}, expected format, comment, element, property or end_header")),
            };
            parsed.map_err(|message| source.invalid(place, message))?;
        }
        header.format = format.ok_or_else(|| source.invalid("header", "no \"format\" line, expected one such as \"format ascii 1.0\""))?;
        Ok(header)
    }

    fn add_element(&mut self, rest: &str) -> Result<(), String> {
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        let [name, count] = words[..] else {
            return Err(format!("element {rest:?}, expected a name and a count"));
        };
        let count = count.parse().map_err(|_| format!("element {name:?} has count {count:?}, expected a whole number"))?;
        if self.elements.iter().any(|e| e.name == name) {
            return Err(format!("element {name:?} occurs twice"));
        }
        self.elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
        Ok(())
    }

    fn add_property(&mut self, rest: &str) -> Result<(), String> {
        let scalar =
            |name: &str| Scalar::from_name(name).ok_or_else(|| format!("unknown type {name:?}, expected one such as float or uchar"));
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        let (kind, name) = match words[..] {
            ["list", count, item, name] => {
                let count = scalar(count)?;
                if matches!(count, Scalar::F32 | Scalar::F64) {
                    return Err(format!("list {name:?} is counted by a {:?}, expected a whole number", words[1]));
                }
                (Kind::List { count, item: scalar(item)? }, name)
            }
            [kind, name] => (Kind::Scalar(scalar(kind)?), name),
            _ => return Err(format!("property {rest:?}, expected a type and a name")),
        };
        let element = self.elements.last_mut().ok_or_else(|| format!("property {name:?} comes before any element"))?;
        element.properties.push(Property { name: name.to_owned(), kind });
        Ok(())
    }
}

fn parse_format(rest: &str) -> Result<Format, String> {
    let words: Vec<&str> = rest.split_ascii_whitespace().collect();
    match words[..] {
        ["ascii", "1.0"] => Ok(Format::Ascii),
        ["binary_little_endian", "1.0"] => Ok(Format::LittleEndian),
        ["binary_big_endian", "1.0"] => Ok(Format::BigEndian),
        _ => Err(format!("format {rest:?}, expected ascii, binary_little_endian or binary_big_endian, version 1.0")),
    }
}
