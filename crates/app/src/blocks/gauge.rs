//! One exposure gauge for all blocks.
//!
//! In: for each block the gains that its training found for its images, stops by channel; their
//! mean over the block's own images is 0. Out: what to add to the gains of each block, so that
//! blocks agree on the images that they share as far as one number each allows (least squares), and
//! the mean over all images is 0. A block whose gains rise by some stops is darkened by as many.
//! Degenerate: blocks that share no image with others keep the mean of their own.

use std::collections::BTreeMap;

/// Gains of images by name, stops by channel.
pub(super) type Gains = BTreeMap<String, [f32; 3]>;

/// Rounds of averaging; the error falls by a constant factor with each.
const ROUNDS: usize = 1000;

/// Returns for each block what to add to its gains, stops by channel.
pub(super) fn shifts(blocks: &[Gains]) -> Vec<[f64; 3]> {
    let mut shifts = vec![[0.0; 3]; blocks.len()];
    for _ in 0..ROUNDS {
        let common = common(blocks, &shifts);
        for (gains, shift) in blocks.iter().zip(&mut shifts) {
            for (channel, shift) in shift.iter_mut().enumerate() {
                let missing: f64 = gains.iter().map(|(name, gain)| common[name.as_str()][channel] - f64::from(gain[channel])).sum();
                *shift = missing / gains.len().max(1) as f64;
            }
        }
    }
    let common = common(blocks, &shifts);
    for channel in 0..3 {
        let mean = common.values().map(|gain| gain[channel]).sum::<f64>() / common.len().max(1) as f64;
        shifts.iter_mut().for_each(|shift| shift[channel] -= mean);
    }
    shifts
}

/// Returns the mean over the blocks of each image's shifted gain.
fn common<'a>(blocks: &'a [Gains], shifts: &[[f64; 3]]) -> BTreeMap<&'a str, [f64; 3]> {
    let mut sums: BTreeMap<&str, ([f64; 3], f64)> = BTreeMap::new();
    for (gains, shift) in blocks.iter().zip(shifts) {
        for (name, gain) in gains {
            let (sum, count) = sums.entry(name).or_default();
            (0..3).for_each(|channel| sum[channel] += f64::from(gain[channel]) + shift[channel]);
            *count += 1.0;
        }
    }
    sums.into_iter().map(|(name, (sum, count))| (name, sum.map(|sum| sum / count))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_agree_on_shared_images_and_all_images_have_the_mean_of_none() {
        // True gains 0 to 7 stops, less their mean; each block knows its own up to a constant.
        let gains = |views: std::ops::Range<u32>, constant: f32| -> Gains {
            views.map(|view| (format!("{view:03}"), [view as f32 + constant; 3])).collect()
        };
        let blocks = [gains(0..3, -1.0), gains(2..6, 0.4), gains(5..8, 3.0)];
        let shifts = shifts(&blocks);
        for (block, shift) in blocks.iter().zip(&shifts) {
            for (name, gain) in block {
                let truth = name.parse::<f64>().unwrap() - 3.5;
                assert!((f64::from(gain[0]) + shift[0] - truth).abs() < 1e-6, "{name}");
            }
        }
        assert_eq!(super::shifts(&[Gains::new()]), [[0.0; 3]]);
    }
}
