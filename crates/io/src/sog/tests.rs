use std::path::Path;

use image_webp::WebPDecoder;
use luxel_core::{Antialias, RadianceScale, RasterConfig, Scene, Similarity, sigmoid, synthetic};

use super::codebook::Codebook;
use super::palette::Palette;
use super::*;
use crate::bake::{Appearance, BakeOptions, Baked};
use crate::input::Input;

fn baked(count: usize, max_degree: u8) -> Baked {
    let scene = Scene {
        splats: synthetic::room(count, 9),
        radiance_scale: RadianceScale::ONE,
        color_space: Default::default(),
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: None,
    };
    Baked::new(&scene, &BakeOptions { appearance: Appearance::PREVIEW, max_degree })
}

/// Returns the files of an archive.
fn files(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut at = 0;
    while bytes[at..].starts_with(b"PK\x03\x04") {
        let number = |offset: usize| u32::from_le_bytes(bytes[at + offset..][..4].try_into().unwrap()) as usize;
        let (size, name) = (number(18), usize::from(u16::from_le_bytes([bytes[at + 26], bytes[at + 27]])));
        let start = at + 30 + name;
        found.push((String::from_utf8(bytes[at + 30..start].to_vec()).unwrap(), bytes[start..start + size].to_vec()));
        at = start + size;
    }
    found
}

/// Returns a picture's pixels with alpha.
fn pixels(files: &[(String, Vec<u8>)], name: &str) -> Vec<[u8; 4]> {
    let (_, bytes) = files.iter().find(|(found, _)| found == name).unwrap();
    let mut decoder = WebPDecoder::new(std::io::Cursor::new(bytes)).unwrap();
    let mut out = vec![0; decoder.output_buffer_size().unwrap()];
    decoder.read_image(&mut out).unwrap();
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    out.chunks_exact(channels).map(|p| [p[0], p[1], p[2], p.get(3).copied().unwrap_or(255)]).collect()
}

#[test]
fn splats_come_back_within_the_steps_of_the_format() {
    let baked = baked(300, 3);
    let bytes = encode_sog(Path::new("a.sog"), &baked).unwrap();
    assert_eq!(bytes, encode_sog(Path::new("a.sog"), &baked).unwrap());
    let found = files(&bytes);
    let meta: serde_json::Value = serde_json::from_slice(&found[0].1).unwrap();
    let splats = &baked.scene.splats;
    let splats = splats.clone().select(luxel_core::spatial_order(&splats.position));
    assert_eq!((&meta["version"], &meta["count"], &meta["shN"]["bands"]), (&2.into(), &splats.len().into(), &3.into()));
    let number = |value: &serde_json::Value| value.as_f64().unwrap() as f32;
    let [low, high, scales, quats, sh0] =
        ["means_l", "means_u", "scales", "quats", "sh0"].map(|name| pixels(&found, &format!("{name}.webp")));
    let mut scale_errors = 0.0;
    for (i, low) in low.iter().take(splats.len()).enumerate() {
        for c in 0..3 {
            let (min, max) = (number(&meta["means"]["mins"][c]), number(&meta["means"]["maxs"][c]));
            let step = f32::from(u16::from_le_bytes([low[c], high[i][c]]));
            let place = min + (max - min) * step / 65535.0;
            let position = place.signum() * place.abs().exp_m1();
            assert!((position - splats.position[i][c]).abs() <= 2e-5 * (max - min) * (1.0 + position.abs()) + 1e-6, "{position}");
            let scale = number(&meta["scales"]["codebook"][usize::from(scales[i][c])]);
            // 256 values stand for 900; the rarest sizes are the farthest from theirs.
            let error = (scale - splats.log_scale[i][c]).abs();
            assert!(error < 0.12, "{scale}, {}", splats.log_scale[i][c]);
            scale_errors += error / (3 * splats.len()) as f32;
        }
        assert!((f32::from(sh0[i][3]) / 255.0 - sigmoid(splats.opacity_logit[i])).abs() < 0.003);
        let largest = usize::from(quats[i][3] - 252);
        let mut q = [0.0f32; 4];
        let others = (0..4).filter(|n| *n != largest);
        others.zip(quats[i]).for_each(|(n, byte)| q[n] = (f32::from(byte) / 255.0 * 2.0 - 1.0) / std::f32::consts::SQRT_2);
        q[largest] = (1.0 - q.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
        let given = splats.rotation[i];
        let length = given.iter().map(|v| v * v).sum::<f32>().sqrt();
        let product: f32 = q.iter().zip(given).map(|(a, b)| a * b / length).sum();
        assert!(product.abs() > 0.9998, "{q:?}, {given:?}");
    }
    assert!(scale_errors < 0.02, "{scale_errors}");
}

#[test]
fn a_written_file_is_read_as_the_display_bake_that_it_holds() {
    for degree in [0, 2, 3] {
        let baked = baked(300, degree);
        let bytes = encode_sog(Path::new("a.sog"), &baked).unwrap();
        let back = decode_sog(Path::new("a.sog"), &bytes).unwrap();
        assert_eq!((back.color_space, back.raster), (luxel_core::ColorSpace::DisplaySrgb, baked.scene.raster));
        let splats = baked.scene.splats.select(luxel_core::spatial_order(&baked.scene.splats.position));
        assert_eq!((back.splats.len(), back.splats.color_model), (splats.len(), splats.color_model));
        let mut errors = 0.0;
        for i in 0..splats.len() {
            assert!((0..3).all(|c| (back.splats.position[i][c] - splats.position[i][c]).abs() < 2e-3), "splat {i}");
            let direction = [0.6, -0.8, 0.0];
            let (found, expected) = (back.splats.radiance(i, direction), splats.radiance(i, direction));
            errors += (0..3).map(|c| (found[c] - expected[c]).abs()).sum::<f32>() / (3 * splats.len()) as f32;
            assert!((sigmoid(back.splats.opacity_logit[i]) - sigmoid(splats.opacity_logit[i])).abs() < 0.003);
        }
        // A step of 8 bits, but for harmonics that share a palette's row with seven others.
        assert!(errors < if degree == 0 { 0.004 } else { 0.03 }, "{degree}: {errors}");
    }
}

#[test]
fn damaged_files_are_errors() {
    let bytes = encode_sog(Path::new("a.sog"), &baked(40, 1)).unwrap();
    let error = |bytes: &[u8]| decode_sog(Path::new("a.sog"), bytes).unwrap_err().message;
    assert!(error(&bytes[..bytes.len() - 1]).contains("no directory"));
    let changed = |from: &[u8], to: &[u8]| {
        let at = bytes.windows(from.len()).position(|part| part == from).unwrap();
        [&bytes[..at], to, &bytes[at + from.len()..]].concat()
    };
    assert!(error(&changed(b"\"count\":40", b"\"count\":41")).contains("checksum"));
    let archive_of = |meta: &str| archive::archive(&[archive::File { name: "meta.json", bytes: meta.into() }]).unwrap();
    assert!(error(&archive_of("{\"version\": 2}")).contains("no \"count\""));
    assert!(error(&archive_of("{\"version\": 3, \"count\": 1}")).contains("SOG version 3"));
    assert!(error(&archive_of("{")).contains("meta.json"));
    let means = "{\"version\": 2, \"count\": 1, \"means\": {\"mins\": [0,0,0], \"maxs\": [1,1,1], \"files\": [\"a\", \"b\"]}, \"scales\": \
                 {\"codebook\": [], \"files\": [\"c\"]}, \"quats\": {\"files\": [\"d\"]}, \"sh0\": {\"codebook\": [], \"files\": [\"e\"]}}";
    assert!(error(&archive_of(means)).contains("no file \"a\""));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.sog");
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(crate::read_scene_file(&path).unwrap().scene.splats.len(), 40);
}

#[test]
fn linear_bakes_and_empty_scenes_are_refused() {
    let mut baked = baked(3, 0);
    let meta = files(&encode_sog(Path::new("a.sog"), &baked).unwrap())[0].1.clone();
    assert!(!String::from_utf8(meta).unwrap().contains("shN"));
    let appearance = Appearance::Linear { color_space: baked.scene.color_space, exposure_ev: 0.0 };
    let error = encode_sog(Path::new("a.sog"), &Baked { appearance, ..baked.clone() }).unwrap_err();
    assert!(error.to_string().contains("bake for a display"), "{error}");
    baked.scene.splats = baked.scene.splats.select([]);
    assert!(encode_sog(Path::new("a.sog"), &baked).unwrap_err().to_string().contains("no splats"));
}

#[test]
fn a_codebook_has_the_numbers_that_there_are_or_comes_near_them() {
    let few = Codebook::new([3.0, 1.0, 2.0, 1.0].into_iter());
    assert_eq!([1.0, 2.0, 3.0].map(|v| few.0[usize::from(few.nearest(v))]), [1.0, 2.0, 3.0]);
    let values: Vec<f32> = (0..10_000).map(|i| (i as f32 / 10_000.0).powi(3)).collect();
    let many = Codebook::new(values.iter().copied());
    let error = values.iter().map(|v| (many.0[usize::from(many.nearest(*v))] - v).powi(2)).sum::<f32>() / 10_000.0;
    assert!(error.sqrt() < 0.5 / 256.0, "{error}");
}

#[test]
fn a_palette_has_the_rows_that_there_are() {
    // Sixteen different rows, each many times.
    let rows: Vec<f32> = (0..4096)
        .flat_map(|i| {
            let n = (i * 7 % 16) as f32;
            [n, -n, 0.5 * n]
        })
        .collect();
    let palette = Palette::new(&rows, 3);
    let worst =
        rows.chunks(3).zip(&palette.labels).map(|(row, label)| (palette.rows[usize::from(*label) * 3] - row[0]).abs()).fold(0.0, f32::max);
    assert!(worst < 0.5, "{worst}");
}

#[test]
fn the_model_of_the_splats_is_read_by_both_of_its_names() {
    let found = files(&encode_sog(Path::new("a.sog"), &baked(40, 0)).unwrap());
    let with = |more: &str| {
        let pack = |(name, bytes): &(String, Vec<u8>)| {
            let bytes = match name.as_str() {
                "meta.json" => String::from_utf8(bytes.clone()).unwrap().replacen('{', &format!("{{{more},"), 1).into_bytes(),
                _ => bytes.clone(),
            };
            archive::File { name: name.clone().leak(), bytes }
        };
        decode(Input::new("a.sog", &archive::archive(&found.iter().map(pack).collect::<Vec<_>>()).unwrap())).unwrap()
    };
    for (stated, expected) in
        [("\"antialias\":true", Antialias::Mip), ("\"model\":\"antialiased\"", Antialias::Mip), ("\"model\":\"default\"", Antialias::Off)]
    {
        let file = with(stated);
        assert_eq!((file.scene.raster.antialias, file.warnings.len()), (expected, 0), "{stated}");
    }
    let flat = with("\"model\":\"2dgs\"");
    assert!(flat.warnings[0].contains("flat splats of 2DGS"), "{:?}", flat.warnings);
    assert!(flat.scene.splats.log_scale.iter().all(|[a, b, c]| (c - a.min(*b) + 1000f32.ln()).abs() < 1e-5));
}
