//! The facts that a camera writes about a photograph (Exif 3.0): exposure, time, lens, orientation.
//!
//! In: the tags of a TIFF or DNG, or the Exif block of a JPEG or PNG. Out: [`Exif`]; facts
//! that are missing or implausible are `None`.

use luxel_core::photo::{Exif, GpsPosition};

use super::panorama::{panorama_of_exr, panorama_of_xmp};
use crate::tags::{Ifd, Tags};

/// Returns the Exif of a whole image file of any kind; empty if there is none.
pub(crate) fn exif_of_file(bytes: &[u8]) -> Exif {
    let block = if bytes.starts_with(&[0xff, 0xd8]) {
        jpeg_block(bytes)
    } else if bytes.starts_with(b"\x89PNG") {
        png_block(bytes)
    } else {
        Some(bytes)
    };
    let exif = block.and_then(Tags::new).and_then(|tags| Some(exif_of_tags(&tags, &tags.first()?))).unwrap_or_default();
    let xmp = jpeg_xmp(bytes).or_else(|| png_xmp(bytes));
    let pitch_deg = exif.pitch_deg.or_else(|| xmp.and_then(pitch_of_xmp));
    let panorama = exif.panorama.or_else(|| xmp.and_then(panorama_of_xmp)).or_else(|| panorama_of_exr(bytes));
    Exif { pitch_deg, panorama, ..exif }
}

/// Returns the position of a directory of GPS tags.
fn gps_of(gps: &Ifd<'_>) -> Option<GpsPosition> {
    let angle = |tag: u16, reference: u16, negative: &str| {
        let parts = gps.numbers(tag).filter(|parts| !parts.is_empty() && parts.iter().all(|v| v.is_finite()))?;
        let degrees = parts.iter().zip([1.0, 60.0, 3600.0]).map(|(v, unit)| v / unit).sum::<f64>();
        let is_negative = gps.text(reference)?.eq_ignore_ascii_case(negative);
        Some(if is_negative { -degrees } else { degrees })
    };
    let latitude_deg = angle(2, 1, "S").filter(|v| v.abs() <= 90.0)?;
    let longitude_deg = angle(4, 3, "W").filter(|v| v.abs() <= 180.0)?;
    // Odd references state depths: 1, and 3 of Exif 3.0, which tells sea level from the ellipsoid.
    let is_below = gps.unsigned(5).is_some_and(|reference| reference % 2 == 1);
    let altitude_m = gps.number(6).filter(|m| m.abs() < 1e5).map(|m| if is_below { -m } else { m });
    // Receivers that have no position write zeros.
    (latitude_deg != 0.0 || longitude_deg != 0.0).then_some(GpsPosition { latitude_deg, longitude_deg, altitude_m })
}

/// Returns the pitch of a drone's gimbal (DJI, Parrot and others), from an XMP packet.
fn pitch_of_xmp(packet: &[u8]) -> Option<f64> {
    let text = String::from_utf8_lossy(packet);
    ["GimbalPitchDegree", "CameraPitchDegree"].iter().find_map(|name| {
        let (_, rest) = text.split_once(name)?;
        // An attribute (="-90.0") or an element (>-90.0<).
        let rest = rest.trim_start().trim_start_matches('=').trim_start().trim_start_matches(['"', '\'', '>']);
        let end = rest.find(['"', '\'', '<'])?;
        rest.get(..end)?.trim().parse::<f64>().ok().filter(|deg| deg.abs() <= 90.0)
    })
}

/// Returns the Exif of a directory and of the one it points to.
pub(crate) fn exif_of_tags(tags: &Tags<'_>, first: &Ifd<'_>) -> Exif {
    let exif = first.unsigned(0x8769).and_then(|at| tags.ifd(at)).unwrap_or_default();
    let positive = |tag: u16| exif.number(tag).or_else(|| first.number(tag)).filter(|v| *v > 0.0);
    // APEX: time 2^-Tv, f-number 2^(Av/2).
    let apex = |tag: u16| exif.number(tag).filter(|v| v.abs() < 30.0);
    let time = exif.text(0x9003).or_else(|| first.text(0x0132));
    let fraction = exif.text(0x9291).and_then(|text| format!("0.{text}").parse::<f64>().ok()).unwrap_or(0.0);
    Exif {
        make: first.text(0x010f),
        model: first.text(0x0110),
        serial: exif.text(0xa431).or_else(|| first.text(0xc62f)),
        lens: exif.text(0xa434),
        seconds: positive(0x829a).or_else(|| apex(0x9201).map(|tv| (-tv).exp2())),
        // 65535 means "more than this field holds": the recommended exposure index has it.
        iso: positive(0x8827).filter(|iso| *iso < 65535.0).or_else(|| positive(0x8832)),
        f_number: positive(0x829d).or_else(|| apex(0x9202).map(|av| (0.5 * av).exp2())),
        time_s: time.and_then(|text| seconds_since_1970(&text)).map(|s| s + fraction),
        is_white_balance_automatic: exif.number(0xa403).map(|v| v == 0.0),
        orientation: first.unsigned(0x0112).filter(|o| (1..=8).contains(o)).map(|o| o as u16),
        focal_mm: positive(0x920a),
        focal_35mm: positive(0xa405),
        gps: first.unsigned(0x8825).and_then(|at| tags.ifd(at)).and_then(|gps| gps_of(&gps)),
        pitch_deg: first.bytes(0x02bc).and_then(pitch_of_xmp),
        panorama: first.bytes(0x02bc).and_then(panorama_of_xmp),
    }
}

/// Parses a time such as `2026:05:17 14:03:59`.
pub(super) fn seconds_since_1970(text: &str) -> Option<f64> {
    let mut numbers = text
        .split([':', ' ', '-', 'T'])
        .map(|part| part.split('.').next().and_then(|whole| whole.trim_end_matches('Z').parse::<i64>().ok()));
    let mut next = || numbers.next().flatten();
    let (year, month, day, hour, minute, second) = (next()?, next()?, next()?, next()?, next()?, next()?);
    let is_date = (1900..2200).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    let is_time = (0..24).contains(&hour) && (0..60).contains(&minute) && (0..=60).contains(&second);
    if !(is_date && is_time) {
        return None;
    }
    // Days of the proleptic Gregorian calendar, years beginning in March.
    let (y, m) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let era = y.div_euclid(400);
    let year_of_era = y.rem_euclid(400);
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + (153 * m + 2) / 5 + day - 1;
    let days = era * 146_097 + day_of_era - 719_468;
    Some((((days * 24 + hour) * 60 + minute) * 60 + second) as f64)
}

/// Returns the TIFF inside of the first Exif segment.
fn jpeg_block(bytes: &[u8]) -> Option<&[u8]> {
    jpeg_segment(bytes, b"Exif\0\0")
}

/// Returns the first XMP packet of a JPEG.
fn jpeg_xmp(bytes: &[u8]) -> Option<&[u8]> {
    bytes.starts_with(&[0xff, 0xd8]).then(|| jpeg_segment(bytes, b"http://ns.adobe.com/xap/1.0/\0"))?
}

/// Returns what follows the name of the first segment of applications that has this name.
fn jpeg_segment<'a>(bytes: &'a [u8], name: &[u8]) -> Option<&'a [u8]> {
    let mut rest = bytes.get(2..)?;
    loop {
        let [0xff, marker, high, low] = *rest.first_chunk::<4>()? else { return None };
        if marker == 0xff {
            rest = rest.get(1..)?;
            continue;
        }
        // Picture data begins: Exif comes before it.
        if marker == 0xda || marker == 0xd9 {
            return None;
        }
        let segment = rest.get(4..2 + usize::from(u16::from_be_bytes([high, low])))?;
        if let Some(block) = segment.strip_prefix(name).filter(|_| marker == 0xe1) {
            return Some(block);
        }
        rest = rest.get(2 + usize::from(u16::from_be_bytes([high, low])).max(2)..)?;
    }
}

/// Returns the content of PNG's eXIf chunk.
fn png_block(bytes: &[u8]) -> Option<&[u8]> {
    png_chunk(bytes, *b"eXIf", Some)
}

/// Returns the XMP packet of a PNG: an iTXt chunk of that keyword, without compression.
fn png_xmp(bytes: &[u8]) -> Option<&[u8]> {
    let is_png = bytes.starts_with(b"\x89PNG");
    is_png.then(|| png_chunk(bytes, *b"iTXt", |content| content.strip_prefix(b"XML:com.adobe.xmp\0\0")))?
}

/// Returns what `found` makes of the first chunk of a kind of which it makes something.
fn png_chunk<'a>(bytes: &'a [u8], kind: [u8; 4], found: impl Fn(&'a [u8]) -> Option<&'a [u8]>) -> Option<&'a [u8]> {
    let mut rest = bytes.get(8..)?;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk::<4>()?) as usize;
        let content = rest.get(8..length.checked_add(8)?)?;
        let name = rest.get(4..8)?;
        if let Some(content) = found(content).filter(|_| name == kind) {
            return Some(content);
        }
        if name == b"IEND" {
            return None;
        }
        rest = rest.get(length.checked_add(12)?..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_counted_by_the_calendar() {
        assert_eq!(seconds_since_1970("1970:01:01 00:00:00"), Some(0.0));
        assert_eq!(seconds_since_1970("2000:03:01 00:00:01"), Some(951_868_801.0));
        assert_eq!(seconds_since_1970("2024-02-29T12:00:00.5"), Some(1_709_208_000.0));
        assert_eq!(seconds_since_1970("0000:00:00 00:00:00"), None);
        assert_eq!(seconds_since_1970("soon"), None);
    }

    #[test]
    fn makers_are_not_said_twice() {
        let exif = |make: &str, model: &str| Exif { make: Some(make.into()), model: Some(model.into()), ..Exif::default() };
        assert_eq!(exif("Canon", "Canon EOS R5").camera_name().unwrap(), "Canon EOS R5");
        assert_eq!(exif("Apple", "iPhone 14 Pro").camera_name().unwrap(), "Apple iPhone 14 Pro");
        assert_eq!(Exif::default().camera_name(), None);
    }

    #[test]
    fn a_drone_states_its_pitch_as_attribute_or_element() {
        let attribute = br#"<rdf:Description drone-dji:GimbalRollDegree="+0.00" drone-dji:GimbalPitchDegree="-89.90" x="1"/>"#;
        assert_eq!(pitch_of_xmp(attribute), Some(-89.9));
        assert_eq!(pitch_of_xmp(b"<drone-dji:GimbalPitchDegree>-45</drone-dji:GimbalPitchDegree>"), Some(-45.0));
        assert_eq!(pitch_of_xmp(b"<drone-dji:GimbalPitchDegree>steep<"), None);
        assert_eq!(pitch_of_xmp(b"GimbalPitchDegree"), None);
    }

    /// A TIFF whose directory points to one of GPS tags.
    fn gps_file(south: bool, altitude_reference: u8) -> Vec<u8> {
        let mut out = b"II*\0\x08\0\0\0\x01\0\x25\x88\x04\0\x01\0\0\0\x1a\0\0\0\0\0\0\0".to_vec();
        let values_at = 26 + 2 + 12 * 6 + 4;
        let entry = |tag: u16, kind: u16, count: u32, value: [u8; 4]| {
            [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value].concat()
        };
        out.extend(6u16.to_le_bytes());
        out.extend(entry(1, 2, 2, [if south { b'S' } else { b'N' }, 0, 0, 0]));
        out.extend(entry(2, 5, 3, (values_at as u32).to_le_bytes()));
        out.extend(entry(3, 2, 2, *b"W\0\0\0"));
        out.extend(entry(4, 5, 3, (values_at as u32 + 24).to_le_bytes()));
        out.extend(entry(5, 1, 1, [altitude_reference, 0, 0, 0]));
        out.extend(entry(6, 5, 1, (values_at as u32 + 48).to_le_bytes()));
        out.extend([0; 4]);
        for (value, unit) in [(47u32, 1u32), (30, 1), (3600, 100), (8, 1), (0, 1), (900, 100), (1234, 10)] {
            out.extend(value.to_le_bytes());
            out.extend(unit.to_le_bytes());
        }
        out
    }

    #[test]
    fn positions_have_signs_and_degrees() {
        let found = exif_of_file(&gps_file(true, 1)).gps.unwrap();
        assert!((found.latitude_deg + (47.0 + 0.5 + 0.01)).abs() < 1e-12, "{found:?}");
        assert!((found.longitude_deg + 8.0025).abs() < 1e-12, "{found:?}");
        assert_eq!(found.altitude_m, Some(-123.4));
        let north = exif_of_file(&gps_file(false, 0)).gps.unwrap();
        assert_eq!((north.latitude_deg, north.altitude_m), (-found.latitude_deg, Some(123.4)));
        // Cut short, there is no position rather than a wrong one.
        assert_eq!(exif_of_file(&gps_file(true, 1)[..120]).gps, None);
    }
}
