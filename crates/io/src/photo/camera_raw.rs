//! Camera makers' own RAW formats (CR2, CR3, NEF, ARW, RAF, ORF, RW2 and others), by the library
//! rawler, which is under the LGPL 2.1: only with the feature `camera-raw`.
//!
//! In: bytes of a file. Out: the same as of a DNG, cropped to the area that the maker recommends:
//! [`PhotoInfo`] and [`RawPixels`] with levels, colour matrices and white balance. Corrections of
//! the lens that makers' files hold are not applied. Degenerate: mosaics other than Bayer's and
//! cameras that the library does not know are errors; its panics are contained by the callers.

use luxel_core::photo::{Exif, PhotoInfo, PhotoKind, RawInfo, RawPixels};
use rawler::decoders::{Decoder, RawDecodeParams, RawMetadata};
use rawler::formats::tiff::Rational;
use rawler::imgop::xyz::Illuminant;
use rawler::rawimage::RawPhotometricInterpretation;
use rawler::rawsource::RawSource;
use rawler::{RawImage, RawImageData};

use super::exif::{exif_of_file, seconds_since_1970};
use crate::IoError;
use crate::input::Input;

/// Most components of the length of an image's side, pixels, that a sensor has.
const MAX_SIDE: usize = 1 << 16;

/// A file that the library knows.
struct CameraFile<'a> {
    input: Input<'a>,
    source: RawSource,
    decoder: Box<dyn Decoder>,
}

/// Part of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Area {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl<'a> CameraFile<'a> {
    fn open(input: Input<'a>) -> Result<Self, IoError> {
        let source = RawSource::new_from_slice(input.bytes).with_path(input.name);
        let decoder = rawler::get_decoder(&source).map_err(|error| refused(input, &error.to_string()))?;
        Ok(Self { input, source, decoder })
    }

    /// Returns the image, without samples if `is_head`.
    fn image(&self, is_head: bool) -> Result<RawImage, IoError> {
        let image = self.decoder.raw_image(&self.source, &RawDecodeParams::default(), is_head);
        let image = image.map_err(|error| refused(self.input, &error.to_string()))?;
        match image.width.max(image.height) {
            1..=MAX_SIDE => Ok(image),
            _ => Err(self.input.invalid(format!("{} x {} pixels, expected a sensor's", image.width, image.height))),
        }
    }

    fn metadata(&self) -> Result<RawMetadata, IoError> {
        let found = self.decoder.raw_metadata(&self.source, &RawDecodeParams::default());
        found.map_err(|error| refused(self.input, &error.to_string()))
    }
}

/// Returns the error about a file that is not read.
fn refused(input: Input<'_>, reason: &str) -> IoError {
    input.unsupported(format!("{reason}; convert the file with a DNG converter, which loses nothing"))
}

/// Reads the headers.
///
/// # Errors
/// A camera that the library does not know, or a damaged file.
pub(super) fn info(input: Input<'_>) -> Result<PhotoInfo, IoError> {
    let file = CameraFile::open(input)?;
    let image = file.image(true)?;
    let Area { width, height, .. } = area(input, &image)?;
    let exif = exif(&file.metadata()?, exif_of_file(input.bytes));
    let size_px = [width as u32, height as u32];
    Ok(PhotoInfo {
        kind: PhotoKind::Raw,
        size_px,
        exif,
        raw: Some(raw_info(&image)),
        profile: None,
        primaries: None,
        curve: None,
        has_gain_map: false,
    })
}

/// Reads the samples.
///
/// # Errors
/// Those of [`info`], and a mosaic other than Bayer's.
pub(super) fn pixels(input: Input<'_>) -> Result<RawPixels, IoError> {
    let image = CameraFile::open(input)?.image(false)?;
    cropped(input, &image)
}

/// Returns the part of the sensor that is used.
fn area(input: Input<'_>, image: &RawImage) -> Result<Area, IoError> {
    let rect = image.crop_area.or(image.active_area);
    let area = rect.map_or(Area { left: 0, top: 0, width: image.width, height: image.height }, |rect| Area {
        left: rect.p.x,
        top: rect.p.y,
        width: rect.d.w,
        height: rect.d.h,
    });
    let is_inside = |first: usize, length: usize, whole: usize| length > 0 && first.checked_add(length).is_some_and(|end| end <= whole);
    match is_inside(area.left, area.width, image.width) && is_inside(area.top, area.height, image.height) {
        true => Ok(area),
        false => {
            let message = format!("crop {area:?} of a sensor of {} x {} pixels, expected one inside", image.width, image.height);
            Err(input.invalid(message))
        }
    }
}

fn cropped(input: Input<'_>, image: &RawImage) -> Result<RawPixels, IoError> {
    let area = area(input, image)?;
    let RawImageData::Integer(samples) = &image.data else { return Err(refused(input, "floating-point samples")) };
    if samples.len() != image.width * image.height * image.cpp {
        return Err(input.invalid(format!("{} samples, expected {} x {} x {}", samples.len(), image.width, image.height, image.cpp)));
    }
    let (cell, black) = match &image.photometric {
        RawPhotometricInterpretation::Cfa(mosaic) if image.cpp == 1 && (mosaic.cfa.width, mosaic.cfa.height) == (2, 2) => {
            let places = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[y, x]| [(area.top + y) % 2, (area.left + x) % 2]);
            // Levels are those of the whole sensor's cells.
            let levels = image.blacklevel.as_bayer_array();
            (Some(places.map(|[y, x]| mosaic.cfa.color_at(y, x) as u8)), places.map(|[y, x]| levels[2 * y + x]))
        }
        RawPhotometricInterpretation::LinearRaw if image.cpp == 3 => {
            let levels = image.blacklevel.as_vec();
            (None, [0, 1, 2, 0].map(|channel| levels.get(channel).or(levels.first()).copied().unwrap_or_default()))
        }
        RawPhotometricInterpretation::Cfa(mosaic) => {
            let message = format!("a mosaic of {} x {}, expected Bayer's of 2 x 2", mosaic.cfa.width, mosaic.cfa.height);
            return Err(refused(input, &message));
        }
        _ => return Err(refused(input, &format!("{} samples a pixel without a mosaic, expected 3", image.cpp))),
    };
    let row = |y: usize| {
        let first = ((area.top + y) * image.width + area.left) * image.cpp;
        samples.get(first..first + area.width * image.cpp).unwrap_or_default()
    };
    let codes: Vec<u16> = (0..area.height).flat_map(row).copied().collect();
    let white = image.whitelevel.0.iter().min().map_or(f32::from(u16::MAX), |white| *white as f32);
    Ok(RawPixels { width: area.width, height: area.height, cell, codes, black, white, corrections: None })
}

/// Returns the colours that the file and the library state.
fn raw_info(image: &RawImage) -> RawInfo {
    let [r, g, b, _] = image.wb_coeffs.map(f64::from);
    let neutral = [g / r, 1.0, g / b];
    let is_usable = neutral.iter().all(|v| v.is_finite() && *v > 0.0);
    let mut camera_from_xyz: Vec<(f64, [f64; 9])> = image
        .color_matrix
        .iter()
        .filter_map(|(illuminant, matrix)| Some((kelvin(*illuminant)?, matrix.get(..9)?.try_into().ok()?)))
        .map(|(kelvin, matrix): (f64, [f32; 9])| (kelvin, matrix.map(f64::from)))
        .collect();
    // The library has them in a hash map.
    camera_from_xyz.sort_by(|a, b| a.0.total_cmp(&b.0));
    if let [first, .., last] = camera_from_xyz.as_slice() {
        // Two, as DNG: others lie between.
        camera_from_xyz = vec![*first, *last];
    }
    RawInfo { as_shot_neutral: is_usable.then_some(neutral), camera_from_xyz, ..RawInfo::default() }
}

/// Returns the temperature of an illuminant of Exif's.
fn kelvin(illuminant: Illuminant) -> Option<f64> {
    match illuminant {
        Illuminant::A | Illuminant::Tungsten => Some(2856.0),
        Illuminant::IsoStudioTungsten => Some(3200.0),
        Illuminant::B => Some(4874.0),
        Illuminant::D50 => Some(5003.0),
        Illuminant::D55 | Illuminant::Daylight | Illuminant::FineWeather | Illuminant::Flash => Some(5503.0),
        Illuminant::D65 | Illuminant::CloudyWeather => Some(6504.0),
        Illuminant::C => Some(6774.0),
        Illuminant::D75 | Illuminant::Shade => Some(7504.0),
        _ => None,
    }
}

/// Returns the facts that the library finds, completed by those that `own` reader finds.
fn exif(metadata: &RawMetadata, own: Exif) -> Exif {
    let found = &metadata.exif;
    let number = |value: Option<Rational>| value.map(|v| f64::from(v.n) / f64::from(v.d)).filter(|v| v.is_finite() && *v > 0.0);
    let text = |value: &str| Some(value.to_owned()).filter(|value| !value.is_empty());
    let iso = found.iso_speed_ratings.filter(|iso| (1..u16::MAX).contains(iso)).map(f64::from);
    Exif {
        make: text(&metadata.make).or(own.make),
        model: text(&metadata.model).or(own.model),
        serial: found.serial_number.clone().or(own.serial),
        lens: found.lens_model.clone().or(own.lens),
        seconds: number(found.exposure_time).or(own.seconds),
        iso: iso.or(found.recommended_exposure_index.or(found.iso_speed).map(f64::from)).or(own.iso),
        f_number: number(found.fnumber).or(own.f_number),
        time_s: found.date_time_original.as_deref().and_then(seconds_since_1970).or(own.time_s),
        is_white_balance_automatic: found.white_balance.map(|v| v == 0).or(own.is_white_balance_automatic),
        orientation: found.orientation.filter(|o| (1..=8).contains(o)).or(own.orientation),
        focal_mm: number(found.focal_length).or(own.focal_mm),
        ..own
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;
    use std::path::Path;

    use rawler::cfa::{CFA, PlaneColor};
    use rawler::decoders::{Camera, Orientation};
    use rawler::imgop::{Dim2, Point, Rect};
    use rawler::rawimage::{BlackLevel, CFAConfig, WhiteLevel};

    use super::*;
    use crate::photo::{decode_photo, photo_info};

    /// A sensor of 6 x 4 samples that count up, with a crop that begins at an odd place.
    fn sensor(pattern: &str) -> RawImage {
        let cfa = CFA::new(pattern);
        RawImage {
            camera: Camera::default(),
            make: String::new(),
            model: String::new(),
            clean_make: String::new(),
            clean_model: String::new(),
            width: 6,
            height: 4,
            cpp: 1,
            bps: 14,
            wb_coeffs: [2.0, 1.0, 1.6, f32::NAN],
            whitelevel: WhiteLevel(vec![16000, 15000, 15500, 16000]),
            blacklevel: BlackLevel::new(&[512u16, 513, 514, 515], 2, 2, 1),
            xyz_to_cam: [[0.0; 3]; 4],
            photometric: RawPhotometricInterpretation::Cfa(CFAConfig::new(&cfa, &PlaneColor::default())),
            active_area: None,
            crop_area: Some(Rect::new(Point::new(1, 1), Dim2::new(4, 2))),
            blackareas: Vec::new(),
            orientation: Orientation::Normal,
            data: RawImageData::Integer((0..24).collect()),
            color_matrix: HashMap::from([(Illuminant::D65, vec![0.5; 9]), (Illuminant::A, vec![0.25; 9])]),
            dng_tags: HashMap::new(),
        }
    }

    #[test]
    fn the_crop_moves_the_mosaic_and_its_levels() {
        let input = Input::new("a.nef", &[]);
        let found = cropped(input, &sensor("RGGB")).unwrap();
        assert_eq!((found.width, found.height, found.cell), (4, 2, Some([2, 1, 1, 0])));
        assert_eq!(found.codes, [7, 8, 9, 10, 13, 14, 15, 16]);
        assert_eq!((found.black, found.white), ([515.0, 514.0, 513.0, 512.0], 15000.0));
        let info = raw_info(&sensor("RGGB"));
        assert_eq!(info.as_shot_neutral, Some([0.5, 1.0, 1.0 / f64::from(1.6f32)]));
        assert_eq!(info.camera_from_xyz, [(2856.0, [0.25; 9]), (6504.0, [0.5; 9])]);
        let trans = cropped(input, &sensor("GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG")).unwrap_err();
        assert!(trans.message.contains("a mosaic of 6 x 6, expected Bayer's of 2 x 2; convert the file with a DNG converter"), "{trans}");
        let beyond = RawImage { crop_area: Some(Rect::new(Point::new(4, 0), Dim2::new(4, 2))), ..sensor("RGGB") };
        assert!(cropped(input, &beyond).unwrap_err().message.contains("expected one inside"));
        let short = RawImage { data: RawImageData::Integer(vec![0; 7]), ..sensor("RGGB") };
        assert!(cropped(input, &short).unwrap_err().message.contains("7 samples, expected 6 x 4 x 1"));
    }

    #[test]
    fn damaged_files_are_errors_with_their_name() {
        let tiff = b"II*\0\x08\0\0\0\x02\0\x0f\x01\x02\0\x06\0\0\0\x26\0\0\0\x10\x01\x02\0\x06\0\0\0\x2c\0\0\0\0\0\0\0NIKON\0NIKON\0";
        let heads: [&[u8]; 7] =
            [b"", b"II*\0", tiff, b"FUJIFILMCCD-RAW 0201FF389501", b"\0\0\0\x18ftypcrx \0\0\0\x01", b"IIU\0\x18\0\0\0", b"IIRO\x08\0\0\0"];
        for ending in ["cr2", "cr3", "nef", "arw", "raf", "orf", "rw2"] {
            for head in heads {
                for length in [0, 7, 300, 5000] {
                    let mut bytes = head.to_vec();
                    bytes.extend((0..length).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8));
                    let name = Path::new("broken").with_extension(ending);
                    let error = photo_info(&name, &bytes).unwrap_err().to_string();
                    assert!(error.contains("broken.") && error.contains("export it again") || error.contains("DNG converter"), "{error}");
                    assert!(decode_photo(&name, &bytes).is_err());
                }
            }
        }
    }
}
