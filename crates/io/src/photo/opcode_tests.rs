use std::path::Path;

use luxel_core::photo::*;
use proptest::prelude::*;

use super::tests::{Dng, codes, decode, little_endian, longs};
use super::*;
use crate::IoErrorKind;

/// Returns an opcode; an optional one may be left out.
fn opcode(id: u32, is_optional: bool, parameters: &[u8]) -> Vec<u8> {
    [&ints(&[id, 0x0103_0000, u32::from(is_optional), parameters.len() as u32]), parameters].concat()
}

fn list(opcodes: &[Vec<u8>]) -> (u16, u32, Vec<u8>) {
    let bytes = [ints(&[opcodes.len() as u32]), opcodes.concat()].concat();
    (7, bytes.len() as u32, bytes)
}

fn ints(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_be_bytes()).collect()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_be_bytes()).collect()
}

fn doubles(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_be_bytes()).collect()
}

/// Returns the region of all samples of `planes` planes of 4 x 4 pixels.
fn everywhere(planes: u32) -> Vec<u8> {
    ints(&[0, 0, 4, 4, 0, planes, 1, 1])
}

/// Returns a mosaic of 4 x 4 pixels from 1000 to 1150, black 0 and white 2000.
fn mosaic() -> Dng {
    let stored: Vec<u16> = (0..16).map(|i| 1000 + 10 * i).collect();
    let mut dng = Dng::new(4, 4, 1, 16, 1, little_endian(&stored));
    dng.set(50717, longs(&[2000]));
    dng
}

fn with(mut dng: Dng, tag: u16, opcodes: &[Vec<u8>]) -> Result<RawPixels, IoError> {
    decode(&dng.set(tag, list(opcodes)).bytes())
}

const LISTS: [u16; 3] = [51008, 51009, 51022];

#[test]
fn bad_pixels_become_the_mean_of_their_colour() {
    // Pixel (1, 1) is blue: its neighbours are (3, 1), (1, 3). Pixel (2, 1) is green: diagonal ones
    // are nearest, of which (1, 0) is bad itself.
    let bad = ints(&[0, 3, 0, 1, 1, 1, 2, 0, 1]);
    let found = with(mosaic(), LISTS[0], &[opcode(5, false, &bad)]).unwrap().codes;
    assert_eq!(found[5], (1070 + 1130) / 2);
    // (3, 0), (1, 2), (3, 2): 1030, 1090, 1110.
    assert_eq!(found[6], (1030 + 1090 + 1110 + 1) / 3);
    // A rectangle of the two columns on the left: greens next to it have its right neighbours.
    let rectangle = ints(&[0, 0, 1, 0, 0, 4, 2]);
    let found = with(mosaic(), LISTS[0], &[opcode(5, false, &rectangle)]).unwrap().codes;
    assert_eq!((found[0], found[1], found[3]), (1020, 1060, 1030));
    // All of one code.
    let found = with(mosaic(), LISTS[0], &[opcode(4, false, &ints(&[1050, 0]))]).unwrap().codes;
    assert_eq!((found[5], found[4]), (1100, 1040));
}

#[test]
fn places_of_list_1_count_from_the_corner_of_the_sensor() {
    let stored = codes(8 * 6, 1000);
    let mut dng = Dng::new(8, 6, 1, 16, 1, little_endian(&stored));
    dng.set(50829, longs(&[1, 1, 6, 8]));
    // Row 3, column 4 of the sensor is row 2, column 3 of the area of 7 columns. Its colour is blue
    // or red in every cell: neighbours are two away.
    let found = with(dng, LISTS[0], &[opcode(5, false, &ints(&[0, 1, 0, 3, 4]))]).unwrap();
    let neighbours = [(2, 3), (6, 3), (4, 1), (4, 5)].map(|(x, y)| u32::from(stored[y * 8 + x]));
    let diagonal = [(3, 2), (5, 2), (3, 4), (5, 4)].map(|(x, y)| u32::from(stored[y * 8 + x]));
    let mean = |four: [u32; 4]| ((four.iter().sum::<u32>() + 2) / 4) as u16;
    // Column 3, row 2 from the area's corner, of a cell of red, green, green, blue.
    assert_eq!(found.cell, Some([0, 1, 1, 2]));
    assert_eq!(found.codes[2 * 7 + 3], mean(diagonal), "{neighbours:?}");
}

#[test]
fn maps_of_values_are_for_linear_ones() {
    // Half of the value, plus a quarter: 1000 of 2000 stays, and the scale grows to 16 bits.
    let polynomial = [everywhere(1), ints(&[1]), doubles(&[0.25, 0.5])].concat();
    let found = with(mosaic(), LISTS[1], &[opcode(8, false, &polynomial)]).unwrap();
    assert_eq!((found.white, found.black), (64000.0, [0.0; 4]));
    assert_eq!((found.codes[0], found.codes[15]), (32000, (0.25 * 64000.0 + 0.5 * 1150.0 * 32.0) as u16));
    // A hundredth is added to every second row, from the second on.
    let rows = [ints(&[1, 0, 4, 4, 0, 1, 2, 1]), ints(&[2]), floats(&[0.01, 0.02])].concat();
    let found = with(mosaic(), LISTS[1], &[opcode(10, false, &rows)]).unwrap().codes;
    assert_eq!((found[0], found[4], found[12]), (32000, 1040 * 32 + 640, 1120 * 32 + 1280));
    let columns = [everywhere(1), ints(&[4]), floats(&[0.0, 0.01, 0.0, 0.0])].concat();
    let found = with(mosaic(), LISTS[1], &[opcode(11, false, &columns)]).unwrap().codes;
    assert_eq!((found[0], found[5], found[6]), (32000, 1050 * 32 + 640, 1060 * 32));
    // A table of list 1 is for stored codes; beyond its end its last value holds.
    let table = [everywhere(1), ints(&[1001]), (0..=1000u16).flat_map(|i| (2 * i).to_be_bytes()).collect()].concat();
    let found = with(mosaic(), LISTS[0], &[opcode(7, false, &table)]).unwrap();
    assert_eq!((found.codes[0], found.codes[15], found.white), (2000, 2000, 2000.0));
}

#[test]
fn saturated_samples_stay_so() {
    let mut dng = mosaic();
    dng.set(50717, longs(&[1100]));
    let polynomial = [everywhere(1), ints(&[1]), doubles(&[0.0, 0.5])].concat();
    let found = with(dng, LISTS[1], &[opcode(8, false, &polynomial)]).unwrap();
    let factor = (found.white / 1100.0) as u16;
    assert_eq!((found.codes[0], found.codes[10], found.codes[15]), (factor * 500, factor * 1100, factor * 1150));
}

fn gain_map(top: u32, left: u32, values: &[f32]) -> Vec<u8> {
    let region = ints(&[top, left, 4, 4, 0, 1, 2, 2]);
    [region, ints(&[2, 2]), doubles(&[1.0, 0.5, 0.0, 0.25]), ints(&[1]), floats(values)].concat()
}

#[test]
fn gains_of_samples_are_left_to_merging() {
    let opcodes = [
        opcode(9, false, &gain_map(0, 1, &[1.0, 2.0, 3.0, 4.0])),
        opcode(12, false, &[everywhere(1), ints(&[4]), floats(&[2.0; 4])].concat()),
    ];
    let found = with(mosaic(), LISTS[1], &opcodes).unwrap();
    let corrections = found.corrections.unwrap();
    assert_eq!((corrections.area_px, corrections.origin_px, corrections.steps.len()), ([4, 4], [0, 0], 0));
    let map = &corrections.gains[0];
    let region = SampleRegion { top: 0, left: 1, bottom: 4, right: 4, plane: 0, planes: 1, row_pitch: 2, column_pitch: 2 };
    let expected = GainMap { points: [2, 2], spacing: [0.5, 1.0], origin: [0.25, 0.0], planes: 1, values: vec![1.0, 2.0, 3.0, 4.0] };
    assert_eq!((map.region, &map.shape, map.is_by_color), (region, &GainShape::Map(expected), false));
    assert_eq!(corrections.gains[1].shape, GainShape::Rows(vec![2.0; 4]));
    assert_eq!(found.codes[0], 1000);
}

fn vignette() -> Vec<u8> {
    opcode(3, true, &doubles(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.25]))
}

fn warp(planes: u32) -> Vec<u8> {
    let plane = [1.0, -0.1, 0.01, 0.0, 0.001, 0.002];
    opcode(1, false, &[ints(&[planes]), doubles(&plane.repeat(planes as usize)), doubles(&[0.5, 0.4])].concat())
}

#[test]
fn a_warp_takes_the_whole_active_area_and_leaves_the_crop() {
    let mut dng = Dng::new(8, 6, 1, 16, 1, little_endian(&codes(8 * 6, 1000)));
    dng.set(50829, longs(&[1, 1, 6, 8])).set(50719, longs(&[2, 1])).set(50720, longs(&[4, 3]));
    let bytes = dng.set(LISTS[2], list(&[vignette(), warp(3), vignette()])).bytes();
    let found = decode(&bytes).unwrap();
    assert_eq!((found.width, found.height, found.cell), (7, 5, Some([0, 1, 1, 2])));
    let corrections = found.corrections.unwrap();
    assert_eq!((corrections.area_px, corrections.origin_px), ([7, 5], [0, 0]));
    assert_eq!(corrections.crop, CropRect { left: 2, top: 1, width: 4, height: 3 });
    // A gain before the warp is one of samples, one after it comes after it.
    let radial = GainShape::Radial { coefficients: [0.1, 0.2, 0.3, 0.4, 0.5], center: [0.5, 0.25] };
    assert!(corrections.gains.len() == 1 && corrections.gains[0].shape == radial && corrections.gains[0].is_by_color);
    let [LensStep::Warp(warp), LensStep::Gain(after)] = &corrections.steps[..] else { panic!("{:?}", corrections.steps) };
    assert_eq!((warp.planes.len(), warp.center, warp.kind), (3, [0.5, 0.4], WarpKind::Rectilinear));
    assert_eq!((warp.planes[2].radial[..5].to_vec(), warp.planes[2].tangential), (vec![1.0, 0.0, -0.1, 0.0, 0.01], [0.001, 0.002]));
    assert_eq!(after.shape, radial);
    let info = photo_info(Path::new("a.dng"), &bytes).unwrap();
    let raw = info.raw.unwrap();
    assert_eq!((info.size_px, raw.is_straightened, raw.not_applied.len()), ([4, 3], true, 0));
    assert_eq!(raw.applied, ["opcode list 3 (FixVignetteRadial, WarpRectilinear)"]);
}

#[test]
fn other_warps_have_numbers_of_their_own() {
    let fisheye = opcode(2, false, &[ints(&[1]), doubles(&[1.0, 0.1, 0.2, 0.3, 0.5, 0.5])].concat());
    let mut numbers = [0.0; 19];
    (numbers[0], numbers[1], numbers[18]) = (1.0, 0.5, 0.75);
    let second = opcode(14, false, &[ints(&[1]), doubles(&numbers), doubles(&[0.5, 0.5]), ints(&[1])].concat());
    let steps = with(mosaic(), LISTS[2], &[fisheye, second]).unwrap().corrections.unwrap().steps;
    let [LensStep::Warp(fisheye), LensStep::Warp(second)] = &steps[..] else { panic!("{steps:?}") };
    assert_eq!((fisheye.kind, &fisheye.planes[0].radial[..4]), (WarpKind::Fisheye, &[1.0, 0.1, 0.2, 0.3][..]));
    assert_eq!((second.kind, second.planes[0].radial[1], second.planes[0].valid), (WarpKind::Reciprocal, 0.5, [0.0, 0.75]));
}

#[test]
fn what_must_be_done_and_is_not_known_is_refused_and_optional_things_are_named() {
    let trim = |is_optional| opcode(6, is_optional, &ints(&[0, 0, 4, 4]));
    // Operations with their lists: unknown, known elsewhere, and after a gain.
    let late = [
        opcode(12, false, &[everywhere(1), ints(&[4]), floats(&[2.0; 4])].concat()),
        opcode(8, false, &[everywhere(1), ints(&[0]), doubles(&[1.0])].concat()),
    ];
    for (tag, opcodes, part) in [
        (LISTS[2], vec![trim(false)], "opcode list 3 requires TrimBounds"),
        (LISTS[0], vec![opcode(4711, false, &[])], "opcode list 1 requires unknown opcode 4711"),
        (LISTS[0], vec![warp(1)], "opcode list 1 requires WarpRectilinear"),
        (LISTS[1], vec![warp(1)], "opcode list 2 requires WarpRectilinear"),
        (LISTS[1], late.to_vec(), "opcode list 2 requires MapPolynomial"),
    ] {
        let mut dng = mosaic();
        let bytes = dng.set(tag, list(&opcodes)).bytes();
        for error in [decode(&bytes).unwrap_err(), photo_info(Path::new("a.dng"), &bytes).unwrap_err()] {
            assert!(error.message.contains(part) && error.kind == IoErrorKind::Unsupported, "{part}: {error}");
        }
    }
    let mut dng = mosaic();
    let info = photo_info(Path::new("a.dng"), &dng.set(LISTS[2], list(&[trim(true), vignette()])).bytes()).unwrap().raw.unwrap();
    assert_eq!((info.applied, info.is_straightened), (vec!["opcode list 3 (FixVignetteRadial)".to_owned()], false));
    assert_eq!(info.not_applied, ["opcode list 3 (TrimBounds)"]);
}

#[test]
fn damaged_lists_say_what_is_wrong() {
    let covered = [ints(&[0, 0, 5]), ints(&[0, 0, 4, 4]).repeat(5)].concat();
    let cases = [
        (LISTS[0], vec![opcode(5, false, &ints(&[0, 9, 0, 1]))], "FixBadPixelsList is cut short"),
        (LISTS[0], vec![opcode(5, false, &covered)], "cover the image more than 4 times"),
        (LISTS[1], vec![opcode(9, false, &gain_map(0, 0, &[1.0, 2.0]))], "GainMap is cut short"),
        (LISTS[1], vec![opcode(9, false, &gain_map(0, 0, &[1.0, 2.0, -1.0, 1.0]))], "GainMap holds gains that are not above 0"),
        (LISTS[1], vec![opcode(9, true, &gain_map(5, 0, &[1.0; 4]))], "GainMap covers rows 5 to 4"),
        (
            LISTS[1],
            vec![opcode(12, false, &[everywhere(1), ints(&[3]), floats(&[2.0; 3])].concat())],
            "ScalePerRow has 3 numbers, expected 4",
        ),
        (LISTS[1], vec![opcode(8, false, &[everywhere(1), ints(&[9])].concat())], "degree 9, expected 0 to 8"),
        (LISTS[2], vec![opcode(3, true, &doubles(&[-2.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5]))], "FixVignetteRadial holds gains"),
        (LISTS[2], vec![opcode(1, false, &ints(&[9]))], "WarpRectilinear is of 9 planes"),
        (LISTS[2], vec![opcode(1, false, &[ints(&[1]), doubles(&[f64::NAN; 8])].concat())], "WarpRectilinear holds numbers"),
    ];
    for (tag, opcodes, part) in cases {
        let error = with(mosaic(), tag, &opcodes).unwrap_err();
        assert!(error.message.contains(part) && error.kind == IoErrorKind::Invalid, "{part}: {error}");
    }
    let mut dng = mosaic();
    let error = decode(&dng.set(LISTS[1], (7, 8, ints(&[9, 9]))).bytes()).unwrap_err();
    assert!(error.message.contains("opcode list 2: the list is cut short"), "{error}");
}

/// Bytes of any numbers, small ones above all.
const PARAMETERS: &str = "[\\x00-\\x05]{0,120}";

proptest! {
    #[test]
    fn any_list_is_done_or_an_error(which in 0..3usize, id in 0..16u32, parameters in PARAMETERS, is_linear: bool) {
        let mut dng = if is_linear { Dng::new(4, 2, 3, 16, 1, vec![9; 48]) } else { mosaic() };
        dng.set(LISTS[which], list(&[opcode(id, false, parameters.as_bytes())]));
        let bytes = dng.bytes();
        let info = photo_info(Path::new("a.dng"), &bytes);
        prop_assert!(decode(&bytes).is_err() || info.is_ok());
    }
}
