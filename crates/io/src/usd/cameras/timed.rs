//! Values of a property over time: held outside of the samples, linear between them.

/// A number or a tuple over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Timed {
    pub(super) default: Option<Vec<f64>>,
    /// Sorted by time.
    pub(super) samples: Vec<Sample>,
}

/// A value at a time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) time: f64,
    pub(super) values: Vec<f64>,
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
