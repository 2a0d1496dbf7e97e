//! Reads the OpenUSD files that Luxel writes with the library `openusd`, which shares no code with
//! it.
//!
//! In: the path of the program. Checked: text, binary form and package hold the same layer; splats
//! are where the exported PLY has them; lamps, mesh and cameras have finite numbers of the right
//! count. Out: what was compared, a line each; exit code 1 where anything differs.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use openusd::sdf::{AbstractData, Value};
use openusd::{usda, usdc, usdz};

/// Steps of training: a rough scene has all kinds of prims.
const ITERATIONS: &str = "60";

/// The program, in a folder of its own.
struct Luxel {
    program: PathBuf,
    folder: tempfile::TempDir,
}

impl Luxel {
    fn run(&self, args: &[&str]) -> Result<()> {
        let mut command = Command::new(&self.program);
        let output = command.current_dir(self.folder.path()).args(args).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "luxel {}: {}: {said}", args.join(" "), output.status);
        Ok(())
    }

    /// Writes a file in all three forms; returns the one layer that they hold.
    fn one_layer(&self, args: &[&str], stem: &str) -> Result<Layer> {
        let mut layers = Vec::new();
        for extension in ["usda", "usdc", "usdz"] {
            let file = format!("{stem}.{extension}");
            self.run(&[args, &["--overwrite", "-o", &file]].concat())?;
            layers.push((extension, Layer::read(&self.folder.path().join(&file))?));
        }
        let (_, text) = layers.remove(0);
        for (extension, other) in &layers {
            text.check_equal(other, *extension == "usdz").with_context(|| format!("{stem}.usda and {stem}.{extension}"))?;
        }
        println!("{stem}: {} fields, the same in text, binary form and package", text.fields.len());
        Ok(text)
    }
}

/// The fields of all specs of a layer, by path and name.
struct Layer {
    fields: BTreeMap<(String, String), Value>,
}

impl Layer {
    fn read(path: &Path) -> Result<Self> {
        Self::decode(path).with_context(|| path.display().to_string())
    }

    fn decode(path: &Path) -> Result<Self> {
        let bytes = fs::read(path)?;
        let data: Box<dyn AbstractData> = match path.extension().and_then(|extension| extension.to_str()) {
            Some("usda") => Box::new(usda::parse(&String::from_utf8(bytes)?)?),
            Some("usdc") => Box::new(usdc::CrateData::open(Cursor::new(bytes), true)?),
            _ => usdz::Archive::from_reader(Cursor::new(bytes))?.read_first_layer()?,
        };
        let mut fields = BTreeMap::new();
        for path in data.spec_paths() {
            for field in data.list_fields(&path).unwrap_or_default() {
                let value = data.get_field(&path, &field)?.into_owned();
                fields.insert((path.to_string(), field), value);
            }
        }
        Ok(Self { fields })
    }

    /// Compares the layer of a text with another. A package has names of its own for the files in
    /// it.
    fn check_equal(&self, other: &Self, is_package: bool) -> Result<()> {
        for (key, value) in &self.fields {
            let found = other.fields.get(key).with_context(|| format!("{key:?} is missing"))?;
            let is_renamed = is_package && is_file(value) && is_file(found);
            ensure!(is_renamed || is_equal(value, found), "{key:?}: {} and {}", short(value), short(found));
        }
        match other.fields.keys().find(|key| !self.fields.contains_key(*key)) {
            Some(key) => bail!("{key:?} is in one alone"),
            None => Ok(()),
        }
    }

    /// Returns the path of the one prim that has this attribute.
    fn prim_with(&self, attribute: &str) -> Result<&str> {
        let suffix = format!(".{attribute}");
        let mut prims: Vec<_> = self.fields.keys().filter_map(|(path, _)| path.strip_suffix(&suffix)).collect();
        prims.dedup();
        match prims[..] {
            [prim] => Ok(prim),
            _ => bail!("{} prims with {attribute}, expected one", prims.len()),
        }
    }

    /// Returns the numbers of an attribute, finite ones.
    fn numbers(&self, path: &str) -> Result<Vec<f64>> {
        let value = self.fields.get(&(path.to_owned(), "default".to_owned())).with_context(|| format!("no {path}"))?.clone();
        let wide = |values: Vec<f32>| values.into_iter().map(f64::from).collect();
        let numbers: Vec<f64> = match value {
            Value::Int(value) => vec![value.into()],
            Value::Float(value) => vec![value.into()],
            Value::Double(value) => vec![value],
            Value::IntVec(values) => values.into_iter().map(f64::from).collect(),
            Value::FloatVec(values) => wide(values),
            Value::Vec3f(value) => wide(<[f32; 3]>::from(value).to_vec()),
            Value::Vec3fVec(values) => wide(values.into_iter().flat_map(<[f32; 3]>::from).collect()),
            Value::QuatfVec(values) => wide(values.into_iter().flat_map(<[f32; 4]>::from).collect()),
            other => bail!("{path}: {}, expected numbers", short(&other)),
        };
        ensure!(numbers.iter().all(|number| number.is_finite()), "{path}: not all numbers are finite");
        Ok(numbers)
    }
}

/// Returns whether a value of a text and of a binary form are equal. In a text, the library leaves
/// the backslashes that stand before quotes, and takes tokens of metadata for strings.
fn is_equal(of_text: &Value, other: &Value) -> bool {
    match (of_text, other) {
        (Value::String(a), Value::String(b)) => a.replace(r#"\""#, "\"") == *b,
        (Value::String(a), Value::Token(b)) => a == b.as_str(),
        (Value::Dictionary(a), Value::Dictionary(b)) => {
            a.len() == b.len() && a.iter().all(|(key, value)| b.get(key).is_some_and(|other| is_equal(value, other)))
        }
        _ => of_text == other,
    }
}

/// Returns whether a value names a file beside the layer.
fn is_file(value: &Value) -> bool {
    matches!(value, Value::AssetPath(path) if path.authored_path.starts_with("./"))
}

/// Returns the beginning of a value.
fn short(value: &Value) -> String {
    format!("{value:?}").chars().take(120).collect()
}

/// Returns the positions of a binary PLY whose vertices begin with x, y, z and have only floats.
fn ply_positions(path: &Path) -> Result<Vec<[f32; 3]>> {
    let bytes = fs::read(path)?;
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|window| window == end).context("no end_header")? + end.len();
    let header = std::str::from_utf8(&bytes[..body])?;
    let floats = header.lines().filter(|line| line.starts_with("property float ")).count();
    ensure!(floats == header.lines().filter(|line| line.starts_with("property ")).count(), "properties other than floats");
    let float = |at: &[u8]| f32::from_le_bytes([at[0], at[1], at[2], at[3]]);
    Ok(bytes[body..].chunks_exact(4 * floats).map(|vertex| [float(vertex), float(&vertex[4..]), float(&vertex[8..])]).collect())
}

fn check_splats(luxel: &Luxel) -> Result<()> {
    let layer = luxel.one_layer(&["export", "run"], "splats")?;
    luxel.run(&["export", "run", "--bake", "linear", "-o", "splats.ply"])?;
    let prim = layer.prim_with("positions")?;
    let of = |name: &str| layer.numbers(&format!("{prim}.{name}"));
    let found: Vec<[f32; 3]> = of("positions")?.chunks(3).map(|p| [p[0] as f32, p[1] as f32, p[2] as f32]).collect();
    // The PLY has the data set's axes, in which z is up; OpenUSD's y is.
    let expected: Vec<_> = ply_positions(&luxel.folder.path().join("splats.ply"))?.into_iter().map(|[x, y, z]| [x, z, -y]).collect();
    ensure!(found == expected, "positions of {} splats are not those of the {} of the PLY", found.len(), expected.len());
    let count = found.len();
    let degree = of("radiance:sphericalHarmonicsDegree")?[0] as usize;
    let lengths =
        [("scales", 3), ("orientations", 4), ("opacities", 1), ("radiance:sphericalHarmonicsCoefficients", 3 * (degree + 1).pow(2))];
    for (name, width) in lengths {
        ensure!(of(name)?.len() == width * count, "{name}: {} numbers for {count} splats", of(name)?.len());
    }
    ensure!(of("opacities")?.iter().all(|opacity| (0.0..=1.0).contains(opacity)), "an opacity is not between 0 and 1");
    println!("splats: {count}, where the PLY has them");
    Ok(())
}

fn check_lights(luxel: &Luxel) -> Result<()> {
    let layer = luxel.one_layer(&["export", "run", "--lights"], "lit")?;
    let lamps: Vec<_> = layer.fields.keys().filter_map(|(path, _)| path.strip_suffix(".inputs:intensity")).collect();
    ensure!(!lamps.is_empty(), "no lamp was found in the demo's scene");
    for lamp in &lamps {
        ensure!(layer.numbers(&format!("{lamp}.inputs:intensity"))?[0] > 0.0, "{lamp}: no light");
    }
    println!("lights: {}", lamps.len());
    Ok(())
}

fn check_mesh(luxel: &Luxel) -> Result<()> {
    let layer = luxel.one_layer(&["mesh", "run", "--image-size", "64"], "mesh")?;
    let prim = layer.prim_with("faceVertexIndices")?;
    let of = |name: &str| layer.numbers(&format!("{prim}.{name}"));
    let (points, faces, corners) = (of("points")?.len() / 3, of("faceVertexCounts")?, of("faceVertexIndices")?);
    ensure!(faces.iter().all(|count| *count == 3.0) && corners.len() == 3 * faces.len(), "faces are not triangles");
    ensure!(corners.iter().all(|corner| (*corner as usize) < points), "a triangle has a corner beyond the {points} points");
    println!("mesh: {} triangles", faces.len());
    Ok(())
}

fn check_cameras(luxel: &Luxel) -> Result<()> {
    luxel.run(&["render", "run", "--write-cameras", "cameras.usda", "-o", "frames"])?;
    let layer = Layer::read(&luxel.folder.path().join("cameras.usda"))?;
    let lenses: Vec<_> = layer.fields.keys().filter(|(path, field)| path.ends_with(".focalLength") && field == "default").collect();
    ensure!(!lenses.is_empty(), "no cameras");
    for (path, _) in &lenses {
        ensure!(layer.numbers(path)?[0] > 0.0, "{path}: not positive");
    }
    println!("cameras: {}", lenses.len());
    Ok(())
}

fn main() -> Result<()> {
    let program = std::env::args_os().nth(1).context("usage: luxel-openusd-oracle PROGRAM")?;
    let luxel = Luxel { program: fs::canonicalize(program)?, folder: tempfile::tempdir()? };
    luxel.run(&["demo", "--iterations", ITERATIONS, "-o", "run"])?;
    check_splats(&luxel)?;
    check_lights(&luxel)?;
    check_mesh(&luxel)?;
    check_cameras(&luxel)
}
