//! Values of a property over time: held outside of the samples, linear between them.

/// A number or a tuple over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::usd) struct Timed {
    pub(in crate::usd) default: Option<Vec<f64>>,
    /// Sorted by time.
    pub(in crate::usd) samples: Vec<Sample>,
}

/// A value at a time.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::usd) struct Sample {
    pub(in crate::usd) time: f64,
    pub(in crate::usd) values: Vec<f64>,
}

impl Timed {
    /// Returns the value at a time.
    pub(super) fn at(&self, time: Option<f64>) -> Option<Vec<f64>> {
        let (Some(time), [first, ..]) = (time, self.samples.as_slice()) else {
            return self.default.clone().or_else(|| self.samples.first().map(|sample| sample.values.clone()));
        };
        let after = self.samples.partition_point(|sample| sample.time <= time);
        let Some(before) = after.checked_sub(1).and_then(|i| self.samples.get(i)) else { return Some(first.values.clone()) };
        match self.samples.get(after) {
            Some(next) if next.values.len() == before.values.len() => {
                let part = (time - before.time) / (next.time - before.time);
                Some(before.values.iter().zip(&next.values).map(|(a, b)| a + part * (b - a)).collect())
            }
            _ => Some(before.values.clone()),
        }
    }
}

/// Returns samples in the order of their times, one of each time.
pub(in crate::usd) fn sorted(mut samples: Vec<Sample>) -> Vec<Sample> {
    samples.sort_by(|a, b| a.time.total_cmp(&b.time));
    samples.dedup_by(|a, b| a.time == b.time);
    samples
}
