//! OpenUSD text to a scene.

use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::DVec3;
use luxel_core::{RadianceScale, RasterConfig, Scene, Similarity, sh};

use super::field::{Field, is_read};
use super::lexer::{Lexer, Token};
use super::{ORDER, PRIM_TYPE, TRANSFORMED, TRANSLATE, binary, color_space_named};
use crate::IoError;
use crate::bake::{BakeRecord, RECORD_KEY};
use crate::byte_order_mark::MARK;
use crate::local_frame::settled;
use crate::memory::check_memory;
use crate::read_file::{open_regular, read_file};
use crate::scene_file::SceneFile;

/// Deepest nesting of prims.
const MAX_PRIMS: usize = 64;

/// Reads the particle field of splats.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, no splats, arrays that do not go together, or
/// what is not supported: a transform of the field or of a prim around it, several fields, values
/// over time, a colour space without a name here.
pub fn read_usda(path: &Path) -> Result<Scene, IoError> {
    read_scene_file(path).map(|file| file.scene)
}

/// Reads the particle field with its warnings.
pub(crate) fn read_scene_file(path: &Path) -> Result<SceneFile, IoError> {
    let (file, _) = open_regular(path)?;
    read(path, BufReader::with_capacity(1 << 20, file))
}

/// Decodes a file's bytes as [`read_usda`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_usda`].
pub fn decode_usda(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    read(name, bytes).map(|file| file.scene)
}

fn read<R: BufRead>(path: &Path, mut reader: R) -> Result<SceneFile, IoError> {
    if reader.fill_buf().is_ok_and(|head| head.starts_with(MARK)) {
        reader.consume(MARK.len());
    }
    let mut first = [0u8; 5];
    let is_text = reader.read_exact(&mut first).is_ok() && &first == b"#usda";
    if !is_text {
        return Err(IoError::invalid(path, "line 1: expected \"#usda 1.0\": this is not OpenUSD text"));
    }
    let mut layer = Layer { lexer: Lexer::new(reader, path), record: None, field: None, field_within: None, transformed_at: None };
    // The rest of the first line.
    while !matches!(layer.lexer.next()?, Token::NewLine | Token::End) {}
    layer.prims(0)?;
    let Layer { record, field, .. } = layer;
    let Some(field) = field else {
        return Err(IoError::invalid(path, format_args!("no prim of type {PRIM_TYPE}, expected one; splats of other types are not read")));
    };
    scene_of(path, field, record)
}

/// Reads a binary file or a package with its warnings.
pub(crate) fn read_binary_file(path: &Path) -> Result<SceneFile, IoError> {
    let bytes = read_file(path)?;
    // The file, and its arrays.
    check_memory(path, bytes.len() as u64 * 3)?;
    decode_binary_file(path, &bytes)
}

/// Decodes a binary file's or a package's bytes as [`read_usda`] reads text; `name` is for errors.
///
/// # Errors
/// The same as [`read_usda`]; a package whose scene is text, compressed or encrypted.
pub fn decode_usdc(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    decode_binary_file(name, bytes).map(|file| file.scene)
}

fn decode_binary_file(name: &Path, bytes: &[u8]) -> Result<SceneFile, IoError> {
    let layer = if bytes.starts_with(binary::PACKAGE_MAGIC) {
        binary::layer_in_package(bytes).map_err(|e| IoError::invalid(name, e))?
    } else {
        bytes
    };
    if layer.starts_with(b"#usda") {
        return read(name, layer);
    }
    let found = binary::read(layer).map_err(|error| match error.is_unsupported {
        true => IoError::unsupported(name, error.message),
        false => IoError::invalid(name, error.message),
    })?;
    scene_of(name, found.field, found.record)
}

/// Makes a scene of a field and the record of the bake.
fn scene_of(path: &Path, field: Field, record: Option<String>) -> Result<SceneFile, IoError> {
    let record = record.map(|json| BakeRecord::parse(&json)).transpose().map_err(|e| IoError::invalid(path, e))?;
    let color_space = field.color_space;
    // A move to the origin that the record states; another one has no record here.
    let origin = record.as_ref().map_or(DVec3::ZERO, BakeRecord::origin_in_file).as_vec3().to_array();
    if field.is_translated && field.translation != Some(origin) {
        return Err(IoError::unsupported(path, TRANSFORMED));
    }
    let mut warnings = Vec::new();
    let splats = field.splats(&mut warnings).map_err(|e| IoError::invalid(path, e))?;
    let scene = match record {
        Some(record) => record.scene(splats).map_err(|e| IoError::invalid(path, e))?,
        None => settled(
            Scene {
                splats,
                radiance_scale: RadianceScale::ONE,
                color_space,
                raster: RasterConfig::default(),
                edits: Vec::new(),
                world_from_local: Similarity::IDENTITY,
                metres_per_unit: None,
            },
            None,
        ),
    };
    Ok(SceneFile { scene, warnings })
}

/// The effect of a property on its prim's place.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Placed {
    AsItIs,
    Moved,
}

/// A layer under way of being read.
struct Layer<'a, R> {
    lexer: Lexer<'a, R>,
    record: Option<String>,
    field: Option<Field>,
    /// Depth of the innermost open prim's body that contains the field.
    field_within: Option<usize>,
    /// Depth of the outermost open body whose prim is transformed, and with it its content.
    transformed_at: Option<usize>,
}

impl<R: BufRead> Layer<'_, R> {
    /// Reads statements up to the end of the file or of the prim around them.
    fn prims(&mut self, depth: usize) -> Result<(), IoError> {
        loop {
            match self.lexer.next_on()? {
                Token::End if depth == 0 => return Ok(()),
                Token::End => return Err(self.lexer.invalid("file ends within a prim; the file is truncated")),
                Token::Mark(b'}') if depth > 0 => {
                    self.transformed_at = self.transformed_at.filter(|at| *at < depth);
                    self.field_within = self.field_within.map(|within| within.min(depth - 1));
                    return Ok(());
                }
                Token::Mark(b'(') if depth == 0 => self.layer_metadata()?,
                Token::Mark(b';') => {}
                // Metadata of the property before.
                Token::Mark(b'(') => self.lexer.skip_brackets()?,
                Token::Word(word) if matches!(word.as_str(), "def" | "over" | "class") => self.prim(depth)?,
                Token::Word(word) => {
                    if self.property(vec![word], None)? == Placed::Moved {
                        // The order of a prim's properties and children is free.
                        if self.field_within.is_some_and(|within| within >= depth) {
                            return Err(self.transformed());
                        }
                        self.transformed_at.get_or_insert(depth);
                    }
                }
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a prim or a property"))),
            }
        }
    }

    /// Looks for the record of the bake.
    fn layer_metadata(&mut self) -> Result<(), IoError> {
        let mut depth = 1usize;
        let mut previous = [Token::NewLine, Token::NewLine];
        while depth > 0 {
            let token = self.lexer.next_on()?;
            match &token {
                Token::Mark(b'(' | b'[' | b'{') => depth += 1,
                Token::Mark(b')' | b']' | b'}') => depth -= 1,
                Token::Text(text) if previous == [Token::Word(RECORD_KEY.into()), Token::Mark(b'=')] => self.record = Some(text.clone()),
                Token::End => return Err(self.lexer.invalid("file ends within the layer's metadata; the file is truncated")),
                _ => {}
            }
            let [_, last] = previous;
            previous = [last, token];
        }
        Ok(())
    }

    /// Reads a prim behind its `def`.
    fn prim(&mut self, depth: usize) -> Result<(), IoError> {
        if depth >= MAX_PRIMS {
            return Err(self.lexer.invalid(format_args!("more than {MAX_PRIMS} prims within one another")));
        }
        let mut kind = None;
        loop {
            match self.lexer.next_on()? {
                Token::Word(word) => kind = Some(word),
                Token::Text(_) => {}
                Token::Mark(b'(') => self.lexer.skip_brackets()?,
                Token::Mark(b'{') => break,
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a prim's type, name, metadata or body"))),
            }
        }
        if kind.as_deref() == Some(PRIM_TYPE) {
            if self.field_within.is_some() {
                return Err(self.lexer.unsupported(format_args!("a second prim of type {PRIM_TYPE}, expected one; export them apart")));
            }
            if self.transformed_at.is_some() {
                return Err(self.transformed());
            }
            self.field_within = Some(depth);
            let mut field = Field::default();
            self.field_body(&mut field, depth + 1)?;
            self.field = Some(field);
            return Ok(());
        }
        self.prims(depth + 1)
    }

    /// Reads the body of the particle field.
    fn field_body(&mut self, field: &mut Field, depth: usize) -> Result<(), IoError> {
        loop {
            match self.lexer.next_on()? {
                Token::End => return Err(self.lexer.invalid("file ends within the splats; the file is truncated")),
                Token::Mark(b'}') => return Ok(()),
                Token::Mark(b';') => {}
                Token::Mark(b'(') => self.lexer.skip_brackets()?,
                Token::Word(word) if matches!(word.as_str(), "def" | "over" | "class") => self.prim(depth)?,
                Token::Word(word) => {
                    if self.property(vec![word], Some(field))? == Placed::Moved {
                        return Err(self.transformed());
                    }
                }
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a property"))),
            }
        }
    }

    /// Reads a property from its first word on: words, then perhaps `= value`, then perhaps
    /// metadata.
    fn property(&mut self, mut words: Vec<String>, field: Option<&mut Field>) -> Result<Placed, IoError> {
        loop {
            match self.lexer.next()? {
                Token::Word(word) => words.push(word),
                // `float[]`, `variantSet "name"`.
                Token::Mark(b'[' | b']') | Token::Text(_) => {}
                Token::Mark(b'=') => break,
                Token::Mark(b'(') => return self.lexer.skip_brackets().map(|()| Placed::AsItIs),
                Token::NewLine | Token::Mark(b';') | Token::End => return Ok(Placed::AsItIs),
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a property's name or value"))),
            }
            if words.len() > 16 {
                return Err(self.lexer.invalid("more than 16 words before a value: not OpenUSD text"));
            }
        }
        let name = words.pop().unwrap_or_default();
        if name == ORDER {
            return self.transform_order(field);
        }
        match field {
            Some(field) => self.field_value(&name, field)?,
            None => self.lexer.skip_value()?,
        }
        Ok(Placed::AsItIs)
    }

    /// Reads an order of transforms; one that is not empty moves the prim and its content. A field
    /// that is only moved to a place keeps that for later.
    fn transform_order(&mut self, field: Option<&mut Field>) -> Result<Placed, IoError> {
        let opening = self.lexer.next_on()?;
        match (opening, self.lexer.next_on()?) {
            (Token::Mark(b'['), Token::Mark(b']')) => Ok(Placed::AsItIs),
            (Token::Mark(b'['), Token::Text(only)) if only == TRANSLATE && field.is_some() => {
                if self.lexer.next_on()? != Token::Mark(b']') {
                    return self.lexer.skip_brackets().map(|()| Placed::Moved);
                }
                if let Some(field) = field {
                    field.is_translated = true;
                }
                Ok(Placed::AsItIs)
            }
            (Token::Mark(b'['), _) => self.lexer.skip_brackets().map(|()| Placed::Moved),
            (other, _) => Err(self.lexer.invalid(format_args!("\"xformOpOrder\" begins with {other:?}, expected a list"))),
        }
    }

    fn transformed(&self) -> IoError {
        self.lexer.unsupported(TRANSFORMED)
    }

    /// Reads three numbers in parentheses.
    fn triple(&mut self, name: &str) -> Result<[f32; 3], IoError> {
        let mut words = Vec::new();
        let mut token = self.lexer.next_on()?;
        while token != Token::Mark(b')') && words.len() < 4 {
            match token {
                Token::Word(word) => words.push(word),
                Token::Mark(b'(' | b',') => {}
                other => return Err(self.lexer.invalid(format_args!("{name:?} has {other:?}, expected three numbers in parentheses"))),
            }
            token = self.lexer.next_on()?;
        }
        // By way of 64 bits, as the origin that it is compared with.
        let numbers: Option<Vec<f32>> = words.iter().map(|word| word.parse::<f64>().ok().map(|v| v as f32)).collect();
        let triple = numbers.and_then(|numbers| <[f32; 3]>::try_from(numbers).ok());
        triple.ok_or_else(|| self.lexer.invalid(format_args!("{name:?} is {words:?}, expected three numbers")))
    }

    fn field_value(&mut self, name: &str, field: &mut Field) -> Result<(), IoError> {
        match name {
            TRANSLATE => {
                field.translation = Some(self.triple(name)?);
                return Ok(());
            }
            "radiance:sphericalHarmonicsDegree" => {
                let Token::Word(word) = self.lexer.next_on()? else { return Err(self.lexer.invalid("expected a degree")) };
                let degree = word.parse().ok().filter(|degree| *degree <= sh::MAX_DEGREE);
                let message = || format!("{name:?} is {word:?}, expected a degree of 0 to {}", sh::MAX_DEGREE);
                field.degree = degree.ok_or_else(|| self.lexer.invalid(message()))?;
                return Ok(());
            }
            "colorSpace:name" => {
                let Token::Text(text) = self.lexer.next_on()? else {
                    return Err(self.lexer.invalid("expected the name of a colour space"));
                };
                field.color_space = color_space_named(&text).map_err(|message| self.lexer.unsupported(message))?;
                return Ok(());
            }
            timed if timed.ends_with(".timeSamples") && is_read(timed.trim_end_matches(".timeSamples")) => {
                return Err(self
                    .lexer
                    .unsupported(format_args!("{name:?}: splats that change over time, expected one value; export a single frame")));
            }
            _ => {}
        }
        let Some(array) = field.array(name) else { return self.lexer.skip_value() };
        let values = self.lexer.numbers(name)?;
        // The float array takes precedence over its half-float twin, as the schema requires.
        if array.is_empty() || !name.ends_with('h') {
            *array = values;
        }
        Ok(())
    }
}
