use std::path::Path;

use luxel_core::{RadianceScale, RasterConfig, Scene, sigmoid, synthetic};
use proptest::prelude::*;

use super::layout::*;
use super::*;
use crate::bake::{Appearance, BakeOptions, Baked};

fn name() -> &'static Path {
    Path::new("scene.spz")
}

fn baked(max_degree: u8) -> Baked {
    Baked::new(&scene_of(50), &BakeOptions { appearance: Appearance::PREVIEW, max_degree })
}

fn baked_of(count: usize) -> Baked {
    Baked::new(&scene_of(count), &BakeOptions { appearance: Appearance::PREVIEW, max_degree: 0 })
}

fn scene_of(count: usize) -> Scene {
    let splats = synthetic::room(count, 9);
    Scene {
        splats,
        radiance_scale: RadianceScale::ONE,
        color_space: Default::default(),
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

#[test]
fn a_splat_far_out_does_not_cost_the_others_their_places() {
    let near = baked_of(500);
    let mut far = near.clone();
    let last = far.scene.splats.select([0]);
    far.scene.splats.position.push([2e7, 0.0, 0.0]);
    far.scene.splats.rotation.extend(last.rotation);
    far.scene.splats.log_scale.extend(last.log_scale);
    far.scene.splats.opacity_logit.extend(last.opacity_logit);
    far.scene.splats.sh.extend(last.sh);
    let positions = spz_positions(&far);
    assert_eq!((positions.left_out, positions.is_coarse()), (1, false));
    assert_eq!(encode_spz(name(), &far, SpzVersion::V4).unwrap(), encode_spz(name(), &near, SpzVersion::V4).unwrap());
    // A whole world far out is kept, and its step is known.
    let mut moved = near.clone();
    moved.scene.splats.position.iter_mut().for_each(|p| p[0] += 4.6e6);
    let positions = spz_positions(&moved);
    assert_eq!((positions.left_out, positions.is_coarse(), positions.step), (0, true, 1.0));
}

const VERSIONS: [SpzVersion; 3] = [SpzVersion::V2, SpzVersion::V3, SpzVersion::V4];

#[test]
fn every_version_and_degree_reads_back_within_its_steps() {
    for version in VERSIONS {
        for degree in 0..=3 {
            let baked = baked(degree);
            let bytes = encode_spz(name(), &baked, version).unwrap();
            let back = decode_spz(name(), &bytes).unwrap().splats;
            back.validate().unwrap();
            let splats = &baked.scene.splats;
            assert_eq!((back.len(), back.color_model), (splats.len(), splats.color_model));
            for i in 0..splats.len() {
                let far = |a: [f32; 3], b: [f32; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
                assert!(far(back.position[i], splats.position[i]) < 1e-5);
                assert!(far(back.log_scale[i], splats.log_scale[i]) < 0.04);
                assert!((sigmoid(back.opacity_logit[i]) - sigmoid(splats.opacity_logit[i])).abs() < 0.003);
                let dot: f32 = (0..4).map(|c| back.rotation[i][c] * splats.rotation[i][c]).sum();
                let length = splats.rotation[i].iter().map(|q| q * q).sum::<f32>().sqrt();
                // Version 2 leaves the real part to be found from the others, which a small one is
                // not well.
                let least = if version == SpzVersion::V2 { 0.99 } else { 0.999 };
                assert!(dot.abs() / length > least, "{version:?} {:?} {:?}", back.rotation[i], splats.rotation[i]);
                assert!((back.radiance(i, [0.0, 0.6, 0.8])[1] - splats.radiance(i, [0.0, 0.6, 0.8])[1]).abs() < 0.2);
            }
        }
    }
}

#[test]
fn radiance_and_nothing_are_refused() {
    let mut linear = baked(1);
    linear.appearance = Appearance::Linear { color_space: Default::default(), exposure_ev: 0.0 };
    assert!(encode_spz(name(), &linear, SpzVersion::V4).unwrap_err().message.contains("bake for a display"));
    let mut none = baked(1);
    none.scene.splats = luxel_core::Splats::empty(none.scene.splats.color_model);
    assert!(encode_spz(name(), &none, SpzVersion::V3).is_err());
}

#[test]
fn sizes_beyond_the_format_are_counted() {
    let mut baked = baked(1);
    assert_eq!(spz_out_of_range(&baked), 0);
    baked.scene.splats.log_scale[3][0] = 8.0;
    baked.scene.splats.log_scale[4] = [-11.0; 3];
    assert_eq!(spz_out_of_range(&baked), 2);
}

#[test]
fn wrong_headers_are_named() {
    let whole = encode_spz(name(), &baked(1), SpzVersion::V4).unwrap();
    let with = |at: usize, value: u8| {
        let mut bytes = whole.clone();
        bytes[at] = value;
        decode_spz(name(), &bytes).unwrap_err().message
    };
    assert!(with(4, 9).contains("version 9, expected 2 to 4"));
    assert!(with(4, 3).contains("without gzip"));
    assert!(with(12, 5).contains("degree 5"));
    assert!(with(13, 24).contains("24 fractional bits"));
    assert!(with(15, 3).contains("3 streams, expected 6"));
    assert!(with(19, 255).contains("table of streams"));
    assert!(with(10, 255).contains("claims"));
    assert!(decode_spz(name(), b"").is_err());
    assert!(decode_spz(name(), &whole[..whole.len() - 1]).is_err());
}

#[test]
fn checksum_and_length_of_gzip_are_compared() {
    for version in [SpzVersion::V2, SpzVersion::V3] {
        let whole = encode_spz(name(), &baked(1), version).unwrap();
        decode_spz(name(), &whole).unwrap();
        for cut in 1..=8 {
            assert!(decode_spz(name(), &whole[..whole.len() - cut]).is_err(), "cut by {cut}");
        }
        for back in 1..=8 {
            let mut damaged = whole.clone();
            let at = damaged.len() - back;
            damaged[at] ^= 1;
            let error = decode_spz(name(), &damaged).unwrap_err();
            assert!(error.message.starts_with("gzip: "), "{error}");
        }
    }
}

#[test]
fn more_splats_than_a_file_can_hold_are_refused() {
    let mut bytes = Vec::new();
    bytes.extend([0x4e, 0x47, 0x53, 0x50, 3, 0, 0, 0]);
    bytes.extend(60_000_000u32.to_le_bytes());
    bytes.extend([0, 12, 0, 0]);
    bytes.resize(bytes.len() + (4 << 20), 0);
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, &bytes).unwrap();
    let error = decode_spz(name(), &encoder.finish().unwrap()).unwrap_err();
    assert!(error.message.contains("claims 60000000 splats in a file of"), "{error}");
}

#[test]
fn axes_are_right_up_back() {
    assert_eq!(axes().point(glam::DVec3::new(1.0, 2.0, 3.0)), glam::DVec3::new(1.0, -2.0, -3.0));
    assert_eq!(axes().inverse().rotation(), axes().rotation());
}

#[test]
fn bytes_are_the_references() {
    // Worked by hand from the description: 24-bit two's complement, (log scale + 10) 16, dc 0.15
    // 255 + 127.5, buckets of 8 and 16.
    assert_eq!(pack_coordinate(-1.0, 12), [0x00, 0xf0, 0xff]);
    assert_eq!(unpack_coordinate([0x00, 0xf0, 0xff], 12), -1.0);
    assert_eq!((pack_log_scale(-3.5), pack_color(0.0), pack_opacity(0.5)), (104, 128, 128));
    assert_eq!((pack_harmonic(0.0, 1), pack_harmonic(0.1, 1), pack_harmonic(0.1, 2), pack_harmonic(-9.0, 3)), (128, 144, 144, 0));
    // The identity: w is largest (index 3), the others 0.
    assert_eq!(pack_rotation_smallest_three([0.0, 0.0, 0.0, 1.0]), [0, 0, 0, 0xc0]);
    assert_eq!(fractional_bits(1.0), 20);
    assert_eq!(fractional_bits(3000.0), 11);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn damage_is_an_error_or_a_valid_scene(version in 0usize..3, at: prop::sample::Index, byte: u8, cut: prop::sample::Index) {
        let mut bytes = encode_spz(name(), &baked(2), VERSIONS[version]).unwrap();
        prop_assert!(decode_spz(name(), &bytes[..cut.index(bytes.len())]).is_err());
        let at = at.index(bytes.len());
        bytes[at] = byte;
        if let Ok(scene) = decode_spz(name(), &bytes) {
            prop_assert_eq!(scene.splats.validate(), Ok(()));
        }
    }

    #[test]
    fn any_rotation_comes_back(q in prop::array::uniform4(-1f32..1.0)) {
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        prop_assume!(length > 0.1);
        let q = q.map(|v| v / length);
        for back in [unpack_rotation_smallest_three(pack_rotation_smallest_three(q)), unpack_rotation_first_three(pack_rotation_first_three(q))] {
            let dot: f32 = (0..4).map(|c| back[c] * q[c]).sum();
            prop_assert!(dot.abs() > 0.98, "{:?} {:?}", q, back);
        }
    }
}

/// Returns a file whose extension states other axes, with the same numbers; `None` leaves it out.
fn with_axes(bytes: &[u8], code: Option<u32>) -> Vec<u8> {
    let mut changed = bytes.to_vec();
    match code {
        Some(code) => changed[HEADER + 8..HEADER + 12].copy_from_slice(&code.to_le_bytes()),
        None => changed[14] &= !FLAG_EXTENSIONS,
    }
    changed
}

#[test]
fn stated_axes_are_heeded_and_unstated_ones_are_warned_of() {
    let bytes = encode_spz(name(), &baked(3), SpzVersion::V4).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.spz");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        crate::read_scene_file(&path).unwrap()
    };
    for version in VERSIONS {
        assert_eq!(read(&encode_spz(name(), &baked(3), version).unwrap()).warnings, [""; 0], "{version:?}");
    }
    let own = read(&bytes);
    let unstated = read(&with_axes(&bytes, None));
    assert_eq!(unstated.scene, own.scene);
    assert!(unstated.warnings[0].contains("does not state its axes"), "{:?}", unstated.warnings);
    let [x, y, z] = own.scene.splats.position[0];
    // As stored: right, up, back of what is right, down, forward.
    for (code, expected) in [(6, [x, -y, -z]), (7, [-x, y, -z]), (4, [x, y, z]), (8, [x, y, -z]), (12, [x, z, -y])] {
        let found = read(&with_axes(&bytes, Some(code))).scene.splats;
        assert!(found.position[0].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{code}: {:?} {expected:?}", found.position[0]);
        found.validate().unwrap();
    }
    std::fs::write(&path, with_axes(&bytes, Some(17))).unwrap();
    assert!(crate::read_scene_file(&path).unwrap_err().message.contains("states axes 17"));
}

#[test]
fn a_mirrored_scene_looks_as_in_a_mirror() {
    let bytes = encode_spz(name(), &baked(3), SpzVersion::V4).unwrap();
    let decode = |code| decode_spz(name(), &with_axes(&bytes, Some(code))).unwrap().splats;
    // Right, up, forward is right, up, back with z mirrored.
    let (plain, mirrored) = (decode(4), decode(8));
    let direction = [0.48f32, -0.6, 0.64];
    let seen = [direction[0], direction[1], -direction[2]];
    for i in 0..plain.len() {
        let (a, b) = (plain.radiance(i, direction), mirrored.radiance(i, seen));
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4), "splat {i}: {a:?} {b:?}");
    }
}
