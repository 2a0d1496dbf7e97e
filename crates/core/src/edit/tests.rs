use proptest::prelude::*;

use super::*;
use crate::{Activation, Antialias, ColorModel, ColorSpace, Cutoffs, RadianceScale, RasterConfig, Scene, Splat, Splats};

fn lcd(luminance_degree: u8, activation: Activation) -> ColorModel {
    ColorModel::Lcd { chroma_degree: 3, luminance_degree, activation }
}

/// Returns the models whose scaling is exact.
fn exact_models() -> Vec<ColorModel> {
    let mut models = vec![ColorModel::Sh { degree: 0 }, ColorModel::Sh { degree: 3 }, ColorModel::Sh { degree: 5 }];
    models.extend([Activation::Softplus, Activation::Exp, Activation::Relu].map(|a| lcd(0, a)));
    models.extend([lcd(2, Activation::Exp), lcd(3, Activation::Relu), lcd(2, Activation::Softplus)]);
    models
}

/// Radiance of one normalised unit.
const SCALE: f32 = 8.0;

/// Returns splats along x with luminance around `2^ev` in units of the data set, with view
/// dependence.
fn scene(model: ColorModel, evs: &[f32], wobble: f32) -> Scene {
    let mut splats = Splats::empty(model);
    for (n, ev) in evs.iter().enumerate() {
        let l = ev.exp2() / SCALE;
        let (dc, raw0) = model.constant([0.5 * l, 0.3 * l, 0.2 * l]);
        let noise = |i: usize, size: f32| ((i * 31 + n * 7) as f32 * 1.7).sin() * size;
        let sh_size = if matches!(model, ColorModel::Sh { .. }) { wobble * l } else { wobble };
        let mut sh: Vec<f32> = (0..3 * model.sh_coefficients()).map(|i| noise(i, sh_size)).collect();
        sh[..3].copy_from_slice(&dc);
        let mut raw: Vec<f32> = (0..model.luminance_coefficients()).map(|i| noise(i + 5, wobble)).collect();
        if let Some(first) = raw.first_mut() {
            *first = raw0;
        }
        let position = [n as f32, 0.0, 0.0];
        let rotation = [1.0, 0.0, 0.0, 0.0];
        splats.push(&Splat { position, rotation, log_scale: [0.0; 3], opacity_logit: 0.0, sh: &sh, raw_luminance: &raw });
    }
    let raster = RasterConfig { cutoffs: Cutoffs::PARITY, antialias: Antialias::Off, ..RasterConfig::default() };
    Scene {
        splats,
        radiance_scale: RadianceScale::new(SCALE).unwrap(),
        color_space: ColorSpace::LinearRec709,
        raster,
        edits: Vec::new(),
        world_from_local: crate::Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

fn apply(scene: &mut Scene, text: &str) -> Result<Applied, EditError> {
    let edits = Edit::parse_all(text).unwrap();
    let [edit] = &edits[..] else { panic!("{text} is not one edit") };
    edit.apply(scene, &MaskShares::new(), ShMap::Luminance)
}

fn selected(scene: &Scene, selection: &str) -> Vec<f32> {
    let selection: Selection = selection.parse().unwrap_or_else(|e| panic!("{selection}: {e}"));
    selection.weights(scene, &MaskShares::new()).unwrap()
}

const DIRECTIONS: [[f32; 3]; 4] = [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [-0.48, 0.64, -0.6], [0.0, 0.0, -1.0]];

/// Compares within f32 tolerance: relative, plus the cancellation of the offset of 1/2 in `Sh` and
/// the floor of luminances.
fn close(found: f32, expected: f32, factor: f32) -> bool {
    (found - expected).abs() < 2e-5 * expected + 3e-6 * (1.0 + factor)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn gain_scales_radiance_in_every_direction(gain_ev in -8f32..8.0, ev in -10f32..8.0) {
        let gain = gain_ev.exp2();
        for model in exact_models() {
            let before = scene(model, &[ev, ev + 1.0], 0.05);
            let mut after = before.clone();
            prop_assert_eq!(apply(&mut after, &format!("gain {gain}")).unwrap().hue_shift, None);
            for i in 0..2 {
                for direction in DIRECTIONS {
                    let (a, b) = (after.splats.radiance(i, direction), before.splats.radiance(i, direction));
                    for c in 0..3 {
                        let expected = gain * b[c];
                        prop_assert!(close(a[c], expected, gain), "{}: {} expected {}", model.name(), a[c], expected);
                    }
                }
            }
        }
    }

    #[test]
    fn power_maps_the_base_luminance_and_keeps_the_pivot(exponent in 0.3f32..2.0, ev in -6f32..6.0) {
        for model in exact_models() {
            let pivot = 0.7;
            let mut after = scene(model, &[ev], 0.0);
            let luminance = after.luminance(0);
            apply(&mut after, &format!("power {exponent}; pivot {pivot}")).unwrap();
            let expected = pivot * (luminance / pivot).powf(exponent);
            prop_assert!(close(after.luminance(0) / SCALE, expected / SCALE, expected / luminance), "{}", model.name());
        }
    }

    #[test]
    fn an_edit_and_its_inverse_give_back_the_scene(ev in -10f32..10.0, stops in -8f32..8.0, exponent in 0.4f32..2.5, ratio in 0.5f32..4.0) {
        let amount = 1.0 - 1.0 / ratio;
        let pairs = [
            (format!("stops {stops}"), format!("stops {}", -stops)),
            (format!("power {exponent}; pivot 0.5"), format!("power {}; pivot 0.5", 1.0 / exponent)),
            (format!("compress-above 0.3:{ratio}"), format!("compress-above 0.3:{}", 1.0 / ratio)),
            (format!("lift-below 2:{amount}"), format!("lift-below 2:{}", 1.0 - ratio)),
            ("curve 0.01:0.1,100:10".to_owned(), "curve 0.1:0.01,10:100".to_owned()),
        ];
        for model in [lcd(0, Activation::Softplus), lcd(0, Activation::Exp), lcd(0, Activation::Relu), lcd(2, Activation::Exp)] {
            for (edit, inverse) in &pairs {
                let before = scene(model, &[ev], 0.05);
                let mut after = before.clone();
                apply(&mut after, edit).unwrap();
                apply(&mut after, inverse).unwrap();
                prop_assert_eq!(&after.splats.sh, &before.splats.sh);
                let (a, b) = (after.luminance(0), before.luminance(0));
                prop_assert!((a - b).abs() <= 1e-4 * b, "{} of {}: {} became {}", edit, model.name(), b, a);
            }
        }
    }

    /// Only gains are invertible on harmonics.
    #[test]
    fn a_gain_of_harmonics_and_its_inverse_give_back_the_scene(ev in -10f32..10.0, stops in -8f32..8.0) {
        for degree in [0, 3, 5] {
            let before = scene(ColorModel::Sh { degree }, &[ev, ev - 1.0], 0.05);
            let mut after = before.clone();
            apply(&mut after, &format!("stops {stops}")).unwrap();
            apply(&mut after, &format!("stops {}", -stops)).unwrap();
            prop_assert_eq!(&after.splats.sh, &before.splats.sh);
            let (a, b) = (after.luminance(0), before.luminance(0));
            prop_assert!((a - b).abs() <= 1e-6 * b, "{}: {} became {}", stops, b, a);
        }
    }

    #[test]
    fn chromaticity_and_geometry_keep_their_bits_under_any_map(which in 0usize..7, value in 0.05f32..0.95, feather in 0f32..3.0) {
        let maps = ["gain", "stops", "power", "curve 0.01:0.02,1:1,8:4", "clamp-max", "compress-above", "lift-below"];
        let map = if which == 3 { maps[which].to_owned() } else { format!("{} {value}", maps[which]) };
        for activation in [Activation::Softplus, Activation::Exp, Activation::Relu] {
            let before = scene(lcd(2, activation), &[-4.0, 0.0, 5.0], 0.1);
            let mut after = before.clone();
            apply(&mut after, &format!("where L > 0.5 ~{feather} or L < 0.2; {map}")).unwrap();
            let restored = Splats { gain: Vec::new(), ..after.splats };
            prop_assert_eq!(&restored, &before.splats);
            prop_assert_eq!((after.radiance_scale.get(), after.raster, after.edits.len()), (SCALE, before.raster, 1));
        }
    }

    #[test]
    fn garbage_is_an_error_and_no_panic(text in "\\PC{0,60}", words in prop::collection::vec(0usize..24, 0..12)) {
        const WORDS: [&str; 24] = [
            "where", "L", "<", "0.1", "p20", "and", "or", "not", "(", ")", "box(", "sphere(0,0,0,1)", "mask(a.png, b)", "~", ";", "gain", "power",
            "pivot", "curve", "1:2,3:4", "in", "..", "hue", "all",
        ];
        let sentence: Vec<&str> = words.iter().map(|i| WORDS[*i]).collect();
        for text in [text.clone(), sentence.join(" "), sentence.concat(), format!("where {text}"), format!("gain {text}")] {
            match Edit::parse_all(&text) {
                Ok(edits) => {
                    for edit in edits {
                        prop_assert_eq!(Edit::parse_all(&edit.to_string()), Ok(vec![edit]));
                    }
                }
                Err(e) => prop_assert!(e.column >= 1 && e.column <= text.chars().count() + 1, "{:?}: {}", text, e),
            }
        }
    }

    #[test]
    fn selections_read_back_as_written(selection in selections()) {
        prop_assert_eq!(selection.to_string().parse(), Ok(selection));
    }
}

fn selections() -> impl Strategy<Value = Selection> {
    let level = prop_oneof![(0f32..1.0).prop_map(Level::Absolute), (0f32..100.0).prop_map(Level::Percentile)];
    let quantity = prop::sample::select(vec![Quantity::Luminance, Quantity::Hue, Quantity::Saturation]);
    let comparison = prop::sample::select(vec![Comparison::Below, Comparison::AtMost, Comparison::Above, Comparison::AtLeast]);
    let feather = prop_oneof![Just(0.0), 0.01f32..1.0];
    let leaf = prop_oneof![
        Just(Selection::All),
        (quantity, comparison, level, feather.clone()).prop_map(|(quantity, comparison, level, feather)| Selection::Compare {
            quantity,
            comparison,
            level,
            feather
        }),
        (0f32..360.0, 0f32..360.0, feather.clone()).prop_map(|(low, high, feather)| Selection::Within {
            quantity: Quantity::Hue,
            low: Level::Absolute(low),
            high: Level::Absolute(high),
            feather,
        }),
        (-1e3f32..0.0, 0f32..1e3, feather.clone()).prop_map(|(low, high, feather)| Selection::Cuboid {
            min: [f64::from(low); 3],
            max: [f64::from(high); 3],
            feather
        }),
        (-1e3f32..1e3, 1e-3f32..1e3, feather.clone()).prop_map(|(c, radius, feather)| Selection::Sphere {
            center: [f64::from(c); 3],
            radius,
            feather
        }),
        ("[ -~&&[^\"]]{1,12}", "[a-z/0-9é]{1,8}", feather)
            .prop_map(|(file, view, feather)| Selection::Mask { name: MaskName { file, view }, feather }),
    ];
    leaf.prop_recursive(4, 24, 3, |inner| {
        prop_oneof![
            inner.clone().prop_map(|s| Selection::Not(Box::new(s))),
            prop::collection::vec(inner.clone(), 2..4).prop_map(Selection::And),
            prop::collection::vec(inner, 2..4).prop_map(Selection::Or),
        ]
    })
}

#[test]
fn only_selected_splats_change() {
    let mut models = exact_models();
    models.push(lcd(1, Activation::Softplus));
    for model in models {
        for map in ["gain 3", "power 0.5; pivot 3", "clamp-max 0.9"] {
            let before = scene(model, &[-5.0, 0.0, 5.0], 0.01);
            let mut after = before.clone();
            let applied = apply(&mut after, &format!("where L in 0.5..2; {map}")).unwrap();
            assert_eq!(applied.weights, [0.0, 1.0, 0.0]);
            for i in 0..3 {
                let (a, b) = (&after.splats, &before.splats);
                assert_eq!((a.sh_of(i), a.gain_of(i)) == (b.sh_of(i), 1.0), i != 1, "{map} {}", model.name());
                assert_eq!(a.raw_luminance, b.raw_luminance);
            }
        }
    }
}

#[test]
fn what_a_map_leaves_alone_keeps_its_bits() {
    for model in exact_models() {
        let before = scene(model, &[-2.0, 3.0], 0.01);
        let mut after = before.clone();
        apply(&mut after, "compress-above 1:3").unwrap();
        let (a, b) = (&after.splats, &before.splats);
        assert_eq!((a.sh_of(0), a.raw_luminance_of(0), a.gain_of(0)), (b.sh_of(0), b.raw_luminance_of(0), 1.0), "{}", model.name());
        assert!(close(after.luminance(1), 2.0, 1.0), "{} {}", after.luminance(1), model.name());
    }
}

#[test]
fn selections_select() {
    // Luminance 1/4, 1, 4, 16 at x = 0, 1, 2, 3.
    let scene = scene(lcd(0, Activation::Softplus), &[-2.0, 0.0, 2.0, 4.0], 0.0);
    let cases: [(&str, [u8; 4]); 18] = [
        ("all", [1, 1, 1, 1]),
        ("L < 2", [1, 1, 0, 0]),
        ("luminance>=2", [0, 0, 1, 1]),
        ("L in 0.5..8", [0, 1, 1, 0]),
        ("L <= p0", [1, 0, 0, 0]),
        ("L < p100", [1, 1, 1, 0]),
        ("L in p30..p70", [0, 1, 1, 0]),
        ("not L < 2", [0, 0, 1, 1]),
        ("L > 0.5 and L < 8 or L > 10", [0, 1, 1, 1]),
        ("L > 0.5 and (L < 0.6 or L > 10)", [0, 0, 0, 1]),
        ("box(0.5,-1,-1, 2.5,1,1)", [0, 1, 1, 0]),
        ("sphere(3, 0, 0, 1.5)", [0, 0, 1, 1]),
        // Shares of 0.5, 0.3, 0.2: an orange of saturation 0.6.
        ("hue in 15..25", [1, 1, 1, 1]),
        ("hue in 340..40", [1, 1, 1, 1]),
        ("hue in 40..340", [0, 0, 0, 0]),
        ("hue in 0..360", [1, 1, 1, 1]),
        ("saturation in 0.5..0.7", [1, 1, 1, 1]),
        ("saturation < 0.5 or not all", [0, 0, 0, 0]),
    ];
    for (selection, expected) in cases {
        assert_eq!(selected(&scene, selection), expected.map(f32::from), "{selection}");
    }
}

#[test]
fn soft_edges_lie_half_on_each_side_and_grey_has_no_hue() {
    let mut scene = scene(lcd(0, Activation::Softplus), &[-2.0, 0.0, 2.0, 4.0], 0.0);
    let weights = selected(&scene, "L < 1 ~6");
    assert!(
        weights[0] > 0.5 && weights[0] < 1.0 && (weights[1] - 0.5).abs() < 1e-4 && weights[2] < 0.5 && weights[3] == 0.0,
        "{weights:?}"
    );
    let inverse = selected(&scene, "not L < 1 ~6");
    assert!(weights.iter().zip(&inverse).all(|(a, b)| (a + b - 1.0).abs() < 1e-6));
    assert_eq!(selected(&scene, "sphere(0,0,0,1) ~1"), [1.0, 0.5, 0.0, 0.0]);
    let edges = selected(&scene, "hue in 15..19 ~8");
    assert!(edges.iter().all(|w| *w > 0.2 && *w < 0.8), "{edges:?}");

    scene.splats.sh.fill(0.0);
    assert_eq!(selected(&scene, "hue in 0..360 or saturation > 0"), [0.0; 4]);
    // A soft edge fades the change in stops.
    let before = scene.luminance(1);
    apply(&mut scene, "where L < 1 ~6; gain 16").unwrap();
    assert!((scene.luminance(1) / before - 4.0).abs() < 0.01);
}

#[test]
fn masks_are_by_name_and_of_this_scene() {
    let scene = scene(lcd(0, Activation::Softplus), &[0.0, 0.0, 0.0], 0.0);
    let selection: Selection = "mask('a b.png', images/000) ~0.5 and not mask(c.png,001)".parse().unwrap();
    let names: Vec<MaskName> = selection.masks().into_iter().cloned().collect();
    assert_eq!((names[0].file.as_str(), names[0].view.as_str()), ("a b.png", "images/000"));
    let mut shares = MaskShares::from([(names[0].clone(), vec![1.0, 0.5, 0.1])]);
    assert_eq!(selection.weights(&scene, &shares), Err(EditError::Mask(names[1].clone())));
    shares.insert(names[1].clone(), vec![0.0; 2]);
    assert!(selection.weights(&scene, &shares).is_err());
    shares.insert(names[1].clone(), vec![0.0, 0.0, 1.0]);
    assert_eq!(selection.weights(&scene, &shares).unwrap(), [1.0, 0.5, 0.0]);
}

#[test]
fn summaries_tell_count_light_and_place() {
    let scene = scene(lcd(0, Activation::Relu), &[0.0, 1.0, 2.0], 0.0);
    let summary = SelectionSummary::new(&scene, &[0.0, 0.5, 1.0]);
    assert_eq!((summary.count, summary.partial), (2, 1));
    assert_eq!(summary.bounds, Some([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]));
    assert!((summary.light_share - 5.0 / 7.0).abs() < 1e-6);
    assert_eq!(SelectionSummary::new(&scene, &[0.0; 3]).bounds, None);
}

#[test]
fn the_median_is_the_pivot_and_the_edit_is_recorded() {
    let mut scene = scene(lcd(0, Activation::Relu), &[0.0, 1.0, 3.0], 0.0);
    let applied = apply(&mut scene, "where L < 100; power 2; gain 0.5").unwrap();
    let pivot = 2.0;
    assert_eq!(applied.edit.maps[0], Map::Power { exponent: 2.0, pivot: Some(pivot) });
    assert!(close(scene.luminance(2), 16.0, 1.0) && close(scene.luminance(0), 0.25, 1.0));
    assert_eq!(scene.edits, ["where L < 100; power 2; pivot 2; gain 0.5"]);
    apply(&mut scene, "stops 1").unwrap();
    assert_eq!(scene.edits[1], "where all; stops 1");
    // An edit that only selects is not logged.
    apply(&mut scene, "where L < 1").unwrap();
    assert_eq!(scene.edits.len(), 2);
}

#[test]
fn harmonics_shift_hue_under_maps_that_are_no_gains() {
    let before = scene(ColorModel::Sh { degree: 3 }, &[0.0, 3.0], 0.2);
    let shift = |sh_map| {
        let edit = &Edit::parse_all("power 1.2").unwrap()[0];
        edit.apply(&mut before.clone(), &MaskShares::new(), sh_map).unwrap().hue_shift.unwrap()
    };
    let (luminance, channels) = (shift(ShMap::Luminance), shift(ShMap::Channels));
    assert!(luminance > 1e-4 && channels > 3.0 * luminance, "{luminance} {channels}");
}

#[test]
fn black_splats_stay_black() {
    let mut after = scene(lcd(0, Activation::Relu), &[0.0], 0.0);
    after.splats.raw_luminance[0] = -3.0;
    apply(&mut after, "power 0.5; pivot 1").unwrap();
    assert_eq!(after.splats.raw_luminance[0], -3.0);
    apply(&mut after, "gain 0").unwrap();
    assert_eq!(after.luminance(0), 0.0);
}

#[test]
fn parameters_out_of_range_and_overflow_leave_the_scene_alone() {
    for model in exact_models() {
        let before = scene(model, &[5.0], 0.01);
        let mut after = before.clone();
        let maps = [
            Map::Gain(-1.0),
            Map::Gain(f32::NAN),
            Map::Power { exponent: 0.0, pivot: Some(1.0) },
            Map::Power { exponent: 2.0, pivot: Some(f32::INFINITY) },
            Map::LiftBelow { threshold: 1.0, amount: 1.0 },
            Map::Gain(f32::MAX),
        ];
        for map in maps {
            let edit = Edit { selection: Selection::All, maps: vec![map] };
            assert!(edit.apply(&mut after, &MaskShares::new(), ShMap::Luminance).is_err(), "{edit} {}", model.name());
            assert_eq!(after, before);
        }
    }
}

#[test]
fn errors_of_the_text_name_the_column() {
    let cases = [
        ("gain", "column 5: expected a number, found the end"),
        ("gain -1", "column 6: gain is -1, expected a finite number, 0 or more"),
        ("gain 2 stops 1", "column 8: expected \";\" or the end, found \"stops 1\""),
        ("brighten 2", "column 1: expected one of where, pivot, gain"),
        ("pivot 2", "column 1: a pivot belongs to a power"),
        ("power 2; pivot 1; pivot 2", "column 19: a pivot belongs to a power"),
        ("where L = 2", "column 9: expected <, <=, >, >= or in, found \"= 2\""),
        ("where L < p120", "column 7: percentile is 120"),
        ("where L < pq", "column 11: expected a number, or a percentile such as p20, found \"pq\""),
        ("where (L < 2", "column 13: expected \")\", found the end"),
        ("where box(0,0,0,1,1)", "column 20: expected \",\", found \")\""),
        ("where box(1,0,0,0,1,1)", "column 7: corner of the box is 0"),
        ("where L in 2..1", "column 7: end of the range is 1"),
        ("where mask(a.png)", "column 12: expected an image file and a comma"),
        ("where L < 1 and", "column 16: expected a test"),
        ("curve 1:1,1:2", "column 7: curve goes from 1:1 to 1:2"),
        ("lift-below 1:1", "column 12: amount is 1, expected a number below 1"),
        ("gain 1e99", "column 6: expected a number, found \"1e99\""),
    ];
    for (text, expected) in cases {
        let error = Edit::parse_all(text).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{text}: {error}");
    }
    let deep = "(".repeat(100_000);
    assert!(Edit::parse_all(&format!("where {deep}")).unwrap_err().message.contains("nested deeper"));
    assert!(format!("L<1{}", " or L<1".repeat(10_000)).parse::<Selection>().is_ok());
    assert_eq!(Edit::parse_all(" ; "), Ok(Vec::new()));
    assert_eq!(Statement::parse("gain", "2 3").unwrap_err().column, 3);
}

#[test]
fn a_hard_edge_is_found_where_it_cuts_through_many_splats() {
    // A dark group and a bright one, with nothing from 0.09 to 16 between them.
    let evs: Vec<f32> = (0..40).map(|i| -5.5 + 0.05 * i as f32).chain((0..40).map(|i| 4.0 + 0.05 * i as f32)).collect();
    for model in [ColorModel::Sh { degree: 3 }, lcd(0, Activation::Softplus)] {
        let scene = scene(model, &evs, 0.0);
        let found = |text: &str| text.parse::<Selection>().unwrap().hard_edges(&scene);
        let [edge] = &found("L < 0.05")[..] else { panic!("{:?}", found("L < 0.05")) };
        assert_eq!((edge.test.as_str(), edge.soft.as_str(), edge.width), ("L < 0.05", "L < 0.05 ~2", "2 stops"));
        // Half of the splats lie within a stop of it.
        assert!((0.4..0.5).contains(&edge.part), "{}", edge.part);
        let soft: Vec<String> = found("not (L > p25 or L in 0.001..0.04)").into_iter().map(|edge| edge.soft).collect();
        assert_eq!(soft, ["L > p25 ~2", "L in 0.001..0.04 ~2"]);
        // In the gap, at the ends, soft already, or a cut in space.
        for text in ["L < 1", "L < 65", "L > 1000", "L < 0.05 ~0.1", "sphere(1,0,0,3)", "box(0,0,0,9,9,9)", "all"] {
            assert_eq!(found(text), [], "{text}");
        }
    }
    let empty = Scene { splats: Splats::empty(ColorModel::Sh { degree: 0 }), ..scene(ColorModel::Sh { degree: 0 }, &[], 0.0) };
    assert_eq!("L < 1".parse::<Selection>().unwrap().hard_edges(&empty), []);
}

#[test]
fn a_hard_edge_of_colour_is_found_too() {
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    // Hues from 0 to 60 degrees; saturations from 0.5 to 1.
    for i in 0..50 {
        let (green, blue) = (0.5 + 0.01 * i as f32, 0.5 - 0.01 * i as f32);
        let (sh, _) = splats.color_model.constant([1.0, green, blue]);
        let rotation = [1.0, 0.0, 0.0, 0.0];
        splats.push(&Splat { position: [0.0; 3], rotation, log_scale: [0.0; 3], opacity_logit: 0.0, sh: &sh, raw_luminance: &[] });
    }
    let scene = Scene { splats, ..scene(ColorModel::Sh { degree: 0 }, &[], 0.0) };
    let soft = |text: &str| text.parse::<Selection>().unwrap().hard_edges(&scene).into_iter().map(|edge| edge.soft).collect::<Vec<_>>();
    assert_eq!(soft("hue in 20..40"), ["hue in 20..40 ~30"]);
    assert_eq!(soft("saturation > 0.8"), ["saturation > 0.8 ~0.2"]);
    assert_eq!(soft("hue in 200..260 and saturation > 0.1"), Vec::<String>::new());
}

#[test]
fn boxes_and_spheres_are_in_world_coordinates() {
    let mut far = scene(ColorModel::Sh { degree: 0 }, &[0.0; 3], 0.0);
    let selections = ["box(0.5,-1,-1,1.5,1,1) ~0.25", "sphere(2,0,0,0.75)", "box(-9,-9,-9,9,9,9)"];
    let near: Vec<Vec<f32>> = selections.iter().map(|text| selected(&far, text)).collect();
    assert!(near[0].iter().any(|w| *w > 0.0) && near[1].contains(&0.0));
    far.world_from_local = crate::Similarity::new(glam::DMat3::IDENTITY, 0.125, glam::DVec3::new(4_600_321.0, -2e6, 500.0)).unwrap();
    let moved = [
        "box(4600321.0625,-2000000.125,499.875,4600321.1875,-1999999.875,500.125) ~0.03125",
        "sphere(4600321.25,-2000000,500,0.09375)",
        "box(4600319.875,-2000001.125,498.875,4600322.125,-1999998.875,501.125)",
    ];
    let found: Vec<Vec<f32>> = moved.iter().map(|text| selected(&far, text)).collect();
    assert_eq!(found, near);
    let summary = SelectionSummary::new(&far, &found[2]);
    assert_eq!(summary.bounds.unwrap()[0], far.world_position(0).to_array());
}
