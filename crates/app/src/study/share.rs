//! The share of one of several processes in the runs of a study.
//!
//! In: its text. Out: which runs it has, by their places among the jobs. Degenerate: with more
//! shares than runs, some have none.

/// The K-th of N shares of a study's runs: every N-th run, beginning with the K-th.
///
/// ```
/// use luxel_app::study::parse_share;
///
/// let [first, zeroth, third] = ["1/3", "0/3", "3/3"].map(|text| parse_share(text).unwrap());
/// assert!(first.has(0) && first.has(3) && !first.has(1));
/// assert_eq!(zeroth, third);
/// assert!(parse_share("4/3").is_err());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StudyShare {
    /// 1 to `count`.
    number: usize,
    count: usize,
}

impl StudyShare {
    /// Returns whether the run at a place among the jobs, from 0, is in the share.
    pub fn has(self, job: usize) -> bool {
        job % self.count == self.number - 1
    }
}

/// Parses `K/N`. Shares count from 1; 0 is the last one, so that arrays of jobs which count from 0
/// have every share once, too.
///
/// # Errors
/// Text that is no such pair, or a share beyond the last.
pub fn parse_share(text: &str) -> Result<StudyShare, String> {
    let expected = || format!("expected a share such as 1/4, the first of four, got \"{text}\"");
    let (number, count) = text.split_once('/').ok_or_else(expected)?;
    let [number, count]: [usize; 2] = [number.trim().parse().map_err(|_| expected())?, count.trim().parse().map_err(|_| expected())?];
    if count == 0 || number > count {
        return Err(format!("{text}: expected a share from 1/{0} to {0}/{0}", count.max(1)));
    }
    Ok(StudyShare { number: if number == 0 { count } else { number }, count })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_run_is_in_one_share_counted_from_one_or_from_zero() {
        for count in 1..6 {
            for first in [0, 1] {
                let shares: Vec<StudyShare> = (first..first + count).map(|k| parse_share(&format!("{k}/{count}")).unwrap()).collect();
                assert!((0..20).all(|job| shares.iter().filter(|share| share.has(job)).count() == 1), "{count} shares from {first}");
            }
        }
        for bad in ["", "1", "a/2", "1/", "3/2", "0/0", "-1/2"] {
            assert!(parse_share(bad).is_err(), "{bad}");
        }
    }
}
