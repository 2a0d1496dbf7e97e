//! Plates of cameras: integer and floating-point samples through a log curve, in the camera's
//! primaries.

use luxel_core::Conversion;
use luxel_io::{LoadOptions, describe_dataset, load_dataset};

use super::*;

const fn with(transfer: Transfer) -> ReadOptions {
    ReadOptions { transfer: Some(transfer), layer: None }
}

/// Returns a 16-bit PNG of one pixel, its samples of 0 to 1.
fn png16(pixel: [f64; 3]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let samples: Vec<u16> = pixel.iter().map(|v| (v * 65535.0).round() as u16).collect();
    let image = image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(1, 1, samples).unwrap();
    image.write_to(&mut Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    bytes
}

/// Returns a DPX file of RGB, of 10 bits in filled words or of another depth, in big-endian order.
pub(crate) fn dpx([width, height]: [u32; 2], bits: u8, samples: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 2048];
    let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
    put(0, b"SDPX");
    put(4, &2048u32.to_be_bytes());
    put(770, &1u16.to_be_bytes());
    put(772, &width.to_be_bytes());
    put(776, &height.to_be_bytes());
    put(800, &[50, 0, 0, bits]);
    put(804, &u16::from(bits == 10).to_be_bytes());
    bytes.extend_from_slice(samples);
    bytes
}

#[test]
fn a_data_set_of_dpx_plates_is_read_through_its_curve() {
    let folder = tempfile::tempdir().unwrap();
    let (lens, pose) = (r#""fl_x": 9, "fl_y": 9, "w": 6, "h": 4"#, "[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]");
    let word = [285u32; 3].iter().fold(0, |word, code| word << 10 | code) << 2;
    let samples: Vec<u8> = [word; 24].iter().flat_map(|word| word.to_be_bytes()).collect();
    std::fs::write(folder.path().join("a.dpx"), dpx([6, 4], 10, &samples)).unwrap();
    let frame = format!(r#"{{"file_path": "a.dpx", "transform_matrix": {pose}}}"#);
    std::fs::write(folder.path().join("transforms.json"), format!("{{{lens}, \"frames\": [{frame}]}}")).unwrap();
    let options = LoadOptions { transfer: Some(Transfer::LogC4), ..LoadOptions::default() };
    let data = load_dataset(folder.path(), &options).unwrap();
    let [red, ..] = data.train[0].image.at(5, 3);
    assert!((red - 0.18).abs() < 1e-3 && data.color_space == ColorSpace::AcesCg, "{red}");
    assert_eq!(describe_dataset(folder.path(), &options).unwrap().cameras.len(), 1);
    let error = load_dataset(folder.path(), &LoadOptions::default()).unwrap_err();
    assert!(error.message.contains("10-bit integer samples"), "{error}");
}

#[test]
fn a_grey_card_is_18_percent_in_any_camera() {
    // The makers' codes of 18 % grey.
    let cards = [(Transfer::LogC3, 0.391), (Transfer::LogC4, 0.2784), (Transfer::SLog3, 420.0 / 1023.0), (Transfer::VLog, 0.4233)];
    for (transfer, code) in cards {
        let decoded = decode(&png16([code; 3]), &with(transfer)).unwrap();
        assert_eq!(decoded.color_space, Some(ColorSpace::AcesCg));
        let found = decoded.image.at(0, 0);
        assert!(found.iter().all(|v| (v - 0.18).abs() < 1e-3), "{transfer}: {found:?}");
    }
}

#[test]
fn colours_are_those_of_opencolorio() {
    // OpenColorIO 2.6 adapts white by CAT02, Luxel by Bradford: a little apart.
    let expected = [
        (Transfer::LogC3, [0.948_663, 0.305_149, 0.066_484]),
        (Transfer::LogC4, [4.998_445, 0.746_533, 0.230_702]),
        (Transfer::SLog3, [0.810_264, 0.185_536, 0.051_335]),
        (Transfer::SLog3Cine, [0.711_972, 0.167_975, 0.028_266]),
        (Transfer::VLog, [0.759_929, 0.161_501, 0.040_561]),
    ];
    let aces = Conversion::between(ColorSpace::AcesCg, ColorSpace::Aces2065);
    for (transfer, expected) in expected {
        let decoded = decode(&png16([0.6, 0.4, 0.3]), &with(transfer)).unwrap();
        let found = aces.apply(decoded.image.at(0, 0));
        let largest = expected[0];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 0.02 * largest, "{transfer}: {found}, expected {expected}");
        }
    }
}

#[test]
fn floats_are_taken_as_samples_and_stated_primaries_do_not_count() {
    let stored = Radiance { width: 2, height: 1, pixels: vec![[0.391; 3], [0.05; 3]] };
    let options = ExrOptions { color_space: ColorSpace::LinearRec709, sample: ExrSample::Float, ..ExrOptions::default() };
    let bytes = encode_exr(Path::new("plate.exr"), &stored, &options).unwrap();
    let decoded = decode(&bytes, &with(Transfer::LogC3)).unwrap();
    assert!((decoded.image.at(0, 0)[1] - 0.18).abs() < 1e-3);
    // Below black there is no light.
    assert_eq!(decoded.image.at(1, 0), [0.0; 3]);
    let warnings = decoded.warnings.join("\n");
    assert!(warnings.contains("1 pixels have channels below black") && warnings.contains("not those of logc3"), "{warnings}");
    // Without the curve the same file is light.
    assert_eq!(decode(&bytes, &LINEAR).unwrap().image.at(0, 0), [0.391; 3]);
}

#[test]
fn video_keeps_its_primaries() {
    let decoded = decode(&png16([0.58; 3]), &with(Transfer::Pq)).unwrap();
    assert_eq!(decoded.color_space, Some(ColorSpace::LinearRec2020));
    assert!((decoded.image.at(0, 0)[0] - 2.03).abs() < 0.02, "{:?}", decoded.image.at(0, 0));
}

#[test]
fn files_of_light_have_no_curve() {
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\x80\x80\x80\x81";
    let error = decode(hdr, &with(Transfer::LogC4)).unwrap_err();
    assert!(error.to_string().contains("hold light"), "{error}");
}
