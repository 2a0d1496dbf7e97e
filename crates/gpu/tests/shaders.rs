//! The text of the shaders, of the engine and of the viewer's page: what drivers differ in is not
//! in them. A comparison of a number with itself is false for NaN on SwiftShader and llvmpipe,
//! where it should be true; the logarithm of a literal 0 is refused by some and infinite for
//! others; pack2x16float is undefined above 65504, so that halves are rounded by hand.
#![allow(missing_docs, clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};

/// Returns the files with shaders in them.
fn sources() -> Vec<PathBuf> {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let in_folder = |folder: &str, extension: &str| -> Vec<PathBuf> {
        let files = std::fs::read_dir(crates.join(folder)).unwrap().map(|entry| entry.unwrap().path());
        files.filter(|path| path.extension().is_some_and(|found| found == extension)).collect()
    };
    let shaders = in_folder("gpu/src/passes", "wgsl");
    let page = in_folder("view/src/page/gpu", "js");
    assert!(shaders.len() > 20 && page.len() > 3, "{} shaders, {} files of the page", shaders.len(), page.len());
    let display = ["shader.js", "hdr-shader.js"].map(|name| crates.join("view/src/page/display").join(name));
    [shaders, page, display.to_vec()].concat()
}

/// Returns the operand at the end, or at the start, of what stands beside an operator.
fn operand(text: &str, is_before: bool) -> &str {
    let is_part = |c: char| c.is_alphanumeric() || "_.[]".contains(c);
    let text = text.trim();
    if is_before {
        text.rfind(|c| !is_part(c)).map_or(text, |at| &text[at + 1..])
    } else {
        text.find(|c| !is_part(c)).map_or(text, |at| &text[..at])
    }
}

/// Returns what is wrong with a line.
fn fault(line: &str) -> Option<&'static str> {
    let code = line.split("//").next().unwrap_or_default();
    for operator in [" != ", " == "] {
        let mut rest = code;
        while let Some((before, after)) = rest.split_once(operator) {
            let [left, right] = [operand(before, true), operand(after, false)];
            if !left.is_empty() && left == right {
                return Some("a number compared with itself");
            }
            rest = after;
        }
    }
    if ["log(0", "log2(0"].iter().any(|call| code.split(call).skip(1).any(|rest| rest.trim_start_matches(['.', '0', 'f']).starts_with(')')))
    {
        return Some("the logarithm of 0");
    }
    code.contains("pack2x16float(").then_some("pack2x16float").filter(|_| !code.contains("unpack2x16float("))
}

#[test]
fn shaders_hold_nothing_that_drivers_differ_in() {
    for path in sources() {
        let text = std::fs::read_to_string(&path).unwrap();
        for (number, line) in text.lines().enumerate() {
            assert_eq!(fault(line), None, "{}: line {}: {line}", path.display(), number + 1);
        }
    }
}

#[test]
fn the_faults_are_found() {
    for line in ["if (x != x) {", "let is_nan = value.x == value.x;", "y = log(0.0);", "log2(0)", "pack2x16float(v)"] {
        assert!(fault(line).is_some(), "{line}");
    }
    for line in ["if (x != y) {", "a.x == b.x", "log(0.5)", "log2(0.18 * v)", "unpack2x16float(word)", "// x != x"] {
        assert_eq!(fault(line), None, "{line}");
    }
}
