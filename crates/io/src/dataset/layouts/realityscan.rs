//! RealityScan and RealityCapture: the registration as a table, or an XMP file beside each image.
//!
//! Table ("internal and external camera parameters"): a header with name, x, y, alt, heading, pitch
//! and roll (degrees) and f, of which px, py, k1 to k4, t1 and t2 may be missing, in any order. The
//! camera's OpenGL axes in the world are Rz(-heading) Rx(pitch) Ry(roll). f is for film of 36 mm
//! along the longer side, px and py are shares of the longer side.
//!
//! XMP: `xcr:Rotation` (row by row, camera from world, OpenCV axes), `xcr:Position`,
//! `xcr:FocalLength35mm`, `xcr:PrincipalPointU` and `V` (shares of the longer side), and
//! `xcr:DistortionCoeficients` k1 k2 k3 k4 t1 t2. Both have Brown's distortion, with t1 and t2 as
//! OpenCV's p1 and p2. The division model is refused. Files without a pose are left out and
//! counted.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use roxmltree::{Document, Node};

use crate::IoError;
use crate::byte_order_mark::without_mark;
use crate::dataset::Supervision;
use crate::dataset::components::{ComponentCamera, Coordinates, largest};
use crate::dataset::posed::{CameraFile, FilmLens, PosedCamera, PosedLens, from_opengl, rigid};
use crate::dataset::source::DatasetSource;
use crate::dataset::xml::{numbers, parse_xml};
use crate::lens::{Base, Lens, Warp};
use crate::read_file::read_file;

/// Columns that a table must have.
const REQUIRED: [&str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];
/// Columns of the principal point and of the distortion.
const OPTIONAL: [&str; 8] = ["px", "py", "k1", "k2", "k3", "k4", "t1", "t2"];
/// Namespace of RealityCapture's XMP.
const NAMESPACE: &str = "http://www.capturingreality.com/ns/xcr/1.1#";
/// Folders that XMP files lie in, below the scene's.
pub(in crate::dataset) const XMP_FOLDERS: [&str; 3] = ["", "images", "input"];
/// Largest skew, and deviation of an aspect ratio from 1, that is rounding.
const ROUNDING: f64 = 1e-9;

/// Returns the lens of Brown's model, k1 to k4, t1 and t2.
fn brown([k1, k2, k3, k4, t1, t2]: [f64; 6]) -> Lens {
    Lens { base: Base::Perspective, warp: Warp { radial: [k1, k2, k3, k4, 0.0, 0.0], tangential: [t1, t2], ..Warp::default() } }
}

/// Returns a table without the mark, the empty lines and the number of cameras before its header.
fn without_count(text: &str) -> &str {
    let text = without_mark(text).trim_start();
    let counted = text.strip_prefix("#cameras ").and_then(|rest| rest.split_once('\n'));
    counted.map_or(text, |(_, table)| table.trim_start())
}

/// Returns whether the first line of a file is that of a table of cameras.
pub(in crate::dataset) fn is_table(head: &str) -> bool {
    Columns::of(head).is_ok()
}

/// Reads the table, or the XMP files of the folder.
pub(in crate::dataset) fn realityscan_source(path: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    if path.is_file() {
        return table_source(path, supervision);
    }
    let tables = crate::dataset::candidates::files_with(path, "csv", is_table);
    match tables.as_slice() {
        [] => xmp_source(path, supervision),
        [one] => table_source(one, supervision),
        _ => Err(crate::dataset::candidates::several(path, "tables of cameras", &tables)),
    }
}

fn table_source(path: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let cameras = parse_realityscan_table(path, &read_file(path)?)?;
    let folder = path.parent().unwrap_or(path);
    CameraFile { format: "RealityScan (CSV)".to_owned(), folder, path, supervision }.source(cameras, Vec::new())
}

/// Places of the columns of a table.
struct Columns {
    delimiter: u8,
    required: [usize; REQUIRED.len()],
    optional: [Option<usize>; OPTIONAL.len()],
}

impl Columns {
    /// Finds the columns in the header; an error names those that are missing.
    fn of(header: &str) -> Result<Self, String> {
        let header = without_count(header).lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
        let delimiter = *b",;\t".iter().max_by_key(|mark| header.bytes().filter(|byte| byte == *mark).count()).unwrap_or(&b',');
        let names: Vec<String> = header
            .split(char::from(delimiter))
            .map(|name| name.trim().trim_matches('"').trim_start_matches('#').trim().to_ascii_lowercase())
            .collect();
        let at = |wanted: &str| names.iter().position(|name| name == wanted);
        let missing: Vec<&str> = REQUIRED.into_iter().filter(|name| at(name).is_none()).collect();
        if !missing.is_empty() {
            return Err(format!("line 1: no column {}, expected {} in the header", missing.join(", "), REQUIRED.join(", ")));
        }
        Ok(Self { delimiter, required: REQUIRED.map(|name| at(name).unwrap_or_default()), optional: OPTIONAL.map(at) })
    }
}

/// Parses a table of cameras; `path` is for error messages.
///
/// # Errors
/// A header without the columns of pose and focal length, or a row with something else than numbers
/// in them; rows are counted as lines of the file, from 1.
pub fn parse_realityscan_table(path: &Path, bytes: &[u8]) -> Result<Vec<PosedCamera>, IoError> {
    let invalid = |message: String| IoError::invalid(path, message);
    let text = str::from_utf8(bytes).map_err(|e| invalid(format!("byte {}: not UTF-8 text", e.valid_up_to())))?;
    let text = without_count(text);
    let columns = Columns::of(text).map_err(invalid)?;
    let mut reader = csv::ReaderBuilder::new().delimiter(columns.delimiter).flexible(true).from_reader(text.as_bytes());
    let mut cameras = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| invalid(format!("not a table: {e}")))?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column: usize, name: &str| {
            let field = record.get(column).unwrap_or_default().trim();
            let value = field.parse().ok().filter(|v: &f64| v.is_finite());
            value.ok_or_else(|| invalid(format!("line {line}: {name} is {field:?}, expected a number")))
        };
        let [name_at, rest @ ..] = columns.required;
        let name = record.get(name_at).unwrap_or_default().trim();
        if name.is_empty() {
            return Err(invalid(format!("line {line}: the name is empty, expected an image's")));
        }
        let mut values = [0.0; 7];
        for ((value, column), name) in values.iter_mut().zip(rest).zip(&REQUIRED[1..]) {
            *value = number(column, name)?;
        }
        let mut extra = [0.0; OPTIONAL.len()];
        for ((value, column), name) in extra.iter_mut().zip(columns.optional).zip(OPTIONAL) {
            *value = column.map_or(Ok(0.0), |column| number(column, name))?;
        }
        let [x, y, alt, heading, pitch, roll, focal_mm] = values;
        if focal_mm <= 0.0 {
            return Err(invalid(format!("line {line}: f is {focal_mm}, expected a focal length above 0")));
        }
        let [heading, pitch, roll] = [heading, pitch, roll].map(f64::to_radians);
        let axes = DMat3::from_rotation_z(-heading) * DMat3::from_rotation_x(pitch) * DMat3::from_rotation_y(roll);
        let pose = rigid(from_opengl(axes), DVec3::new(x, y, alt)).map_err(|e| invalid(format!("line {line}: {e}")))?;
        let [px, py, k1, k2, k3, k4, t1, t2] = extra;
        let lens = PosedLens::Film(FilmLens { focal_mm, shift: [px, py], lens: brown([k1, k2, k3, k4, t1, t2]) });
        cameras.push(PosedCamera { name: name.to_owned(), camera_from_world: pose, lens, place: format!("line {line}") });
    }
    Ok(cameras)
}

/// Returns the XMP files of a scene's folder that are of the program.
pub(in crate::dataset) fn xmp_files(folder: &Path) -> Vec<PathBuf> {
    XMP_FOLDERS.iter().flat_map(|sub| crate::dataset::candidates::files_with(&folder.join(sub), "xmp", is_xmp)).collect()
}

/// Returns whether the beginning of an XMP file is one of the program: other programs write XMP,
/// too.
fn is_xmp(head: &str) -> bool {
    head.contains(NAMESPACE)
}

fn xmp_source(folder: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let files = xmp_files(folder);
    if files.is_empty() {
        return Err(IoError::invalid(folder, "no table of cameras (.csv) and no XMP files of RealityScan, expected one or the other"));
    }
    let (mut cameras, mut without) = (Vec::new(), 0usize);
    let total = files.len();
    for file in files {
        let bytes = read_file(&file)?;
        match parse_realityscan_xmp(&file, &bytes)? {
            Some(camera) => cameras.push(ComponentCamera { camera, coordinates: xmp_coordinates(&file, &bytes)? }),
            None => without += 1,
        }
    }
    let (cameras, of_components) = largest(cameras);
    let warning = (without > 0).then(|| format!("{without} of {total} XMP files hold no pose: their images are left out"));
    let file = CameraFile { format: "RealityScan (XMP)".to_owned(), folder, path: folder, supervision };
    file.source(cameras, warning.into_iter().chain(of_components).collect())
}

/// Returns the coordinates that an XMP file's pose is in: those of its component, unless they are
/// absolute.
fn xmp_coordinates(path: &Path, bytes: &[u8]) -> Result<Coordinates, IoError> {
    let text = crate::dataset::xml::text_of(path, bytes)?;
    let document: Document<'_> = parse_xml(path, text)?;
    let is_absolute = field(&document, "Coordinates").is_some_and(|kind| kind == "absolute");
    let component = field(&document, "ComponentId").filter(|_| !is_absolute);
    Ok(component.map_or(Coordinates::World, |id| Coordinates::Own(format!("component {id}"))))
}

/// Parses an XMP file; `path` names the image, too. `None` for a file without a pose.
///
/// # Errors
/// Text that is not XML, numbers that are missing or wrong, a lens model other than Brown's.
pub fn parse_realityscan_xmp(path: &Path, bytes: &[u8]) -> Result<Option<PosedCamera>, IoError> {
    let text = crate::dataset::xml::text_of(path, bytes)?;
    let document: Document<'_> = parse_xml(path, text)?;
    let field = |name: &str| field(&document, name);
    let list = |name: &str, count: usize| -> Result<Option<Vec<f64>>, IoError> {
        let Some(text) = field(name) else { return Ok(None) };
        let values = numbers(&text).filter(|values| values.len() == count);
        values.map(Some).ok_or_else(|| IoError::invalid(path, format!("xcr:{name} is {text:?}, expected {count} numbers")))
    };
    let number = |name: &str| Ok::<_, IoError>(list(name, 1)?.and_then(|values| values.first().copied()));
    let (Some(rotation), Some(position)) = (list("Rotation", 9)?, list("Position", 3)?) else { return Ok(None) };
    let axes = DMat3::from_cols_slice(&rotation);
    let pose = rigid(axes, DVec3::from_slice(&position)).map_err(|e| IoError::invalid(path, format!("xcr:Rotation: {e}")))?;
    let Some(focal_mm) = number("FocalLength35mm")? else {
        return Err(IoError::invalid(path, "xcr:FocalLength35mm is missing, expected a focal length: export the calibration, too"));
    };
    if focal_mm <= 0.0 {
        return Err(IoError::invalid(path, format!("xcr:FocalLength35mm is {focal_mm}, expected a number above 0")));
    }
    for (name, neutral) in [("Skew", 0.0), ("AspectRatio", 1.0)] {
        if let Some(value) = number(name)?.filter(|value| (value - neutral).abs() > ROUNDING) {
            return Err(IoError::unsupported(path, format!("xcr:{name} is {value}, expected {neutral}; export undistorted images")));
        }
    }
    let coefficients = match list("DistortionCoeficients", 6)? {
        Some(values) => std::array::from_fn(|i| values[i]),
        None => [0.0; 6],
    };
    let model = field("DistortionModel").unwrap_or_default();
    let is_brown = model.is_empty() || model.starts_with("brown") || model == "perspective";
    if !is_brown && coefficients.iter().any(|k| *k != 0.0) {
        let remedy = "choose a Brown model in the alignment settings before the export, or export undistorted images";
        return Err(IoError::unsupported(path, format!("distortion model {model:?}, expected brown3, brown4 and the like; {remedy}")));
    }
    let shift = [number("PrincipalPointU")?.unwrap_or(0.0), number("PrincipalPointV")?.unwrap_or(0.0)];
    let lens = PosedLens::Film(FilmLens { focal_mm, shift, lens: brown(coefficients) });
    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Some(PosedCamera { name, camera_from_world: pose, lens, place: "XMP".to_owned() }))
}

/// Returns the text of a field of the program, which is an attribute or an element.
fn field(document: &Document<'_>, name: &str) -> Option<String> {
    let of_node = |node: Node<'_, '_>| {
        let attribute = node.attribute((NAMESPACE, name)).map(str::to_owned);
        attribute.or_else(|| node.has_tag_name((NAMESPACE, name)).then(|| node.text().unwrap_or_default().to_owned()))
    };
    document.descendants().filter(Node::is_element).find_map(of_node)
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use proptest::prelude::*;

    use super::*;

    const HEADER: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n";
    const ROW: &str = "a.jpg,10,20,3,90,60,0,18,0.01,-0.02,-0.1,0.02,0.003,0,0.001,-0.002\n";

    fn table(text: &str) -> Result<Vec<PosedCamera>, IoError> {
        parse_realityscan_table(Path::new("cameras.csv"), text.as_bytes())
    }

    #[test]
    fn a_point_lands_where_the_programs_formula_says() {
        let camera = &table(&format!("{HEADER}{ROW}")).unwrap()[0];
        let seen = camera.camera([4000, 3000]).unwrap();
        assert!(seen.eye().distance(DVec3::new(10.0, 20.0, 3.0)) < 1e-12);
        // Heading 90 turns north to east, pitch 60 lifts the gaze from straight down: east and
        // down.
        let forward = DVec3::new(60f64.to_radians().sin(), 0.0, -60f64.to_radians().cos());
        assert!(seen.forward().distance(forward) < 1e-12, "{}", seen.forward());
        // The camera's right is south.
        let right = seen.camera_from_world.matrix3.row(0);
        assert!(right.distance(DVec3::NEG_Y) < 1e-12, "{right}");
        // 18 mm on 36 mm of film are half of the longer side.
        assert!((seen.focal_px.x - 2000.0).abs() < 1e-9 && seen.center_px.distance(DVec2::new(2040.0, 1420.0)) < 1e-9);
        let PosedLens::Film(film) = camera.lens else { unreachable!() };
        let found = film.lens.prepared().project(DVec3::new(0.2, -0.3, 1.0)).unwrap();
        let (x, y, r2) = (0.2, -0.3, 0.13f64);
        let radial = 1.0 - 0.1 * r2 + 0.02 * r2 * r2 + 0.003 * r2 * r2 * r2;
        let expected = DVec2::new(
            x * radial + 2.0 * 0.001 * x * y - 0.002 * (r2 + 2.0 * x * x),
            y * radial + 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.002 * x * y,
        );
        assert!(found.distance(expected) < 1e-12);
    }

    #[test]
    fn columns_may_be_missing_and_in_any_order() {
        let found = table("name;f;roll;pitch;heading;alt;y;x\n\"b 1.jpg\";20;0;0;0;3;2;1\n").unwrap();
        assert_eq!((found.len(), found[0].name.as_str()), (1, "b 1.jpg"));
        assert!(found[0].camera([60, 40]).unwrap().eye().distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-12);
        assert_eq!(table(HEADER).unwrap(), []);
        assert_eq!(table(&format!("#cameras 1\r\n{HEADER}{ROW}")).unwrap().len(), 1);
    }

    #[test]
    fn what_is_wrong_in_a_table_is_named() {
        let message = |text: &str| table(text).unwrap_err().message;
        assert!(message("#name,x,y,alt\na,1,2,3\n").contains("no column heading, pitch, roll, f"));
        assert!(message(&format!("{HEADER}{ROW}{}", ROW.replace("60", "sixty"))).contains("line 3: pitch is \"sixty\", expected a number"));
        assert!(message(&format!("{HEADER}a.jpg,1,2\n")).contains("line 2: alt is \"\""));
        assert!(message(&format!("{HEADER}{}", ROW.replace(",18,", ",0,"))).contains("f is 0, expected a focal length"));
        assert!(message(&format!("{HEADER}{}", ROW.replace("a.jpg", " "))).contains("the name is empty"));
        assert!(message(&format!("{HEADER}{}", ROW.replace("20", "1e999"))).contains("y is \"1e999\""));
    }

    const XMP: &str = r#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xcr:Version="3" xcr:PosePrior="exact" xcr:Coordinates="absolute" xcr:DistortionModel="brown3" xcr:FocalLength35mm="18"
 xcr:Skew="0" xcr:AspectRatio="1" xcr:PrincipalPointU="0.01" xcr:PrincipalPointV="-0.02" xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">
<xcr:Rotation>0 -1 0 -0.5 0 -0.86602540378443865 0.86602540378443865 0 -0.5</xcr:Rotation><xcr:Position>10 20 3</xcr:Position>
<xcr:DistortionCoeficients>-0.1 0.02 0.003 0 0.001 -0.002</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>"#;

    fn xmp(text: &str) -> Result<Option<PosedCamera>, IoError> {
        parse_realityscan_xmp(Path::new("images/a.xmp"), text.as_bytes())
    }

    #[test]
    fn an_xmp_file_is_the_camera_of_its_row() {
        let found = xmp(XMP).unwrap().unwrap();
        let row = &table(&format!("{HEADER}{ROW}")).unwrap()[0];
        assert_eq!((found.name.as_str(), found.lens), ("a", row.lens));
        assert!(found.camera_from_world.abs_diff_eq(row.camera_from_world, 1e-12), "{} {}", found.camera_from_world, row.camera_from_world);
    }

    #[test]
    fn what_is_wrong_in_an_xmp_file_is_named() {
        let message = |from: &str, to: &str| {
            assert!(XMP.contains(from));
            xmp(&XMP.replace(from, to)).unwrap_err().message
        };
        assert!(message("10 20 3", "10 20").contains("xcr:Position is \"10 20\", expected 3 numbers"));
        assert!(message("0 -1 0 ", "0 -2 0 ").contains("xcr:Rotation: the pose is not a rotation"));
        assert!(message("xcr:FocalLength35mm=\"18\"", "").contains("FocalLength35mm is missing"));
        assert!(message("AspectRatio=\"1\"", "AspectRatio=\"1.01\"").contains("AspectRatio is 1.01"));
        assert!(message("brown3", "division").contains("distortion model \"division\""));
        assert!(message("</rdf:RDF>", "").contains("not XML"));
        let without = XMP.replace("<xcr:Position>10 20 3</xcr:Position>", "");
        assert_eq!(xmp(&without).unwrap(), None);
    }

    proptest! {
        #[test]
        fn damage_gives_cameras_or_errors(at: prop::sample::Index, byte: u8, text in "[0-9.,;a-z#\n\"-]{0,200}") {
            for whole in [format!("{HEADER}{ROW}"), XMP.to_owned()] {
                let mut bytes = whole.into_bytes();
                let at = at.index(bytes.len());
                bytes[at] = byte;
                for camera in parse_realityscan_table(Path::new("t"), &bytes).unwrap_or_default() {
                    let _ = camera.camera([40, 30]);
                }
                let _ = parse_realityscan_xmp(Path::new("x"), &bytes);
            }
            let _ = table(&format!("{HEADER}{text}"));
        }
    }
}
