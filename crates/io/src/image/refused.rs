//! Files that are no image of a format that is read, by the names of what they are.

use crate::IoError;
use crate::input::Input;
use crate::scene_file::{SceneFormat, refused_scene};

/// First bytes of formats, and what to say of each.
const MAGIC: [(&[u8], &str); 15] = [
    (b"\0\0\0\x0cJXL ", "JPEG XL, which is not read; export it as OpenEXR, or as 16-bit PNG or TIFF"),
    (&[0xff, 0x0a], "JPEG XL, which is not read; export it as OpenEXR, or as 16-bit PNG or TIFF"),
    (b"\0\0\0\x0cjP", "JPEG 2000, which is not read; export it as 16-bit PNG or TIFF"),
    (b"GIF8", "GIF, which is not read; export it as PNG"),
    (b"BM", "BMP, which is not read; export it as PNG"),
    (b"8BPS", "Photoshop's own format, which is not read; export it as OpenEXR or TIFF"),
    (b"gimp xcf", "GIMP's own format, which is not read; export it as OpenEXR or TIFF"),
    (b"PF\n", "a portable float map, which is read as depth only; export it as OpenEXR"),
    (b"Pf\n", "a portable float map, which is read as depth only; export it as OpenEXR"),
    (b"P6", "a portable pixmap, which is not read; export it as PNG"),
    (b"P5", "a portable greymap, which is not read; export it as PNG"),
    (b"DDS ", "a DirectDraw surface, which is not read; export it as OpenEXR"),
    (b"\xabKTX", "a KTX texture, which is not read; export it as OpenEXR"),
    (b"SIMPLE  =", "FITS, which is not read; export it as OpenEXR or TIFF"),
    (b"\x1aE\xdf\xa3", "a video, of which frames are prepared"),
];

/// Returns the refusal of a file that is known to be something else; `None` for one that is not
/// known.
pub(super) fn known_by_name(input: Input<'_>) -> Option<IoError> {
    if let Some(refused) = refused_scene(input) {
        return Some(refused);
    }
    let what = other_picture(input.bytes).or_else(|| {
        let is_scene = SceneFormat::from_bytes(input.bytes).is_some();
        is_scene.then_some("a scene or an archive and not an image; give it where a scene is expected")
    });
    what.map(|what| input.unsupported(format!("{what}{}", expected())))
}

/// Returns what a file of a format of pictures or videos is that is not read, and what to do.
pub(super) fn other_picture(head: &[u8]) -> Option<&'static str> {
    if let Some((_, what)) = MAGIC.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Some(what);
    }
    match (head.get(..4), head.get(4..8), head.get(8..12)) {
        (Some(b"RIFF"), _, Some(b"WEBP")) => Some("WebP, which is not read; export it as PNG"),
        (_, Some(b"ftyp"), Some(brand)) => Some(iso_media(brand)),
        _ => None,
    }
}

fn expected() -> &'static str {
    " (images are OpenEXR, Radiance HDR, TIFF, PNG, JPEG, DPX or NumPy's .npy)"
}

/// Returns what a file of ISO's base media format is, by its brand.
fn iso_media(brand: &[u8]) -> &'static str {
    match brand {
        b"avif" | b"avis" => "AVIF, which is not read, nor its gain map; export it as OpenEXR, or as 16-bit PNG in PQ",
        b"heic" | b"heix" | b"hevc" | b"hevx" | b"heim" | b"heis" | b"hevm" | b"mif1" | b"msf1" => {
            "HEIC, which is not read, nor its gain map; export it as OpenEXR, or as JPEG with its gain map (ISO 21496-1, Ultra HDR)"
        }
        _ => "a video, of which frames are prepared",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_other_formats_are_refused_by_their_names() {
        for (name, head, part) in [
            ("a.heic", &b"\0\0\0\x18ftypheic\0\0\0\0"[..], "HEIC, which is not read, nor its gain map"),
            ("a.avif", b"\0\0\0\x18ftypavif\0\0\0\0", "AVIF"),
            ("a.mp4", b"\0\0\0\x18ftypisom\0\0\0\0", "video"),
            ("a.webp", b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
            ("a.splat", &[0; 32], ".splat"),
            ("a.ply", b"ply\nformat", "a scene"),
        ] {
            let error = known_by_name(Input::new(name, head)).unwrap().to_string();
            assert!(error.contains(part), "{error}");
        }
        assert!(known_by_name(Input::new("a.bin", &[1, 2, 3])).is_none());
    }
}
