//! Pass `sort`: visible splats from front to back.
//!
//! In: footprints `[N]`. Out: indices of the visible ones by ascending depth, equal depths by ascending index. A
//! least-significant-digit radix sort on the bits of the depth, which is positive.

use super::project::Footprint;

const DIGIT_BITS: u32 = 11;
const DIGITS: usize = 1 << DIGIT_BITS;

/// Buffers of the sort, kept between steps.
#[derive(Default)]
pub(crate) struct DepthOrder {
    /// Visible splats, front to back.
    pub(crate) order: Vec<u32>,
    keyed: Vec<(u32, u32)>,
    scratch: Vec<(u32, u32)>,
}

impl DepthOrder {
    /// Sorts the visible footprints.
    pub(crate) fn sort(&mut self, footprints: &[Footprint]) {
        self.keyed.clear();
        for (i, footprint) in footprints.iter().enumerate() {
            if footprint.is_visible() {
                self.keyed.push((footprint.depth.to_bits(), i as u32));
            }
        }
        self.scratch.resize(self.keyed.len(), (0, 0));
        // Three digits of 11 bits: a positive float's sign bit is zero, so 31 bits decide.
        let mut histograms = [[0u32; DIGITS]; 3];
        for (key, _) in &self.keyed {
            for (digit, histogram) in histograms.iter_mut().enumerate() {
                histogram[digit_of(*key, digit)] += 1;
            }
        }
        for (digit, histogram) in histograms.iter_mut().enumerate() {
            if histogram.contains(&(self.keyed.len() as u32)) {
                continue;
            }
            let mut start = 0;
            for count in histogram.iter_mut() {
                start += std::mem::replace(count, start);
            }
            for pair in &self.keyed {
                let slot = &mut histogram[digit_of(pair.0, digit)];
                self.scratch[*slot as usize] = *pair;
                *slot += 1;
            }
            std::mem::swap(&mut self.keyed, &mut self.scratch);
        }
        self.order.clear();
        self.order.extend(self.keyed.iter().map(|(_, i)| *i));
    }
}

fn digit_of(key: u32, digit: usize) -> usize {
    (key >> (DIGIT_BITS * digit as u32)) as usize & (DIGITS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sort_is_by_depth_then_index() {
        let depths = [3.0, 1.0, 2.5e-3, 1.0, 7e9, 2.0, 1.0];
        let footprints: Vec<Footprint> = depths.iter().map(|d| Footprint { depth: *d, ..Footprint::default() }).collect();
        let mut order = DepthOrder::default();
        order.sort(&footprints);
        assert_eq!(order.order, [2, 1, 3, 6, 5, 0, 4]);
    }
}
