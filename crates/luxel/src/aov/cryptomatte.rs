//! Mattes in the form of Cryptomatte 1.2 (Friedman and Jones, Psyop): pairs of a name's hash and
//! its coverage, the largest first, and a manifest of the names.

use std::fmt::Write as _;

use luxel_io::{ExrPlane, PlaneValues};

/// Layer of the mattes.
const LAYER: &str = "CryptoSelection";
/// Pairs in a file at most.
const MOST_PAIRS: usize = 6;
/// Coverage that is left out.
const LEAST_COVERAGE: f32 = 1e-4;

/// Names of mattes, and how files hold them.
///
/// ```
/// use luxel::aov::Cryptomatte;
///
/// let mattes = Cryptomatte::new(["lamp".into(), "desk".into()]);
/// let planes = mattes.planes(&[vec![0.25, 0.0], vec![0.75, 0.0]]);
/// assert_eq!((planes.len(), planes[0].name.as_str()), (4, "CryptoSelection00.R"));
/// let (name, manifest) = &mattes.attributes()[3];
/// assert!(name.ends_with("/manifest") && manifest.contains("lamp"));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Cryptomatte {
    names: Vec<String>,
    hashes: Vec<u32>,
}

impl Cryptomatte {
    /// Takes the names of mattes.
    pub fn new(names: impl IntoIterator<Item = String>) -> Self {
        let names: Vec<String> = names.into_iter().collect();
        Self { hashes: names.iter().map(|name| hash(name)).collect(), names }
    }

    /// Returns the attributes of a file with these mattes: name and value.
    pub fn attributes(&self) -> Vec<(String, String)> {
        let key = format!("cryptomatte/{:.7}/", format!("{:08x}", hash(LAYER)));
        let mut manifest = String::from("{");
        for (n, (name, hash)) in self.names.iter().zip(&self.hashes).enumerate() {
            // Writing to a string does not fail.
            let _ = write!(manifest, "{}{}:\"{hash:08x}\"", if n == 0 { "" } else { "," }, serde_json::Value::from(name.as_str()));
        }
        manifest.push('}');
        let entry = |name: &str, value: &str| (format!("{key}{name}"), value.to_owned());
        vec![entry("name", LAYER), entry("hash", "MurmurHash3_32"), entry("conversion", "uint32_to_float32"), entry("manifest", &manifest)]
    }

    /// Returns the channels of coverages `[mattes][H*W]`: two pairs of hash and coverage in every
    /// four.
    pub fn planes(&self, coverage: &[Vec<f32>]) -> Vec<ExrPlane> {
        let pixels = coverage.first().map_or(0, Vec::len);
        let levels = coverage.len().min(MOST_PAIRS).div_ceil(2);
        let mut planes = vec![vec![0.0f32; pixels]; 4 * levels];
        let mut pairs = Vec::with_capacity(coverage.len());
        for pixel in 0..pixels {
            pairs.clear();
            let present = self.hashes.iter().zip(coverage).map(|(hash, plane)| (*hash, plane[pixel]));
            pairs.extend(present.filter(|(_, coverage)| *coverage > LEAST_COVERAGE));
            // Stable: of equal coverages the first comes first.
            pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
            for (rank, (hash, coverage)) in pairs.iter().take(2 * levels).enumerate() {
                planes[2 * rank][pixel] = f32::from_bits(*hash);
                planes[2 * rank + 1][pixel] = *coverage;
            }
        }
        let name = |n: usize| format!("{LAYER}{:02}.{}", n / 4, ["R", "G", "B", "A"][n % 4]);
        planes.into_iter().enumerate().map(|(n, values)| ExrPlane { name: name(n), values: PlaneValues::Float(values) }).collect()
    }
}

/// Returns the hash of a name, whose bits are a finite normal float.
fn hash(name: &str) -> u32 {
    // Reading from memory does not fail.
    let hash = murmur3::murmur3_32(&mut name.as_bytes(), 0).unwrap_or_default();
    let exponent = (hash >> 23) & 0xff;
    if exponent == 0 || exponent == 0xff { hash ^ (1 << 23) } else { hash }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_specification() {
        // Names and hashes of its example manifest.
        for (name, expected) in [("bunny", 0x13851a76), ("default", 0x42c9679f)] {
            assert_eq!(format!("{:08x}", hash(name)), format!("{expected:08x}"), "{name}");
        }
    }

    #[test]
    fn pairs_are_sorted_by_coverage_and_more_than_fit_lose_the_least() {
        let names: Vec<String> = (0..8).map(|n| format!("matte{n}")).collect();
        let mattes = Cryptomatte::new(names.clone());
        let coverage: Vec<Vec<f32>> = (0..8u8).map(|n| vec![f32::from(n) / 28.0]).collect();
        let planes = mattes.planes(&coverage);
        assert_eq!(planes.len(), 12);
        let value = |n: usize| match &planes[n].values {
            PlaneValues::Float(values) => values[0],
            PlaneValues::Whole(_) => f32::NAN,
        };
        for rank in 0..6 {
            assert_eq!(value(2 * rank).to_bits(), hash(&names[7 - rank]));
            assert_eq!(value(2 * rank + 1), (7 - rank) as f32 / 28.0);
        }
    }
}
