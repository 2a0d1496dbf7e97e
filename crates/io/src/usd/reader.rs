//! OpenUSD text to a scene.

use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::DMat4;
use luxel_core::{Cutoffs, RadianceScale, RasterConfig, Scene, Similarity, sh};

use super::cameras::{OPERATION, Transform};
use super::field::{Field, is_read};
use super::lexer::{Lexer, Token};
use super::shown::{ARCS, Hidden, INSTANCER, Unshown};
use super::{ORDER, PRIM_TYPE, binary, color_space_named};
use crate::IoError;
use crate::bake::{BakeRecord, RECORD_KEY};
use crate::byte_order_mark::MARK;
use crate::input::Input;
use crate::joined::{MAX_PARTS, settle_together, similarity};
use crate::memory::check_memory;
use crate::read_file::{open_regular, read_file};
use crate::scene_file::SceneFile;

/// Deepest nesting of prims.
const MAX_PRIMS: usize = 64;

/// Reads the particle field of splats.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, no splats, or what is not supported: a transform
/// that shears or mirrors, fields of different colours, values over time, a colour space without a
/// name here.
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
    let mut layer = Layer { lexer: Lexer::new(reader, path), record: None, fields: Vec::new(), unshown: Unshown::default() };
    // The rest of the first line.
    while !matches!(layer.lexer.next()?, Token::NewLine | Token::End) {}
    layer.body(&mut Prim::default(), 0)?;
    let Layer { record, fields, unshown, .. } = layer;
    scene_of(path, fields, record, &unshown)
}

/// Reads a binary file or a package with its warnings.
pub(crate) fn read_binary_file(path: &Path) -> Result<SceneFile, IoError> {
    let bytes = read_file(path)?;
    // The file, and its arrays.
    check_memory(path, bytes.len() as u64 * 3)?;
    decode_binary_file(Input::new(path, &bytes))
}

/// Decodes a binary file's or a package's bytes as [`read_usda`] reads text; `name` is for errors.
///
/// # Errors
/// The same as [`read_usda`]; a package whose scene is text, compressed or encrypted.
pub fn decode_usdc(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    decode_binary_file(Input::new(name, bytes)).map(|file| file.scene)
}

/// Decodes a binary file or a package with its warnings.
pub(crate) fn decode_binary_file(input: Input<'_>) -> Result<SceneFile, IoError> {
    let layer = if input.bytes.starts_with(binary::PACKAGE_MAGIC) {
        binary::layer_in_package(input.bytes).map_err(|e| input.invalid(e))?
    } else {
        input.bytes
    };
    if layer.starts_with(b"#usda") {
        return read(input.name, layer);
    }
    let found = binary::read(layer).map_err(|error| match error.is_unsupported {
        true => input.unsupported(error.message),
        false => input.invalid(error.message),
    })?;
    scene_of(input.name, found.fields, found.record, &found.unshown)
}

/// Makes a scene of the fields and the record of the bake.
fn scene_of(path: &Path, fields: Vec<Field>, record: Option<String>, unshown: &Unshown) -> Result<SceneFile, IoError> {
    let record = record.map(|json| BakeRecord::parse(&json)).transpose().map_err(|e| IoError::invalid(path, e))?;
    let (mut warnings, mut parts) = (unshown.lines(), Vec::new());
    let mut is_as_written = fields.len() == 1;
    for field in fields {
        let matrix = field.matrix().map_err(|e| IoError::invalid(path, e))?;
        // A bake of this program is moved to the origin that its record states, and not further.
        is_as_written &= record.as_ref().is_some_and(|record| is_moved_only_to(&matrix, record));
        let moved = similarity(matrix).map_err(|e| IoError::unsupported(path, e))?;
        let color_space = record.as_ref().map_or(field.color_space, BakeRecord::color_space);
        // Colours of a display are from programs that render as 3D Gaussian splatting does.
        let cutoffs = if color_space.is_linear() { RasterConfig::default().cutoffs } else { Cutoffs::PARITY };
        let raster = record.as_ref().map_or_else(|| RasterConfig { cutoffs, ..RasterConfig::default() }, |record| record.raster);
        let splats = field.splats(&mut warnings).map_err(|e| IoError::invalid(path, e))?;
        let radiance_scale = RadianceScale::ONE;
        let (edits, world_from_local, metres_per_unit) = (Vec::new(), Similarity::IDENTITY, None);
        parts.push((Scene { splats, radiance_scale, color_space, raster, edits, world_from_local, metres_per_unit }, moved));
    }
    if let (Some(record), [_], true) = (&record, parts.as_slice(), is_as_written)
        && let Some((scene, _)) = parts.pop()
    {
        let scene = record.scene(scene.splats).map_err(|e| IoError::invalid(path, e))?;
        return Ok(SceneFile { scene, warnings });
    }
    if record.is_some() {
        warnings.push("another program has moved the splats: they are where it put them, not where the data set has them".to_owned());
    }
    let joined = settle_together(parts).map_err(|e| IoError::unsupported(path, e))?;
    let none = || {
        let message = format!("no prim of type {PRIM_TYPE}, expected one; splats of other types are not read");
        IoError::invalid(path, unshown.lines().into_iter().fold(message, |message, line| message + "; " + &line))
    };
    let scene = joined.ok_or_else(none)?;
    scene.splats.validate().map_err(|e| IoError::invalid(path, e))?;
    Ok(SceneFile { scene, warnings })
}

/// Returns whether a matrix is a move to the local origin that a record states, in the digits of a
/// file.
fn is_moved_only_to(matrix: &DMat4, record: &BakeRecord) -> bool {
    let found = matrix.w_axis.truncate().as_vec3();
    let is_move = DMat4::from_translation(matrix.w_axis.truncate()) == *matrix;
    is_move && found == record.origin_in_file().as_vec3()
}

/// A prim under way of being read.
#[derive(Default)]
struct Prim {
    /// The arrays of a particle field.
    field: Option<Field>,
    transform: Transform,
    hidden: Option<Hidden>,
}

/// A layer under way of being read.
struct Layer<'a, R> {
    lexer: Lexer<'a, R>,
    record: Option<String>,
    fields: Vec<Field>,
    unshown: Unshown,
}

impl<R: BufRead> Layer<'_, R> {
    /// Reads statements up to the end of the prim, or of the file.
    fn body(&mut self, prim: &mut Prim, depth: usize) -> Result<(), IoError> {
        loop {
            match self.lexer.next_on()? {
                Token::End if depth == 0 => return Ok(()),
                Token::End => return Err(self.lexer.invalid("file ends within a prim; the file is truncated")),
                Token::Mark(b'}') if depth > 0 => return Ok(()),
                Token::Mark(b'(') if depth == 0 => self.layer_metadata()?,
                Token::Mark(b';') => {}
                // Metadata of the property before.
                Token::Mark(b'(') => self.lexer.skip_brackets()?,
                Token::Word(word) if matches!(word.as_str(), "def" | "over") => self.prim(depth, false)?,
                // Classes are templates, no splats.
                Token::Word(word) if word == "class" => self.prim(depth, true)?,
                Token::Word(word) => self.property(word, prim)?,
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
                Token::Word(word) if word == "subLayers" => self.unshown.compose(),
                Token::End => return Err(self.lexer.invalid("file ends within the layer's metadata; the file is truncated")),
                _ => {}
            }
            let [_, last] = previous;
            previous = [last, token];
        }
        Ok(())
    }

    /// Reads the metadata of a prim behind its bracket; returns whether it hides the prim.
    fn prim_metadata(&mut self) -> Result<Option<Hidden>, IoError> {
        let (mut depth, mut hidden) = (1usize, None);
        let mut name = String::new();
        while depth > 0 {
            match self.lexer.next_on()? {
                Token::Mark(b'(' | b'[' | b'{') => depth += 1,
                Token::Mark(b')' | b']' | b'}') => depth -= 1,
                Token::Word(value) if depth == 1 && name == "active" => {
                    hidden = hidden.or((value == "false" || value == "0").then_some(Hidden::Inactive));
                    name = String::new();
                }
                Token::Word(word) if depth == 1 => {
                    if ARCS.contains(&word.as_str()) {
                        self.unshown.compose();
                    }
                    name = word;
                }
                Token::End => return Err(self.lexer.invalid("file ends within a prim's metadata; the file is truncated")),
                _ => {}
            }
            if depth > MAX_PRIMS {
                return Err(self.lexer.invalid(format_args!("more than {MAX_PRIMS} brackets within one another")));
            }
        }
        Ok(hidden)
    }

    /// Reads a prim behind its `def`.
    fn prim(&mut self, depth: usize, is_class: bool) -> Result<(), IoError> {
        if depth >= MAX_PRIMS {
            return Err(self.lexer.invalid(format_args!("more than {MAX_PRIMS} prims within one another")));
        }
        let (mut kind, mut hidden) = (None, None);
        loop {
            match self.lexer.next_on()? {
                Token::Word(word) => kind = Some(word),
                Token::Text(_) => {}
                Token::Mark(b'(') => hidden = hidden.or(self.prim_metadata()?),
                Token::Mark(b'{') => break,
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a prim's type, name, metadata or body"))),
            }
        }
        let is_field = kind.as_deref() == Some(PRIM_TYPE);
        if kind.as_deref() == Some(INSTANCER) {
            hidden = Some(Hidden::Prototype);
        }
        let mut prim = Prim { field: is_field.then(Field::default), transform: Transform::default(), hidden };
        let first_below = self.fields.len();
        self.body(&mut prim, depth + 1)?;
        self.fields.extend(prim.field);
        // Their transforms come behind those of the prims around them.
        for field in self.fields.iter_mut().skip(first_below) {
            field.transforms.insert(0, prim.transform.clone());
        }
        if is_class {
            self.fields.truncate(first_below);
        }
        if let Some(reason) = prim.hidden {
            self.unshown.hide(reason, self.fields.len() - first_below);
            self.fields.truncate(first_below);
        }
        if self.fields.len() > MAX_PARTS {
            return Err(self
                .lexer
                .unsupported(format_args!("more than {MAX_PARTS} prims of type {PRIM_TYPE}, expected fewer; join them first")));
        }
        Ok(())
    }

    /// Reads a property from its first word on: words, then perhaps `= value`, then perhaps
    /// metadata.
    fn property(&mut self, first: String, prim: &mut Prim) -> Result<(), IoError> {
        let mut words = vec![first];
        loop {
            match self.lexer.next()? {
                Token::Word(word) => words.push(word),
                // `float[]`, `variantSet "name"`.
                Token::Mark(b'[' | b']') | Token::Text(_) => {}
                Token::Mark(b'=') => break,
                Token::Mark(b'(') => return self.lexer.skip_brackets(),
                Token::NewLine | Token::Mark(b';') | Token::End => return Ok(()),
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a property's name or value"))),
            }
            if words.len() > 16 {
                return Err(self.lexer.invalid("more than 16 words before a value: not OpenUSD text"));
            }
        }
        let name = words.pop().unwrap_or_default();
        if matches!(name.as_str(), "visibility" | "purpose") {
            if let Token::Text(value) = self.lexer.next_on()? {
                prim.hidden = prim.hidden.or(Hidden::by_attribute(&name, &value));
            }
            return Ok(());
        }
        if words.first().is_some_and(|word| word == "variantSet") {
            self.unshown.compose();
            return self.lexer.skip_value();
        }
        let (base, is_timed) = name.strip_suffix(".timeSamples").map_or((name.as_str(), false), |base| (base, true));
        if base == ORDER {
            prim.transform.set_order(self.lexer.texts(base)?);
            return Ok(());
        }
        if base.starts_with(OPERATION) {
            return self.lexer.timed(base, is_timed, prim.transform.op(base));
        }
        match &mut prim.field {
            Some(field) => self.field_value(&name, field),
            None => self.lexer.skip_value(),
        }
    }

    fn field_value(&mut self, name: &str, field: &mut Field) -> Result<(), IoError> {
        match name {
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
