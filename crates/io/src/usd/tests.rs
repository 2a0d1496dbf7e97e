mod camera_layers;
mod gains;
mod lights;
mod shown;

use std::path::Path;

use luxel_core::{ColorModel, RadianceScale, RasterConfig, Scene, Similarity, synthetic};
use proptest::prelude::*;

use super::*;
use crate::bake::{Appearance, BakeOptions, Baked};
use crate::input::Input;

fn name() -> &'static Path {
    Path::new("scene.usda")
}

fn baked(color_space: ColorSpace) -> Baked {
    let scene = Scene {
        splats: synthetic::room(30, 9),
        radiance_scale: RadianceScale::new(300.0).unwrap(),
        color_space: ColorSpace::LinearRec709,
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: None,
    };
    Baked::new(&scene, &BakeOptions { appearance: Appearance::Linear { color_space, exposure_ev: 0.0 }, max_degree: 3 })
}

#[test]
fn radiance_reads_back_to_the_bit() {
    for space in ColorSpace::ALL {
        let baked = baked(space);
        let bytes = encode_usda(name(), &baked).unwrap();
        let back = decode_usda(name(), &bytes).unwrap();
        assert_eq!((back.color_space, back.raster, back.radiance_scale), (space, baked.scene.raster, RadianceScale::ONE));
        assert_eq!((&back.splats.sh, &back.splats.position), (&baked.scene.splats.sh, &baked.scene.splats.position));
        for (a, b) in back.splats.log_scale.as_flattened().iter().zip(baked.scene.splats.log_scale.as_flattened()) {
            assert!((a - b).abs() < 1e-5);
        }
        for (a, b) in back.splats.opacity_logit.iter().zip(&baked.scene.splats.opacity_logit) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }
}

#[test]
fn the_binary_form_holds_what_text_holds() {
    for space in [ColorSpace::AcesCg, ColorSpace::LinearRec709] {
        let mut baked = baked(space);
        baked.scene.world_from_local = Similarity::new(glam::DMat3::IDENTITY, 1.0, glam::DVec3::new(4e5, -1.5, 3e6)).unwrap();
        let text = decode_usda(name(), &encode_usda(name(), &baked).unwrap()).unwrap();
        let bytes = encode_usdc(name(), &baked).unwrap();
        assert_eq!(decode_usdc(name(), &bytes).unwrap(), text);
        assert_eq!(encode_usdc(name(), &baked).unwrap(), bytes);
    }
    let empty = Baked {
        scene: Scene { splats: luxel_core::Splats::empty(ColorModel::Sh { degree: 3 }), ..baked(ColorSpace::AcesCg).scene },
        ..baked(ColorSpace::AcesCg)
    };
    assert!(decode_usdc(name(), &encode_usdc(name(), &empty).unwrap()).unwrap().splats.is_empty());
}

#[test]
fn a_package_holds_the_binary_form_at_a_multiple_of_64() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.usdz");
    let baked = baked(ColorSpace::AcesCg);
    write_usdz(&path, &baked, None, None).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let layer = encode_usdc(name(), &baked).unwrap();
    let at = bytes.windows(8).position(|window| window == BINARY_MAGIC).unwrap();
    assert!(at.is_multiple_of(64) && bytes[at..].starts_with(&layer));
    let scene = crate::read_scene(&path).unwrap();
    assert_eq!(scene, decode_usdc(name(), &layer).unwrap());
}

/// Bytes that `usd-core` 26.11 made of [`FOREIGN`] by `Sdf.Layer.Export`, and of the same with
/// float arrays that it compresses.
const FOREIGN_BINARY: [&str; 2] = [include_str!("tests/foreign.hex"), include_str!("tests/compressed.hex")];

fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

#[test]
fn binary_files_of_other_programs_are_read() {
    let [foreign, compressed] = FOREIGN_BINARY.map(unhex);
    assert_eq!(decode_usdc(name(), &foreign).unwrap(), decode_usda(name(), FOREIGN.as_bytes()).unwrap());
    let scene = decode_usdc(name(), &compressed).unwrap();
    let opacities: Vec<f32> = scene.splats.opacity_logit.iter().map(|o| luxel_core::sigmoid(*o)).collect();
    assert!((opacities[0] - 0.25).abs() < 1e-6 && (opacities[39] - 0.75).abs() < 1e-6, "{opacities:?}");
    assert_eq!((scene.splats.len(), scene.splats.position[39]), (40, [39.0, 0.0, 0.5]));
}

#[test]
fn damaged_binary_files_are_errors() {
    let bytes = encode_usdc(name(), &baked(ColorSpace::AcesCg)).unwrap();
    for length in (0..bytes.len()).step_by(97) {
        assert!(decode_usdc(name(), &bytes[..length]).is_err(), "{length}");
    }
    let newer = [&bytes[..8], &[0, 14], &bytes[10..]].concat();
    assert!(decode_usdc(name(), &newer).unwrap_err().message.contains("version 0.14 of binary OpenUSD, expected 0.7 to 0.13"));
}

proptest! {
    #[test]
    fn changed_binary_files_do_not_crash(changes in proptest::collection::vec((0usize..1 << 16, any::<u8>()), 1..8)) {
        let mut bytes = encode_usdc(name(), &baked(ColorSpace::AcesCg)).unwrap();
        for (at, value) in changes {
            // The tables at the end as often as all else.
            let place = if at % 2 == 0 { at % bytes.len() } else { bytes.len() - 1 - at % 1500 };
            bytes[place] = value;
        }
        let _ = decode_usdc(name(), &bytes);
    }
}

#[test]
fn the_files_world_is_undone() {
    let mut baked = baked(ColorSpace::AcesCg);
    let before = baked.scene.splats.position.clone();
    let turn = glam::DMat3::from_cols(glam::DVec3::X, glam::DVec3::NEG_Y, glam::DVec3::NEG_Z);
    baked.transform(&Similarity::turn(turn).unwrap());
    let bytes = encode_usda(name(), &baked).unwrap();
    assert_eq!(decode_usda(name(), &bytes).unwrap().splats.position, before);
}

#[test]
fn sizes_that_cannot_be_read_back_are_refused() {
    let mut baked = baked(ColorSpace::AcesCg);
    baked.scene.splats.log_scale[7][1] = 100.0;
    assert!(encode_usda(name(), &baked).unwrap_err().message.contains("log scale of splat 7"));
}

/// A file as other programs write it: nested, half floats, metadata, comments.
const FOREIGN: &str = r#"#usda 1.0
(
    doc = """Two
"splats" """
    upAxis = "Z"
)
def Xform "World" ( kind = "component" )
{
    rel material:binding = </World/Looks/"m">
    custom asset texture = @@@a@b@@@ ( doc = "x" )
    float2 x.timeSamples = { 1: (0, 1), 2: (1, 2) }
    variantSet "detail" = { "high" { float y = 1 } }
    uniform token[] xformOpOrder = []
    def ParticleField3DGaussianSplat "S" {
        point3h[] positionsh = [(0, 0, 0), (1, 2, -3e0)] # two
        quath[] orientationsh = [(1, 0, 0, 0), (0, 1, 0, 0)]
        half3[] scalesh = [(1, 1, 1), (.5, 0, 2)];
        half[] opacitiesh = [0.5, 1]
        uniform int radiance:sphericalHarmonicsDegree = 0
        half3[] radiance:sphericalHarmonicsCoefficientsh = [(1, -1, 2), (0, 0, 0)] ( interpolation = "constant" )
        uniform token colorSpace:name = "lin_ap1_scene"
        def Scope "child" { int z = 1 }
    }
}
"#;

#[test]
fn files_of_other_programs_are_read() {
    let scene = decode_usda(name(), FOREIGN.as_bytes()).unwrap();
    assert_eq!((scene.splats.len(), scene.color_space), (2, ColorSpace::AcesCg));
    assert_eq!(scene.splats.position[1], [1.0, 2.0, -3.0]);
    assert_eq!(scene.splats.rotation[1], [0.0, 1.0, 0.0, 0.0]);
    assert_eq!(scene.splats.sh, [1.0, -1.0, 2.0, 0.0, 0.0, 0.0]);
    scene.splats.validate().unwrap();
    // What moves a neighbour moves no splats.
    let camera = "def Camera \"c\" { uniform token[] xformOpOrder = [\"xformOp:translate\"] }\n";
    for (from, to) in [("def Xform", format!("{camera}def Xform")), ("    }\n}\n", format!("    }}\n{camera}}}\n"))] {
        let text = FOREIGN.replace(from, &to);
        assert_ne!(text, FOREIGN);
        assert_eq!(decode_usda(name(), text.as_bytes()).unwrap().splats, scene.splats);
    }
}

#[test]
fn splats_without_orientations_and_splats_that_are_no_numbers_are_read_with_a_warning() {
    let read = |from: &str, to: &str| {
        let text = FOREIGN.replace(from, to);
        assert_ne!(text, FOREIGN, "{from}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.usda");
        std::fs::write(&path, text).unwrap();
        crate::read_scene_file(&path).unwrap()
    };
    let unturned = read("quath[] orientationsh = [(1, 0, 0, 0), (0, 1, 0, 0)]", "");
    assert_eq!(unturned.scene.splats.rotation, [[1.0, 0.0, 0.0, 0.0]; 2]);
    assert_eq!(unturned.warnings, ["no \"orientations\", as the schema says; all splats have [1.0, 0.0, 0.0, 0.0]"]);
    let left_out = read("(1, 2, -3e0)", "(1, 2, nan)");
    assert_eq!((left_out.scene.splats.len(), left_out.scene.splats.sh.clone()), (1, vec![1.0, -1.0, 2.0]));
    assert_eq!(left_out.warnings, ["left out, with a number that is NaN or infinite: 1 of 2 splats"]);
    let zero = read("(0, 1, 0, 0)]", "(0, 0, 0, 0)]");
    assert_eq!(zero.scene.splats.len(), 1);
    assert!(zero.warnings[0].contains("no quaternion"), "{:?}", zero.warnings);
    assert_eq!(read("#usda 1.0", "\u{feff}#usda 1.0").scene.splats.len(), 2);
}

#[test]
fn arrays_of_other_lengths_are_cut_or_ignored_as_the_schema_says() {
    let read = |from: &str, to: &str| {
        let text = FOREIGN.replace(from, to);
        assert_ne!(text, FOREIGN, "{from}");
        decode_usda(name(), text.as_bytes()).unwrap().splats
    };
    let whole = decode_usda(name(), FOREIGN.as_bytes()).unwrap().splats;
    assert_eq!(read("[0.5, 1]", "[0.5, 1, 0.25, 0]"), whole);
    assert!(read("[0.5, 1]", "[0.5]").opacity_logit.iter().all(|o| *o > 13.0));
    // Of degree 1 there are too few: grey, which is a coefficient of 0.
    assert!(read("Degree = 0", "Degree = 1").sh.iter().all(|k| *k == 0.0));
}

#[test]
fn transforms_of_prims_and_of_those_around_them_are_applied() {
    let whole = decode_usda(name(), FOREIGN.as_bytes()).unwrap();
    // On a parent: turned a quarter about z, twice as large, moved by 1 along x.
    let around = "    }\nuniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:rotateZ\", \"xformOp:scale\"]\n\
                  double3 xformOp:translate = (1, 0, 0)\nfloat xformOp:rotateZ = 90\nfloat3 xformOp:scale = (2, 2, 2)\n}\n";
    let moved = decode_usda(name(), FOREIGN.replace("    }\n}\n", around).as_bytes()).unwrap();
    for i in 0..2 {
        let [x, y, z] = whole.splats.position[i].map(f64::from);
        let expected = glam::DVec3::new(1.0 - 2.0 * y, 2.0 * x, 2.0 * z);
        assert!(moved.world_position(i).distance(expected) < 1e-5, "{:?}", moved.world_position(i));
    }
    let scale = moved.world_from_local.scale().ln() as f32;
    assert!((moved.splats.log_scale[0][0] + scale - whole.splats.log_scale[0][0] - 2f32.ln()).abs() < 1e-5);
    // The identity is no transform.
    let identity = "    }\nmatrix4d xformOp:transform = ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1) )\n\
                    uniform token[] xformOpOrder = [\"xformOp:transform\"]\n}\n";
    assert_eq!(decode_usda(name(), FOREIGN.replace("    }\n}\n", identity).as_bytes()).unwrap(), whole);
    // Two prims are one scene, and a class is none.
    let second = |keyword: &str| {
        let prim = FOREIGN.find("def ParticleField3DGaussianSplat").unwrap();
        let end = FOREIGN.find("    }\n}\n").unwrap() + 6;
        let copy = FOREIGN[prim..end].replacen("def", keyword, 1);
        decode_usda(name(), FOREIGN.replace("    }\n}\n", &format!("    }}\n{copy}}}\n")).as_bytes()).unwrap().splats.len()
    };
    assert_eq!((second("def"), second("class")), (4, 2));
}

#[test]
fn colours_of_a_display_are_known_by_their_name() {
    for space in [DISPLAY_SPACE, OTHER_DISPLAY_SPACE] {
        let scene = decode_usda(name(), FOREIGN.replace("lin_ap1_scene", space).as_bytes()).unwrap();
        assert_eq!(scene.color_space, ColorSpace::DisplaySrgb);
    }
    assert_eq!(color_space_named("lin_rec709_display"), Ok(ColorSpace::LinearRec709));
}

#[test]
fn what_is_wrong_is_named() {
    for (from, to, part) in [
        ("#usda 1.0", "usda", "not OpenUSD text"),
        ("ParticleField3DGaussianSplat", "Points", "no prim of type"),
        ("(1, 2, -3e0)", "(1, 2, x)", "\"positionsh\": value 5 is \"x\", expected a number"),
        ("[(0, 0, 0), (1, 2, -3e0)]", "[(0, 0, nan), (1, inf, 0)]", "all of 2 splats have a number that is NaN or infinite"),
        ("(1, 2, -3e0)", "(1, 2)", "\"positions\" has 5 numbers"),
        ("[0.5, 1]", "[0.5, 1.5]", "opacity of splat 1 is 1.5"),
        ("Degree = 0", "Degree = 9", "expected a degree of 0 to 5"),
        ("xformOpOrder = []", "xformOpOrder = [\"xformOp:translate\"]", "\"xformOp:translate\" is in xformOpOrder and has no value"),
        (
            "    }\n}\n",
            "    }\nfloat3 xformOp:scale = (1, 2, 1)\nuniform token[] xformOpOrder = [\"xformOp:scale\"]\n}\n",
            "scales its splats unevenly",
        ),
        ("lin_ap1_scene", "lin_adobergb_scene", "colour space \"lin_adobergb_scene\", expected one of lin_rec709_scene"),
        ("positionsh = [(0, 0, 0), (1, 2, -3e0)]", "positionsh.timeSamples = { 1: [(0, 0, 0), (1, 2, 3)] }", "change over time"),
        ("(.5, 0, 2)", "(.5, -1, 2)", "scale of splat 1 is -1"),
    ] {
        let text = FOREIGN.replace(from, to);
        assert_ne!(text, FOREIGN, "{from}");
        let error = decode_usda(name(), text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
    let deep = format!("#usda 1.0\n{}", "def X \"a\" {\n".repeat(65));
    assert!(decode_usda(name(), deep.as_bytes()).unwrap_err().message.contains("prims within one another"));
    let brackets = format!("#usda 1.0\n({}", "(".repeat(257));
    assert!(decode_usda(name(), brackets.as_bytes()).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn damage_is_an_error_or_a_valid_scene(at: prop::sample::Index, byte: u8, cut: prop::sample::Index) {
        for whole in [FOREIGN.as_bytes().to_vec(), encode_usda(name(), &baked(ColorSpace::AcesCg)).unwrap()] {
            let mut bytes = whole;
            let _ = decode_usda(name(), &bytes[..cut.index(bytes.len())]);
            let at = at.index(bytes.len());
            bytes[at] = byte;
            if let Ok(scene) = decode_usda(name(), &bytes) {
                prop_assert_eq!(scene.splats.validate(), Ok(()));
            }
        }
    }
}
