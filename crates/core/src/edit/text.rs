//! The text form of edits: as users write them, and as an edited scene's log stores them.
//!
//! ```text
//! edits     = statement (';' statement)*
//! statement = 'where' selection | 'gain' X | 'stops' X | 'power' X | 'pivot' X
//!           | 'curve' X:Y,X:Y,... | 'clamp-max' X | 'compress-above' X[:RATIO]
//!           | 'lift-below' X[:AMOUNT] | 'light' N:GAIN
//! selection = every ('or' every)*
//! every     = unary ('and' unary)*
//! unary     = 'not' unary | '(' selection ')' | test ['~' WIDTH]
//! test      = 'all' | quantity ('<' | '<=' | '>' | '>=') level | quantity 'in' level '..' level
//!           | 'box' '(' x0,y0,z0,x1,y1,z1 ')' | 'sphere' '(' x,y,z,RADIUS ')'
//!           | 'mask' '(' FILE, VIEW ')'
//! quantity  = 'L' | 'luminance' | 'hue' | 'saturation'
//! level     = X | 'p' PERCENT
//! ```
//! FILE and VIEW are bare, or in single or double quotes. A `where` applies to the maps after it,
//! up to the next; `pivot` belongs to the `power` before it. The output of `Display` reads back as
//! the same edits. Degenerate: empty text gives no edits. No input makes the reader panic; errors
//! name the column, counted from 1.

pub(super) mod cursor;

use std::str::FromStr;

use self::cursor::Cursor;
use super::map::{DEFAULT_AMOUNT, DEFAULT_RATIO};
use super::{Comparison, Curve, Edit, Level, Map, MaskName, Quantity, Selection};
use crate::MAX_LIGHTS;

/// Deepest nesting of parentheses and `not`.
const MAX_DEPTH: usize = 64;

/// A syntax error in an edit's text, with its column.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("column {column}: {message}")]
pub struct EditTextError {
    /// Column in characters, counted from 1.
    pub column: usize,
    /// Message with expected and found.
    pub message: String,
}

/// A statement of the text form.
#[derive(Clone, Debug, PartialEq)]
pub enum Statement {
    /// Begins an edit with this selection.
    Where(Selection),
    /// Adds a map to the edit.
    Map(Map),
    /// Sets the pivot of the preceding power.
    Pivot(f32),
}

impl Statement {
    /// Names of the statements that are maps.
    pub const MAPS: [&'static str; 8] = ["gain", "stops", "power", "curve", "clamp-max", "compress-above", "lift-below", "light"];

    /// Parses the statement `name` with the value `text`.
    ///
    /// # Errors
    /// [`EditTextError`], its column counted in `text`.
    pub fn parse(name: &str, text: &str) -> Result<Self, EditTextError> {
        let mut cursor = Cursor::new(text);
        let statement = cursor.value_of(name)?;
        cursor.end()?;
        Ok(statement)
    }
}

impl FromStr for Edit {
    type Err = EditTextError;

    /// Reads the text form of one edit: one selection and its maps.
    fn from_str(text: &str) -> Result<Self, EditTextError> {
        let edits = Self::parse_all(text)?;
        let count = edits.len();
        match <[Self; 1]>::try_from(edits) {
            Ok([edit]) => Ok(edit),
            Err(_) => Err(EditTextError { column: 1, message: format!("{count} edits, expected one") }),
        }
    }
}

impl Edit {
    /// Reads the text form.
    ///
    /// # Errors
    /// [`EditTextError`].
    pub fn parse_all(text: &str) -> Result<Vec<Self>, EditTextError> {
        edits_of(text, "", &mut |_, _| Ok(false))
    }

    /// Combines statements into edits.
    ///
    /// # Errors
    /// The index of a pivot without a power before it, and the reason.
    pub fn sequence<'s>(statements: impl IntoIterator<Item = &'s Statement>) -> Result<Vec<Self>, (usize, String)> {
        let mut edits: Vec<Self> = Vec::new();
        for (i, statement) in statements.into_iter().enumerate() {
            match (statement, edits.last_mut()) {
                (Statement::Where(selection), _) => edits.push(Self { selection: selection.clone(), maps: Vec::new() }),
                (Statement::Map(map), Some(edit)) => edit.maps.push(map.clone()),
                (Statement::Map(map), None) => edits.push(Self { selection: Selection::All, maps: vec![map.clone()] }),
                (Statement::Pivot(value), edit) => match edit.and_then(|edit| edit.maps.last_mut()) {
                    Some(Map::Power { pivot: pivot @ None, .. }) => *pivot = Some(*value),
                    _ => return Err((i, "a pivot belongs to a power; put it right behind one".to_owned())),
                },
            }
        }
        Ok(edits)
    }
}

/// Reads the statements of a text: `other` is offered each statement's name first, and returns
/// whether it has read its value; `others` names those for errors.
pub(super) fn edits_of(
    text: &str,
    others: &str,
    other: &mut dyn FnMut(&mut Cursor<'_>, &str) -> Result<bool, EditTextError>,
) -> Result<Vec<Edit>, EditTextError> {
    let mut cursor = Cursor::new(text);
    let mut statements = Vec::new();
    loop {
        cursor.space();
        if !cursor.eat(";") {
            if cursor.rest().is_empty() {
                return Edit::sequence(statements.iter().map(|(_, statement): &(usize, _)| statement)).map_err(|(i, message)| {
                    let column = statements.get(i).map_or(1, |(start, _)| cursor.column_of(*start));
                    EditTextError { column, message }
                });
            }
            let start = cursor.at;
            let expected = || format!("{}{others}", statement_names());
            let Some(name) = cursor.word() else { return Err(cursor.expected(&expected())) };
            if !other(&mut cursor, name)? {
                if !is_statement(name) {
                    cursor.at = start;
                    return Err(cursor.expected(&expected()));
                }
                statements.push((start, cursor.value_of(name)?));
            }
            if !cursor.rest().is_empty() && !cursor.rest().starts_with(';') {
                return Err(cursor.expected("\";\" or the end"));
            }
        }
    }
}

impl FromStr for Selection {
    type Err = EditTextError;

    fn from_str(text: &str) -> Result<Self, EditTextError> {
        let mut cursor = Cursor::new(text);
        let selection = cursor.selection(0)?;
        cursor.end()?;
        Ok(selection)
    }
}

fn is_statement(name: &str) -> bool {
    ["where", "pivot"].contains(&name) || Statement::MAPS.contains(&name)
}

fn statement_names() -> String {
    format!("one of where, pivot, {}", Statement::MAPS.join(", "))
}

impl Cursor<'_> {
    fn value_of(&mut self, name: &str) -> Result<Statement, EditTextError> {
        self.space();
        let (start, number) = (self.at, "a number");
        let optional = |cursor: &mut Self, default| if cursor.eat(":") { cursor.number(number) } else { Ok(default) };
        let map = match name {
            "where" => return self.selection(0).map(Statement::Where),
            "pivot" => {
                let value = self.number(number)?;
                let checked = Map::Power { exponent: 1.0, pivot: Some(value) }.check();
                return checked.map(|()| Statement::Pivot(value)).map_err(|e| self.refused(start, &e));
            }
            "gain" => Map::Gain(self.number(number)?),
            "stops" => Map::Stops(self.number(number)?),
            "power" => Map::Power { exponent: self.number(number)?, pivot: None },
            "curve" => Map::Curve(self.curve()?),
            "clamp-max" => Map::ClampMax(self.number(number)?),
            "compress-above" => Map::CompressAbove { threshold: self.number(number)?, ratio: optional(self, DEFAULT_RATIO)? },
            "lift-below" => Map::LiftBelow { threshold: self.number(number)?, amount: optional(self, DEFAULT_AMOUNT)? },
            "light" => self.light()?,
            _ => return Err(self.error(format!("there is no edit \"{name}\", expected {}", statement_names()))),
        };
        map.check().map_err(|e| self.refused(start, &e))?;
        Ok(Statement::Map(map))
    }

    fn light(&mut self) -> Result<Map, EditTextError> {
        let start = self.at;
        let number = self.number("the number of a light")?;
        if number.fract() != 0.0 || !(1.0..=MAX_LIGHTS as f32).contains(&number) {
            let message = format!("light {number}, expected a number from 1 to {MAX_LIGHTS}");
            return Err(EditTextError { column: self.column_of(start), message });
        }
        self.need(":")?;
        Ok(Map::Light { number: number as u8, gain: self.number("a number")? })
    }

    fn curve(&mut self) -> Result<Curve, EditTextError> {
        let start = self.at;
        let mut points = Vec::new();
        loop {
            let x = self.number("a point x:y")?;
            self.need(":")?;
            points.push([x, self.number("a number")?]);
            if !self.eat(",") {
                return Curve::new(points).map_err(|e| self.refused(start, &e));
            }
        }
    }

    pub(super) fn selection(&mut self, depth: usize) -> Result<Selection, EditTextError> {
        self.list("or", |cursor| cursor.list("and", |cursor| cursor.unary(depth), Selection::And), Selection::Or)
    }

    /// Reads one item, or several with `word` between them.
    fn list(
        &mut self,
        word: &str,
        mut item: impl FnMut(&mut Self) -> Result<Selection, EditTextError>,
        join: fn(Vec<Selection>) -> Selection,
    ) -> Result<Selection, EditTextError> {
        self.space();
        let first = item(self)?;
        if self.peek_word() != Some(word) {
            return Ok(first);
        }
        let mut items = vec![first];
        while self.eat_word(word) {
            items.push(item(self)?);
        }
        Ok(join(items))
    }

    fn unary(&mut self, depth: usize) -> Result<Selection, EditTextError> {
        if depth > MAX_DEPTH {
            return Err(self.error(format!("nested deeper than {MAX_DEPTH} levels")));
        }
        if self.eat_word("not") {
            return Ok(Selection::Not(Box::new(self.unary(depth + 1)?)));
        }
        if self.eat("(") {
            let inner = self.selection(depth + 1)?;
            self.need(")")?;
            return Ok(inner);
        }
        let start = self.at;
        let test = self.test()?;
        test.check().map_err(|e| self.refused(start, &e))?;
        Ok(test)
    }

    fn test(&mut self) -> Result<Selection, EditTextError> {
        let start = self.at;
        match self.word() {
            Some("all") => Ok(Selection::All),
            Some("L" | "l" | "luminance") => self.comparison(Quantity::Luminance),
            Some("hue") => self.comparison(Quantity::Hue),
            Some("saturation") => self.comparison(Quantity::Saturation),
            Some("box") => {
                self.need("(")?;
                let [x0, y0, z0, x1, y1, z1] = self.numbers(["x0", "y0", "z0", "x1", "y1", "z1"])?;
                self.need(")")?;
                Ok(Selection::Cuboid { min: [x0, y0, z0], max: [x1, y1, z1], feather: self.feather()? })
            }
            Some("sphere") => {
                self.need("(")?;
                let [x, y, z, radius] = self.numbers(["x", "y", "z", "radius"])?;
                self.need(")")?;
                Ok(Selection::Sphere { center: [x, y, z], radius: radius as f32, feather: self.feather()? })
            }
            Some("mask") => {
                self.need("(")?;
                let file = self.name(',', "an image file and a comma")?;
                self.need(",")?;
                let view = self.name(')', "the name of a view and \")\"")?;
                self.need(")")?;
                Ok(Selection::Mask { name: MaskName { file, view }, feather: self.feather()? })
            }
            _ => {
                self.at = start;
                Err(self.expected("a test: L, hue or saturation compared, box(...), sphere(...), mask(...), all, not or \"(\""))
            }
        }
    }

    fn comparison(&mut self, quantity: Quantity) -> Result<Selection, EditTextError> {
        if self.eat_word("in") {
            let low = self.level()?;
            self.need("..")?;
            let high = self.level()?;
            return Ok(Selection::Within { quantity, low, high, feather: self.feather()? });
        }
        let comparisons = [("<=", Comparison::AtMost), (">=", Comparison::AtLeast), ("<", Comparison::Below), (">", Comparison::Above)];
        let found = comparisons.into_iter().find(|(symbol, _)| self.eat(symbol));
        let (_, comparison) = found.ok_or_else(|| self.expected("<, <=, >, >= or in"))?;
        Ok(Selection::Compare { quantity, comparison, level: self.level()?, feather: self.feather()? })
    }

    fn level(&mut self) -> Result<Level, EditTextError> {
        const EXPECTED: &str = "a number, or a percentile such as p20";
        if self.rest().starts_with('p') {
            let start = self.at;
            self.at += 1;
            return self.number(EXPECTED).map(Level::Percentile).map_err(|_| {
                self.at = start;
                self.expected(EXPECTED)
            });
        }
        self.number(EXPECTED).map(Level::Absolute)
    }

    fn feather(&mut self) -> Result<f32, EditTextError> {
        if self.eat("~") { self.number("the width of the soft edge") } else { Ok(0.0) }
    }
}
