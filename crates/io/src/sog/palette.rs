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
fn divide(rows: &[f32], width: usize, members: &[usize], count: usize) -> (Vec<f32>, Vec<usize>) {
    if count == 0 {
        return (Vec::new(), Vec::new());
    }
    let row = |member: usize| &rows[member * width..][..width];
    // Multiples of the golden ratio fall in step with no pattern of the rows.
    let start = |n: usize| {
        let share = (n as u64).wrapping_mul(GOLDEN) % (1 << 32);
        ((share * members.len() as u64) >> 32) as usize
    };
    let mut centers: Vec<f32> = (0..count).flat_map(|n| row(members[start(n)])).copied().collect();
    let mut groups = Vec::new();
    for step in 0..=STEPS {
        // The nearest has the largest product with the centre, less half the centre's square.
        let halves: Vec<f32> = centers.chunks_exact(width).map(|center| 0.5 * dot(center, center)).collect();
        groups = members
            .par_iter()
            .with_min_len(256)
            .map(|member| {
                let row = row(*member);
                let mut best = (0, f32::NEG_INFINITY);
                for (n, (center, half)) in centers.chunks_exact(width).zip(&halves).enumerate() {
                    let value = dot(row, center) - half;
                    if value > best.1 {
                        best = (n, value);
                    }
                }
                best.0
            })
            .collect();
        if step == STEPS {
            break;
        }
        let (mut sums, mut counts) = (vec![0.0f64; count * width], vec![0u32; count]);
        for (member, group) in members.iter().zip(&groups) {
            counts[*group] += 1;
            sums[group * width..][..width].iter_mut().zip(row(*member)).for_each(|(sum, value)| *sum += f64::from(*value));
        }
        for ((center, sums), count) in centers.chunks_exact_mut(width).zip(sums.chunks_exact(width)).zip(counts) {
            if count > 0 {
                center.iter_mut().zip(sums).for_each(|(value, sum)| *value = (sum / f64::from(count)) as f32);
            }
        }
    }
    (centers, groups)
}

/// Returns the product of two rows, in eight sums, which run at the same time.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (heads, tail_a) = a.as_chunks::<8>();
    let (others, tail_b) = b.as_chunks::<8>();
    let mut sums = [0.0f32; 8];
    for (a, b) in heads.iter().zip(others) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum::<f32>() + tail_a.iter().zip(tail_b).map(|(a, b)| a * b).sum::<f32>()
}
