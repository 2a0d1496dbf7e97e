//! Prims that are not shown, and parts of other layers, as text and in the binary form.

use super::*;

/// A layer with splats that are shown and others, as text.
const TEXT: &str = include_str!("shown.usda");
/// The bytes that `usd-core` 26.11 makes of it by `Sdf.Layer.Export`.
const BINARY: &str = include_str!("shown.hex");

#[test]
fn only_prims_that_are_shown_are_read_and_the_others_are_said() {
    for layer in [TEXT.as_bytes().to_vec(), unhex(BINARY)] {
        let file = decode_binary_file(Input::new(name(), &layer)).unwrap();
        assert_eq!(file.scene.splats.position, [[0.0; 3], [1.0, 0.0, 0.0]]);
        for words in [
            "left out: a prim of splats, which is not active",
            "left out: a prim of splats, which is invisible",
            "left out: a prim of splats, which is a guide or a proxy",
            "left out: 2 prims of splats, each of which is copied by a point instancer",
            "references, payloads, sublayers, inherited prims and variants are not followed",
            "no \"scales\", as the schema says",
        ] {
            assert!(file.warnings.iter().any(|line| line.contains(words)), "{words}: {:?}", file.warnings);
        }
    }
}

#[test]
fn a_layer_of_references_alone_says_what_composes_it() {
    let layer = "#usda 1.0\n(\n    subLayers = [\n        @splats.usda@\n    ]\n)\n";
    let error = decode_usda(name(), layer.as_bytes()).unwrap_err();
    assert!(error.message.contains("no prim of type") && error.message.contains("usdcat --flatten"), "{error}");
    let hidden = TEXT.replace("\"Shown\"", "\"Shown\" (\n    active = 0\n)");
    let error = decode_usda(name(), hidden.as_bytes()).unwrap_err();
    assert!(error.message.contains("2 prims of splats, each of which is not active"), "{error}");
}
