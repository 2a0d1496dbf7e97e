//! Files of other programs.

use super::*;

#[test]
fn plain_files_of_all_formats_orders_and_types_are_read_alike() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let read = decode_scene_ply(name(), &plain_file(format)).unwrap_or_else(|e| panic!("{format}: {e}"));
        assert_eq!(
            (read.radiance_scale, read.raster),
            (RadianceScale::ONE, RasterConfig { cutoffs: Cutoffs::PARITY, antialias: Antialias::Off, ..RasterConfig::default() })
        );
        let s = &read.splats;
        assert_eq!((s.color_model, s.len()), (ColorModel::Sh { degree: 1 }, 2));
        assert_eq!(s.position, [[14.0, 13.0, 12.0], [114.0, 113.0, 112.0]], "{format}");
        assert_eq!(s.rotation[0], [9.0, 10.0, 11.0, 1.0]);
        assert_eq!((s.log_scale[1], s.opacity_logit[1]), ([105.0, 104.0, 103.0], 102.0));
        // f_rest_i is 23 - i; the file is channel-major: channel c's coefficient m is f_rest_{3 c +
        // m - 1}.
        assert_eq!(s.sh_of(0), [8.0, 7.0, 6.0, 23.0, 20.0, 17.0, 22.0, 19.0, 16.0, 21.0, 18.0, 15.0]);
        assert_eq!(s.validate(), Ok(()));
    }
}

#[test]
fn mip_splatting_filter_is_honoured() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let text = text.replace("property uchar flag", "property float filter_3D");
    let read = decode_scene_ply(name(), text.as_bytes()).unwrap();
    assert_eq!(read.splats.smoothing, [0.0, 100.0]);
    assert_eq!(read.raster.antialias, Antialias::Mip);
}

#[test]
fn rows_with_a_number_that_is_not_finite_are_left_out_and_counted() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let whole = decode_scene_ply(name(), text.as_bytes()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for (from, to) in [(" 102 ", " nan "), (" 114 ", " 1e99 ")] {
        assert!(text.contains(from));
        std::fs::write(&path, text.replace(from, to)).unwrap();
        let file = crate::read_scene_file(&path).unwrap();
        let kept = (0..whole.splats.len() as u32).filter(|i| *i != 1);
        assert_eq!(file.scene.splats, whole.splats.select(kept));
        assert_eq!(file.warnings, [format!("left out, with a number that is NaN or infinite: 1 of {} splats", whole.splats.len())]);
    }
}

#[test]
fn rows_without_a_rotation_are_left_out_and_most_of_a_file_is_said() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let whole = decode_scene_ply(name(), text.as_bytes()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        crate::read_scene_file(&path)
    };
    let damaged = text.replace(" 109 110 111 ", " 0 0 0 ").replace("100 101 ", "100 0 ");
    let file = read(&damaged).unwrap();
    assert_eq!(file.scene.splats, whole.splats.select((0..whole.splats.len() as u32).filter(|i| *i != 1)));
    assert!(file.warnings[0].contains("no quaternion") && file.warnings[0].ends_with(&format!("1 of {} splats", whole.splats.len())));
    // Rows of zeros behind, as an allocation that was not filled leaves them.
    let (count, columns) = (whole.splats.len(), text.lines().filter(|line| line.starts_with("property")).count());
    let zeros = format!("{}\n", vec!["0"; columns].join(" ")).repeat(9);
    let padded = text.replace(&format!("element vertex {count}"), &format!("element vertex {}", count + 9)) + &zeros;
    let file = read(&padded).unwrap();
    assert_eq!(file.scene.splats, whole.splats);
    assert!(file.warnings[0].contains("padded?"), "{:?}", file.warnings);
}

#[test]
fn colours_of_points_and_comments_of_anti_aliasing_are_read() {
    let geometry = "x y z opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let file = |comment: &str, kind: &str, row: &str| {
        let floats: String = geometry.split(' ').map(|n| format!("property float {n}\n")).collect();
        let colors: String = ["red", "green", "blue"].map(|n| format!("property {kind} {n}\n")).concat();
        let head = format!("ply\nformat ascii 1.0\n{comment}element vertex 1\n{floats}{colors}end_header\n");
        decode_scene_ply(name(), format!("{head}0 0 0 0 0 0 0 1 0 0 0 {row}\n").as_bytes()).unwrap()
    };
    for (kind, row) in [("uchar", "255 0 51"), ("float", "1 0 0.2")] {
        let scene = file("", kind, row);
        let color = scene.splats.radiance(0, [0.0, 0.0, 1.0]);
        assert!(color.iter().zip([1.0, 0.0, 0.2]).all(|(a, b)| (a - b).abs() < 1e-5), "{color:?}");
        assert_eq!((scene.color_space, scene.raster.antialias), (ColorSpace::DisplaySrgb, Antialias::Off));
    }
    for comment in ["comment SplatRenderMode: mip\n", "comment antialiased 1\n"] {
        assert_eq!(file(comment, "uchar", "1 2 3").raster.antialias, Antialias::Mip, "{comment}");
    }
    for comment in ["comment antialiased 0\n", "comment antialiased 1\ncomment SplatRenderMode: default\n"] {
        assert_eq!(file(comment, "uchar", "1 2 3").raster.antialias, Antialias::Off, "{comment}");
    }
}

#[test]
fn bytes_behind_the_last_row_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for format in ["ascii", "binary_little_endian"] {
        let mut file = plain_file(format);
        let rows = decode_scene_ply(name(), &file).unwrap().splats.len();
        file.extend_from_slice(b"\n");
        std::fs::write(&path, &file).unwrap();
        assert_eq!(crate::read_scene_file(&path).unwrap().warnings, [""; 0]);
        file.resize(file.len() + 99, b'1');
        std::fs::write(&path, &file).unwrap();
        let warnings = crate::read_scene_file(&path).unwrap().warnings;
        let expected = format!("left out, behind the {rows} rows of \"vertex\" that the header counts: 100 bytes; is that number right?");
        assert_eq!(warnings, [expected]);
    }
}

#[test]
fn flat_splats_of_2dgs_are_read_as_thin_ones() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    // The property of that place is another program's.
    let without = text.replace("scale_2", "area");
    let stated = text.replace("comment made elsewhere", "comment SplatRenderMode: 2dgs");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    for flat in [without, stated] {
        assert_ne!(flat, text);
        std::fs::write(&path, &flat).unwrap();
        let file = crate::read_scene_file(&path).unwrap();
        for [a, b, c] in &file.scene.splats.log_scale {
            assert!((c - (a.min(*b) - 1000f32.ln())).abs() < 1e-3, "{a} {b} {c}");
        }
        assert!(file.warnings[0].contains("flat splats of 2DGS"), "{:?}", file.warnings);
    }
    assert!(error_of(text.replace("scale_1", "area").as_bytes()).contains("no property \"scale_1\""));
}

#[test]
fn a_byte_order_mark_is_left_out() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let marked = format!("\u{feff}{text}");
    assert_eq!(decode_scene_ply(name(), marked.as_bytes()).unwrap(), decode_scene_ply(name(), text.as_bytes()).unwrap());
}

#[test]
fn points_carry_positions_and_colours_of_any_type() {
    let file = |colors: &str, row: &str| {
        format!("ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty float y\nproperty int z\n{colors}end_header\n{row}\n")
    };
    let rgb = |kind: &str| ["red", "green", "blue"].map(|c| format!("property {kind} {c}\n")).concat();
    let read = |colors: &str, row: &str| decode_points_ply(name(), file(colors, row).as_bytes()).unwrap().points;
    assert_eq!(read("", "1.5 2 -3"), [([1.5, 2.0, -3.0], None)]);
    assert_eq!(read(&rgb("uchar"), "1 2 3 4 5 255"), [([1.0, 2.0, 3.0], Some([4, 5, 255]))]);
    assert_eq!(read(&rgb("float"), "1 2 3 0 0.5 1"), [([1.0, 2.0, 3.0], Some([0, 128, 255]))]);
    assert_eq!(read(&rgb("ushort"), "1 2 3 0 32896 65535"), [([1.0, 2.0, 3.0], Some([0, 128, 255]))]);
    let error = decode_points_ply(name(), file("", "1 inf 3").as_bytes()).unwrap_err().to_string();
    assert_eq!(error, "scene.ply: vertex 0: property \"y\" is inf, expected a finite number");
}

#[test]
fn infinite_opacities_of_other_programs_are_bounded() {
    let names =
        ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let properties: String = names.map(|n| format!("property float {n}\n")).concat();
    let file = |opacity: &str| {
        let head = format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n");
        decode_scene_ply(name(), format!("{head}0 0 0 0 0 0 {opacity} 0 0 0 1 0 0 0\n").as_bytes())
    };
    assert!(sigmoid(file("inf").unwrap().splats.opacity_logit[0]) > 0.99999);
    assert!(sigmoid(file("-inf").unwrap().splats.opacity_logit[0]) < 0.00001);
    assert!(file("nan").unwrap_err().to_string().contains("\"opacity\" is NaN"));
}

#[test]
fn lengths_in_the_place_of_logarithms_are_warned_of() {
    let names =
        ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let properties: String = names.map(|name| format!("property float {name}\n")).concat();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let warnings = |count: usize, numbers: &str| {
        let rows = format!("0 0 0 1 1 1 {numbers} 1 0 0 0\n").repeat(count);
        std::fs::write(&path, format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n{rows}")).unwrap();
        crate::read_scene_file(&path).unwrap().warnings
    };
    assert!(warnings(100, "0.9 0.01 0.02 0.03")[0].contains("if they are lengths and opacities"));
    for (count, numbers) in [(99, "0.9 0.01 0.02 0.03"), (100, "0.9 -0.01 0.02 0.03"), (100, "2 0.01 0.02 0.03")] {
        assert_eq!(warnings(count, numbers), [""; 0], "{numbers}");
    }
}
