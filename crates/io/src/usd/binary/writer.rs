//! A layer to a crate file: values as they come, tables at the end.

use std::io::{self, Write};

use super::written_tables::{
    END_OF_SET, Field, Node, Spec, Table, counted, fields_table, integers_table, paths_table, specs_table, tokens_table,
};
use super::{HEADER_BYTES, MAGIC, ValueRep, kind, spec};

/// Version of the files.
const VERSION: [u8; 3] = [0, 8, 0];
/// Bytes that are written at a time.
const BLOCK: usize = 1 << 20;
/// A crate file that is being written: the root, and prims with their properties.
pub(super) struct CrateWriter<W> {
    out: W,
    at: u64,
    tokens: Table<String>,
    strings: Vec<u32>,
    fields: Table<Field>,
    sets: Vec<u32>,
    specs: Vec<Spec>,
    nodes: Vec<Node>,
}

/// A kind of attribute.
pub(super) enum Form {
    /// One of the schema that may change over time.
    Varying,
    /// One of the schema that does not change over time.
    Uniform,
    /// One of the schema that has a value for each vertex.
    PerVertex,
    /// One of no schema.
    Custom,
    /// A colour of the schema, in the space of this name.
    ColorOf(&'static str),
}

/// A field of a spec.
pub(super) struct FieldValue {
    name: &'static str,
    value: ValueRep,
}

impl<W: Write> CrateWriter<W> {
    /// Begins what is behind the header, which [`Self::finish`] returns.
    pub(super) fn new(out: W) -> Self {
        let mut tokens = Table::new();
        // A property's token is stored with a minus, which zero has none of.
        tokens.number(";-)".to_owned());
        Self {
            out,
            at: HEADER_BYTES as u64,
            tokens,
            strings: Vec::new(),
            fields: Table::new(),
            sets: Vec::new(),
            specs: Vec::new(),
            nodes: Vec::new(),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    /// Returns a token's value.
    pub(super) fn token(&mut self, token: &str) -> ValueRep {
        ValueRep::inlined(kind::TOKEN, self.tokens.number(token.to_owned()))
    }

    fn string_number(&mut self, text: &str) -> u32 {
        let token = self.tokens.number(text.to_owned());
        self.strings.push(token);
        self.strings.len() as u32 - 1
    }

    /// Returns a text's value.
    pub(super) fn string(&mut self, text: &str) -> ValueRep {
        ValueRep::inlined(kind::STRING, self.string_number(text))
    }

    /// Returns a truth value's value.
    pub(super) fn bool(&self, value: bool) -> ValueRep {
        ValueRep::inlined(kind::BOOL, value.into())
    }

    /// Returns an integer's value.
    pub(super) fn int(&self, value: i32) -> ValueRep {
        ValueRep::inlined(kind::INT, value as u32)
    }

    /// Writes a number and returns its value. Those that 32 bits hold are part of the value.
    pub(super) fn double(&mut self, value: f64) -> io::Result<ValueRep> {
        if f64::from(value as f32) == value {
            return Ok(ValueRep::inlined(kind::DOUBLE, (value as f32).to_bits()));
        }
        let at = self.at;
        self.write(&value.to_le_bytes())?;
        Ok(ValueRep::at(kind::DOUBLE, at))
    }

    /// Returns the value of a number that 32 bits hold.
    pub(super) fn float(&self, value: f32) -> ValueRep {
        ValueRep::inlined(kind::FLOAT, value.to_bits())
    }

    /// Returns the value of a path to another file.
    pub(super) fn asset(&mut self, path: &str) -> ValueRep {
        ValueRep::inlined(kind::ASSET_PATH, self.tokens.number(path.to_owned()))
    }

    /// Writes three numbers of 32 bits and returns their value.
    pub(super) fn vec3f(&mut self, value: [f32; 3]) -> io::Result<ValueRep> {
        let at = self.at;
        self.write(&value.map(f32::to_le_bytes).concat())?;
        Ok(ValueRep::at(kind::VEC3F, at))
    }

    /// Writes a matrix by rows and returns its value.
    pub(super) fn matrix4d(&mut self, rows: &[[f64; 4]; 4]) -> io::Result<ValueRep> {
        let at = self.at;
        self.write(&rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
        Ok(ValueRep::at(kind::MATRIX4D, at))
    }

    /// Writes three numbers and returns their value.
    pub(super) fn vec3d(&mut self, value: [f64; 3]) -> io::Result<ValueRep> {
        let at = self.at;
        self.write(&value.map(f64::to_le_bytes).concat())?;
        Ok(ValueRep::at(kind::VEC3D, at))
    }

    /// Writes a dictionary of one text and returns its value.
    pub(super) fn dictionary(&mut self, key: &str, text: &str) -> io::Result<ValueRep> {
        let (key, value) = (self.string_number(key), self.string(text));
        let at = self.at;
        self.write(&1u64.to_le_bytes())?;
        self.write(&key.to_le_bytes())?;
        // The value follows behind this number, its distance.
        self.write(&8i64.to_le_bytes())?;
        self.write(&value.0.to_le_bytes())?;
        Ok(ValueRep::at(kind::DICTIONARY, at))
    }

    fn token_numbers(&mut self, tokens: &[&str]) -> Vec<u8> {
        let numbers: Vec<u32> = tokens.iter().map(|token| self.tokens.number((*token).to_owned())).collect();
        let count = (numbers.len() as u64).to_le_bytes();
        count.into_iter().chain(numbers.into_iter().flat_map(u32::to_le_bytes)).collect()
    }

    /// Writes an array of tokens, the value of an attribute, and returns its value.
    pub(super) fn token_array(&mut self, tokens: &[&str]) -> io::Result<ValueRep> {
        let (at, bytes) = (self.at, self.token_numbers(tokens));
        self.write(&bytes)?;
        Ok(ValueRep::array_at(kind::TOKEN, at))
    }

    /// Writes names of children and returns their value.
    pub(super) fn token_vector(&mut self, tokens: &[&str]) -> io::Result<ValueRep> {
        let (at, bytes) = (self.at, self.token_numbers(tokens));
        self.write(&bytes)?;
        Ok(ValueRep::at(kind::TOKEN_VECTOR, at))
    }

    /// Writes tokens that are put before those of weaker layers, and returns their value.
    pub(super) fn prepended_tokens(&mut self, tokens: &[&str]) -> io::Result<ValueRep> {
        const HAS_PREPENDED: u8 = 1 << 5;
        let (at, bytes) = (self.at, self.token_numbers(tokens));
        self.write(&[HAS_PREPENDED])?;
        self.write(&bytes)?;
        Ok(ValueRep::at(kind::TOKEN_LIST_OP, at))
    }

    /// Writes an array of `count` entries of floats, or of integers, in blocks, and returns its
    /// value.
    pub(super) fn floats(&mut self, kind: u8, count: usize, entry: impl FnMut(usize, &mut Vec<u8>)) -> io::Result<ValueRep> {
        self.rows(kind, [count, 1], entry)
    }

    /// Writes an array of rows, each of so many entries of floats, as [`Self::floats`] does.
    pub(super) fn rows(
        &mut self,
        kind: u8,
        [count, entries]: [usize; 2],
        mut row: impl FnMut(usize, &mut Vec<u8>),
    ) -> io::Result<ValueRep> {
        if count == 0 {
            return Ok(ValueRep::array_at(kind, 0));
        }
        // Values stand at multiples of eight, so that programs can map them.
        let padding = (8 - self.at % 8) % 8;
        self.write(&[0; 8][..padding as usize])?;
        let at = self.at;
        self.write(&((count * entries) as u64).to_le_bytes())?;
        let mut block = Vec::with_capacity(BLOCK + 1024);
        for i in 0..count {
            row(i, &mut block);
            if block.len() >= BLOCK {
                self.write(&block)?;
                block.clear();
            }
        }
        self.write(&block)?;
        Ok(ValueRep::array_at(kind, at))
    }

    /// Adds a spec: first that of the root, then those of prims and properties.
    fn spec(&mut self, kind: u32, fields: &[FieldValue]) {
        let fields_at = self.sets.len() as u32;
        for field in fields {
            let name = self.tokens.number(field.name.to_owned());
            let number = self.fields.number(Field { name, value: field.value });
            self.sets.push(number);
        }
        self.sets.push(END_OF_SET);
        self.specs.push(Spec { fields_at, kind });
    }

    /// Adds the root.
    pub(super) fn root(&mut self, fields: &[FieldValue]) {
        self.spec(spec::PSEUDO_ROOT, fields);
    }

    /// Adds a prim with `depth` prims around it, the last ones that were added, and returns the
    /// number of its path.
    pub(super) fn prim(&mut self, name: &str, depth: usize, fields: &[FieldValue]) -> u32 {
        self.nodes.push(Node { name: name.to_owned(), depth, is_property: false });
        self.spec(spec::PRIM, fields);
        self.nodes.len() as u32
    }

    /// Adds a relationship of the last prim, which has no prims within it yet, to paths by number.
    pub(super) fn relationship(&mut self, name: &str, targets: &[u32]) -> io::Result<()> {
        let variability = FieldValue::new("variability", ValueRep::inlined(kind::VARIABILITY, 1));
        let targets = FieldValue::new("targetPaths", self.paths_of(targets)?);
        self.property(name);
        self.spec(spec::RELATIONSHIP, &[variability, targets]);
        Ok(())
    }

    /// Adds an output of the last prim, a shader's, which has no prims within it yet, and the
    /// number of the path that it is taken from.
    pub(super) fn output(&mut self, name: &str, from: Option<u32>) -> io::Result<()> {
        let mut fields = vec![FieldValue::new("typeName", self.token("token"))];
        if let Some(from) = from {
            fields.push(FieldValue::new("connectionPaths", self.paths_of(&[from])?));
        }
        self.property(name);
        self.spec(spec::ATTRIBUTE, &fields);
        Ok(())
    }

    /// Writes paths that replace those of weaker layers, and returns their value.
    fn paths_of(&mut self, paths: &[u32]) -> io::Result<ValueRep> {
        const IS_EXPLICIT: u8 = 1;
        const HAS_EXPLICIT: u8 = 1 << 1;
        let at = self.at;
        self.write(&[IS_EXPLICIT | HAS_EXPLICIT])?;
        self.write(&counted(paths.len(), paths.iter().flat_map(|path| path.to_le_bytes())))?;
        Ok(ValueRep::at(kind::PATH_LIST_OP, at))
    }

    /// Adds an attribute of the last prim, which has no prims within it yet.
    pub(super) fn attribute(&mut self, name: &str, kind: &str, form: Form, value: ValueRep) {
        let mut fields = vec![FieldValue::new("typeName", self.token(kind))];
        match form {
            Form::Varying => {}
            Form::Uniform => fields.push(FieldValue::new("variability", ValueRep::inlined(kind::VARIABILITY, 1))),
            Form::PerVertex => fields.push(FieldValue::new("interpolation", self.token("vertex"))),
            Form::Custom => fields.push(FieldValue::new("custom", ValueRep::inlined(kind::BOOL, 1))),
            Form::ColorOf(space) => fields.push(FieldValue::new("colorSpace", self.token(space))),
        }
        fields.push(FieldValue::new("default", value));
        self.property(name);
        self.spec(spec::ATTRIBUTE, &fields);
    }

    /// Adds the path of a property of the last prim.
    fn property(&mut self, name: &str) {
        let depth = self.nodes.iter().rev().find(|node| !node.is_property).map_or(0, |prim| prim.depth + 1);
        self.nodes.push(Node { name: name.to_owned(), depth, is_property: true });
    }

    /// Writes the tables and returns the header, which comes before all else.
    pub(super) fn finish(mut self) -> io::Result<Vec<u8>> {
        let mut contents = Vec::new();
        let paths = paths_table(&self.nodes, &mut self.tokens);
        let tables: [(&str, Vec<u8>); 6] = [
            ("TOKENS", tokens_table(&self.tokens.items)),
            ("STRINGS", counted(self.strings.len(), self.strings.iter().flat_map(|token| token.to_le_bytes()))),
            ("FIELDS", fields_table(&self.fields.items)),
            ("FIELDSETS", integers_table(self.sets.len(), &[&self.sets])),
            ("PATHS", paths),
            ("SPECS", specs_table(&self.specs)),
        ];
        for (name, table) in &tables {
            let mut entry = [0; 16];
            entry[..name.len()].copy_from_slice(name.as_bytes());
            contents.extend(entry);
            contents.extend(self.at.to_le_bytes());
            contents.extend((table.len() as u64).to_le_bytes());
            self.write(table)?;
        }
        let contents_at = self.at;
        self.write(&(tables.len() as u64).to_le_bytes())?;
        self.write(&contents)?;
        let mut header = MAGIC.to_vec();
        header.extend(VERSION);
        header.resize(16, 0);
        header.extend(contents_at.to_le_bytes());
        header.resize(HEADER_BYTES, 0);
        Ok(header)
    }
}

impl FieldValue {
    /// Returns a field.
    pub(super) fn new(name: &'static str, value: ValueRep) -> Self {
        Self { name, value }
    }

    /// Returns the field of a prim that is defined here.
    pub(super) fn definition() -> Self {
        Self { name: "specifier", value: ValueRep::inlined(kind::SPECIFIER, 0) }
    }
}
