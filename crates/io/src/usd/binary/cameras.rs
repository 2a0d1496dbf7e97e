//! Cameras in a crate file, with the transforms of the prims around them.

use std::collections::HashMap;

use super::reader::CrateReader;
use super::spec;
use super::tables::Spec;
use crate::usd::ORDER;
use crate::usd::cameras::{OPERATION, PROPERTIES, Timed, Transform, UsdCamera, UsdCameras};

/// The number of the specifier of classes, which are templates.
pub(super) const CLASS: u64 = 2;

/// The values of a prim's attributes.
#[derive(Default)]
struct Attributes {
    properties: HashMap<String, Timed>,
    transform: Transform,
    is_orthographic: bool,
}

/// Reads the cameras of a crate file's bytes.
///
/// # Errors
/// Damaged bytes; values of cameras and transforms that are not numbers.
pub(in crate::usd) fn read_cameras(bytes: &[u8]) -> Result<UsdCameras, String> {
    let file = CrateReader::new(bytes)?;
    let specs = &file.tables.specs;
    // Prims within variants are not composed.
    let prims = || specs.iter().filter(|s| s.kind == spec::PRIM && !s.path.contains('{'));
    let mut by_path: HashMap<&str, Attributes> = HashMap::new();
    for attribute in specs.iter().filter(|s| s.kind == spec::ATTRIBUTE) {
        if let Some((owner, name)) = attribute.path.rsplit_once('.') {
            take(&file, attribute, name, by_path.entry(owner).or_default())?;
        }
    }
    let classes: Vec<&str> = prims().filter(|s| file.specifier(s) == Some(CLASS)).map(|s| s.path.as_str()).collect();
    let is_template = |path: &str| around(path).any(|prim| classes.contains(&prim));
    let is_camera = |s: &&Spec| file.token(s, "typeName") == Some("Camera") && !is_template(&s.path);
    let camera = |s: &Spec| {
        let own = by_path.get(s.path.as_str());
        UsdCamera {
            path: s.path.clone(),
            properties: own.map(|own| own.properties.clone()).unwrap_or_default(),
            is_orthographic: own.is_some_and(|own| own.is_orthographic),
            transforms: around(&s.path).map(|prim| by_path.get(prim).map(|found| found.transform.clone()).unwrap_or_default()).collect(),
        }
    };
    let cameras = prims().filter(is_camera).map(camera).collect();
    let mut found = UsdCameras { cameras, ..UsdCameras::default() };
    if let Some(root) = specs.iter().find(|s| s.kind == spec::PSEUDO_ROOT) {
        if let Some(unit) = file.numbers(root, "metersPerUnit")?.and_then(|numbers| numbers.first().copied()) {
            found.set_unit(unit)?;
        }
        for (end, name) in found.range.iter_mut().zip(["startTimeCode", "endTimeCode"]) {
            *end = file.numbers(root, name)?.and_then(|numbers| numbers.first().copied());
        }
        if let Some(axis) = file.token(root, "upAxis") {
            axis.clone_into(&mut found.up_axis);
        }
    }
    Ok(found)
}

/// Returns the paths of the prims around a prim and its own, the outermost first.
pub(super) fn around(path: &str) -> impl Iterator<Item = &str> {
    path.match_indices('/').skip(1).map(|(at, _)| &path[..at]).chain([path])
}

/// Takes an attribute of a prim.
fn take(file: &CrateReader<'_>, attribute: &Spec, name: &str, prim: &mut Attributes) -> Result<(), String> {
    match name {
        "projection" => prim.is_orthographic = file.token(attribute, "default") == Some("orthographic"),
        _ if PROPERTIES.contains(&name) => drop(prim.properties.insert(name.to_owned(), timed(file, attribute)?)),
        _ => take_transform(file, attribute, name, &mut prim.transform)?,
    }
    Ok(())
}

/// Takes an attribute of a prim that is a part of its transform; leaves others.
pub(super) fn take_transform(file: &CrateReader<'_>, attribute: &Spec, name: &str, transform: &mut Transform) -> Result<(), String> {
    if name == ORDER {
        transform.set_order(file.tokens(attribute)?.into_iter().map(str::to_owned).collect());
    } else if name.starts_with(OPERATION) {
        *transform.op(name) = timed(file, attribute)?;
    }
    Ok(())
}

/// Returns the value of an attribute over time.
fn timed(file: &CrateReader<'_>, attribute: &Spec) -> Result<Timed, String> {
    Ok(Timed { default: file.numbers(attribute, "default")?, samples: file.samples(attribute)? })
}
