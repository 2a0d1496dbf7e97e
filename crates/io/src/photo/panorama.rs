//! Whether a file says that its picture is an equirectangular panorama.
//!
//! In: an XMP packet with Google's Photo Sphere properties (`GPano`), which cameras for panoramas
//! and stitchers write, or an OpenEXR file with the attribute `envmap`. Out: [`StatedPanorama`].
//! Degenerate: other projections, and files that say nothing, have none.

use luxel_core::photo::StatedPanorama;

/// Bytes of an OpenEXR file in which its header is looked for.
const EXR_HEADER_BYTES: usize = 1 << 16;

/// Returns what an XMP packet says.
pub(super) fn panorama_of_xmp(packet: &[u8]) -> Option<StatedPanorama> {
    let text = String::from_utf8_lossy(packet);
    let is_equirectangular = value(&text, "GPano:ProjectionType")?.eq_ignore_ascii_case("equirectangular");
    let number = |name: &str| value(&text, name).and_then(|value| value.parse::<f64>().ok());
    let is_cropped = |part: &str, whole: &str| number(part).zip(number(whole)).is_some_and(|(part, whole)| part < whole);
    let is_part = is_cropped("GPano:CroppedAreaImageWidthPixels", "GPano:FullPanoWidthPixels")
        || is_cropped("GPano:CroppedAreaImageHeightPixels", "GPano:FullPanoHeightPixels");
    is_equirectangular.then_some(if is_part { StatedPanorama::Part } else { StatedPanorama::Whole })
}

/// Returns the value of a property: an attribute (="2048") or an element (>2048<).
fn value<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(name)?;
    let rest = rest.trim_start().trim_start_matches('=').trim_start().trim_start_matches(['"', '\'', '>']);
    rest.get(..rest.find(['"', '\'', '<'])?).map(str::trim)
}

/// Returns what an OpenEXR file says: an `envmap` of 0 is a map of latitude and longitude.
pub(super) fn panorama_of_exr(bytes: &[u8]) -> Option<StatedPanorama> {
    const ATTRIBUTE: &[u8] = b"envmap\0envmap\0\x01\0\0\0\0";
    let header = bytes.get(..bytes.len().min(EXR_HEADER_BYTES)).filter(|bytes| bytes.starts_with(b"\x76\x2f\x31\x01"))?;
    header.windows(ATTRIBUTE.len()).any(|window| window == ATTRIBUTE).then_some(StatedPanorama::Whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::exif::exif_of_file;

    const XMP: &str = r#"<rdf:Description GPano:ProjectionType="equirectangular" GPano:FullPanoWidthPixels="4096""#;

    #[test]
    fn a_sphere_is_told_from_a_part_of_it_and_from_other_projections() {
        let found = |text: &str| panorama_of_xmp(text.as_bytes());
        assert_eq!(found(XMP), Some(StatedPanorama::Whole));
        let elements = "<GPano:ProjectionType>equirectangular</GPano:ProjectionType><GPano:FullPanoHeightPixels>2048</GPano:FullPanoHeightPixels>\
                        <GPano:CroppedAreaImageHeightPixels>900</GPano:CroppedAreaImageHeightPixels>";
        assert_eq!(found(elements), Some(StatedPanorama::Part));
        assert_eq!(found(&format!("{XMP} GPano:CroppedAreaImageWidthPixels='4096'/>")), Some(StatedPanorama::Whole));
        assert_eq!((found("GPano:ProjectionType=\"cylindrical\""), found("GPano:ProjectionType"), found("")), (None, None, None));
    }

    #[test]
    fn jpeg_png_and_openexr_state_it() {
        let packet = [b"http://ns.adobe.com/xap/1.0/\0", XMP.as_bytes()].concat();
        let mut jpeg = b"\xff\xd8\xff\xe1".to_vec();
        jpeg.extend((packet.len() as u16 + 2).to_be_bytes());
        jpeg.extend(&packet);
        jpeg.extend(b"\xff\xd9");
        let text = [b"XML:com.adobe.xmp\0\0\0\0\0", XMP.as_bytes()].concat();
        let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
        for (kind, content) in [(b"iTXt", b"Comment\0\0\0\0\0GPano".as_slice()), (b"iTXt", &text), (b"IEND", b"")] {
            png.extend((content.len() as u32).to_be_bytes());
            png.extend(kind);
            png.extend(content);
            png.extend([0; 4]);
        }
        let exr = |kind: u8| [b"\x76\x2f\x31\x01\x02\0\0\0envmap\0envmap\0\x01\0\0\0".as_slice(), &[kind, 0]].concat();
        for (file, expected) in [(jpeg, true), (png, true), (exr(0), true), (exr(1), false), (b"\xff\xd8\xff\xd9".to_vec(), false)] {
            assert_eq!(exif_of_file(&file).panorama, expected.then_some(StatedPanorama::Whole));
        }
    }
}
