//! Edits as text: reading neither panics nor hangs, what is read is written and read back alike,
//! and does to a scene what an edit may do.
#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_core::edit::{MaskShares, ShMap, Statement};
use luxel_core::{Activation, ColorModel, ColorSpace, Edit, EditError, Mix, RadianceScale, RasterConfig, Scene, Selection, Splat, Splats};

/// Returns the splats of luminance 1/16 to 16, of three hues, along a line.
fn scene(color_model: ColorModel) -> Scene {
    let mut splats = Splats::empty(color_model);
    for n in 0..5u8 {
        let luminance = (2.0 * f32::from(n) - 4.0).exp2();
        let share = |c: u8| if c == n % 3 { 0.6 } else { 0.2 };
        let (dc, raw) = color_model.constant([0, 1, 2].map(|c| luminance * share(c)));
        let mut sh = vec![0.02; 3 * color_model.sh_coefficients()];
        sh[..3].copy_from_slice(&dc);
        let mut raw_luminance = vec![0.01; color_model.luminance_coefficients()];
        raw_luminance.iter_mut().take(1).for_each(|first| *first = raw);
        splats.push(&Splat {
            position: [f32::from(n), 0.0, 0.0],
            rotation: [1.0, 0.0, 0.0, 0.0],
            log_scale: [-1.0; 3],
            opacity_logit: 0.0,
            sh: &sh,
            raw_luminance: &raw_luminance,
        });
    }
    let raster = RasterConfig::default();
    Scene {
        splats,
        radiance_scale: RadianceScale::new(2.0).unwrap(),
        color_space: ColorSpace::LinearRec709,
        raster,
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    }
}

fn apply(edits: &[Edit], color_model: ColorModel, sh_map: ShMap) {
    let mut scene = scene(color_model);
    for edit in edits {
        let names = edit.selection.masks().into_iter().cloned();
        let shares: MaskShares = names.map(|name| (name, vec![0.0, 0.25, 0.5, 0.75, 1.0])).collect();
        let before = scene.clone();
        match edit.apply(&mut scene, &shares, sh_map) {
            Ok(applied) => {
                assert!(applied.weights.iter().all(|weight| (0.0..=1.0).contains(weight)));
                assert_eq!(scene.splats.validate(), Ok(()));
                for i in (0..scene.splats.len()).filter(|i| applied.weights[*i] == 0.0) {
                    assert_eq!(scene.splats.sh_of(i), before.splats.sh_of(i));
                    assert_eq!(scene.splats.raw_luminance_of(i), before.splats.raw_luminance_of(i));
                }
                assert!(!color_model.separates_luminance() || scene.splats.sh == before.splats.sh);
            }
            Err(error) => {
                let is_possible = matches!(error, EditError::Overflow { .. } | EditError::Light { .. });
                assert!(is_possible, "what is read is in range: {error}");
                assert_eq!(scene, before);
            }
        }
    }
}

fuzz_target!(|text: &str| {
    let columns = 1..=text.chars().count() + 1;
    for name in Statement::MAPS {
        let _ = Statement::parse(name, text).map_err(|e| assert!(columns.contains(&e.column)));
    }
    let _ = text.parse::<Selection>().map_err(|e| assert!(columns.contains(&e.column)));
    match Edit::parse_all(text) {
        Ok(edits) => {
            for edit in &edits {
                assert_eq!(Edit::parse_all(&edit.to_string()), Ok(vec![edit.clone()]));
            }
            let lcd = |luminance_degree, activation| ColorModel::Lcd { chroma_degree: 1, luminance_degree, activation };
            apply(&edits, lcd(0, Activation::Softplus), ShMap::Luminance);
            apply(&edits, lcd(1, Activation::Exp), ShMap::Luminance);
            apply(&edits, ColorModel::Sh { degree: 1 }, ShMap::Channels);
            let mix = Mix::new([lcd(0, Activation::Softplus), ColorModel::Sh { degree: 1 }]).map(ColorModel::Mix);
            mix.into_iter().for_each(|mix| apply(&edits, mix, ShMap::Luminance));
        }
        Err(e) => assert!(columns.contains(&e.column)),
    }
});
