//! Which layout a folder has.

use std::path::{Path, PathBuf};

use luxel_core::Remedy;

use super::DatasetFormat;
use super::block::Block;
use super::candidates::files_with;
use super::colmap::find_model;
use super::files::without_extension;
use super::layouts::colmap::scene_folder;
use super::layouts::transforms::TransformsFiles;
use super::layouts::{llff, metashape, phone, poses_bounds, realityscan, usd};
use crate::IoError;

/// The files that identify a data set, for messages.
const LOOKED_FOR: &str = "transforms.json, transforms_train.json, a COLMAP model (cameras.bin or cameras.txt in sparse/0, in sparse or here), poses_bounds_exps.npy with input_images, poses_bounds.npy with images, cameras of RealityScan (.csv, or .xmp beside the images) or Metashape (.xml), cameras of OpenUSD (.usda, .usdc, .usdz), Polycam's keyframes, or Record3D's metadata.json with rgb";

/// Extensions of photographs and other pictures, of which poses can be found; cameras' own RAW
/// formats too.
const PICTURES: [&str; 19] = [
    "exr", "hdr", "jpg", "jpeg", "png", "tif", "tiff", "dng", "heic", "heif", "webp", "cr2", "cr3", "nef", "arw", "raf", "orf", "rw2",
    "dpx",
];

/// Entries of a folder that an error lists.
const MAX_LISTED: usize = 12;

/// Returns the format of the data set at `path`, a folder or a `transforms.json`, by looking at
/// names only.
///
/// HDR-NeRF: `transforms_train.json` and `train_hdr/` or, with captured LDR images alone,
/// `exposure_train.json`. GaussHDR: a COLMAP model and `images_hdr/*_hdr_*.exr` or, with captured
/// images alone, `exposure.json` and `images/*_ldr_*_*`. Otherwise JSON files take precedence over
/// a COLMAP model, and a model with `exr/` is HDR-GS.
///
/// # Errors
/// A folder that is missing, or has no known layout; the message lists the files expected and
/// found.
pub fn detect_format(path: &Path) -> Result<DatasetFormat, IoError> {
    let meta = std::fs::metadata(path).map_err(|e| IoError::system(path, "read", &e))?;
    if meta.is_file() {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        return match extension.as_str() {
            "json" => Ok(DatasetFormat::Transforms),
            "csv" => Ok(DatasetFormat::RealityScan),
            "xml" => Ok(DatasetFormat::Metashape),
            layer if usd::EXTENSIONS.contains(&layer) => Ok(DatasetFormat::Usd),
            _ => Err(IoError::invalid(path, format!("is a file, expected a transforms.json or a folder with {LOOKED_FOR}"))),
        };
    }
    if let Some(block) = Block::read(path)? {
        return detect_format(&block.whole(path)?);
    }
    let json = TransformsFiles::find(path);
    let model = find_model(path).map(|found| found.folder);
    let is_hdr_nerf = path.join("train_hdr").is_dir() || path.join("exposure_train.json").is_file();
    if matches!(json, Some(TransformsFiles::Pair { .. })) && is_hdr_nerf {
        return Ok(DatasetFormat::HdrNerf);
    }
    // The folder of the model itself may be named: images are above it.
    let scene = scene_folder(path);
    let is_gauss_hdr = has_file(&scene.join("images_hdr"), |name| name.strip_suffix(".exr").is_some_and(|stem| is_numbered(stem, "_hdr_")))
        || (scene.join("exposure.json").is_file()
            && has_file(&scene.join("images"), |name| {
                without_extension(name)
                    .rsplit_once('_')
                    .is_some_and(|(stem, exposure)| is_numbered(stem, "_ldr_") && exposure.parse::<u32>().is_ok())
            }));
    if model.is_some() && is_gauss_hdr {
        return Ok(DatasetFormat::GaussHdr);
    }
    if model.is_none() && json.is_none() && llff::is_one(path) {
        return Ok(DatasetFormat::HdrNerfReal);
    }
    match (json, model) {
        (Some(_), _) => Ok(DatasetFormat::Transforms),
        (None, Some(_)) if scene.join("exr").is_dir() => Ok(DatasetFormat::HdrGs),
        (None, Some(_)) => Ok(DatasetFormat::Colmap),
        (None, None) => of_other_program(path)?.ok_or_else(|| no_dataset(path)),
    }
}

/// Returns the format of a folder whose cameras another program wrote, by names and the beginnings
/// of files; an error where several formats are there.
fn of_other_program(path: &Path) -> Result<Option<DatasetFormat>, IoError> {
    let signs = [
        (phone::polycam_folders(path).is_some(), DatasetFormat::Polycam),
        (phone::record3d_metadata(path).is_some(), DatasetFormat::Record3d),
        (!files_with(path, "xml", metashape::is_metashape).is_empty(), DatasetFormat::Metashape),
        (!files_with(path, "csv", realityscan::is_table).is_empty(), DatasetFormat::RealityScan),
        (poses_bounds::is_one(path), DatasetFormat::Llff),
        (!usd::layers(path).is_empty(), DatasetFormat::Usd),
    ];
    let found: Vec<DatasetFormat> = signs.into_iter().filter(|(is_there, _)| *is_there).map(|(_, format)| format).collect();
    match found.as_slice() {
        // XMP files lie beside the images of other programs' exports, too.
        [] => Ok((!realityscan::xmp_files(path).is_empty()).then_some(DatasetFormat::RealityScan)),
        [one] => Ok(Some(*one)),
        several => {
            let names: Vec<&str> = several.iter().map(|format| format.name()).collect();
            let error = IoError::invalid(path, format!("cameras of several programs, of formats {}, expected one", names.join(" and ")));
            Err(error.with_remedy(Remedy::give("format")))
        }
    }
}

/// Returns the error about a folder of no known layout, with a remedy for pictures without poses.
fn no_dataset(path: &Path) -> IoError {
    let is_picture = |name: &str| {
        let extension = Path::new(name).extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        PICTURES.iter().any(|picture| picture.eq_ignore_ascii_case(extension))
    };
    let error = |found: &str| IoError::invalid(path, format!("no data set: expected {LOOKED_FOR}; found {found}"));
    let is_no_file = |path: &PathBuf| std::fs::metadata(path).is_ok_and(|found| !found.is_file());
    if let Some(name) = ["transforms.json", "transforms_train.json"].map(|name| path.join(name)).iter().find(|path| is_no_file(path)) {
        return IoError::invalid(name, "not a regular file, expected one");
    }
    let with_pictures = [path.to_owned(), path.join("images"), path.join("input")].into_iter().find(|folder| has_file(folder, is_picture));
    match with_pictures {
        None => error(&listing(path)),
        Some(folder) => error(&format!("pictures without poses, in {}: {}", folder.display(), listing(&folder))).with_remedy(
            Remedy::advice(format!("make a data set with poses of them first, with luxel prepare {}, and train on that", folder.display())),
        ),
    }
}

/// Returns whether the folder has a file of such a name.
fn has_file(folder: &Path, is_one: impl Fn(&str) -> bool) -> bool {
    std::fs::read_dir(folder).is_ok_and(|entries| entries.flatten().any(|entry| is_one(&entry.file_name().to_string_lossy())))
}

/// Returns whether a name ends in the mark and a number.
fn is_numbered(stem: &str, mark: &str) -> bool {
    stem.rsplit_once(mark).is_some_and(|(_, number)| number.parse::<u32>().is_ok())
}

/// Returns the folder's entries, sorted, for messages.
fn listing(folder: &Path) -> String {
    let Ok(entries) = std::fs::read_dir(folder) else { return "a folder that cannot be listed".to_owned() };
    let mut names: Vec<String> = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    let more = names.len().saturating_sub(MAX_LISTED);
    names.truncate(MAX_LISTED);
    match (names.is_empty(), more) {
        (true, _) => "an empty folder".to_owned(),
        (false, 0) => names.join(", "),
        (false, more) => format!("{} and {more} more", names.join(", ")),
    }
}
