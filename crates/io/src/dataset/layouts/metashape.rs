//! Agisoft Metashape (and PhotoScan): cameras exported as XML.
//!
//! In: `sensors` with calibrations, `components` and `cameras` of each chunk. A camera's transform
//! is its OpenCV axes and place in the coordinates of its component, else of its chunk, whose own
//! transform (rotation, translation, scale) leads to the world. Cameras that are disabled or not
//! aligned are left out and counted. Pixel centres are at +0.5; `cx` and `cy` count from the
//! image's middle.
//!
//! Lenses, from the manual's appendix: x and y are X/Z and Y/Z (frame), or these scaled to the
//! radius of an equidistant or equisolid fisheye. `x' = x (1 + K1 r² + ... + K4 r⁸) + (P1 (r² +
//! 2 x²) + 2 P2 x y) (1 + P3 r² + P4 r⁴)`, and y' with P1 and P2 exchanged; `u = w/2 + cx + x' f +
//! x' B1 + y' B2`, `v = h/2 + cy + y' f`. Spherical sensors are panoramas. Other types are refused.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::{DMat3, DVec2, DVec3};
use luxel_core::{MAX_SIDE_PX, Similarity};
use roxmltree::{Document, Node};

use crate::IoError;
use crate::dataset::Supervision;
use crate::dataset::components::{ComponentCamera, Coordinates, largest};
use crate::dataset::intrinsics::LensImage;
use crate::dataset::posed::{CameraFile, PosedCamera, PosedLens, rigid};
use crate::dataset::source::DatasetSource;
use crate::dataset::xml::{child, numbers, parse_xml, text_of};
use crate::lens::{Base, Lens, Warp};
use crate::read_file::read_file;

/// Names that a warning lists.
const MAX_LISTED: usize = 3;

/// Cameras of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MetashapeCameras {
    /// Aligned and enabled cameras, in the order of the file.
    pub cameras: Vec<PosedCamera>,
    /// Lines about cameras that are left out, for people.
    pub warnings: Vec<String>,
}

/// Returns whether the beginning of a file is that of Metashape's XML.
pub(in crate::dataset) fn is_metashape(head: &str) -> bool {
    head.contains("<document") && head.contains("<chunk")
}

/// Reads the cameras and finds the images.
pub(in crate::dataset) fn metashape_source(path: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let found = if path.is_file() { vec![path.to_path_buf()] } else { crate::dataset::candidates::files_with(path, "xml", is_metashape) };
    let file = match found.as_slice() {
        [one] => one,
        [] => return Err(IoError::invalid(path, "no XML file of Metashape's cameras, expected one")),
        several => return Err(crate::dataset::candidates::several(path, "XML files of Metashape's cameras", several)),
    };
    let MetashapeCameras { cameras, warnings } = parse_metashape(file, &read_file(file)?)?;
    let folder = file.parent().unwrap_or(file);
    CameraFile { format: "Metashape (XML)".to_owned(), folder, path: file, supervision }.source(cameras, warnings)
}

/// A file under way of being read.
struct File<'a> {
    path: &'a Path,
}

impl File<'_> {
    fn error(&self, node: Node<'_, '_>, message: impl std::fmt::Display) -> IoError {
        let line = node.document().text_pos_at(node.range().start).row;
        IoError::invalid(self.path, format!("line {line}: <{}>: {message}", node.tag_name().name()))
    }

    /// Returns the numbers of an element.
    fn numbers<const N: usize>(&self, node: Node<'_, '_>) -> Result<[f64; N], IoError> {
        let text = node.text().unwrap_or_default();
        let values = numbers(text).and_then(|values| <[f64; N]>::try_from(values).ok());
        values.ok_or_else(|| self.error(node, format!("found {text:?}, expected {N} numbers")))
    }

    /// Returns the number of a child element, if it is there.
    fn number(&self, node: Node<'_, '_>, name: &str) -> Result<Option<f64>, IoError> {
        let Some(found) = child(node, name) else { return Ok(None) };
        self.numbers(found).map(|[value]| Some(value))
    }

    fn size(&self, sensor: Node<'_, '_>) -> Result<[u32; 2], IoError> {
        let Some(resolution) = child(sensor, "resolution") else {
            return Err(self.error(sensor, "no <resolution>, expected the size of its images"));
        };
        let side = |name: &str| {
            let text = resolution.attribute(name).unwrap_or_default();
            let side = text.parse().ok().filter(|side| (1..=MAX_SIDE_PX).contains(side));
            side.ok_or_else(|| self.error(resolution, format!("{name} is {text:?}, expected 1 to {MAX_SIDE_PX} pixels")))
        };
        Ok([side("width")?, side("height")?])
    }

    /// Returns the intrinsics of a sensor; `None` for one that is not calibrated.
    fn sensor(&self, sensor: Node<'_, '_>) -> Result<Option<LensImage>, IoError> {
        let size_px = self.size(sensor)?;
        let [width, height] = size_px.map(f64::from);
        let calibrations = || sensor.children().filter(|node| node.has_tag_name("calibration"));
        let adjusted = calibrations().find(|node| node.attribute("class") == Some("adjusted"));
        let calibration = adjusted.or_else(|| calibrations().next_back());
        let kind = calibration.and_then(|node| node.attribute("type")).or_else(|| sensor.attribute("type")).unwrap_or("frame");
        let base = match kind {
            "frame" => Base::Perspective,
            "fisheye" | "equidistant_fisheye" => Base::Equidistant,
            "equisolid_fisheye" => Base::Equisolid,
            "spherical" | "equirectangular" => {
                let focal_px = DVec2::new(width / TAU, height / PI);
                let lens = Lens { base: Base::Equirectangular, warp: Warp::default() };
                return Ok(Some(LensImage { size_px, focal_px, center_px: DVec2::new(0.5 * width, 0.5 * height), lens }));
            }
            other => {
                let known = "frame, fisheye, equisolid_fisheye or spherical";
                return Err(IoError::unsupported(
                    self.path,
                    format!("sensor type {other:?}, expected {known}; export undistorted images with their cameras"),
                ));
            }
        };
        let Some(node) = calibration else { return Ok(None) };
        let Some(f) = self.number(node, "f")? else {
            return Err(self.error(node, "no focal length <f>, expected one in pixels (Metashape 1.2 and later)"));
        };
        let mut of = [0.0; 12];
        for (value, name) in of.iter_mut().zip(["cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4", "b1", "b2"]) {
            *value = self.number(node, name)?.unwrap_or(0.0);
        }
        let [cx, cy, k1, k2, k3, k4, p1, p2, p3, p4, b1, b2] = of;
        let warp = Warp {
            radial: [k1, k2, k3, k4, 0.0, 0.0],
            // Metashape's P1 is OpenCV's p2, and the other way round.
            tangential: [p2, p1],
            tangential_radial: [p3, p4],
            shear: b2 / (f + b1),
            ..Warp::default()
        };
        let center_px = DVec2::new(0.5 * width + cx, 0.5 * height + cy);
        Ok(Some(LensImage { size_px, focal_px: DVec2::new(f + b1, f), center_px, lens: Lens { base, warp } }))
    }

    /// Returns the transform of a chunk or a component to the world, if it has one.
    fn transform(&self, node: Node<'_, '_>) -> Result<Option<Similarity>, IoError> {
        let Some(transform) = child(node, "transform") else { return Ok(None) };
        let rotation = match child(transform, "rotation") {
            Some(node) => rigid(DMat3::from_cols_array(&self.numbers(node)?).transpose(), DVec3::ZERO)
                .map_err(|e| self.error(node, e))?
                .matrix3
                .transpose(),
            None => DMat3::IDENTITY,
        };
        let translation = child(transform, "translation").map_or(Ok([0.0; 3]), |node| self.numbers(node))?;
        let scale = self.number(transform, "scale")?.unwrap_or(1.0);
        let found = Similarity::new(rotation, scale, DVec3::from(translation));
        found.map(Some).ok_or_else(|| self.error(transform, format!("scale {scale}, expected a number above 0")))
    }
}

/// Names of cameras that are left out, by reason.
#[derive(Default)]
struct LeftOut {
    disabled: Vec<String>,
    unaligned: Vec<String>,
    of_rigs: Vec<String>,
}

impl LeftOut {
    fn warnings(&self) -> Vec<String> {
        let kinds = [
            (&self.disabled, "disabled"),
            (&self.unaligned, "not aligned"),
            (&self.of_rigs, "of a rig and placed relative to its master only"),
        ];
        let line = |(names, what): &(&Vec<String>, &str)| {
            let listed = names.iter().take(MAX_LISTED).cloned().collect::<Vec<_>>().join(", ");
            let more = if names.len() > MAX_LISTED { ", ..." } else { "" };
            let cameras = luxel_core::text::plural(names.len(), "camera");
            format!("left out, as {what}: {cameras} ({listed}{more})")
        };
        kinds.iter().filter(|(names, _)| !names.is_empty()).map(line).collect()
    }
}

/// Parses the XML of cameras; `path` is for error messages.
///
/// # Errors
/// Text that is not XML or not Metashape's, numbers that are missing or wrong (with their line), a
/// sensor of another type.
pub fn parse_metashape(path: &Path, bytes: &[u8]) -> Result<MetashapeCameras, IoError> {
    let document: Document<'_> = parse_xml(path, text_of(path, bytes)?)?;
    let root = document.root_element();
    if !root.has_tag_name("document") {
        return Err(IoError::invalid(path, format!("root element <{}>, expected Metashape's <document>", root.tag_name().name())));
    }
    let file = File { path };
    let (mut cameras, mut left_out) = (Vec::new(), LeftOut::default());
    for chunk in root.children().filter(|node| node.has_tag_name("chunk")) {
        chunk_cameras(&file, chunk, &mut cameras, &mut left_out)?;
    }
    let (cameras, of_components) = largest(cameras);
    Ok(MetashapeCameras { cameras, warnings: left_out.warnings().into_iter().chain(of_components).collect() })
}

/// Returns the name of coordinates that only the cameras of a component of a chunk have.
fn own_coordinates(chunk: Node<'_, '_>, component: Option<Node<'_, '_>>) -> Coordinates {
    let label = |node: Node<'_, '_>| node.attribute("label").or_else(|| node.attribute("id")).unwrap_or("without a label").to_owned();
    let of_chunk = format!("chunk {:?} (line {})", label(chunk), chunk.document().text_pos_at(chunk.range().start).row);
    Coordinates::Own(component.map_or(of_chunk.clone(), |component| format!("component {:?} of {of_chunk}", label(component))))
}

fn chunk_cameras(file: &File<'_>, chunk: Node<'_, '_>, out: &mut Vec<ComponentCamera>, left_out: &mut LeftOut) -> Result<(), IoError> {
    let within = |list: &str, item: &'static str| {
        let list = child(chunk, list);
        list.into_iter().flat_map(move |node| node.descendants().filter(move |node| node.has_tag_name(item))).collect::<Vec<_>>()
    };
    let mut sensors: HashMap<&str, Option<LensImage>> = HashMap::new();
    for sensor in within("sensors", "sensor") {
        sensors.insert(sensor.attribute("id").unwrap_or_default(), file.sensor(sensor)?);
    }
    let mut components: HashMap<&str, (Node<'_, '_>, Option<Similarity>)> = HashMap::new();
    for component in within("components", "component") {
        components.insert(component.attribute("id").unwrap_or_default(), (component, file.transform(component)?));
    }
    let world_from_chunk = file.transform(chunk)?;
    let first = out.len();
    for camera in within("cameras", "camera") {
        let label = camera.attribute("label").unwrap_or_default().to_owned();
        let is_disabled = camera.attribute("enabled").is_some_and(|text| matches!(text, "0" | "false"));
        let Some(transform) = child(camera, "transform").filter(|_| !is_disabled) else {
            let is_of_rig = camera.attribute("master_id").is_some();
            match (is_disabled, is_of_rig) {
                (true, _) => left_out.disabled.push(label),
                (false, true) => left_out.of_rigs.push(label),
                (false, false) => left_out.unaligned.push(label),
            }
            continue;
        };
        if label.is_empty() {
            return Err(file.error(camera, "no label, expected the image's name"));
        }
        let sensor = camera.attribute("sensor_id").unwrap_or_default();
        let Some(known) = sensors.get(sensor) else {
            return Err(file.error(camera, format!("{label:?} is of sensor {sensor:?}, which is not among the sensors")));
        };
        let Some(intrinsics) = known else {
            return Err(file.error(camera, format!("{label:?} is of sensor {sensor:?}, which has no <calibration>")));
        };
        let m: [f64; 16] = file.numbers(transform)?;
        let axes = DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| [m[c], m[4 + c], m[8 + c]]));
        let mut pose = rigid(axes, DVec3::new(m[3], m[7], m[11])).map_err(|e| file.error(transform, format!("{label:?}: {e}")))?;
        let component = camera.attribute("component_id").and_then(|id| components.get(id));
        let of_component = component.and_then(|(_, transform)| transform.as_ref());
        if let Some(to_world) = of_component.or(world_from_chunk.as_ref()) {
            to_world.apply_to_pose(&mut pose);
        }
        // A camera of no component among components cannot be told from theirs.
        let coordinates = match of_component {
            None if component.is_some() || components.is_empty() => own_coordinates(chunk, component.map(|(node, _)| *node)),
            _ => Coordinates::World,
        };
        let place = format!("camera {}", camera.attribute("id").unwrap_or_default());
        let camera = PosedCamera { name: label, camera_from_world: pose, lens: PosedLens::Pixels(*intrinsics), place };
        out.push(ComponentCamera { camera, coordinates });
    }
    if world_from_chunk.is_some() {
        join_to_world(&mut out[first..]);
    }
    Ok(())
}

/// Puts the cameras of a chunk with a transform into the world, as far as it is theirs: of several
/// components without a transform of their own it can only be one's.
fn join_to_world(of_chunk: &mut [ComponentCamera]) {
    let mut own: Vec<&Coordinates> = of_chunk.iter().map(|found| &found.coordinates).filter(|c| **c != Coordinates::World).collect();
    own.sort_unstable();
    own.dedup();
    if own.len() == 1 {
        of_chunk.iter_mut().for_each(|found| found.coordinates = Coordinates::World);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const XML: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
  <chunk label="Chunk 1" enabled="true">
    <sensors next_id="3">
      <sensor id="0" label="frame" type="frame">
        <resolution width="640" height="480"/>
        <calibration type="frame" class="initial"><resolution width="640" height="480"/><f>1</f></calibration>
        <calibration type="frame" class="adjusted">
          <resolution width="640" height="480"/>
          <f>500</f><cx>3</cx><cy>-2</cy><b1>4</b1><b2>5</b2>
          <k1>-0.1</k1><k2>0.02</k2><k3>0.003</k3><k4>-0.001</k4><p1>0.004</p1><p2>-0.005</p2>
        </calibration>
      </sensor>
      <sensor id="1" label="fish" type="fisheye">
        <resolution width="640" height="480"/>
        <calibration type="fisheye" class="adjusted"><f>200</f><k1>-0.05</k1><p1>0.001</p1></calibration>
      </sensor>
      <sensor id="2" label="ball" type="spherical"><resolution width="640" height="320"/></sensor>
    </sensors>
    <components next_id="1"><component id="0" label="Component 1">
      <transform><rotation locked="0">0 -1 0 1 0 0 0 0 1</rotation><translation locked="0">100 200 300</translation><scale locked="0">2</scale></transform>
    </component></components>
    <cameras next_id="6">
      <camera id="0" sensor_id="0" component_id="0" label="a.jpg"><transform>1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1</transform></camera>
      <group id="0" label="more"><camera id="1" sensor_id="1" label="b.jpg" enabled="true"><transform>1 0 0 0 0 -1 0 0 0 0 -1 0 0 0 0 1</transform></camera></group>
      <camera id="2" sensor_id="2" label="c"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>
      <camera id="3" sensor_id="0" label="d" enabled="false"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>
      <camera id="4" sensor_id="0" label="e"/>
      <camera id="5" sensor_id="0" master_id="0" label="f"/>
    </cameras>
  </chunk>
</document>"#;

    fn parse(text: &str) -> Result<MetashapeCameras, IoError> {
        parse_metashape(Path::new("cameras.xml"), text.as_bytes())
    }

    /// Returns the pixel of a direction in camera coordinates.
    fn pixel(camera: &PosedCamera, direction: DVec3) -> DVec2 {
        let PosedLens::Pixels(LensImage { focal_px, center_px, lens, .. }) = camera.lens else { unreachable!() };
        lens.prepared().project(direction).unwrap() * focal_px + center_px
    }

    #[test]
    fn points_land_where_the_manuals_formulas_say() {
        let MetashapeCameras { cameras, warnings } = parse(XML).unwrap();
        assert_eq!(cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>(), ["a.jpg", "b.jpg", "c"]);
        assert_eq!(
            warnings,
            [
                "left out, as disabled: 1 camera (d)",
                "left out, as not aligned: 1 camera (e)",
                "left out, as of a rig and placed relative to its master only: 1 camera (f)"
            ]
        );
        let direction = DVec3::new(0.3, -0.2, 1.0);
        let (x, y, r2) = (0.3, -0.2, 0.13f64);
        let radial = 1.0 - 0.1 * r2 + 0.02 * r2.powi(2) + 0.003 * r2.powi(3) - 0.001 * r2.powi(4);
        let bent_x = x * radial + 0.004 * (r2 + 2.0 * x * x) + 2.0 * -0.005 * x * y;
        let bent_y = y * radial + -0.005 * (r2 + 2.0 * y * y) + 2.0 * 0.004 * x * y;
        let frame = DVec2::new(320.0 + 3.0 + bent_x * 500.0 + bent_x * 4.0 + bent_y * 5.0, 240.0 - 2.0 + bent_y * 500.0);
        assert!(pixel(&cameras[0], direction).distance(frame) < 1e-9);
        let r0 = r2.sqrt();
        let (fx, fy, t) = (x * r0.atan() / r0, y * r0.atan() / r0, r0.atan().powi(2));
        let fish = DVec2::new(
            320.0 + 200.0 * (fx * (1.0 - 0.05 * t) + 0.001 * (t + 2.0 * fx * fx)),
            240.0 + 200.0 * (fy * (1.0 - 0.05 * t) + 2.0 * 0.001 * fx * fy),
        );
        assert!(pixel(&cameras[1], direction).distance(fish) < 1e-9);
        let ball = DVec2::new(320.0 + 640.0 / TAU * 0.3f64.atan(), 160.0 + 640.0 / TAU * (-0.2f64).atan2(1.09f64.sqrt()));
        assert!(pixel(&cameras[2], direction).distance(ball) < 1e-9);
    }

    #[test]
    fn the_components_transform_leads_to_the_world() {
        let cameras = parse(XML).unwrap().cameras;
        // 2 R (1, 2, 3) + t, R a quarter turn about z.
        let pose = &cameras[0].camera_from_world;
        assert!(pose.transform_point3(DVec3::new(96.0, 202.0, 306.0)).length() < 1e-9);
        // The camera looks along its z, its x is the world's y.
        assert!(pose.matrix3.row(2).distance(DVec3::Z) < 1e-12 && pose.matrix3.row(0).distance(DVec3::Y) < 1e-12);
        // Without a component, a chunk's transform; without either, none.
        assert!(cameras[1].camera_from_world.transform_point3(DVec3::ZERO).length() < 1e-12);
        let of_chunk = XML.replace("</components>", "</components><transform><scale>3</scale><translation>0 0 1</translation></transform>");
        let cameras = parse(&of_chunk).unwrap().cameras;
        assert!(cameras[1].camera_from_world.transform_point3(DVec3::Z).length() < 1e-12);
    }

    /// Returns a chunk of cameras at x = 0, 1, 2, ... of these components; `more` follows them.
    fn chunk(label: &str, components: &[usize], of_component: &str, more: &str) -> String {
        let camera = |(x, component): (usize, &usize)| {
            format!(
                "<camera id=\"{x}\" sensor_id=\"0\" component_id=\"{component}\" label=\"{label}{x}\">\
                 <transform>1 0 0 {x} 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>"
            )
        };
        let cameras: String = components.iter().enumerate().map(camera).collect();
        format!(
            "<chunk label=\"{label}\"><sensors><sensor id=\"0\" type=\"frame\"><resolution width=\"64\" height=\"48\"/>\
             <calibration><f>50</f></calibration></sensor></sensors><components><component id=\"0\" label=\"large\">{of_component}</component>\
             <component id=\"1\" label=\"small\">{of_component}</component></components><cameras>{cameras}</cameras>{more}</chunk>"
        )
    }

    #[test]
    fn of_components_that_nothing_relates_the_largest_is_read() {
        let names = |xml: &str| {
            let found = parse(&format!("<document>{xml}</document>")).unwrap();
            (found.cameras.iter().map(|camera| camera.name.clone()).collect::<Vec<_>>(), found.warnings)
        };
        let (kept, warnings) = names(&chunk("a", &[1, 0, 0], "", ""));
        assert_eq!(kept, ["a1", "a2"]);
        assert!(warnings[0].contains("\"large\"") && warnings[0].contains("left out: component \"small\""), "{warnings:?}");
        // A transform of the chunk is that of one component only.
        let transform = "<transform><scale>2</scale></transform>";
        assert_eq!(names(&chunk("a", &[1, 0, 0], "", transform)).0.len(), 2);
        assert_eq!(names(&chunk("a", &[0, 0, 0], "", transform)), (["a0", "a1", "a2"].map(str::to_owned).to_vec(), Vec::new()));
        // Components with transforms of their own are in the world, and so are chunks.
        assert_eq!(names(&chunk("a", &[1, 0, 0], transform, "")), (["a0", "a1", "a2"].map(str::to_owned).to_vec(), Vec::new()));
        let georeferenced = [chunk("a", &[0], "", transform), chunk("b", &[0, 0], "", transform)].concat();
        assert_eq!(names(&georeferenced).0.len(), 3);
        let (kept, warnings) = names(&[chunk("a", &[0], "", ""), chunk("b", &[0, 0], "", "")].concat());
        assert_eq!(kept, ["b0", "b1"]);
        assert!(warnings[0].contains("chunk \"a\""), "{warnings:?}");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let message = |from: &str, to: &str| {
            assert!(XML.contains(from), "{from}");
            parse(&XML.replace(from, to)).unwrap_err().message
        };
        assert!(message("</chunk>", "").contains("not XML"));
        assert!(message("<f>500</f>", "").contains("line 8: <calibration>: no focal length <f>"));
        assert!(message("<f>500</f>", "<f>five</f>").contains("<f>: found \"five\", expected 1 numbers"));
        assert!(message("sensor_id=\"2\"", "sensor_id=\"9\"").contains("\"c\" is of sensor \"9\", which is not among"));
        assert!(message("type=\"spherical\"", "type=\"cylindrical\"").contains("sensor type \"cylindrical\""));
        assert!(message("width=\"640\" height=\"320\"", "width=\"0\" height=\"320\"").contains("width is \"0\""));
        assert!(message("<transform>1 0 0 1 ", "<transform>2 0 0 1 ").contains("\"a.jpg\": the pose is not a rotation"));
        assert!(message("<scale locked=\"0\">2", "<scale locked=\"0\">0").contains("scale 0, expected a number above 0"));
        assert!(parse("<other/>").unwrap_err().message.contains("root element <other>"));
        let entities = "<!DOCTYPE d [<!ENTITY a \"aaaa\">]><document>&a;</document>";
        assert!(parse(entities).unwrap_err().message.contains("not XML"));
    }

    proptest! {
        #[test]
        fn damage_gives_cameras_or_errors(at: prop::sample::Index, byte: u8) {
            let mut bytes = XML.as_bytes().to_vec();
            let at = at.index(bytes.len());
            bytes[at] = byte;
            for camera in parse_metashape(Path::new("c"), &bytes).unwrap_or_default().cameras {
                let _ = camera.camera([640, 480]);
            }
        }
    }
}
