//! The cameras of OpenUSD text.

use std::collections::HashMap;
use std::io::BufRead;
use std::path::Path;

use super::{OPERATION, PROPERTIES, Timed, Transform, UsdCamera, UsdCameras};
use crate::IoError;
use crate::byte_order_mark::MARK;
use crate::usd::ORDER;
use crate::usd::lexer::{Lexer, Token};

/// Deepest nesting of prims.
const MAX_PRIMS: usize = 64;
/// Most words before a value.
const MAX_WORDS: usize = 16;

/// Reads the cameras of a text layer.
pub(super) fn read_text<R: BufRead>(path: &Path, mut reader: R) -> Result<UsdCameras, IoError> {
    if reader.fill_buf().is_ok_and(|head| head.starts_with(MARK)) {
        reader.consume(MARK.len());
    }
    let mut first = [0u8; 5];
    if reader.read_exact(&mut first).is_err() || &first != b"#usda" {
        return Err(IoError::invalid(path, "line 1: expected \"#usda 1.0\": this is not OpenUSD, neither text nor binary"));
    }
    let mut layer = Layer { lexer: Lexer::new(reader, path), out: UsdCameras::default(), around: Vec::new() };
    while !matches!(layer.lexer.next()?, Token::NewLine | Token::End) {}
    layer.body(&mut Prim::default(), 0)?;
    Ok(layer.out)
}

/// A prim under way of being read.
#[derive(Default)]
struct Prim {
    name: String,
    is_camera: bool,
    is_orthographic: bool,
    properties: HashMap<String, Timed>,
    transform: Transform,
    /// Cameras found below it, whose transform is yet to be put before theirs.
    first_below: usize,
}

struct Layer<'a, R> {
    lexer: Lexer<'a, R>,
    out: UsdCameras,
    /// Names of the prims around the place of reading.
    around: Vec<String>,
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
                Token::Mark(b'(') => self.lexer.skip_brackets()?,
                Token::Word(word) if matches!(word.as_str(), "def" | "over") => self.prim(depth, false)?,
                // Classes are templates, no cameras.
                Token::Word(word) if word == "class" => self.prim(depth, true)?,
                Token::Word(word) => self.property(word, prim)?,
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a prim or a property"))),
            }
        }
    }

    /// Looks for the unit, the up axis and the range of time.
    fn layer_metadata(&mut self) -> Result<(), IoError> {
        let mut depth = 1usize;
        let mut previous = [Token::NewLine, Token::NewLine];
        while depth > 0 {
            let token = self.lexer.next_on()?;
            let is_value_of = |key: &str| depth == 1 && previous == [Token::Word(key.into()), Token::Mark(b'=')];
            match &token {
                Token::Word(word) if is_value_of("metersPerUnit") => {
                    let unit = word.parse().unwrap_or(f64::NAN);
                    self.out.set_unit(unit).map_err(|message| self.lexer.invalid(message))?;
                }
                Token::Word(word) if is_value_of("startTimeCode") => self.out.range[0] = word.parse().ok().filter(|v: &f64| v.is_finite()),
                Token::Word(word) if is_value_of("endTimeCode") => self.out.range[1] = word.parse().ok().filter(|v: &f64| v.is_finite()),
                Token::Text(text) if is_value_of("upAxis") => self.out.up_axis.clone_from(text),
                Token::Mark(b'(' | b'[' | b'{') => depth += 1,
                Token::Mark(b')' | b']' | b'}') => depth -= 1,
                Token::End => return Err(self.lexer.invalid("file ends within the layer's metadata; the file is truncated")),
                _ => {}
            }
            let [_, last] = previous;
            previous = [last, token];
        }
        Ok(())
    }

    /// Reads a prim behind its `def`.
    fn prim(&mut self, depth: usize, is_class: bool) -> Result<(), IoError> {
        if depth >= MAX_PRIMS {
            return Err(self.lexer.invalid(format_args!("more than {MAX_PRIMS} prims within one another")));
        }
        let mut prim = Prim { first_below: self.out.cameras.len(), ..Prim::default() };
        loop {
            match self.lexer.next_on()? {
                Token::Word(word) => prim.is_camera = word == "Camera",
                Token::Text(name) => prim.name = name,
                Token::Mark(b'(') => self.lexer.skip_brackets()?,
                Token::Mark(b'{') => break,
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a prim's type, name, metadata or body"))),
            }
        }
        self.around.push(prim.name.clone());
        self.body(&mut prim, depth + 1)?;
        for camera in self.out.cameras.get_mut(prim.first_below..).into_iter().flatten() {
            camera.transforms.insert(0, prim.transform.clone());
        }
        if is_class {
            self.out.cameras.truncate(prim.first_below);
        } else if prim.is_camera {
            let path = format!("/{}", self.around.join("/"));
            let Prim { is_orthographic, properties, transform, .. } = prim;
            self.out.cameras.insert(prim.first_below, UsdCamera { path, properties, is_orthographic, transforms: vec![transform] });
        }
        self.around.pop();
        Ok(())
    }

    /// Reads a property from its first word on.
    fn property(&mut self, first: String, prim: &mut Prim) -> Result<(), IoError> {
        let mut words = vec![first];
        loop {
            match self.lexer.next()? {
                Token::Word(word) => words.push(word),
                Token::Mark(b'[' | b']') | Token::Text(_) => {}
                Token::Mark(b'=') => break,
                Token::Mark(b'(') => return self.lexer.skip_brackets(),
                // A block of variants: what is in it is not composed.
                Token::Mark(b'{') => return self.lexer.skip_brackets(),
                Token::NewLine | Token::Mark(b';') | Token::End => return Ok(()),
                other => return Err(self.lexer.invalid(format_args!("found {other:?}, expected a property's name or value"))),
            }
            if words.len() > MAX_WORDS {
                return Err(self.lexer.invalid(format_args!("more than {MAX_WORDS} words before a value: not OpenUSD text")));
            }
        }
        let name = words.pop().unwrap_or_default();
        if words.first().is_some_and(|word| word == "variantSet") {
            return self.lexer.skip_value();
        }
        let (base, is_timed) = name.strip_suffix(".timeSamples").map_or((name.as_str(), false), |base| (base, true));
        if base == ORDER {
            prim.transform.set_order(self.lexer.texts(base)?);
        } else if base.starts_with(OPERATION) {
            self.lexer.timed(base, is_timed, prim.transform.op(base))?;
        } else if PROPERTIES.contains(&base) {
            self.lexer.timed(base, is_timed, prim.properties.entry(base.to_owned()).or_default())?;
        } else if base == "projection" && !is_timed {
            match self.lexer.next_on()? {
                Token::Text(text) => prim.is_orthographic = text == "orthographic",
                other => return Err(self.lexer.invalid(format_args!("\"projection\" is {other:?}, expected a name in quotes"))),
            }
        } else {
            self.lexer.skip_value()?;
        }
        Ok(())
    }
}
