//! Markers of JPEG (ITU-T T.81, annex B): sizes, segments, the end of a picture.
//!
//! In: the bytes of a file, whose end may be missing. Out: what its markers say. Nothing is
//! decoded. Degenerate: a walk ends where the bytes make no sense.

/// The content of the markers of ITU-T T.81 (annex B).
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Markers {
    pub(super) size: Option<[u32; 2]>,
    /// Whether the end-of-image marker is there.
    pub(super) is_complete: bool,
}

impl Markers {
    /// Walks as far as the bytes make sense.
    pub(super) fn read(bytes: &[u8]) -> Self {
        let mut markers = Self::default();
        // Behind the start-of-image marker, which the format was recognised by.
        let mut rest = bytes.get(2..).unwrap_or_default();
        while let Some((marker, after)) = next_marker(rest) {
            rest = after;
            match marker {
                0xd9 => {
                    markers.is_complete = true;
                    break;
                }
                // Stand-alone: TEM, restarts, start of image.
                0x01 | 0xd0..=0xd8 => continue,
                _ => {}
            }
            let Some((segment, after)) = segment(rest) else { break };
            match (marker, segment) {
                // Frame headers are C0 to CF without the tables among them: precision, height,
                // width.
                (0xc0..=0xcf, &[_, h1, h0, w1, w0, ..]) if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                    let [height, width] = [[h1, h0], [w1, w0]].map(|side| u32::from(u16::from_be_bytes(side)));
                    markers.size = markers.size.or(Some([width, height]));
                }
                _ => {}
            }
            rest = after;
        }
        markers
    }
}

/// Returns the next marker's code, skipping entropy-coded data (where FF is followed by 00) and
/// fill bytes.
fn next_marker(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let mut rest = bytes;
    loop {
        let at = rest.iter().position(|&b| b == 0xff)?;
        rest = rest.get(at + 1..)?;
        match rest.first()? {
            0x00 => rest = rest.get(1..)?,
            0xff => {}
            &marker => return Some((marker, rest.get(1..)?)),
        }
    }
}

/// Returns a marker's segment (its length counts itself) and what follows.
fn segment(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<2>()?;
    rest.split_at_checked(usize::from(u16::from_be_bytes(*length)).checked_sub(2)?)
}

/// Returns the segments of a picture up to its entropy-coded data: marker and content.
pub(super) fn segments(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    const START_OF_SCAN: u8 = 0xda;
    let mut rest = bytes.get(2..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (marker, after) = next_marker(rest)?;
        let (content, after) = segment(after).filter(|_| marker != START_OF_SCAN)?;
        rest = after;
        Some((marker, content))
    })
}

/// Returns the length of the picture that bytes begin with, up to its end-of-image marker.
pub(super) fn whole_length(bytes: &[u8]) -> Option<usize> {
    let mut rest = bytes.strip_prefix(&[0xff, 0xd8])?;
    while let Some((marker, after)) = next_marker(rest) {
        rest = after;
        match marker {
            0xd9 => return Some(bytes.len() - rest.len()),
            0x01 | 0xd0..=0xd8 => {}
            _ => (_, rest) = segment(rest)?,
        }
    }
    None
}
