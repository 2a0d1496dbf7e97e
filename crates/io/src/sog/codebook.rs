//! Codebooks: 256 numbers that stand for many.
//!
//! In: numbers. Out: ascending entries that make the mean squared difference small, by Lloyd's
//! algorithm in one dimension (Lloyd 1982), from entries as dense as the cube root of the numbers'
//! density (Panter and Dite 1951). Degenerate: fewer different numbers than entries are all
//! entries.

/// Entries of a codebook.
pub(super) const ENTRIES: usize = 256;
/// Steps of Lloyd's algorithm: later ones change little.
const STEPS: usize = 16;
/// Bins of the histogram that the first entries follow.
const BINS: usize = 4096;

/// A codebook, ascending.
pub(super) struct Codebook(pub(super) Vec<f32>);

impl Codebook {
    /// Returns the codebook of finite numbers.
    pub(super) fn new(values: impl Iterator<Item = f32>) -> Self {
        let mut sorted: Vec<f32> = values.collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let mut different = sorted.clone();
        different.dedup();
        if different.len() <= ENTRIES {
            let last = different.last().copied().unwrap_or(0.0);
            different.resize(ENTRIES, last);
            return Self(different);
        }
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(sorted.iter().scan(0.0, |sum, value| {
                *sum += f64::from(*value);
                Some(*sum)
            }))
            .collect();
        let mut entries = first_entries(&sorted);
        for _ in 0..STEPS {
            let middle = |pair: &[f32]| sorted.partition_point(|value| *value < f32::midpoint(pair[0], pair[1]));
            let ends: Vec<usize> = entries.windows(2).map(middle).chain([sorted.len()]).collect();
            let mut start = 0;
            for (entry, end) in entries.iter_mut().zip(ends) {
                if end > start {
                    *entry = ((sums[end] - sums[start]) / (end - start) as f64) as f32;
                }
                start = end;
            }
        }
        entries.sort_unstable_by(f32::total_cmp);
        Self(entries)
    }

    /// Returns the number of the entry that is nearest.
    pub(super) fn nearest(&self, value: f32) -> u8 {
        let above = self.0.partition_point(|entry| *entry < value).min(ENTRIES - 1);
        let below = above.saturating_sub(1);
        // At most 255.
        if value - self.0[below] < self.0[above] - value { below as u8 } else { above as u8 }
    }
}

/// Returns entries of which equally many lie between two numbers as the cube root of the density
/// has area there.
fn first_entries(sorted: &[f32]) -> Vec<f32> {
    let (low, high) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
    let mut counts = vec![0.0f64; BINS];
    for value in sorted {
        counts[(((f64::from(*value) - low) / (high - low) * BINS as f64) as usize).min(BINS - 1)] += 1.0;
    }
    let mut area = 0.0;
    let areas: Vec<f64> = counts
        .iter()
        .map(|count| {
            area += count.cbrt();
            area
        })
        .collect();
    let place = |n: usize| {
        let wanted = (n as f64 + 0.5) / ENTRIES as f64 * area;
        let bin = areas.partition_point(|area| *area < wanted).min(BINS - 1);
        (low + (bin as f64 + 0.5) / BINS as f64 * (high - low)) as f32
    };
    (0..ENTRIES).map(place).collect()
}
