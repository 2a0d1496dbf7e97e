//! Splats in a crate file: a particle field of a bake, and the field that a file has.

use std::collections::HashMap;
use std::io::{self, Write};

use glam::DVec3;

use super::cameras::{CLASS, around, take_transform};
use super::lights::write_lights;
use super::reader::CrateReader;
use super::tables::Spec;
use super::writer::{CrateWriter, FieldValue, Form};
use super::{kind, spec};
use crate::bake::{Appearance, BakeRecord, Baked, RECORD_KEY};
use crate::joined::MAX_PARTS;
use crate::lights::{LIGHTS, StageLights};
use crate::usd::cameras::{OPERATION, Transform};
use crate::usd::field::{Field, is_read};
use crate::usd::shown::{Hidden, INSTANCER, Unshown};
use crate::usd::writer::{Prim, StageFacts, extent};
use crate::usd::{DISPLAY_SPACE, GAIN, ORDER, PRIM_TYPE, SCENE, SPLATS, TRAINED, TRANSLATE, color_space_named, usd_name};

/// Writes a bake as a crate file. What is in the header depends on what is behind it, which is
/// therefore made twice.
pub(in crate::usd) fn write(baked: &Baked, lights: Option<&StageLights>, out: &mut dyn Write) -> io::Result<()> {
    let header = write_behind_header(baked, lights, CrateWriter::new(io::sink()))?;
    out.write_all(&header)?;
    write_behind_header(baked, lights, CrateWriter::new(out)).map(drop)
}

/// Writes values and tables; returns the header.
fn write_behind_header<W: Write>(baked: &Baked, lights: Option<&StageLights>, mut file: CrateWriter<W>) -> io::Result<Vec<u8>> {
    let record = BakeRecord::from_bake(baked).json()?;
    let StageFacts { metres, documentation } = StageFacts::new(baked);
    let top = if lights.is_some() { SCENE } else { SPLATS };
    let root = [
        FieldValue::new("customLayerData", file.dictionary(RECORD_KEY, &record)?),
        FieldValue::new("defaultPrim", file.token(top)),
        FieldValue::new("documentation", file.string(&documentation)),
        FieldValue::new("metersPerUnit", file.double(metres)?),
        FieldValue::new("upAxis", file.token("Y")),
        FieldValue::new("primChildren", file.token_vector(&[top])?),
    ];
    file.root(&root);
    if let Some(lights) = lights {
        let fields = [
            FieldValue::definition(),
            FieldValue::new("typeName", file.token("Xform")),
            FieldValue::new("primChildren", file.token_vector(&[SPLATS, LIGHTS])?),
        ];
        file.prim(SCENE, 0, &fields);
        write_splats(baked, 1, &mut file)?;
        write_lights(lights, 1, &mut file)?;
    } else {
        write_splats(baked, 0, &mut file)?;
    }
    file.finish()
}

/// Writes the prim of the splats, with `depth` prims around it.
fn write_splats<W: Write>(baked: &Baked, depth: usize, file: &mut CrateWriter<W>) -> io::Result<()> {
    let splats = &baked.scene.splats;
    let space = match baked.appearance {
        Appearance::Linear { .. } => usd_name(baked.scene.color_space),
        Appearance::Display { .. } => DISPLAY_SPACE,
    };
    let is_moved = baked.origin_in_file() != DVec3::ZERO;
    let prim = Prim::new(splats);
    let is_written = |name: &&str| match *name {
        TRANSLATE | ORDER => is_moved,
        GAIN | TRAINED => !splats.gain.is_empty(),
        _ => true,
    };
    let names: Vec<&str> = NAMES.iter().copied().filter(is_written).collect();
    let fields = [
        FieldValue::definition(),
        FieldValue::new("typeName", file.token(PRIM_TYPE)),
        FieldValue::new("apiSchemas", file.prepended_tokens(&["ColorSpaceAPI"])?),
        FieldValue::new("properties", file.token_vector(&names)?),
    ];
    file.prim(SPLATS, depth, &fields);

    for name in names {
        let rows = |block: &mut Vec<u8>, row: &[f32]| block.extend(row.iter().flat_map(|v| v.to_le_bytes()));
        let (n, k) = (splats.len(), splats.color_model.sh_coefficients());
        let (type_name, is_uniform, value) = match name {
            "colorSpace:name" => ("token", true, file.token(space)),
            TRANSLATE => ("double3", false, file.vec3d(baked.origin_in_file().to_array())?),
            ORDER => ("token[]", true, file.token_array(&[TRANSLATE])?),
            "extent" => {
                let corners = extent(splats);
                ("float3[]", false, file.floats(kind::VEC3F, 2, |i, block| rows(block, &corners[i]))?)
            }
            "positions" => ("point3f[]", false, file.floats(kind::VEC3F, n, |i, block| rows(block, &splats.position[i]))?),
            "scales" => ("float3[]", false, file.floats(kind::VEC3F, n, |i, block| rows(block, &prim.scale(i)))?),
            "orientations" => {
                let real_last = |i: usize| {
                    let [w, x, y, z] = prim.orientation(i);
                    [x, y, z, w]
                };
                ("quatf[]", false, file.floats(kind::QUATF, n, |i, block| rows(block, &real_last(i)))?)
            }
            "opacities" => ("float[]", false, file.floats(kind::FLOAT, n, |i, block| rows(block, &[prim.opacity(i)]))?),
            "projectionModeHint" => ("token", true, file.token("perspective")),
            "sortingModeHint" => ("token", true, file.token("zDepth")),
            "radiance:sphericalHarmonicsDegree" => ("int", true, file.int(splats.color_model.sh_degree() as i32)),
            GAIN => ("float[]", false, file.floats(kind::FLOAT, n, |i, block| rows(block, &splats.gain[i..=i]))?),
            TRAINED => ("float3[]", false, file.rows(kind::VEC3F, [n, k], |i, block| rows(block, splats.sh_of(i)))?),
            // The harmonics.
            _ => ("float3[]", false, file.rows(kind::VEC3F, [n, k], |i, block| rows(block, &prim.harmonics(i)))?),
        };
        let form = match name {
            GAIN | TRAINED => Form::Custom,
            _ if is_uniform => Form::Uniform,
            _ => Form::Varying,
        };
        file.attribute(name, type_name, form, value);
    }
    Ok(())
}

/// Attributes of the prim, in the order of their specs.
const NAMES: [&str; 14] = [
    "colorSpace:name",
    TRANSLATE,
    ORDER,
    "extent",
    "positions",
    "scales",
    "orientations",
    "opacities",
    "projectionModeHint",
    "sortingModeHint",
    "radiance:sphericalHarmonicsDegree",
    "radiance:sphericalHarmonicsCoefficients",
    GAIN,
    TRAINED,
];

/// The particle fields of a file, and the record of the bake in it.
#[derive(Debug)]
pub(in crate::usd) struct FoundField {
    pub(in crate::usd) fields: Vec<Field>,
    pub(in crate::usd) record: Option<String>,
    pub(in crate::usd) unshown: Unshown,
}

/// An error of a file, and whether the file is right but not supported.
#[derive(Debug)]
pub(in crate::usd) struct BinaryError {
    pub(in crate::usd) message: String,
    pub(in crate::usd) is_unsupported: bool,
}

impl From<String> for BinaryError {
    fn from(message: String) -> Self {
        Self { message, is_unsupported: false }
    }
}

fn unsupported(message: String) -> BinaryError {
    BinaryError { message, is_unsupported: true }
}

/// Reads the particle fields of a crate file's bytes.
///
/// # Errors
/// Damaged bytes; more fields than are read; one that changes over time.
pub(in crate::usd) fn read(bytes: &[u8]) -> Result<FoundField, BinaryError> {
    let file = CrateReader::new(bytes)?;
    let specs = &file.tables.specs;
    // Prims within variants are not composed, and classes are templates.
    let prims = || specs.iter().filter(|s| s.kind == spec::PRIM && !s.path.contains('{'));
    let classes: Vec<&str> = prims().filter(|s| file.specifier(s) == Some(CLASS)).map(|s| s.path.as_str()).collect();
    let is_template = |path: &str| around(path).any(|prim| classes.contains(&prim));
    let is_field = |s: &&Spec| file.token(s, "typeName") == Some(PRIM_TYPE) && !is_template(&s.path);
    let hidden = hidden_prims(&file);
    let mut unshown = Unshown::default();
    if specs.iter().any(|s| s.path.contains('{') || ARC_FIELDS.iter().any(|arc| file.tables.field(s, arc).is_some())) {
        unshown.compose();
    }
    let mut owners: Vec<&str> = prims().filter(is_field).map(|s| s.path.as_str()).collect();
    owners.retain(|path| match around(path).find_map(|prim| hidden.get(prim)) {
        Some(reason) => {
            unshown.hide(*reason, 1);
            false
        }
        None => true,
    });
    if owners.len() > MAX_PARTS {
        let message = format!("{} prims of type {PRIM_TYPE}, expected at most {MAX_PARTS}; join them first", owners.len());
        return Err(unsupported(message));
    }
    let mut fields: HashMap<&str, Field> = owners.iter().map(|path| (*path, Field::default())).collect();
    let mut transforms: HashMap<&str, Transform> = HashMap::new();
    let is_around = |owner: &str| owners.iter().any(|path| around(path).any(|prim| prim == owner));
    for attribute in specs.iter().filter(|s| s.kind == spec::ATTRIBUTE) {
        let Some((owner, name)) = attribute.path.rsplit_once('.') else { continue };
        if (name == ORDER || name.starts_with(OPERATION)) && is_around(owner) {
            take_transform(&file, attribute, name, transforms.entry(owner).or_default())?;
        }
        if let Some(field) = fields.get_mut(owner) {
            take(&file, attribute, name, field)?;
        }
    }
    let placed = owners.iter().filter_map(|path| {
        let transforms = around(path).map(|prim| transforms.get(prim).cloned().unwrap_or_default()).collect();
        Some(Field { transforms, ..fields.remove(path)? })
    });
    let fields = placed.collect();
    let root = specs.iter().find(|s| s.kind == spec::PSEUDO_ROOT);
    let record = root.map(|root| file.text_in_dictionary(root, "customLayerData", RECORD_KEY)).transpose()?.flatten();
    Ok(FoundField { record: record.map(str::to_owned), fields, unshown })
}

/// Fields of specs by which other layers and parts are composed into them.
const ARC_FIELDS: [&str; 6] = ["references", "payload", "inheritPaths", "specializes", "variantSelection", "subLayers"];

/// Returns the prims that hide themselves and all below them.
fn hidden_prims<'f>(file: &'f CrateReader<'_>) -> HashMap<&'f str, Hidden> {
    let mut hidden = HashMap::new();
    for spec in &file.tables.specs {
        let found = if spec.kind == spec::PRIM {
            let is_instancer = file.token(spec, "typeName") == Some(INSTANCER);
            let inactive = file.is_false(spec, "active").then_some(Hidden::Inactive);
            inactive.or(is_instancer.then_some(Hidden::Prototype)).map(|reason| (spec.path.as_str(), reason))
        } else {
            let attribute = spec.path.rsplit_once('.').filter(|_| spec.kind == spec::ATTRIBUTE);
            attribute.and_then(|(owner, name)| {
                // Most attributes are of no concern here.
                let value = file.token(spec, "default").filter(|_| matches!(name, "visibility" | "purpose"))?;
                Some((owner, Hidden::by_attribute(name, value)?))
            })
        };
        if let Some((prim, reason)) = found {
            hidden.entry(prim).or_insert(reason);
        }
    }
    hidden
}

/// Takes an attribute of the field.
fn take(file: &CrateReader<'_>, attribute: &Spec, name: &str, field: &mut Field) -> Result<(), BinaryError> {
    if is_read(name) && file.tables.field(attribute, "timeSamples").is_some() {
        return Err(unsupported(format!("{name:?}: splats that change over time, expected one value; export a single frame")));
    }
    match name {
        "radiance:sphericalHarmonicsDegree" => {
            let found = file.int(attribute);
            let degree = found.and_then(|degree| usize::try_from(degree).ok()).filter(|degree| *degree <= luxel_core::sh::MAX_DEGREE);
            let message = || format!("{name:?} is {found:?}, expected a degree of 0 to {}", luxel_core::sh::MAX_DEGREE);
            field.degree = degree.ok_or_else(message)?;
        }
        "colorSpace:name" => {
            let found = file.token(attribute, "default").unwrap_or_default();
            field.color_space = color_space_named(found).map_err(unsupported)?;
        }
        _ => {
            if let Some(array) = field.array(name)
                && (array.is_empty() || !name.ends_with('h'))
            {
                *array = file.floats(attribute)?;
            }
        }
    }
    Ok(())
}
