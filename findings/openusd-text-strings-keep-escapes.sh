#!/usr/bin/env bash
# openusd 0.6.0 (Rust): strings change on their way between OpenUSD's text and binary forms.
#
# Guess: both readers return the string that the author meant, and the text writer escapes what it must, so
# that text, binary form and text again hold the same documentation of a prim.
# Seen: the text reader leaves escape sequences as they stand ("a \"b\"" keeps its backslashes), where the binary
# reader returns the string itself. The text writer escapes no backslash: the path C:\new of a binary layer
# is written as it is, and usd-core 26.11 reads a line break in it. Nothing warns. A layer that stays text
# comes back unchanged, since the two omissions undo each other.
#
#     findings/openusd-text-strings-keep-escapes.sh
#
# Needs Rust, Python 3.10 or later (PYTHON=...), and the package indexes of both. Exits 1 if the behaviour
# has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check 'usd-core==26.11'
venv/bin/python - <<'PYTHON'
from pxr import Sdf

layer = Sdf.Layer.CreateNew("path.usdc")
prim = Sdf.PrimSpec(layer, "A", Sdf.SpecifierDef)
prim.documentation = "C:\\new"
layer.Save()
# By hand, since usd-core would write a string in apostrophes, which needs no escape.
with open("quotes.usda", "w") as file:
    file.write('#usda 1.0\ndef "A" (\n    doc = "a \\"b\\""\n)\n{\n}\n')
PYTHON
mkdir src
cat >Cargo.toml <<'TOML'
[package]
name = "strings"
version = "0.0.0"
edition = "2021"

[dependencies]
anyhow = "1"
openusd = "=0.6.0"

[workspace]
TOML
cat >src/main.rs <<'RUST'
use openusd::sdf::AbstractData;
use openusd::{usda, usdc};

fn documentation(layer: &dyn AbstractData) -> anyhow::Result<String> {
    Ok(format!("{:?}", layer.get_field(&"/A".into(), "documentation")?.into_owned()))
}

fn main() -> anyhow::Result<()> {
    println!("text: {}", documentation(&usda::read_file("quotes.usda")?)?);
    let binary = usdc::read_file("path.usdc")?;
    println!("binary: {}", documentation(&*binary)?);
    let mut text = Vec::new();
    usda::TextWriter::write(&*binary, &mut text)?;
    Ok(std::fs::write("path.usda", text)?)
}
RUST
cargo run --quiet >seen.txt
venv/bin/python - <<'PYTHON' >>seen.txt
from pxr import Sdf

for name in ["quotes.usda", "path.usda"]:
    layer = Sdf.Layer.FindOrOpen(name)
    print(f"usd-core, {name}:", repr(layer.GetPrimAtPath("/A").documentation))
PYTHON
cat seen.txt
cat >expected.txt <<'TEXT'
text: String("a \\\"b\\\"")
binary: String("C:\\new")
usd-core, quotes.usda: 'a "b"'
usd-core, path.usda: 'C:\new'
TEXT
cmp seen.txt expected.txt
