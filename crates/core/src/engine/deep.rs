//! Deep images: each pixel is a list of samples with depths, so that a compositor can put things
//! between them.
//!
//! In: the splats that an engine blends into a pixel, front to back. Out: [`DeepImage`]. Composited
//! front to back (Porter and Duff 1984), the samples of a pixel give the pixel that
//! [`Engine::render`](super::Engine::render) makes on a black background, however many were merged.
//! Degenerate: a pixel that no splat touches has no samples.

use super::Layers;
use crate::{Image, each};

/// A part of what a pixel shows, between two depths.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeepSample {
    /// Radiance, multiplied by the sample's own opacity.
    pub radiance: [f32; 3],
    /// Opacity, 0 to 1.
    pub alpha: f32,
    /// Distances along the viewing axis at which the sample begins and ends.
    pub depth: [f32; 2],
}

impl DeepSample {
    /// Returns this sample and one right behind it as a single one.
    #[must_use]
    pub fn over(self, behind: Self) -> Self {
        let left = 1.0 - self.alpha;
        Self {
            radiance: each!([0, 1, 2] c => left.mul_add(behind.radiance[c], self.radiance[c])),
            alpha: left.mul_add(behind.alpha, self.alpha),
            depth: [self.depth[0].min(behind.depth[0]), self.depth[1].max(behind.depth[1])],
        }
    }
}

/// An image of samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeepImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// The samples of each pixel, front to back, `[H*W]`, row-major.
    pub pixels: Vec<Vec<DeepSample>>,
}

impl DeepImage {
    /// Returns the number of samples of the pixel that has most.
    pub fn most_samples(&self) -> usize {
        self.pixels.iter().map(Vec::len).max().unwrap_or(0)
    }

    /// Composites the samples: radiance and coverage on black, and the mean depth by weight, of
    /// which a sample's is in its middle.
    pub fn flatten(&self) -> Layers {
        let mut layers = Layers { image: Image::filled(self.width, self.height, [0.0; 3]), ..Layers::default() };
        for (samples, out) in self.pixels.iter().zip(&mut layers.image.pixels) {
            let (mut left, mut depth) = (1.0f32, 0.0);
            for DeepSample { radiance, alpha, depth: [front, back] } in samples {
                *out = each!([0, 1, 2] c => left.mul_add(radiance[c], out[c]));
                depth += left * alpha * 0.5 * (front + back);
                left *= 1.0 - alpha;
            }
            layers.alpha.push(1.0 - left);
            layers.depth.push(if samples.is_empty() { f32::INFINITY } else { depth / (1.0 - left) });
        }
        layers
    }
}

/// A run of samples that were merged.
#[derive(Clone, Copy)]
struct Run {
    sample: DeepSample,
    /// Part of the pixel that the run makes up.
    weight: f32,
    /// Mean depth by weight.
    mean_depth: f32,
}

impl Run {
    /// Returns by how much the variance of depths within runs, summed by weight, grows if two
    /// neighbours are merged (Ward 1963).
    fn cost(self, behind: Self) -> f32 {
        let (sum, apart) = (self.weight + behind.weight, behind.mean_depth - self.mean_depth);
        if sum > 0.0 { self.weight * behind.weight / sum * apart * apart } else { 0.0 }
    }

    fn merged(self, behind: Self) -> Self {
        let weight = self.weight + behind.weight;
        let share = if weight > 0.0 { behind.weight / weight } else { 0.5 };
        Self {
            sample: self.sample.over(behind.sample),
            weight,
            mean_depth: share.mul_add(behind.mean_depth - self.mean_depth, self.mean_depth),
        }
    }
}

/// Merges neighbours of a pixel's samples, front to back, until there are at most `most`, at least
/// 1: always those whose depths differ least for what they contribute.
///
/// ```
/// use luxel_core::engine::{DeepSample, merge_samples};
///
/// let at = |z: f32| DeepSample { radiance: [0.5; 3], alpha: 0.5, depth: [z; 2] };
/// let mut samples = vec![at(1.0), at(1.1), at(5.0)];
/// merge_samples(&mut samples, 2);
/// assert_eq!(samples, [at(1.0).over(at(1.1)), at(5.0)]);
/// assert_eq!((samples[0].alpha, samples[0].depth), (0.75, [1.0, 1.1]));
/// ```
pub fn merge_samples(samples: &mut Vec<DeepSample>, most: usize) {
    if samples.len() <= most.max(1) {
        return;
    }
    let mut left = 1.0;
    let mut runs: Vec<Run> = Vec::with_capacity(samples.len());
    for sample in samples.drain(..) {
        runs.push(Run { sample, weight: left * sample.alpha, mean_depth: sample.depth[0] });
        left *= 1.0 - sample.alpha;
    }
    let mut costs: Vec<f32> = runs.windows(2).map(|pair| pair[0].cost(pair[1])).collect();
    while runs.len() > most.max(1) {
        // The first of equals.
        let cheapest = costs.iter().enumerate().fold(0, |best, (n, cost)| if *cost < costs[best] { n } else { best });
        runs[cheapest] = runs[cheapest].merged(runs[cheapest + 1]);
        runs.remove(cheapest + 1);
        costs.remove(cheapest);
        if cheapest > 0 {
            costs[cheapest - 1] = runs[cheapest - 1].cost(runs[cheapest]);
        }
        if cheapest < costs.len() {
            costs[cheapest] = runs[cheapest].cost(runs[cheapest + 1]);
        }
    }
    samples.extend(runs.into_iter().map(|run| run.sample));
    samples.shrink_to_fit();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(count: usize) -> Vec<DeepSample> {
        let number = |n: usize, step: usize| ((n * step + 7) % 101) as f32 / 101.0;
        let sample = |n| {
            let alpha = 0.6 * number(n, 17);
            DeepSample { radiance: [alpha * 300.0 * number(n, 29), alpha, alpha * number(n, 31)], alpha, depth: [1.0 + n as f32; 2] }
        };
        (0..count).map(sample).collect()
    }

    fn flat(samples: Vec<DeepSample>) -> Layers {
        DeepImage { width: 1, height: 1, pixels: vec![samples] }.flatten()
    }

    #[test]
    fn merging_leaves_the_flat_pixel() {
        let whole = flat(samples(60));
        for most in [1, 2, 7, 59, 60] {
            let mut merged = samples(60);
            merge_samples(&mut merged, most);
            assert_eq!(merged.len(), most);
            assert!(merged.windows(2).all(|pair| pair[0].depth[1] < pair[1].depth[0]), "{most}");
            let found = flat(merged);
            for (a, b) in found.image.pixels[0].iter().zip(whole.image.pixels[0]).chain([(&found.alpha[0], whole.alpha[0])]) {
                assert!((a - b).abs() <= 2e-6 * b.abs(), "{most}: {a} {b}");
            }
        }
    }

    #[test]
    fn no_samples_are_nothing_far_away() {
        let mut none = Vec::new();
        merge_samples(&mut none, 4);
        let found = flat(none);
        assert_eq!((found.image.pixels[0], found.alpha[0], found.depth[0]), ([0.0; 3], 0.0, f32::INFINITY));
    }
}
