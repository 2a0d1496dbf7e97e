//! The log of a run in forms that other programs plot: a table, and TensorBoard's event file.
//!
//! In: the records of `log.jsonl`, of which these files are copies. Out: `log.csv` with a column
//! for each number, and `tensorboard/`, a folder for `tensorboard --logdir`. A resumed run writes
//! both anew from the records that it keeps. Numbers that a record does not have are empty in the
//! table and missing in the event file.

mod event_file;

use std::fmt;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, SystemTime};

use luxel::error::Context;
use luxel::{LogRecord, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use self::event_file::{EventFile, Scalar};
use crate::files;

/// A form of the log for plots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlotLog {
    /// TensorBoard's event file, in `tensorboard/`.
    Tensorboard,
    /// A table, `log.csv`.
    Csv,
}

impl PlotLog {
    /// All forms.
    pub const ALL: [Self; 2] = [Self::Tensorboard, Self::Csv];

    /// Returns the name in options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tensorboard => "tensorboard",
            Self::Csv => "csv",
        }
    }
}

impl fmt::Display for PlotLog {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for PlotLog {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("unknown log \"{text}\", expected {}", Self::ALL.map(Self::name).join(" or "));
        Self::ALL.into_iter().find(|log| log.name() == text).ok_or_else(expected)
    }
}

/// Name of the table in a run's folder.
pub(super) const TABLE: &str = "log.csv";
/// Name of TensorBoard's folder in a run's folder.
pub(super) const TENSORBOARD: &str = "tensorboard";
/// Name of the event file; TensorBoard looks for `tfevents`.
const EVENTS: &str = "events.out.tfevents.0.luxel";

/// The plots of a run that are being written.
#[derive(Default)]
pub(super) struct Plots {
    table: Option<Table>,
    events: Option<Events>,
}

impl Plots {
    /// Begins the plots that are asked for in a run's folder with the records that the run keeps.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(super) fn begin(folder: &Path, asked: &[PlotLog], kept: &[LogRecord]) -> Result<Self> {
        let mut plots = Self::default();
        if asked.contains(&PlotLog::Csv) {
            plots.table = Some(Table::create(&folder.join(TABLE))?);
        }
        if asked.contains(&PlotLog::Tensorboard) {
            let before = kept.last().map_or(0.0, |record| record.elapsed_s);
            plots.events = Some(Events::create(&folder.join(TENSORBOARD).join(EVENTS), before)?);
        }
        kept.iter().try_for_each(|record| plots.append(record))?;
        Ok(plots)
    }

    /// Appends a record.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(super) fn append(&mut self, record: &LogRecord) -> Result<()> {
        if self.table.is_none() && self.events.is_none() {
            return Ok(());
        }
        let numbers = numbers(record)?;
        if let Some(table) = &mut self.table {
            table.append(&numbers)?;
        }
        if let Some(events) = &mut self.events {
            events.append(record, &numbers)?;
        }
        Ok(())
    }
}

/// A number of a record by its name; `None` where the record does not have it.
struct Number {
    name: String,
    value: Option<f64>,
}

/// Returns the numbers of a record, those of an object in it with its name before theirs.
fn numbers(record: &LogRecord) -> Result<Vec<Number>> {
    let mut found = Vec::new();
    add(&mut found, "", &serde_json::to_value(record)?);
    Ok(found)
}

fn add(found: &mut Vec<Number>, prefix: &str, value: &Value) {
    for (name, value) in value.as_object().into_iter().flatten() {
        let name = if prefix.is_empty() { name.clone() } else { format!("{prefix}_{name}") };
        match value {
            Value::Object(_) => add(found, &name, value),
            Value::Number(number) => found.push(Number { name, value: number.as_f64() }),
            Value::Null => found.push(Number { name, value: None }),
            Value::Bool(_) | Value::String(_) | Value::Array(_) => {}
        }
    }
}

/// The table.
struct Table {
    path: PathBuf,
    writer: csv::Writer<File>,
    has_header: bool,
}

impl Table {
    fn create(path: &Path) -> Result<Self> {
        Ok(Self { path: path.into(), writer: csv::Writer::from_writer(empty_file(path)?), has_header: false })
    }

    fn append(&mut self, numbers: &[Number]) -> Result<()> {
        let text = |number: &Number| number.value.map_or(String::new(), |value| value.to_string());
        let mut write = || {
            if !std::mem::replace(&mut self.has_header, true) {
                self.writer.write_record(numbers.iter().map(|number| &number.name))?;
            }
            self.writer.write_record(numbers.iter().map(text))?;
            self.writer.flush()?;
            Ok::<_, csv::Error>(())
        };
        write().with_context(|| format!("{}: cannot write", self.path.display()))
    }
}

/// TensorBoard's file.
struct Events {
    path: PathBuf,
    file: EventFile<File>,
    /// Time at which the clock of training stood at 0.
    began: SystemTime,
}

impl Events {
    fn create(path: &Path, elapsed_s: f64) -> Result<Self> {
        let now = SystemTime::now();
        let began = Duration::try_from_secs_f64(elapsed_s).ok().and_then(|elapsed| now.checked_sub(elapsed)).unwrap_or(now);
        let file = empty_file(path)?;
        let file = EventFile::begin(file, unix_seconds(began)).with_context(|| format!("{}: cannot write", path.display()))?;
        Ok(Self { path: path.into(), file, began })
    }

    fn append(&mut self, record: &LogRecord, numbers: &[Number]) -> Result<()> {
        let scalars = numbers.iter().filter(|number| number.name != "iteration");
        let scalars = scalars.filter_map(|number| Some(Scalar { name: &number.name, value: number.value? as f32 }));
        let time = unix_seconds(self.began) + record.elapsed_s;
        self.file.append(time, record.iteration.into(), scalars).with_context(|| format!("{}: cannot write", self.path.display()))
    }
}

/// Makes a file without content in place of the one there may be, which may be a link, and opens
/// it.
fn empty_file(path: &Path) -> Result<File> {
    files::write_text(path, "")?;
    File::options().append(true).open(path).with_context(|| format!("{}: cannot open", path.display()))
}

fn unix_seconds(time: SystemTime) -> f64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::super::log::tests::record;
    use super::*;

    #[test]
    fn a_table_has_a_column_for_each_number() {
        let folder = tempfile::tempdir().unwrap();
        let mut plots = Plots::begin(folder.path(), &[PlotLog::Csv], &[record(100)]).unwrap();
        plots.append(&record(200)).unwrap();
        let mut table = csv::Reader::from_path(folder.path().join(TABLE)).unwrap();
        let header = table.headers().unwrap().clone();
        let column = |name: &str| header.iter().position(|found| found == name).unwrap();
        let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 2);
        let at = |row: usize, name: &str| rows[row].get(column(name)).unwrap().to_owned();
        assert_eq!([at(0, "iteration"), at(1, "iteration"), at(1, "loss"), at(1, "psnr_test")], ["100", "200", "0.1", ""]);
        assert!(!folder.path().join(TENSORBOARD).exists());
    }

    #[test]
    fn names_parse_back() {
        for log in PlotLog::ALL {
            assert_eq!(log.to_string().parse(), Ok(log));
        }
        assert_eq!("wandb".parse::<PlotLog>().unwrap_err(), "unknown log \"wandb\", expected tensorboard or csv");
    }
}
