//! Colours of error maps: shares from 0 to 1 to 8-bit sRGB.

/// matplotlib's magma at eleven even places: perceptually even, dark to bright, readable without
/// colour vision; the map that FLIP's authors show errors with.
const MAGMA: [[u8; 3]; 11] = [
    [0, 0, 4],
    [20, 14, 54],
    [59, 15, 112],
    [100, 26, 128],
    [140, 41, 129],
    [183, 55, 121],
    [222, 73, 104],
    [247, 112, 92],
    [254, 159, 109],
    [254, 207, 146],
    [252, 253, 191],
];

/// Magma's colour of `share`.
pub fn magma(share: f32) -> [u8; 3] {
    ramp(&MAGMA, share)
}

/// Between evenly spaced colours; outside of 0 to 1, and for NaN, the nearer end.
pub fn ramp<const N: usize>(colors: &[[u8; 3]; N], share: f32) -> [u8; 3] {
    let place = if share > 0.0 { share.min(1.0) * (N - 1) as f32 } else { 0.0 };
    let i = (place as usize).min(N - 2);
    let t = place - i as f32;
    let (a, b) = (colors[i], colors[i + 1]);
    std::array::from_fn(|c| (f32::from(a[c]) * (1.0 - t) + f32::from(b[c]) * t + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_outside_are_the_ends() {
        for (share, expected) in
            [(-1.0, [0, 0, 4]), (f32::NAN, [0, 0, 4]), (0.5, [183, 55, 121]), (1.0, [252, 253, 191]), (7.0, [252, 253, 191])]
        {
            assert_eq!(magma(share), expected, "{share}");
        }
    }
}
