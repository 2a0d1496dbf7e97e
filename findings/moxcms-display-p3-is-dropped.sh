#!/usr/bin/env bash
# moxcms 0.8.1 (Rust): libpng drops the Display P3 profile that it makes, which also names another white.
#
# Guess: the cicp tag of ColorProfile::new_display_p3 is 12, 13, 0, 1: P3 with white D65 (SMPTE EG 432-1), sRGB's
# curve, RGB, full range, as H.273 and ICC.1:2022 have it for RGB profiles; and a PNG with the profile keeps it in
# any reader.
# Seen: 11, 13, 1, 0: P3 with DCI's greenish white (SMPTE RP 431-2), the matrix of YCbCr, and narrow range.
# Colorants and curve of the same profile are right. ICC.1:2022 lets readers prefer the cicp tag, so that one and
# the same profile has two meanings. new_srgb says 1, 13, 1, 0. The profile has 598 bytes, where version 4 asks for a
# multiple of four: libpng, here in OpenImageIO 3.2.2, reads the PNG without a profile and without a word. With two
# more zeros and the length 600 in its head the profile is there. Pillow 13 shows both.
#
#     findings/moxcms-display-p3-is-dropped.sh
#
# Needs Rust, Python 3 (PYTHON=...) and the package registries of both. Exits 1 if the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/src"
cat > "$folder/Cargo.toml" <<'TOML'
[package]
name = "profile"
version = "0.0.0"
edition = "2024"

[dependencies]
moxcms = "=0.8.1"
TOML
cat > "$folder/src/main.rs" <<'RUST'
use moxcms::ColorProfile;

/// Returns primaries, curve, matrix and range of the cicp tag of an encoded profile.
fn cicp(profile: &ColorProfile) -> Vec<u8> {
    let bytes = profile.encode().unwrap();
    let word = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let entry = (0..word(128)).map(|n| 132 + 12 * n).find(|at| &bytes[*at..at + 4] == b"cicp").unwrap();
    let content = word(entry + 4) + 8;
    bytes[content..content + 4].to_vec()
}

fn main() {
    let found = [ColorProfile::new_display_p3(), ColorProfile::new_srgb()].map(|profile| cicp(&profile));
    println!("Display P3 {:?}, sRGB {:?}", found[0], found[1]);
    assert_eq!(found, [vec![11, 13, 1, 0], vec![1, 13, 1, 0]], "the behaviour has changed");
    std::fs::write(std::env::args().nth(1).unwrap(), ColorProfile::new_display_p3().encode().unwrap()).unwrap();
}
RUST
cargo run --quiet --manifest-path "$folder/Cargo.toml" -- "$folder/p3.icc" || exit 1
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'OpenImageIO==3.2.2.0' 'pillow==13.0.0'
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import OpenImageIO as oiio
from PIL import Image

folder = sys.argv[1]
path = folder + "/picture.png"


def kept(profile: bytes) -> tuple[bool, bool]:
    """Returns whether libpng and Pillow find the profile of a PNG."""
    Image.new("RGB", (2, 2), (200, 100, 50)).save(path, icc_profile=profile)
    by_libpng = oiio.ImageInput.open(path).spec().getattribute("ICCProfile") is not None
    return by_libpng, Image.open(path).info.get("icc_profile") == profile


profile = open(folder + "/p3.icc", "rb").read()
padded = len(profile) + -len(profile) % 4
found = [len(profile), kept(profile), kept(padded.to_bytes(4, "big") + profile[4:] + bytes(padded - len(profile)))]
print(found)
if found != [598, (False, True), (True, True)]:
    sys.exit("the behaviour has changed")
PYTHON
