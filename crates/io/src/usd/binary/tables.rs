//! The tables of a crate file, read with every size checked against the bytes that there are.

use super::integers::{decompressed, decompressed_integers};
use super::{HEADER_BYTES, MAGIC, ValueRep};

/// Oldest version whose arrays are counted by 64 bits.
const OLDEST: [u8; 2] = [0, 7];
/// Newest version whose tables are known.
const NEWEST: [u8; 2] = [0, 13];
/// Largest number of entries of a table: files of splats have a few hundred.
const MAX_ENTRIES: usize = 1 << 20;
/// Largest length of all paths together, bytes.
const MAX_PATHS: usize = 1 << 28;
/// Deepest path.
const MAX_DEPTH: usize = 256;

/// A spec of the file.
pub(super) struct Spec {
    /// Path, such as `/World/Splats.positions`.
    pub(super) path: String,
    /// Kind ([`super::spec`]).
    pub(super) kind: u32,
    /// Index of the first of its fields.
    fields_at: usize,
}

/// The tables.
pub(super) struct Tables {
    tokens: Vec<String>,
    strings: Vec<u32>,
    fields: Vec<(u32, ValueRep)>,
    sets: Vec<u32>,
    pub(super) specs: Vec<Spec>,
}

impl Tables {
    /// Reads the tables of a file's bytes.
    ///
    /// # Errors
    /// A version that is not known; tables that are truncated, damaged or contradict each other.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, String> {
        let header = bytes.get(..HEADER_BYTES).filter(|header| header.starts_with(MAGIC)).ok_or("the header is truncated")?;
        let version = [header[8], header[9]];
        if version < OLDEST || version > NEWEST {
            let [major, minor] = version;
            return Err(format!(
                "version {major}.{minor} of binary OpenUSD, expected 0.7 to 0.13; convert it with usdcat FILE -o FILE.usda"
            ));
        }
        let contents_at = Cursor { bytes: header, at: 16 }.count()?;
        let mut contents = Cursor { bytes, at: contents_at };
        let sections = contents.count()?;
        let mut found: [Option<Cursor<'_>>; NAMES.len()] = Default::default();
        for _ in 0..sections.min(64) {
            let name = contents.take(16)?;
            let (start, size) = (contents.count()?, contents.count()?);
            let end =
                start.checked_add(size).filter(|end| *end <= bytes.len()).ok_or("a section reaches beyond the file; it is truncated")?;
            let place =
                NAMES.iter().position(|known| name.starts_with(known.as_bytes()) && name[known.len()..].first().is_none_or(|b| *b == 0));
            if let Some(place) = place {
                found[place] = Some(Cursor { bytes: &bytes[..end], at: start });
            }
        }
        let mut section = |i: usize| found[i].take().ok_or_else(|| format!("no section {}", NAMES[i]));
        let tokens = tokens(section(0)?)?;
        let strings = strings(section(1)?)?;
        let fields = fields(section(2)?)?;
        let sets = section(3)?.integers_table()?;
        let paths = paths(section(4)?, &tokens)?;
        let specs = specs(section(5)?, paths)?;
        Ok(Self { tokens, strings, fields, sets, specs })
    }

    /// Returns the value of a spec's field; `None` where it has none.
    pub(super) fn field(&self, spec: &Spec, name: &str) -> Option<ValueRep> {
        let set = self.sets.get(spec.fields_at..)?.iter().take_while(|field| **field != u32::MAX);
        let mut fields = set.filter_map(|field| self.fields.get(*field as usize));
        fields.find(|(token, _)| self.token(*token) == Some(name)).map(|(_, value)| *value)
    }

    /// Returns a token by its number.
    pub(super) fn token(&self, number: u32) -> Option<&str> {
        self.tokens.get(number as usize).map(String::as_str)
    }

    /// Returns a text by its number.
    pub(super) fn string(&self, number: u32) -> Option<&str> {
        self.token(*self.strings.get(number as usize)?)
    }
}

/// Names of the sections that are read.
const NAMES: [&str; 6] = ["TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS"];

/// A place in bytes.
#[derive(Clone, Copy)]
pub(super) struct Cursor<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) at: usize,
}

impl<'a> Cursor<'a> {
    /// Takes `length` bytes.
    ///
    /// # Errors
    /// Fewer are left.
    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(length).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| format!("byte {}: expected {length} more; the file is truncated", self.at))?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    /// Takes a number of 32 bits.
    pub(super) fn u32(&mut self) -> Result<u32, String> {
        let bytes = self.take(4)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    /// Takes a number of 64 bits.
    pub(super) fn u64(&mut self) -> Result<u64, String> {
        let [low, high] = [self.u32()?, self.u32()?];
        Ok(u64::from(high) << 32 | u64::from(low))
    }

    /// Takes a count or an offset of 64 bits.
    pub(super) fn count(&mut self) -> Result<usize, String> {
        let value = self.u64()?;
        usize::try_from(value).map_err(|_| format!("a size of {value}, more than memory has"))
    }

    /// Takes a number of entries, which has a bound.
    fn entries(&mut self) -> Result<usize, String> {
        let count = self.count()?;
        if count <= MAX_ENTRIES { Ok(count) } else { Err(format!("a table of {count} entries, expected at most {MAX_ENTRIES}")) }
    }

    /// Takes bytes behind their length.
    fn sized(&mut self) -> Result<&'a [u8], String> {
        let length = self.count()?;
        self.take(length)
    }

    /// Takes `count` compressed integers behind their length.
    pub(super) fn integers(&mut self, count: usize) -> Result<Vec<u32>, String> {
        decompressed_integers(self.sized()?, count)
    }

    /// Takes a count and as many compressed integers.
    fn integers_table(mut self) -> Result<Vec<u32>, String> {
        let count = self.entries()?;
        self.integers(count)
    }
}

fn tokens(mut section: Cursor<'_>) -> Result<Vec<String>, String> {
    let (count, length) = (section.entries()?, section.count()?);
    let plain = decompressed(section.sized()?, length)?;
    let tokens: Vec<String> = plain.split(|byte| *byte == 0).take(count).map(|token| String::from_utf8_lossy(token).into_owned()).collect();
    if tokens.len() == count { Ok(tokens) } else { Err(format!("{} tokens, expected {count}", tokens.len())) }
}

fn strings(mut section: Cursor<'_>) -> Result<Vec<u32>, String> {
    let count = section.entries()?;
    let bytes = section.take(count * 4)?;
    Ok(bytes.as_chunks::<4>().0.iter().map(|number| u32::from_le_bytes(*number)).collect())
}

fn fields(mut section: Cursor<'_>) -> Result<Vec<(u32, ValueRep)>, String> {
    let count = section.entries()?;
    let names = section.integers(count)?;
    let values = decompressed(section.sized()?, count * 8)?;
    let values = values.as_chunks::<8>().0.iter().map(|value| ValueRep(u64::from_le_bytes(*value)));
    let fields: Vec<(u32, ValueRep)> = names.into_iter().zip(values).collect();
    if fields.len() == count { Ok(fields) } else { Err(format!("{} fields, expected {count}", fields.len())) }
}

/// Returns the paths by number.
fn paths(mut section: Cursor<'_>, tokens: &[String]) -> Result<Vec<String>, String> {
    let (count, encoded) = (section.entries()?, section.entries()?);
    let (numbers, elements, steps) = (section.integers(encoded)?, section.integers(encoded)?, section.integers(encoded)?);
    let mut paths = vec![String::new(); count];
    // Places that are still to be read, each with the path around it and its depth.
    let mut pending = vec![(0usize, String::new(), 0usize)];
    let (mut read, mut length) = (0, 0);
    while let Some((place, parent, depth)) = pending.pop() {
        read += 1;
        if place >= encoded || read > encoded || depth > MAX_DEPTH {
            return if encoded == 0 { Ok(paths) } else { Err("the paths do not form a tree".to_owned()) };
        }
        let (number, element, step) = (numbers[place] as usize, elements[place] as i32, steps[place] as i32);
        let token = tokens.get(element.unsigned_abs() as usize).ok_or("a path has a token that there is none of")?;
        let path = match (place, parent.as_str()) {
            (0, _) => "/".to_owned(),
            (_, parent) if element < 0 => format!("{parent}.{token}"),
            (_, "/") => format!("/{token}"),
            (_, parent) => format!("{parent}/{token}"),
        };
        length += path.len();
        if length > MAX_PATHS {
            return Err(format!("paths of more than {MAX_PATHS} bytes"));
        }
        if step >= 0 {
            pending.push((place + if step == 0 { 1 } else { step as usize }, parent, depth));
        }
        if step > 0 || step == -1 {
            pending.push((place + 1, path.clone(), depth + 1));
        }
        *paths.get_mut(number).ok_or("a path has a number beyond their count")? = path;
    }
    Ok(paths)
}

fn specs(mut section: Cursor<'_>, paths: Vec<String>) -> Result<Vec<Spec>, String> {
    let count = section.entries()?;
    let (numbers, sets, kinds) = (section.integers(count)?, section.integers(count)?, section.integers(count)?);
    let spec = |((number, set), kind): ((u32, u32), u32)| {
        let path = paths.get(number as usize).ok_or("a spec has a path that there is none of")?.clone();
        Ok(Spec { path, kind, fields_at: set as usize })
    };
    numbers.into_iter().zip(sets).zip(kinds).map(spec).collect()
}
