//! A palette of higher harmonics: rows that stand for those of many splats.
//!
//! In: rows `[N, D]`. Out: palette rows `[P, D]` and for each row of the input the number of its
//! palette row. Rows are divided by k-means (Lloyd 1982) into a few groups, and each group by
//! k-means into its share of the palette, which takes a fraction of the time of one division into
//! all.
//! Everything begins with rows at golden distances, and sums have a fixed order: the same bits for
//! any number of threads. Degenerate: a group of fewer rows than its share has a palette row for
//! each.

use rayon::prelude::*;

/// Most rows of a palette: labels have 16 bits.
const MOST: usize = 1 << 16;
/// Splats for each row of the palette.
const SPLATS_PER_ROW: usize = 8;
/// Groups that rows are divided into at first.
const GROUPS: usize = 128;
/// Steps of k-means.
const STEPS: usize = 8;
/// Members of a group that its centre is the mean of; more change it little.
const MEMBERS_PER_CENTER: usize = 8;
/// Centres that a row is compared with at a time.
const LANES: usize = 16;

/// The golden ratio's fraction, in units of 2^-32.
const GOLDEN: u64 = 2_654_435_769;

/// A palette.
pub(super) struct Palette {
    /// `[P, D]`.
    pub(super) rows: Vec<f32>,
    /// `[N]`.
    pub(super) labels: Vec<u16>,
}

impl Palette {
    /// Returns the palette of rows of `width` numbers.
    pub(super) fn new(rows: &[f32], width: usize) -> Self {
        let count = rows.len() / width;
        // Groups without a share get one row each.
        let size = (count / SPLATS_PER_ROW).clamp(1, MOST - GROUPS);
        let members: Vec<usize> = (0..count).collect();
        let (_, groups) = divide(rows, width, &members, GROUPS.min(size));
        let mut of_groups = vec![Vec::new(); GROUPS.min(size)];
        groups.iter().enumerate().for_each(|(row, group)| of_groups[*group].push(row));
        let share = |members: &Vec<usize>| (members.len() * size / count).max(usize::from(!members.is_empty()));
        let divided: Vec<(Vec<f32>, Vec<usize>)> =
            of_groups.par_iter().map(|members| divide(rows, width, members, share(members))).collect();
        let mut palette = Self { rows: Vec::new(), labels: vec![0; count] };
        for (members, (centers, numbers)) in of_groups.iter().zip(divided) {
            let first = palette.rows.len() / width;
            for (row, number) in members.iter().zip(numbers) {
                // Below MOST: shares are rounded down.
                palette.labels[*row] = (first + number) as u16;
            }
            palette.rows.extend(centers);
        }
        palette
    }
}

/// Divides some of the rows into `count` groups. Returns the centres, and the group of each member.
/// Centres are found on a part of the members, as many for each as make it a mean.
fn divide(rows: &[f32], width: usize, members: &[usize], count: usize) -> (Vec<f32>, Vec<usize>) {
    if count == 0 {
        return (Vec::new(), Vec::new());
    }
    let row = |member: usize| &rows[member * width..][..width];
    // Multiples of the golden ratio fall in step with no pattern of the rows.
    let start = |n: usize, of: usize| {
        let share = (n as u64).wrapping_mul(GOLDEN) % (1 << 32);
        ((share * of as u64) >> 32) as usize
    };
    let mut centers: Vec<f32> = (0..count).flat_map(|n| row(members[start(n, members.len())])).copied().collect();
    let step = (members.len() / (count * MEMBERS_PER_CENTER)).max(1);
    let sample: Vec<usize> = members.iter().copied().step_by(step).collect();
    for _ in 0..STEPS {
        let groups = nearest(rows, &Centers::new(&centers, width), &sample);
        let (mut sums, mut counts) = (vec![0.0f64; count * width], vec![0u32; count]);
        for (member, group) in sample.iter().zip(&groups) {
            counts[*group] += 1;
            sums[group * width..][..width].iter_mut().zip(row(*member)).for_each(|(sum, value)| *sum += f64::from(*value));
        }
        for ((center, sums), count) in centers.chunks_exact_mut(width).zip(sums.chunks_exact(width)).zip(counts) {
            if count > 0 {
                center.iter_mut().zip(sums).for_each(|(value, sum)| *value = (sum / f64::from(count)) as f32);
            }
        }
    }
    let groups = nearest(rows, &Centers::new(&centers, width), members);
    (centers, groups)
}

/// Returns the number of the centre that is nearest to each member.
fn nearest(rows: &[f32], centers: &Centers, members: &[usize]) -> Vec<usize> {
    let row = |member: usize| &rows[member * centers.width..][..centers.width];
    members.par_iter().with_min_len(256).map(|member| centers.nearest(row(*member))).collect()
}

/// Centres side by side, so that a row is compared with [`LANES`] of them at a time.
struct Centers {
    width: usize,
    /// `[blocks, width, LANES]`.
    values: Vec<[f32; LANES]>,
    /// Half the square of each centre, `[blocks, LANES]`; infinite where there is none.
    halves: Vec<[f32; LANES]>,
}

impl Centers {
    fn new(centers: &[f32], width: usize) -> Self {
        let blocks = (centers.len() / width).div_ceil(LANES);
        let (mut values, mut halves) = (vec![[0.0; LANES]; blocks * width], vec![[f32::INFINITY; LANES]; blocks]);
        for (n, center) in centers.chunks_exact(width).enumerate() {
            let (block, lane) = (n / LANES, n % LANES);
            halves[block][lane] = 0.5 * center.iter().map(|v| v * v).sum::<f32>();
            values[block * width..][..width].iter_mut().zip(center).for_each(|(lanes, value)| lanes[lane] = *value);
        }
        Self { width, values, halves }
    }

    /// Returns the number of the nearest: that with the largest product with the row, less half the
    /// centre's square; of equal ones the first.
    fn nearest(&self, row: &[f32]) -> usize {
        let mut best = (0, f32::NEG_INFINITY);
        for (block, (values, halves)) in self.values.chunks_exact(self.width).zip(&self.halves).enumerate() {
            let mut sums = halves.map(|half| -half);
            for (value, lanes) in row.iter().zip(values) {
                sums.iter_mut().zip(lanes).for_each(|(sum, lane)| *sum += value * lane);
            }
            for (lane, sum) in sums.into_iter().enumerate() {
                if sum > best.1 {
                    best = (block * LANES + lane, sum);
                }
            }
        }
        best.0
    }
}
