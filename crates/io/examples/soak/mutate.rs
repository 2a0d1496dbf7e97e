//! Damage of files: bits, bytes, numbers at their limits, parts cut out, doubled, exchanged and cut
//! off. Equal seeds give equal files.

/// Numbers at which readers fail: limits of types, and lengths that are near to them.
const NUMBERS: [u64; 16] = [
    0,
    1,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0x8000,
    0xffff,
    0x10000,
    0x00ff_ffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
];

/// Texts at which readers of text fail.
const TEXTS: [&[u8]; 12] =
    [b"nan", b"-1", b"1e999", b"1e-999", b"null", b"[[", b"{\"a\":", b"\"", b"\\u0000", b"\xff\xfe", b"4294967296", b"0"];

/// Makes damaged files.
pub(crate) struct Mutator {
    state: u64,
}

impl Mutator {
    pub(crate) fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// Returns the next random number (SplitMix64, Steele et al. 2014).
    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Returns a number below `end`, which is at least 1.
    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }

    /// Returns one of the seeds with one to eight kinds of damage.
    pub(crate) fn damaged(&mut self, seeds: &[Vec<u8>]) -> Vec<u8> {
        let mut file = seeds[self.below(seeds.len())].clone();
        let other = self.below(seeds.len());
        for _ in 0..1 << self.below(4) {
            self.damage(&mut file, &seeds[other]);
        }
        file
    }

    fn damage(&mut self, file: &mut Vec<u8>, other: &[u8]) {
        if file.is_empty() {
            return;
        }
        // Headers are where claims are: half of the damage is there.
        let reach = if self.next() & 1 == 0 { file.len().min(512) } else { file.len() };
        let at = self.below(reach);
        match self.below(9) {
            0 => file[at] ^= 1 << self.below(8),
            1 => file[at] = self.next() as u8,
            2 => {
                let number = NUMBERS[self.below(NUMBERS.len())];
                let bytes = if self.next() & 1 == 0 { number.to_le_bytes() } else { number.to_be_bytes() };
                let width = 1 << self.below(4);
                let from = if self.next() & 1 == 0 { 0 } else { 8 - width };
                file.iter_mut().skip(at).zip(&bytes[from..from + width]).for_each(|(to, byte)| *to = *byte);
            }
            3 => file.truncate(at),
            4 => {
                let end = at + self.below((file.len() - at).min(64));
                file.drain(at..end);
            }
            5 => {
                let end = at + self.below((file.len() - at).min(256));
                let part = file[at..end].to_vec();
                file.splice(at..at, part);
            }
            6 => {
                let from = self.below(other.len());
                let part = other[from..from + self.below((other.len() - from).min(256))].to_vec();
                let end = (at + part.len()).min(file.len());
                file.splice(at..end, part);
            }
            7 => {
                let text = TEXTS[self.below(TEXTS.len())];
                let end = (at + self.below(8)).min(file.len());
                file.splice(at..end, text.iter().copied());
            }
            _ => {
                let end = at + self.below((file.len() - at).min(32));
                let value = self.next() as u8;
                file[at..end].fill(value);
            }
        }
    }
}
