//! Feeds damaged files to every reader for a bounded time and counts what happens: the part of
//! `scripts/soak` that runs in process.
//!
//! ```text
//! cargo run --release -p luxel-io --example soak -- MINUTES [SEED [READER]]
//! ```
//!
//! All readers share the minutes, or READER has them alone. Zero minutes list the readers.
//!
//! Out: one line of JSON per reader: inputs, those that were read, those that were refused, panics
//! of a library's decoder that were contained, the most memory that an input took, and the longest
//! time. Fails if a reader panics, or takes more memory than its files can stand for; the input is
//! then in `target/soak`.

mod camera_seeds;
mod mutate;
mod readers;
mod seeds;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use luxel_io::IoError;
use mutate::Mutator;
use peak_alloc::PeakAlloc;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Most memory that an input of these sizes may take: what any file may claim ("free" pixels and
/// blocks), with the copies that decoders hold at the same time.
const MOST_BYTES: usize = 1 << 30;

/// A reader of files.
pub(crate) struct Reader {
    /// Name in the table.
    pub(crate) name: &'static str,
    /// Reads the bytes of a file.
    pub(crate) read: fn(&[u8]) -> Result<(), IoError>,
    /// Files that it reads.
    pub(crate) seeds: Vec<Vec<u8>>,
}

/// The outcomes of a reader on its inputs.
#[derive(Default)]
struct Counts {
    inputs: u64,
    read: u64,
    refused: u64,
    contained: u64,
    panics: u64,
    too_large: u64,
    most_bytes: usize,
    longest: Duration,
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let minutes: f64 = arguments.next().and_then(|text| text.parse().ok()).unwrap_or(1.0);
    let seed: u64 = arguments.next().and_then(|text| text.parse().ok()).unwrap_or(1);
    let only = arguments.next();
    let readers = readers::all();
    // A reader has the same damage alone as among all.
    let chosen: Vec<_> = readers.iter().enumerate().filter(|(_, reader)| only.as_ref().is_none_or(|name| name == reader.name)).collect();
    if chosen.is_empty() {
        eprintln!("no such reader: {}", only.unwrap_or_default());
        return ExitCode::FAILURE;
    }
    let share = Duration::from_secs_f64(60.0 * minutes / chosen.len() as f64);
    let mut is_good = true;
    for (number, reader) in chosen {
        for file in &reader.seeds {
            if let Err(error) = (reader.read)(file) {
                eprintln!("{}: a seed is refused: {error}", reader.name);
                is_good = false;
            }
        }
        let counts = attack(reader, seed ^ (number as u64) << 32, share);
        is_good &= counts.panics == 0 && counts.too_large == 0;
        println!(
            "{{\"reader\":\"{}\",\"inputs\":{},\"read\":{},\"refused\":{},\"contained\":{},\"panics\":{},\"too_large\":{},\"most_mib\":{},\"longest_ms\":{}}}",
            reader.name,
            counts.inputs,
            counts.read,
            counts.refused,
            counts.contained,
            counts.panics,
            counts.too_large,
            counts.most_bytes.div_ceil(1 << 20),
            counts.longest.as_millis()
        );
    }
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Reads damaged files for a time.
fn attack(reader: &Reader, seed: u64, time: Duration) -> Counts {
    let mut counts = Counts::default();
    let mut mutator = Mutator::new(seed);
    let start = Instant::now();
    while start.elapsed() < time {
        let input = mutator.damaged(&reader.seeds);
        let before = MEMORY.current_usage();
        MEMORY.reset_peak_usage();
        let began = Instant::now();
        // The reader owns or only reads its data.
        let result = catch_unwind(AssertUnwindSafe(|| (reader.read)(&input)));
        counts.longest = counts.longest.max(began.elapsed());
        let taken = MEMORY.peak_usage().saturating_sub(before);
        counts.most_bytes = counts.most_bytes.max(taken);
        counts.inputs += 1;
        match result {
            Ok(Ok(())) => counts.read += 1,
            Ok(Err(error)) if error.message.contains("the decoder failed on this file") => counts.contained += 1,
            Ok(Err(_)) => counts.refused += 1,
            Err(_) => {
                counts.panics += 1;
                keep(reader.name, "panic", counts.inputs, &input);
            }
        }
        if taken > MOST_BYTES {
            counts.too_large += 1;
            keep(reader.name, "memory", counts.inputs, &input);
        }
    }
    counts
}

/// Keeps an input that a reader must not answer like this.
fn keep(reader: &str, what: &str, number: u64, input: &[u8]) {
    let folder = Path::new("target/soak");
    let path = folder.join(format!("{reader}_{what}_{number}"));
    if let Err(error) = std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&path, input)) {
        eprintln!("{}: cannot keep the input: {error}", path.display());
    }
}
