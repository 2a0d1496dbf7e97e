//! The display layer: what other viewers show.

use super::*;

/// Returns the display colour of a row towards `direction`, as a viewer computes it but unclamped.
fn display_color(row: &HashMap<String, f32>, direction: [f32; 3]) -> [f32; 3] {
    let rest = row.keys().filter(|k| k.starts_with("f_rest_")).count() / 3;
    let mut y = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(3, direction, &mut y);
    [0, 1, 2].map(|c| {
        let higher: f32 = (0..rest).map(|m| row[&format!("f_rest_{}", c * rest + m)] * y[m + 1]).sum();
        SH_OFFSET + y[0] * row[&format!("f_dc_{c}")] + higher
    })
}

fn unit(seed: u64, index: u64) -> [f32; 3] {
    let v = random::standard_normal(seed, index);
    let n = v.iter().map(|c| c * c).sum::<f32>().sqrt();
    v.map(|c| c / n)
}

#[test]
fn baked_colours_are_never_negative() {
    for model in [LCD, ColorModel::Sh { degree: 4 }, ColorModel::Lcd { chroma_degree: 2, luminance_degree: 3, activation: Activation::Exp }]
    {
        let bytes = encode_scene_ply(name(), &scene(model, 40, false, 11)).unwrap();
        for splat in 0..40 {
            let row = row_of(&bytes, splat);
            for i in 0..1000 {
                let color = display_color(&row, unit(13, i));
                assert!(color.iter().all(|c| *c > -1e-5), "splat {splat} of {}: {color:?}", model.name());
            }
        }
    }
}

#[test]
fn bake_of_a_constant_grey_scene_is_middle_grey_whatever_its_radiance() {
    for radiance in [1e-4, 0.3, 1e4] {
        let (dc, raw) = LCD.constant([radiance; 3]);
        let mut scene = scene(LCD, 10, false, 2);
        scene.color_space = ColorSpace::LinearRec709;
        for splat in scene.splats.sh.chunks_exact_mut(3 * LCD.sh_coefficients()) {
            splat.fill(0.0);
            splat[..3].copy_from_slice(&dc);
        }
        scene.splats.raw_luminance.fill(raw);
        let row = row_of(&encode_scene_ply(name(), &scene).unwrap(), 4);
        let color = display_color(&row, [0.0, 0.6, 0.8]);
        // AgX has its pivot there: half of the encoded range.
        assert!(color.iter().all(|c| (c - 0.5).abs() < 0.005), "{radiance}: {color:?}");
    }
}

#[test]
fn bake_follows_the_tone_mapped_radiance() {
    // Smooth view dependence (degree 1 in both parts) survives the fit of degree 1 under the curve
    // within a few 8-bit steps.
    let model = ColorModel::Lcd { chroma_degree: 1, luminance_degree: 1, activation: Activation::Softplus };
    let mut scene = scene(model, 30, false, 21);
    scene.color_space = ColorSpace::LinearRec709;
    let k = 3 * model.sh_coefficients();
    for splat in scene.splats.sh.chunks_exact_mut(k) {
        splat[..3].iter_mut().for_each(|v| *v = 1.0 + 0.2 * *v);
        splat[3..].iter_mut().for_each(|v| *v *= 0.2);
    }
    let bytes = encode_scene_ply(name(), &scene).unwrap();
    let mut brightest = [0f32; 2];
    for i in 0..30 {
        let row = row_of(&bytes, i);
        for d in 0..50 {
            let direction = unit(3, d);
            let (radiance, color) = (scene.splats.radiance(i, direction), display_color(&row, direction));
            if radiance[1] > brightest[0] {
                brightest = [radiance[1], color[1]];
            }
            // A channel that is brighter in radiance by far is not darker on the screen.
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                assert!(radiance[a] < 1.5 * radiance[b] || color[a] > color[b] - 0.02, "splat {i}: {radiance:?} shown as {color:?}");
            }
        }
    }
    assert!(brightest[1] > 0.7, "{brightest:?}");
}

#[test]
fn smoothing_is_applied_to_the_standard_scale_and_opacity_only() {
    let mut scene = scene(LCD, 1, true, 7);
    scene.splats.log_scale[0] = [0.1f32.ln(), 0.2f32.ln(), 0.01f32.ln()];
    scene.splats.opacity_logit[0] = 1.5;
    scene.splats.smoothing[0] = 0.05;
    let bytes = encode_scene_ply(name(), &scene).unwrap();
    let row = row_of(&bytes, 0);
    let widened = |s: f32| (s * s + 0.0025).sqrt();
    let expected = [0.1, 0.2, 0.01].map(|s| widened(s).ln());
    for (i, expected) in expected.into_iter().enumerate() {
        assert!((row[&format!("scale_{i}")] - expected).abs() < 1e-5);
    }
    let ratio = 0.1 * 0.2 * 0.01 / (widened(0.1) * widened(0.2) * widened(0.01));
    assert!((sigmoid(row["opacity"]) - sigmoid(1.5) * ratio).abs() < 1e-5);
    assert_eq!(decode_scene_ply(name(), &bytes).unwrap(), scene);
}

#[test]
fn a_bake_of_other_geometry_is_what_is_shown_and_the_model_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for is_smoothed in [false, true] {
        let scene = scene(LCD, 5, is_smoothed, 8);
        let mut baked = Baked::new(&scene, &BakeOptions { appearance: Appearance::PREVIEW, max_degree: 3 });
        baked.scene.splats.log_scale[2] = [-1.0, -2.0, -3.0];
        baked.scene.splats.opacity_logit[2] = 0.75;
        write_exact_ply(&path, &scene, &baked).unwrap();
        let row = row_of(&std::fs::read(&path).unwrap(), 2);
        assert_eq!(["opacity", "scale_0", "scale_1", "scale_2"].map(|name| row[name]), [0.75, -1.0, -2.0, -3.0]);
        assert_eq!(read_scene_ply(&path).unwrap(), scene);
    }
}

#[test]
fn gains_of_edits_are_beside_the_model_and_in_the_light_of_the_display_layer() {
    let plain = scene(ColorModel::Sh { degree: 2 }, 5, false, 7);
    let mut edited = plain.clone();
    edited.splats.gain = vec![1.0, 4.0, 0.25, 0.0, 1.0];
    let version = |scene: &Scene| {
        let bytes = encode_scene_ply(name(), scene).unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        (bytes, text.lines().find_map(|line| line.strip_prefix("comment luxel scene ")).unwrap().to_owned())
    };
    let ((bytes, new), (before, old)) = (version(&edited), version(&plain));
    assert_eq!((new.as_str(), old.as_str()), ("2", "1"));
    for row in 0..5 {
        let (after, before) = (row_of(&bytes, row), row_of(&before, row));
        assert!(!before.contains_key("lcd_gain"));
        assert_eq!(after["lcd_gain"], edited.splats.gain[row]);
        assert_eq!((after["lcd_s_0"], after["opacity"]), (before["lcd_s_0"], before["opacity"]));
    }
    // Black in the display layer.
    let black = row_of(&bytes, 3);
    assert!((SH_OFFSET + sh::C0 * black["f_dc_0"]).abs() < 1e-3, "{}", black["f_dc_0"]);
    let mut damaged = bytes.clone();
    let (names, _) = plain_view(&bytes);
    let end = damaged.len();
    let at = end - 4 * (names.len() - names.iter().position(|name| name == "lcd_gain").unwrap());
    damaged[at..at + 4].copy_from_slice(&(-2.0f32).to_le_bytes());
    let error = decode_scene_ply(name(), &damaged).unwrap_err().to_string();
    assert!(error.contains("vertex 4: property \"lcd_gain\" is -2, expected a gain of 0 or more"), "{error}");
}

#[test]
fn bakes_alone_read_back_as_what_they_are() {
    let scene = scene(LCD, 9, true, 5);
    for appearance in [Appearance::PREVIEW, Appearance::Linear { color_space: ColorSpace::LinearRec2020, exposure_ev: 1.0 }] {
        let mut baked = Baked::new(&scene, &BakeOptions { appearance, max_degree: 2 });
        let bytes = encode_baked_ply(name(), &baked).unwrap();
        assert_eq!(decode_scene_ply(name(), &bytes).unwrap(), baked.scene);
        let header = String::from_utf8_lossy(&bytes[..600]).into_owned();
        assert!(header.contains("comment luxel baked {\"version\":1"), "{header}");
        // In the file's own world, and out of it again.
        let turn = glam::DMat3::from_cols(glam::DVec3::X, glam::DVec3::NEG_Y, glam::DVec3::NEG_Z);
        let before = baked.scene.splats.position.clone();
        baked.transform(&luxel_core::Similarity::turn(turn).unwrap());
        let bytes = encode_baked_ply(name(), &baked).unwrap();
        assert_eq!(decode_scene_ply(name(), &bytes).unwrap().splats.position, before);
    }
}

#[test]
fn an_exact_file_with_a_bake_of_choice_reads_back_to_the_bit() {
    let mut scene = scene(LCD, 9, true, 5);
    let appearance = Appearance::Display { tonemap: luxel_core::tone::Tonemap::Reinhard, exposure_ev: -1.0 };
    let mut baked = Baked::new(&scene, &BakeOptions { appearance, max_degree: 1 });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    write_exact_ply(&path, &scene, &baked).unwrap();
    assert_eq!(crate::read_scene(&path).unwrap(), scene);
    let bytes = std::fs::read(&path).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    let (header, _) = text.split_once("end_header\n").unwrap();
    assert!(header.contains("curve reinhard") && header.contains("f_rest_8\n") && !header.contains("f_rest_9\n"), "{header}");
    // A world so small that the data set's has no numbers for it.
    baked.file_from_world = luxel_core::Similarity::new(glam::DMat3::IDENTITY, 1.2e-38, glam::DVec3::ZERO).unwrap();
    scene.splats.position[7] = [9.0; 3];
    write_exact_ply(&path, &scene, &baked).unwrap();
    let error = crate::read_scene(&path).unwrap_err();
    assert!(error.message.contains("in the world of the data set") && error.kind == IoErrorKind::Invalid, "{error}");
}
