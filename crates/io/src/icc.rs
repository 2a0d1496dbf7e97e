//! A picture's primaries by its ICC profile (ICC.1:2022).
//!
//! In: the profile of a JPEG (segments APP2), a PNG (chunk iCCP) or a TIFF (tag 34675). Out:
//! [`IccProfile`]: its name, and the space whose primaries are its colorants. Profiles of tables,
//! or of colours other than RGB, have none, and neither has data that is not a profile.

use std::io::Read;

use flate2::read::ZlibDecoder;
use glam::DVec3;
use luxel_core::photo::IccProfile;
use luxel_core::{ColorSpace, Conversion};

use crate::tags::Tags;

/// Profiles of pictures are a few kilobytes; ones of tables a few megabytes.
const MAX_BYTES: usize = 8 << 20;
/// White of the profile connection space.
const D50: DVec3 = DVec3::new(0.9642, 1.0, 0.8249);
/// How far a primary may be off: profiles round, and are made with other whites' digits.
const TOLERANCE: f64 = 0.02;
/// Longest name that is reported.
const MAX_NAME: usize = 60;

/// Returns the profile of a whole image file of any kind.
pub(crate) fn profile_of_file(bytes: &[u8]) -> Option<IccProfile> {
    if bytes.starts_with(&[0xff, 0xd8]) {
        return parse(&jpeg_profile(bytes)?);
    }
    if bytes.starts_with(b"\x89PNG") {
        return parse(&png_profile(bytes)?);
    }
    parse(Tags::new(bytes)?.first()?.bytes(34675)?)
}

fn parse(profile: &[u8]) -> Option<IccProfile> {
    if profile.get(36..40)? != b"acsp" {
        return None;
    }
    let name = tag(profile, b"desc").and_then(description).unwrap_or_else(|| "unnamed".to_owned());
    let is_rgb = profile.get(16..20)? == b"RGB ";
    let colorants = is_rgb.then(|| [b"rXYZ", b"gXYZ", b"bXYZ"].map(|name| tag(profile, name).and_then(xyz)));
    let space = match colorants {
        Some([Some(red), Some(green), Some(blue)]) => ColorSpace::ALL.into_iter().find(|space| is_of(*space, [red, green, blue])),
        _ => None,
    };
    Some(IccProfile { name, space })
}

/// Returns whether a space's primaries under D50 are these.
fn is_of(space: ColorSpace, colorants: [DVec3; 3]) -> bool {
    let Some(rgb_from_xyz) = Conversion::from_xyz(D50, space) else { return false };
    let expected = [DVec3::X, DVec3::Y, DVec3::Z];
    colorants.iter().zip(expected).all(|(xyz, unit)| (rgb_from_xyz * *xyz - unit).abs().max_element() < TOLERANCE)
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|b| u32::from_be_bytes(*b))
}

/// Returns the content of a tag; the list of them begins behind the header of 128 bytes.
fn tag<'a>(profile: &'a [u8], name: &[u8; 4]) -> Option<&'a [u8]> {
    let count = word(profile, 128)? as usize;
    let entry = profile.get(132..)?.as_chunks::<12>().0.iter().take(count).find(|entry| entry.starts_with(name))?;
    let (offset, length) = (word(entry, 4)? as usize, word(entry, 8)? as usize);
    profile.get(offset..offset.checked_add(length)?)
}

/// Reads three numbers of 16 bits before and after the point.
fn xyz(content: &[u8]) -> Option<DVec3> {
    let number = |at: usize| Some(f64::from(word(content, at)?.cast_signed()) / 65536.0);
    if content.get(..4)? != b"XYZ " {
        return None;
    }
    Some(DVec3::new(number(8)?, number(12)?, number(16)?))
}

/// Returns the text of version 2 (ASCII) or of version 4 (UTF-16, the first language).
fn description(content: &[u8]) -> Option<String> {
    let text = match content.get(..4)? {
        b"desc" => String::from_utf8_lossy(content.get(12..12usize.checked_add(word(content, 8)? as usize)?)?).into_owned(),
        b"mluc" => {
            let (length, offset) = (word(content, 20)? as usize, word(content, 24)? as usize);
            let units = content.get(offset..offset.checked_add(length)?)?.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b));
            char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
        }
        _ => return None,
    };
    let text: String = text.chars().filter(|c| !c.is_control()).take(MAX_NAME).collect();
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// Returns the parts in the segments APP2, in their order.
fn jpeg_profile(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut parts: Vec<(u8, &[u8])> = Vec::new();
    let mut rest = bytes.get(2..)?;
    while let Some(&[0xff, marker, high, low]) = rest.first_chunk::<4>() {
        if marker == 0xff {
            rest = rest.get(1..)?;
            continue;
        }
        // Picture data begins: profiles come before it.
        if marker == 0xda || marker == 0xd9 {
            break;
        }
        let length = usize::from(u16::from_be_bytes([high, low])).max(2);
        let Some(segment) = rest.get(4..2 + length) else { break };
        if let Some([number, _, part @ ..]) = segment.strip_prefix(b"ICC_PROFILE\0").filter(|_| marker == 0xe2) {
            parts.push((*number, part));
        }
        rest = rest.get(2 + length..)?;
    }
    parts.sort_by_key(|(number, _)| *number);
    let profile: Vec<u8> = parts.iter().flat_map(|(_, part)| part.iter().copied()).take(MAX_BYTES).collect();
    (!profile.is_empty()).then_some(profile)
}

/// Returns the content of the chunk iCCP: a name, a zero, the method 0, and the profile deflated.
fn png_profile(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut rest = bytes.get(8..)?;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk::<4>()?) as usize;
        let content = rest.get(8..length.checked_add(8)?)?;
        match rest.get(4..8)? {
            b"iCCP" => {
                let name = content.iter().position(|b| *b == 0)?;
                let mut profile = Vec::new();
                ZlibDecoder::new(content.get(name + 2..)?).take(MAX_BYTES as u64).read_to_end(&mut profile).ok()?;
                return Some(profile);
            }
            b"IDAT" | b"IEND" => return None,
            _ => rest = rest.get(length.checked_add(12)?..)?,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a profile of version 4 with the colorants that Display P3's profile has.
    pub(crate) fn display_p3(red_x: f64) -> Vec<u8> {
        let text: Vec<u8> = "Display P3".encode_utf16().flat_map(u16::to_be_bytes).collect();
        let mluc = [&b"mluc\0\0\0\0\0\0\0\x01\0\0\0\x0cenUS"[..], &[0, 0, 0, text.len() as u8, 0, 0, 0, 28], &text].concat();
        let xyz = |v: [f64; 3]| [&b"XYZ \0\0\0\0"[..], &v.map(|v| ((v * 65536.0).round() as i32).to_be_bytes()).concat()].concat();
        let tags = [
            (b"desc", mluc),
            (b"rXYZ", xyz([red_x, 0.2412, -0.0011])),
            (b"gXYZ", xyz([0.2920, 0.6922, 0.0419])),
            (b"bXYZ", xyz([0.1571, 0.0666, 0.7841])),
        ];
        let mut profile = vec![0; 128];
        profile[16..20].copy_from_slice(b"RGB ");
        profile[36..40].copy_from_slice(b"acsp");
        profile.extend((tags.len() as u32).to_be_bytes());
        let mut at = 132 + 12 * tags.len();
        for (name, content) in &tags {
            profile.extend([&name[..], &(at as u32).to_be_bytes(), &(content.len() as u32).to_be_bytes()].concat());
            at += content.len();
        }
        profile.extend(tags.into_iter().flat_map(|(_, content)| content));
        profile
    }

    #[test]
    fn a_profile_of_known_primaries_is_their_space_in_every_kind_of_file() {
        let profile = display_p3(0.5151);
        let expected = Some(IccProfile { name: "Display P3".into(), space: Some(ColorSpace::LinearDisplayP3) });
        // In two parts, the second first.
        let (a, b) = profile.split_at(100);
        let segment = |number: u8, part: &[u8]| {
            let length = (2 + 12 + 2 + part.len()) as u16;
            [&[0xff, 0xe2][..], &length.to_be_bytes(), b"ICC_PROFILE\0", &[number, 2], part].concat()
        };
        let jpeg = [&[0xff, 0xd8][..], &segment(2, b), &segment(1, a), &[0xff, 0xd9]].concat();
        assert_eq!(profile_of_file(&jpeg), expected);
        let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut deflated, &profile).unwrap();
        let content = [&b"icc\0\0"[..], &deflated.finish().unwrap()].concat();
        let png = [&b"\x89PNG\r\n\x1a\n"[..], &(content.len() as u32).to_be_bytes(), b"iCCP", &content, &[0; 4]].concat();
        assert_eq!(profile_of_file(&png), expected);
        let entry =
            [&34675u16.to_le_bytes()[..], &7u16.to_le_bytes(), &(profile.len() as u32).to_le_bytes(), &26u32.to_le_bytes()].concat();
        let tiff = [&b"II*\0\x08\0\0\0\x01\0"[..], &entry, &[0; 4], &profile].concat();
        assert_eq!(profile_of_file(&tiff), expected);
    }

    #[test]
    fn other_primaries_have_a_name_and_no_space_and_damage_is_none() {
        assert_eq!(parse(&display_p3(0.61)), Some(IccProfile { name: "Display P3".into(), space: None }));
        let whole = display_p3(0.5151);
        for length in 0..whole.len() {
            assert!(parse(&whole[..length]).is_none_or(|profile| profile.space.is_none() || length > 260), "{length}");
        }
        assert_eq!(profile_of_file(b"\xff\xd8\xff\xe2\0\x05abc"), None);
    }
}
