//! Which of several models is read: COLMAP's mapper writes one for each group of images that it
//! could not join with the others, in `sparse/0`, `sparse/1` and so on, in no order of size.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::read_file::open_regular;

/// A model that was found.
pub(in crate::dataset) struct FoundModel {
    /// Its folder.
    pub(in crate::dataset) folder: PathBuf,
    /// Names of the models that are passed over, for people.
    pub(in crate::dataset) warning: Option<String>,
}

/// Finds the model in or at `folder`: the one with the most images among `sparse/0`, `sparse/1` and
/// so on, else the one in `sparse`, in `folder` itself or in its numbered folders.
pub(in crate::dataset) fn find_model(folder: &Path) -> Option<FoundModel> {
    let sparse = folder.join("sparse");
    let single = |folder: PathBuf| has_model(&folder).then_some(FoundModel { folder, warning: None });
    largest(&sparse).or_else(|| single(sparse)).or_else(|| single(folder.to_path_buf())).or_else(|| largest(folder))
}

fn has_model(folder: &Path) -> bool {
    ["bin", "txt"].iter().any(|extension| folder.join(format!("cameras.{extension}")).is_file())
}

/// Returns the model with the most images in the numbered folders of `parent`; of equal ones the
/// first.
fn largest(parent: &Path) -> Option<FoundModel> {
    let entries = std::fs::read_dir(parent).ok()?;
    let number = |name: &std::ffi::OsStr| name.to_str()?.parse::<u32>().ok();
    let mut models: Vec<(u32, PathBuf)> = entries
        .flatten()
        .filter_map(|entry| Some((number(&entry.file_name())?, entry.path())))
        .filter(|(_, path)| has_model(path))
        .collect();
    models.sort();
    if models.len() < 2 {
        return models.pop().map(|(_, folder)| FoundModel { folder, warning: None });
    }
    let counted: Vec<(u64, PathBuf)> = models.into_iter().map(|(_, folder)| (image_count(&folder).unwrap_or(0), folder)).collect();
    let most = counted.iter().map(|(count, _)| *count).max()?;
    let at = counted.iter().position(|(count, _)| *count == most)?;
    let line = |(count, folder): &(u64, PathBuf)| format!("{} with {count}", folder.display());
    let others: Vec<String> = counted.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, model)| line(model)).collect();
    let warning =
        format!("{} COLMAP models that share no frame: {} images is read, not {}", counted.len(), line(&counted[at]), others.join(", "));
    Some(FoundModel { folder: counted[at].1.clone(), warning: Some(warning) })
}

/// Returns the number of images that a model claims, without reading their features.
fn image_count(folder: &Path) -> Option<u64> {
    if folder.join("cameras.bin").is_file() {
        let mut count = [0; 8];
        open_regular(&folder.join("images.bin")).ok()?.0.read_exact(&mut count).ok()?;
        return Some(u64::from_le_bytes(count));
    }
    let lines = BufReader::new(open_regular(&folder.join("images.txt")).ok()?.0).lines();
    // A line of an image ends in its name, one of its features in numbers.
    let is_image = |line: &String| {
        let mut words = line.split_ascii_whitespace();
        !line.starts_with('#') && words.nth(9).is_some_and(|word| word.parse::<f64>().is_err())
    };
    Some(lines.map_while(Result::ok).filter(is_image).count() as u64)
}
