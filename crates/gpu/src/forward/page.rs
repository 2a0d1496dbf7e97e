//! The passes up to the image for the viewer's page, as a module of JavaScript that is part of the
//! repository, so that a viewer needs neither wgpu nor this crate.
//!
//! `LUXEL_WRITE_PAGE=1 cargo test -p luxel-gpu page` writes the module; without it the test
//! compares.

use std::collections::BTreeMap;
use std::path::Path;

use luxel_core::engine::JACOBIAN_MARGIN;
use luxel_core::{Activation, ColorModel};
use serde_json::{Map, Value, json};

use super::{Dispatch, PixelKind, Resource, Workgroups, bin, project, rasterize, sort_by_depth, sort_by_tile};
use crate::constants::{Update, constants, model_constants};
use crate::frame::{EXPECTED_TILES, FIRST_ENTRIES, TILE_DIGITS, depth_sorts, tile_sorts};
use crate::kernels::{KernelId, source};
use crate::layout::{
    DIGIT_BITS, FLAG_COMPENSATION, FLAG_EDIT_GAIN, FLAG_MIN_CONTRIBUTION, FLAG_SMOOTHING, HALT_NONE, HALT_OVERFLOW, MAX_GROUPS,
    SortUniform, TILE_PX,
};

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../view/src/page/gpu/forward.js");
const MODEL: ColorModel = ColorModel::Sh { degree: 3 };

/// Returns every colour model of one light.
fn models() -> Vec<ColorModel> {
    let activations = [Activation::Softplus, Activation::Exp, Activation::Relu];
    let lcd = |chroma_degree: u8| {
        (0..=3)
            .flat_map(move |luminance_degree| activations.map(|activation| ColorModel::Lcd { chroma_degree, luminance_degree, activation }))
    };
    let degrees = || 0..=5;
    let plain = degrees().map(|degree| ColorModel::Sh { degree }).chain(degrees().map(|degree| ColorModel::LogSh { degree }));
    plain.chain(degrees().flat_map(lcd)).collect()
}

fn dispatch(dispatch: &Dispatch) -> Value {
    let bindings: Vec<Value> =
        dispatch.bindings.iter().map(|bound| json!({ "slot": bound.slot, "buffer": format!("{:?}", bound.resource) })).collect();
    let workgroups = match dispatch.workgroups {
        Workgroups::Fixed(groups) => json!({ "fixed": groups }),
        Workgroups::Per { count, plus, per } => json!({ "count": format!("{count:?}").to_lowercase(), "plus": plus, "per": per }),
        Workgroups::Indirect(offset) => json!({ "indirect": offset }),
    };
    json!({ "kernel": dispatch.kernel.name(), "bindings": bindings, "workgroups": workgroups })
}

fn dispatches(list: &[Dispatch]) -> Value {
    list.iter().map(dispatch).collect()
}

/// Returns the passes after the projection, for a number of digits of the sort by tile.
fn after_projection(digits: usize) -> Vec<Dispatch> {
    [sort_by_depth(), bin(PixelKind::Places), sort_by_tile(digits), vec![rasterize(digits, PixelKind::Places)]].concat()
}

/// Returns the fields of a shader's structure: offset, type and number of components.
fn fields(kernel: KernelId, name: &str) -> Value {
    let module = naga::front::wgsl::parse_str(&source(kernel)).unwrap();
    let members = module.types.iter().find_map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => Some((members, *span)),
        _ => None,
    });
    let (members, bytes) = members.unwrap();
    let field = |member: &naga::StructMember| {
        let (scalar, count) = match module.types[member.ty].inner {
            naga::TypeInner::Scalar(scalar) => (scalar, 1),
            naga::TypeInner::Vector { size, scalar } => (scalar, size as usize),
            ref other => panic!("{name}: {other:?}"),
        };
        let kind = if scalar.kind == naga::ScalarKind::Float { "f32" } else { "u32" };
        (member.name.clone().unwrap(), json!({ "offset": member.offset, "type": kind, "count": count }))
    };
    json!({ "bytes": bytes, "fields": members.iter().map(field).collect::<Map<_, _>>() })
}

/// Returns the parts of the kernels' texts, each once, and the numbers of those of each kernel.
fn kernels(list: &[Dispatch]) -> [Value; 2] {
    let mut texts = vec![constants()];
    let mut kernels = BTreeMap::new();
    for kernel in list.iter().map(|dispatch| dispatch.kernel) {
        let has_model = matches!(kernel, KernelId::Project(..));
        let mut numbers = vec![0];
        for file in kernel.files() {
            let known = texts.iter().position(|text| text == file);
            numbers.push(known.unwrap_or_else(|| {
                texts.push((*file).to_owned());
                texts.len() - 1
            }));
        }
        let model = has_model.then(|| model_constants(MODEL, 0, Update::Parameters));
        let parts = [texts[0].clone(), model.unwrap_or_default()].concat();
        let whole = numbers[1..].iter().fold(parts, |whole, n| whole + "\n" + &texts[*n]);
        assert!(whole == source(kernel), "{kernel:?} has another text in the page");
        kernels.insert(kernel.name(), json!({ "texts": numbers, "hasModel": has_model }));
    }
    let lines: Vec<Vec<&str>> = texts.iter().map(|text| text.split('\n').collect()).collect();
    [json!(lines), json!(kernels)]
}

fn forward() -> Value {
    let last = TILE_DIGITS as usize;
    let all: Vec<Dispatch> = [project(MODEL, 0, PixelKind::Places)].into_iter().chain(after_projection(last)).collect();
    let extents: Map<String, Value> = (1..=last)
        .flat_map(after_projection)
        .chain([project(MODEL, 0, PixelKind::Places)])
        .flat_map(|dispatch| dispatch.bindings)
        .chain([super::at(0, Resource::Dispatches)])
        .map(|bound| {
            let extent = bound.resource.extent();
            let term = |term: &super::Term| {
                let counts: Vec<String> = term.largest_of.iter().map(|count| format!("{count:?}").to_lowercase()).collect();
                json!({ "largestOf": counts, "per": term.per, "bytes": term.bytes })
            };
            let terms: Vec<Value> = extent.terms.iter().map(term).collect();
            (format!("{:?}", bound.resource), json!({ "bytes": extent.bytes, "terms": terms }))
        })
        .collect();
    let sorts = |sorts: Vec<SortUniform>| -> Value { sorts.iter().map(|s| json!([s.shift, s.count, s.flags, s.bits])).collect() };
    let most_bits = TILE_DIGITS * DIGIT_BITS;
    let tile_sorts: Value = (0..=most_bits).map(|bits| sorts(tile_sorts(bits))).collect();
    let [texts, kernels] = kernels(&all);
    let constants: Map<String, Value> =
        models().into_iter().map(|model| (model.name(), model_constants(model, 0, Update::Parameters).into())).collect();
    json!({
        "camera": fields(KernelId::Project(MODEL, 0), "Camera"),
        "shard": fields(KernelId::Project(MODEL, 0), "Shard"),
        "state": fields(KernelId::BinScan, "State"),
        "flags": {
            "compensation": FLAG_COMPENSATION, "smoothing": FLAG_SMOOTHING, "minContribution": FLAG_MIN_CONTRIBUTION,
            "editGain": FLAG_EDIT_GAIN,
        },
        "halt": { "none": HALT_NONE, "overflow": HALT_OVERFLOW },
        "sorts": { "depth": sorts(depth_sorts()), "tile": tile_sorts },
        "numbers": {
            "tilePx": TILE_PX, "maxGroups": MAX_GROUPS, "firstEntries": FIRST_ENTRIES,
            "expectedTiles": EXPECTED_TILES, "jacobianMargin": JACOBIAN_MARGIN,
        },
        "extents": extents,
        "project": dispatch(&project(MODEL, 0, PixelKind::Places)),
        "afterProjection": (1..=last).map(|digits| (digits.to_string(), dispatches(&after_projection(digits)))).collect::<Map<_, _>>(),
        "kernels": kernels,
        "texts": texts,
        "models": constants,
    })
}

#[test]
fn the_viewer_s_page_has_the_engine_s_shaders_and_passes() {
    // One line for each part, but for the shaders: people compare those.
    let parts = forward();
    let line = |(name, part): (&String, &Value)| {
        let text = if name == "texts" { serde_json::to_string_pretty(part) } else { serde_json::to_string(part) };
        format!("  {name:?}: {},\n", text.unwrap())
    };
    let json: String = parts.as_object().unwrap().iter().map(line).collect();
    let head = "// The passes up to the image, as crates/gpu/src/forward.rs has them: generated by its test, see forward/page.rs.\n";
    let module = format!("{head}/** @type {{import(\"./passes.js\").Forward}} */\nexport const FORWARD = {{\n{json}}};\n");
    let file = Path::new(FILE);
    if std::env::var_os("LUXEL_WRITE_PAGE").is_some() {
        std::fs::write(file, &module).unwrap();
    }
    let found = std::fs::read_to_string(file).unwrap_or_default();
    assert!(found == module, "{FILE} differs from the engine: run LUXEL_WRITE_PAGE=1 cargo test -p luxel-gpu page");
}
