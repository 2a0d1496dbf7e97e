//! Gains of edits: light for other programs, and what cut-offs follow for this one.

use luxel_core::{SH_OFFSET, Splats, sh};

use super::*;

/// Returns a bake with gains, and its layers as text and binary.
fn edited() -> (Baked, [Vec<u8>; 2]) {
    let mut baked = baked(ColorSpace::AcesCg);
    baked.scene.splats.gain = (0..baked.scene.splats.len()).map(|i| [1.0, 0.0, 1024.0, 1.0 / 1024.0][i % 4]).collect();
    let layers = [encode_usda(name(), &baked).unwrap(), encode_usdc(name(), &baked).unwrap()];
    (baked, layers)
}

fn decode(layer: &[u8]) -> crate::scene_file::SceneFile {
    decode_binary_file(Input::new(name(), layer)).unwrap()
}

/// Returns the text with the value of an attribute replaced.
fn with_value(text: &[u8], attribute: &str, value: &str) -> Vec<u8> {
    let is_it = |line: &&str| line.split_whitespace().any(|word| word == attribute);
    let line = |line: &str| if is_it(&line) { format!("    custom float[] {attribute} = {value}") } else { line.to_owned() };
    std::str::from_utf8(text).unwrap().lines().map(|l| line(l) + "\n").collect::<String>().into_bytes()
}

#[test]
fn gains_and_what_they_act_on_read_back_to_the_bit() {
    let (baked, layers) = edited();
    for layer in layers {
        let file = decode(&layer);
        assert_eq!(file.warnings, [""; 0]);
        let Splats { gain, sh, .. } = file.scene.splats;
        assert_eq!((&gain, &sh), (&baked.scene.splats.gain, &baked.scene.splats.sh));
        assert_eq!(file.scene.raster, baked.scene.raster);
    }
}

#[test]
fn other_programs_find_the_light_that_gains_make() {
    let (baked, [text, _]) = edited();
    let plain: String =
        std::str::from_utf8(&text).unwrap().lines().filter(|line| !line.contains("luxel:")).map(|line| format!("{line}\n")).collect();
    let shown = decode(plain.as_bytes()).scene.splats;
    assert!(shown.gain.is_empty());
    for i in 0..shown.len() {
        let [before, after] = [&baked.scene.splats, &shown].map(|splats| SH_OFFSET + sh::C0 * splats.sh_of(i)[0]);
        let expected = before * baked.scene.splats.gain[i];
        assert!((after - expected).abs() < 1e-6 * (1.0 + expected), "splat {i}: {after}, expected {expected}");
    }
}

#[test]
fn gains_of_another_number_of_splats_are_ignored_with_a_warning() {
    let (_, [text, _]) = edited();
    for value in ["[1, 2]", "[]"] {
        let file = decode(&with_value(&text, GAIN, value));
        assert!(file.scene.splats.gain.is_empty(), "{value}");
        assert!(file.warnings[0].contains("expected 30 and"), "{:?}", file.warnings);
    }
    let negative = with_value(&text, GAIN, &format!("{:?}", [-2.0; 30]));
    let error = decode_usda(name(), &negative).unwrap_err();
    assert!(error.message.contains("\"luxel:gain\" of splat 0 is -2, expected 0 or more"), "{error}");
}

#[test]
fn radiance_that_another_program_changed_is_what_is_read() {
    let (baked, [text, _]) = edited();
    // All of the same gain: no longer what the radiance was made with, except where it was 1.
    let file = decode(&with_value(&text, GAIN, &format!("{:?}", [1.0; 30])));
    let changed = baked.scene.splats.gain.iter().filter(|gain| **gain != 1.0).count();
    assert!(file.warnings[0].contains(&format!("changed the radiance of {changed} splats")), "{:?}", file.warnings);
    let brightness = |splats: &Splats, i: usize| SH_OFFSET + sh::C0 * splats.sh_of(i)[0];
    let [black, bright] = [1, 2].map(|i| brightness(&file.scene.splats, i));
    assert!(black.abs() < 1e-6 && bright > 1000.0 * brightness(&baked.scene.splats, 2), "{black} {bright}");
}
