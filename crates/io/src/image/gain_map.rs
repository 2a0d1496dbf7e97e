//! Gain maps of JPEG: a second picture in the file that says how much brighter than white each part
//! of the first one was. Of Ultra HDR (Android's, XMP in Adobe's namespace) and of ISO 21496-1.
//!
//! In: a file, and the light of its first picture, 1 for white. Out: light beyond white, relative
//! to the same white: `(light + base offset) * 2^gain - offset`, where the gain is between two
//! bounds by the map's code to the power of 1 / gamma, bilinear between its pixels. The map is used
//! in full, as on a display without a limit.
//!
//! Degenerate: a map whose description is missing or of a kind that is not applied (a first picture
//! that is HDR already, another colour space, Apple's own) is named in a warning, and the first
//! picture is read as it is.

use luxel_core::Image;
use roxmltree::{Document, Node};

use super::jpeg_markers::{segments, whole_length};
use super::samples::SampleGrid;
use crate::IoError;

/// Beginnings of segments.
const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
const ISO: &[u8] = b"urn:iso:std:iso:ts:21496:-1\0";
const APPLE: &[u8] = b"HDRGainMap";
/// Adobe's namespace.
const NAMESPACE: &str = "http://ns.adobe.com/hdr-gain-map/1.0/";
/// Codes of APP1 and APP2.
const APP1: u8 = 0xe1;
const APP2: u8 = 0xe2;
/// Pictures of a file that are looked at.
const MOST_PICTURES: usize = 8;

/// The description of a map, by channel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct GainMap {
    /// Logarithms to the base of 2.
    min: [f32; 3],
    max: [f32; 3],
    gamma: [f32; 3],
    base_offset: [f32; 3],
    offset: [f32; 3],
}

/// The map of a file, if there is one.
#[derive(Clone, Debug, PartialEq)]
enum Found<'a> {
    Nothing,
    /// A map that is not applied, and why.
    Named(&'static str),
    Map(GainMap, &'a [u8]),
}

/// Returns whether a file has a gain map, applied or not.
pub(super) fn is_in(bytes: &[u8]) -> bool {
    find(bytes) != Found::Nothing
}

/// Applies the map of a file to the light of its first picture, or names it. `decode` returns the
/// samples of the map's own picture.
pub(super) fn apply(
    bytes: &[u8],
    decode: impl FnOnce(&[u8]) -> Result<(SampleGrid, Vec<u8>), IoError>,
    image: &mut Image,
    warnings: &mut Vec<String>,
) -> Result<(), IoError> {
    match find(bytes) {
        Found::Nothing => {}
        Found::Named(why) => warnings.push(format!("its gain map is not applied: {why}; what is read is the picture for ordinary screens")),
        Found::Map(map, picture) => {
            let (layout, codes) = decode(picture)?;
            map.brighten(image, layout, &codes);
            let most = map.max.into_iter().fold(f32::MIN, f32::max).exp2();
            warnings.push(format!("its gain map is applied: light is relative to white, and up to about {most:.1} times as bright"));
        }
    }
    Ok(())
}

/// Looks for a map among the pictures that follow one another in a file.
fn find(bytes: &[u8]) -> Found<'_> {
    let (mut rest, mut found) = (bytes, Found::Nothing);
    for number in 0..MOST_PICTURES {
        let Some(length) = whole_length(rest) else { break };
        let (picture, after) = rest.split_at(length);
        if number > 0 {
            match description(picture) {
                Found::Nothing => {}
                other => found = other,
            }
            if matches!(found, Found::Map(..)) {
                break;
            }
        }
        // Padding between pictures.
        let Some(next) = after.windows(3).position(|mark| mark == [0xff, 0xd8, 0xff]) else { break };
        rest = &after[next..];
    }
    found
}

/// Returns what the segments of a picture say of it as a map.
fn description(picture: &[u8]) -> Found<'_> {
    let mut found = Found::Nothing;
    for (marker, content) in segments(picture) {
        let map = match marker {
            APP2 => content.strip_prefix(ISO).map(iso),
            APP1 => content.strip_prefix(XMP).and_then(xmp),
            _ => None,
        };
        match map {
            Some(Ok(map)) => return Found::Map(map, picture),
            Some(Err(why)) => found = Found::Named(why),
            None => {}
        }
    }
    found
}

/// Reads the metadata of ISO 21496-1, annex C: big-endian fractions.
fn iso(bytes: &[u8]) -> Result<GainMap, &'static str> {
    const MULTICHANNEL: u8 = 1 << 7;
    const BASE_COLOR_SPACE: u8 = 1 << 6;
    const COMMON_DENOMINATOR: u8 = 1 << 3;
    const CUT_SHORT: &str = "its description by ISO 21496-1 is cut short";
    let (versions, rest) = bytes.split_first_chunk::<4>().ok_or(CUT_SHORT)?;
    if versions[..2] != [0, 0] {
        return Err("its description is of a newer version of ISO 21496-1");
    }
    let (&flags, mut rest) = rest.split_first().ok_or(CUT_SHORT)?;
    if flags & BASE_COLOR_SPACE == 0 {
        return Err("it is in another colour space than the picture");
    }
    let mut word = || -> Result<u32, &'static str> {
        let (word, after) = rest.split_first_chunk::<4>().ok_or(CUT_SHORT)?;
        rest = after;
        Ok(u32::from_be_bytes(*word))
    };
    let common = if flags & COMMON_DENOMINATOR == 0 { None } else { Some(word()?) };
    let mut number = |is_signed: bool| -> Result<f32, &'static str> {
        let numerator = word()?;
        let denominator = common.map_or_else(&mut word, Ok)?;
        let numerator = if is_signed { f64::from(numerator.cast_signed()) } else { f64::from(numerator) };
        Ok((numerator / f64::from(denominator)) as f32)
    };
    let (base_headroom, headroom) = (number(false)?, number(false)?);
    if base_headroom > headroom {
        return Err("the picture is the brighter one, of which the map makes one for ordinary screens");
    }
    let mut map = GainMap { min: [0.0; 3], max: [0.0; 3], gamma: [1.0; 3], base_offset: [0.0; 3], offset: [0.0; 3] };
    let channels = if flags & MULTICHANNEL == 0 { 1 } else { 3 };
    for c in 0..3 {
        if c >= channels {
            (map.min[c], map.max[c], map.gamma[c]) = (map.min[0], map.max[0], map.gamma[0]);
            (map.base_offset[c], map.offset[c]) = (map.base_offset[0], map.offset[0]);
            continue;
        }
        (map.min[c], map.max[c], map.gamma[c]) = (number(true)?, number(true)?, number(false)?);
        (map.base_offset[c], map.offset[c]) = (number(true)?, number(true)?);
    }
    map.checked()
}

/// Reads Adobe's description in XMP; `None` for XMP about something else.
fn xmp(bytes: &[u8]) -> Option<Result<GainMap, &'static str>> {
    if bytes.windows(APPLE.len()).any(|word| word == APPLE) {
        return Some(Err("it is of Apple's own kind, whose description is not public"));
    }
    let text = std::str::from_utf8(bytes).ok()?;
    let document = Document::parse(text.trim_end_matches('\0')).ok()?;
    let field = |name: &str| document.descendants().filter(Node::is_element).find_map(|node| field_of(node, name));
    field("Version")?;
    if field("BaseRenditionIsHDR").is_some_and(|value| value.trim().eq_ignore_ascii_case("true")) {
        return Some(Err("the picture is the brighter one, of which the map makes one for ordinary screens"));
    }
    let numbers = |name: &str, absent: f32| -> Option<[f32; 3]> {
        let Some(text) = field(name) else { return Some([absent; 3]) };
        let values: Vec<f32> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
        match *values.as_slice() {
            [one] => Some([one; 3]),
            [r, g, b] => Some([r, g, b]),
            _ => None,
        }
    };
    // Fallbacks of Ultra HDR's description, version 1.1.
    let map = || {
        Some(GainMap {
            min: numbers("GainMapMin", 0.0)?,
            max: field("GainMapMax").and(numbers("GainMapMax", 1.0))?,
            gamma: numbers("Gamma", 1.0)?,
            base_offset: numbers("OffsetSDR", 1.0 / 64.0)?,
            offset: numbers("OffsetHDR", 1.0 / 64.0)?,
        })
    };
    Some(map().ok_or("its description in XMP is not complete").and_then(GainMap::checked))
}

/// Returns the text of a field: an attribute, an element, or a list of three.
fn field_of(node: Node<'_, '_>, name: &str) -> Option<String> {
    if let Some(text) = node.attribute((NAMESPACE, name)) {
        return Some(text.to_owned());
    }
    let is_it = node.has_tag_name((NAMESPACE, name));
    is_it.then(|| node.descendants().filter(Node::is_text).filter_map(|text| text.text()).collect::<Vec<_>>().join(" "))
}

impl GainMap {
    fn checked(self) -> Result<Self, &'static str> {
        let all = [self.min, self.max, self.gamma, self.base_offset, self.offset];
        let is_right = all.as_flattened().iter().all(|v| v.is_finite()) && self.gamma.iter().all(|gamma| *gamma > 0.0);
        // Sixteen stops above white are more than any display or camera has.
        let is_bounded = self.max.iter().zip(self.min).all(|(max, min)| *max <= 16.0 && min >= -16.0 && min <= *max);
        if is_right && is_bounded { Ok(self) } else { Err("the numbers of its description are out of their range") }
    }

    /// Returns the factor of each code of a channel.
    fn factors(&self, c: usize) -> [f32; 256] {
        std::array::from_fn(|code| {
            let share = (code as f32 / 255.0).powf(1.0 / self.gamma[c]);
            self.min[c] * (1.0 - share) + self.max[c] * share
        })
    }

    /// Brightens light by the codes of the map.
    fn brighten(&self, image: &mut Image, layout: SampleGrid, codes: &[u8]) {
        let logarithms = [0, 1, 2].map(|c| self.factors(c));
        let [across, down] = [(image.width, layout.width), (image.height, layout.height)].map(|(size, of_map)| Steps::new(size, of_map));
        let of_map = |x: usize, y: usize, c: usize| {
            let at = (y * layout.width + x) * layout.channels + if layout.channels == 3 { c } else { 0 };
            logarithms[c][usize::from(codes.get(at).copied().unwrap_or(0))]
        };
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let (x, y) = (across.at(i % image.width), down.at(i / image.width));
            *pixel = [0, 1, 2].map(|c| {
                let row = |y: usize| of_map(x.first, y, c) * (1.0 - x.share) + of_map(x.second, y, c) * x.share;
                let gain = row(y.first) * (1.0 - y.share) + row(y.second) * y.share;
                ((pixel[c] + self.base_offset[c]) * gain.exp2() - self.offset[c]).max(0.0)
            });
        }
    }
}

/// Places of an image's pixels among those of a map, along one side.
struct Steps {
    ratio: f32,
    last: usize,
}

/// Two pixels of the map, and the share of the second.
struct Between {
    first: usize,
    second: usize,
    share: f32,
}

impl Steps {
    fn new(size: usize, of_map: usize) -> Self {
        Self { ratio: of_map as f32 / size as f32, last: of_map.saturating_sub(1) }
    }

    fn at(&self, pixel: usize) -> Between {
        // Centres of pixels are at one half.
        let place = ((pixel as f32 + 0.5) * self.ratio - 0.5).clamp(0.0, self.last as f32);
        let first = place as usize;
        Between { first, second: (first + 1).min(self.last), share: place - first as f32 }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::{ReadOptions, decode_image, encode_jpeg};
    use super::*;

    fn segment(marker: u8, content: &[u8]) -> Vec<u8> {
        [&[0xff, marker], &((content.len() + 2) as u16).to_be_bytes()[..], content].concat()
    }

    /// Returns a grey picture of one code, with segments behind its start.
    fn picture(code: u8, size: usize, segments: &[Vec<u8>]) -> Vec<u8> {
        let bytes = encode_jpeg(size, size, &vec![code; 3 * size * size], 100).unwrap();
        [&bytes[..2], &segments.concat(), &bytes[2..]].concat()
    }

    fn described(attributes: &str) -> Vec<u8> {
        let xml = format!(
            "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\"><rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">\
             <rdf:Description xmlns:hdrgm=\"{NAMESPACE}\" hdrgm:Version=\"1.0\" {attributes}/></rdf:RDF></x:xmpmeta>"
        );
        segment(APP1, &[XMP, xml.as_bytes()].concat())
    }

    fn fractions(numbers: &[(i32, u32)]) -> Vec<u8> {
        numbers.iter().flat_map(|(n, d)| [n.to_be_bytes(), d.to_be_bytes()].concat()).collect()
    }

    /// Returns ISO 21496-1: headrooms 0 and 3, gain 1 to 3, gamma 1, offsets of 1/64.
    fn iso_described(flags: u8) -> Vec<u8> {
        let numbers = fractions(&[(0, 1), (3, 1), (1, 1), (3, 1), (1, 1), (1, 64), (1, 64)]);
        segment(APP2, &[ISO, &[0, 0, 0, 0, flags], &numbers].concat())
    }

    fn read(bytes: &[u8]) -> super::super::DecodedImage {
        decode_image(Path::new("a.jpg"), bytes, &ReadOptions::default()).unwrap()
    }

    #[test]
    fn light_beyond_white_is_what_the_map_says() {
        // White twice as bright at code 0 of the map and eight times at 255: four times in between.
        let first = picture(255, 16, &[]);
        for description in [described("hdrgm:GainMapMin=\"1\" hdrgm:GainMapMax=\"3\""), iso_described(0x40)] {
            for (code, gain) in [(0u8, 2.0f32), (255, 8.0)] {
                let decoded = read(&[first.clone(), picture(code, 4, std::slice::from_ref(&description))].concat());
                let expected = (1.0 + 1.0 / 64.0) * gain - 1.0 / 64.0;
                assert!(decoded.image.pixels.iter().flatten().all(|v| (v - expected).abs() < 1e-3), "{:?}", decoded.image.pixels[0]);
                assert!(
                    decoded.warnings.iter().any(|w| w.contains("gain map is applied") && w.contains("8.0 times")),
                    "{:?}",
                    decoded.warnings
                );
            }
        }
        assert!(is_in(&[first.clone(), picture(0, 4, &[iso_described(0x40)])].concat()) && !is_in(&first));
    }

    #[test]
    fn maps_that_are_not_applied_are_named_and_leave_the_picture() {
        let first = picture(255, 16, &[]);
        let max = "hdrgm:GainMapMax=\"2\"";
        for (description, part) in [
            (described(&format!("{max} hdrgm:BaseRenditionIsHDR=\"True\"")), "brighter one"),
            (described(""), "not complete"),
            (described("hdrgm:GainMapMax=\"2\" hdrgm:Gamma=\"0\""), "out of their range"),
            (iso_described(0), "another colour space"),
            (segment(APP1, &[XMP, b"<a HDRGainMapVersion='1'/>"].concat()), "Apple"),
        ] {
            let decoded = read(&[first.clone(), picture(9, 4, &[description])].concat());
            assert!(decoded.warnings.iter().any(|w| w.contains("gain map is not applied") && w.contains(part)), "{:?}", decoded.warnings);
            assert!(decoded.image.pixels.iter().flatten().all(|v| (v - 1.0).abs() < 1e-6));
        }
        // Another picture behind the first is none.
        assert!(!read(&[first.clone(), picture(9, 4, &[])].concat()).warnings.iter().any(|w| w.contains("gain map")));
    }

    #[test]
    fn a_map_of_fewer_pixels_lies_on_the_whole_picture() {
        let map = GainMap { min: [0.0; 3], max: [1.0; 3], gamma: [1.0; 3], base_offset: [0.0; 3], offset: [0.0; 3] };
        let mut image = Image::filled(8, 1, [1.0; 3]);
        map.brighten(&mut image, SampleGrid { width: 2, height: 1, channels: 1 }, &[0, 255]);
        let found: Vec<f32> = image.pixels.iter().map(|p| p[0].log2()).collect();
        // Constant outside of the centres of the map's pixels, linear between them.
        let expected = [0.0, 0.0, 0.125, 0.375, 0.625, 0.875, 1.0, 1.0];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}");
    }
}
