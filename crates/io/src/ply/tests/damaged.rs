//! Files that are refused, and the words for it.

use super::*;

#[test]
fn files_cut_anywhere_are_refused() {
    let files = [encode_scene_ply(name(), &scene(LCD, 2, true, 1)).unwrap(), plain_file("binary_big_endian"), plain_file("ascii")];
    for (kind, file) in files.iter().enumerate() {
        // Text may lose the end of its last number unnoticed.
        let whole = if kind == 2 { file.len() - 5 } else { file.len() };
        for length in 0..whole {
            assert!(decode_scene_ply(name(), &file[..length]).is_err(), "file {kind} cut at byte {length}");
        }
    }
    let file = &files[0];
    assert!(error_of(&file[..file.len() - 1]).contains("vertex 1: file ends at byte"), "{}", error_of(&file[..file.len() - 1]));
}

#[test]
fn absurd_counts_are_refused_without_allocating() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let text = format!("ply\nformat {format} 1.0\nelement vertex {}\n", 1_000_000);
        let plain =
            ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "f_dc_0", "f_dc_1", "f_dc_2"];
        let properties: String = plain.iter().map(|p| format!("property float {p}\n")).collect();
        let file = text.clone() + &properties + "end_header\n0 0 0\n";
        let error = error_of(file.as_bytes());
        assert!(error.contains("expected 1000000 rows"), "{error}");
        assert!(decode_points_ply(name(), file.as_bytes()).is_err());
        // The same claim for an element on the way, with and without lists.
        for way in ["property float a", "property list int double a", ""] {
            let file = format!("ply\nformat {format} 1.0\nelement face {}\n{way}\nelement vertex 1\n{properties}end_header\n", 1_000_000);
            assert!(decode_scene_ply(name(), file.as_bytes()).is_err());
        }
    }
}

#[test]
fn errors_name_vertex_property_and_remedy() {
    let text = String::from_utf8(plain_file("ascii")).unwrap();
    let broken = |from: &str, to: &str| {
        assert!(text.contains(from), "{from:?} is not in the file");
        error_of(text.replace(from, to).as_bytes())
    };
    assert_eq!(broken(" 114 ", " abc "), "scene.ply: vertex 1: property \"x\" is \"abc\", expected a number");
    assert!(broken("f_rest_8", "f_rust_8").contains("8 properties f_rest_*, expected 0, 9, 24"));
    assert!(broken("float opacity", "float opacities").contains("no property \"opacity\""));
    assert!(broken("ply\r\n", "plx\r\n").contains("not a PLY file"));
    assert!(broken("ascii 1.0", "ascii 2.0").contains("line 2: format \"ascii 2.0\", expected"));
    assert!(broken("float opacity", "half opacity").contains("unknown type \"half\""));
    assert!(broken("element vertex", "element vortex").contains("no element \"vertex\""));
    assert!(broken("float opacity", "list uchar float opacity").contains("property \"opacity\" is a list"));
}

#[test]
fn damaged_comments_are_refused_rather_than_the_bake_taken_for_radiance() {
    let file = encode_scene_ply(name(), &scene(LCD, 0, false, 1)).unwrap();
    let text = String::from_utf8(file).unwrap();
    let broken = |from: &str, to: &str| {
        assert!(text.contains(from), "{from:?} is not in the file");
        decode_scene_ply(name(), text.replace(from, to).as_bytes()).unwrap_err()
    };
    assert!(broken("comment luxel", "comment luxury").to_string().contains("a tool dropped them"));
    assert_eq!(broken("luxel scene 1", "luxel scene 3").kind, IoErrorKind::Unsupported);
    for (from, to) in [
        ("luxel scene 1", "luxel scene one"),
        ("acescg", "srgb"),
        ("\"chroma_degree\":3", "\"chroma_degree\":9"),
        ("luxel color_model", "luxel colour_model"),
        ("radiance_scale 1", "radiance_scale -1"),
        ("\"antialias\":\"off\"", "\"antialias\":\"on\""),
        ("\"near\":0.01", "\"near\":-3"),
        ("property float lcd_c_7\n", ""),
    ] {
        assert_eq!(broken(from, to).kind, IoErrorKind::Invalid, "{from} -> {to}");
    }
}

#[test]
fn scenes_that_could_not_be_read_back_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("point_cloud/iteration_7/point_cloud.ply");
    let good = scene(LCD, 3, false, 1);
    write_scene_ply(&path, &good).unwrap();
    let broken: [fn(&mut Scene); 7] = [
        |s| s.splats.rotation[1] = [0.0; 4],
        |s| s.splats.sh[5] = f32::NAN,
        |s| s.splats.opacity_logit.truncate(2),
        |s| s.splats.smoothing = vec![-1.0; 3],
        |s| s.splats.gain = vec![1.0, -1.0, 1.0],
        |s| s.splats.gain = vec![2.0; 2],
        |s| s.raster.cutoffs.near = f32::NAN,
    ];
    for break_it in broken {
        let mut scene = good.clone();
        break_it(&mut scene);
        assert!(write_scene_ply(&path, &scene).is_err());
    }
    assert_eq!(read_scene_ply(&path).unwrap(), good);
    assert_eq!(read_scene_ply(folder.path()).unwrap_err().kind, IoErrorKind::Invalid);
    assert_eq!(read_scene_ply(&folder.path().join("absent.ply")).unwrap_err().kind, IoErrorKind::System);
}
