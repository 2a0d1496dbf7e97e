//! Tests of packed files.

use std::path::Path;

use luxel_core::{Antialias, ColorModel};
use proptest::prelude::*;

use crate::decode_scene_ply;

fn name() -> &'static Path {
    Path::new("scene.ply")
}

/// Returns two splats as PlayCanvas packs them, in text; `more` goes behind the vertices' element.
fn compressed(more: &str, rows: &str) -> String {
    let bounds = ["min_x", "min_y", "min_z", "max_x", "max_y", "max_z"].map(str::to_owned);
    let scales = ["min", "max"].iter().flat_map(|e| ["x", "y", "z"].map(|a| format!("{e}_scale_{a}")));
    let colors = ["min", "max"].iter().flat_map(|e| ["r", "g", "b"].map(|a| format!("{e}_{a}")));
    let chunk: String = bounds.into_iter().chain(scales).chain(colors).map(|n| format!("property float {n}\n")).collect();
    let packed: String = ["position", "rotation", "scale", "color"].map(|n| format!("property uint packed_{n}\n")).concat();
    format!(
        "ply\nformat ascii 1.0\nelement chunk 1\n{chunk}element vertex 2\n{packed}{more}end_header\n\
         -1 -2 -3 1 2 3 -6 -6 -6 0 0 0 0 0 0 2 1 1\n{rows}"
    )
}

/// All bits: the upper ends, the rotation's last component largest; none: the lower ends, its
/// first.
const PACKED_ROWS: &str = "4294967295 3757571583 4294967295 4294967295\n0 537395712 0 0\n";

#[test]
fn compressed_files_are_unpacked() {
    let scene = decode_scene_ply(name(), compressed("", PACKED_ROWS).as_bytes()).unwrap();
    let splats = &scene.splats;
    assert_eq!((splats.position[0], splats.position[1]), ([1.0, 2.0, 3.0], [-1.0, -2.0, -3.0]));
    assert_eq!((splats.log_scale[0], splats.log_scale[1]), ([0.0; 3], [-6.0; 3]));
    assert!(splats.opacity_logit[0] > 13.0 && splats.opacity_logit[1] < -13.0);
    let color = splats.radiance(0, [0.0, 0.0, 1.0]);
    assert!((color[0] - 2.0).abs() < 1e-5 && (color[1] - 1.0).abs() < 1e-5, "{color:?}");
    assert_eq!(splats.radiance(1, [0.0, 0.0, 1.0]), [0.0; 3]);
    assert!(splats.rotation[1][0] > 0.99, "{:?}", splats.rotation[1]);
    splats.validate().unwrap();

    let sh: String = (0..9).map(|i| format!("property uchar f_rest_{i}\n")).collect();
    let rows = format!("{PACKED_ROWS}0 255 128 0 0 0 0 0 0\n128 128 128 128 128 128 128 128 128\n");
    let scene = decode_scene_ply(name(), compressed(&format!("element sh 2\n{sh}"), &rows).as_bytes()).unwrap();
    assert_eq!(scene.splats.color_model, ColorModel::Sh { degree: 1 });
    // Channel-major in the file: red's three come first.
    let red: Vec<f32> = scene.splats.sh_of(0)[3..].iter().step_by(3).copied().collect();
    assert_eq!((red[0], red[1]), (-4.0, 4.0));
    assert!(red[2].abs() < 0.02);
}

#[test]
fn comments_state_the_model_of_compressed_files_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let read = |comment: &str| {
        std::fs::write(&path, compressed("", PACKED_ROWS).replace("ply\n", &format!("ply\n{comment}"))).unwrap();
        crate::read_scene_file(&path).unwrap()
    };
    assert_eq!(read("comment SplatRenderMode: mip\n").scene.raster.antialias, Antialias::Mip);
    let flat = read("comment SplatRenderMode: 2dgs\n");
    assert!(flat.warnings[0].contains("flat splats of 2DGS"), "{:?}", flat.warnings);
    assert!(flat.scene.splats.log_scale[0][2] < -6.9 && flat.scene.splats.log_scale[0][..2] == [0.0; 2]);
}

#[test]
fn damaged_compressed_files_are_refused() {
    let whole = compressed("", PACKED_ROWS);
    for (from, to, part) in [
        ("property uint packed_scale", "property float packed_scale", "expected U32"),
        ("property float max_scale_z\n", "", "no property \"max_scale_z\""),
        ("element chunk 1", "element chunk 0", "0 chunks for 2 splats"),
        ("element vertex 2", "element vertex 3", "file ends"),
        ("element chunk 1", "element other 1", "comes before the splats"),
        ("4294967295 3757571583", "x 3757571583", "expected a number"),
    ] {
        assert_ne!(whole.replace(from, to), whole, "{from}");
        let error = decode_scene_ply(name(), whole.replace(from, to).as_bytes()).unwrap_err().to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn any_damage_to_a_compressed_file_is_an_error_or_a_valid_scene(at: prop::sample::Index, byte: u8) {
        let mut bytes = compressed("", PACKED_ROWS).into_bytes();
        let at = at.index(bytes.len());
        bytes[at] = byte;
        if let Ok(scene) = decode_scene_ply(name(), &bytes) {
            prop_assert_eq!(scene.splats.validate(), Ok(()));
        }
    }
}
