//! The pairs of images that are compared.
//!
//! In: two images or two folders. Out: [`Pairs`], by name. Degenerate: images of folders without a
//! partner are listed; two images of one name without extension in a folder are an error.

use luxel_core::text;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::CompareOptions;
use crate::Result;
use crate::error::{Context, bail};

/// Extensions of image files.
const EXTENSIONS: [&str; 10] = ["exr", "hdr", "pic", "tif", "tiff", "png", "jpg", "jpeg", "npy", "dpx"];

/// Two images.
pub(super) struct Pair {
    /// Name without folder and extension; for two images that of the test.
    pub(super) name: String,
    pub(super) reference: PathBuf,
    pub(super) test: PathBuf,
    pub(super) mask: Option<PathBuf>,
    pub(super) heatmap: Option<PathBuf>,
}

impl Pair {
    /// Returns the files that are read.
    pub(super) fn inputs(&self) -> impl Iterator<Item = &Path> {
        [Some(&self.reference), Some(&self.test), self.mask.as_ref()].into_iter().flatten().map(PathBuf::as_path)
    }
}

/// All pairs, by name, and images without a partner.
pub(super) struct Pairs {
    pub(super) are_folders: bool,
    pub(super) pairs: Vec<Pair>,
    /// Files of the reference without a test.
    pub(super) only_reference: Vec<PathBuf>,
    /// Files of the test without a reference.
    pub(super) only_test: Vec<PathBuf>,
    /// References that a folder of masks has none of.
    pub(super) unmasked: Vec<PathBuf>,
}

impl Pairs {
    /// Finds the pairs of two images or two folders.
    pub(super) fn find(reference: &Path, test: &Path, options: &CompareOptions) -> Result<Self> {
        match (is_folder(reference)?, is_folder(test)?) {
            (true, true) => Self::in_folders(reference, test, options),
            (false, false) => Ok(Self::two_images(reference, test, options)),
            (is_reference_folder, _) => {
                let kind = |is_folder| if is_folder { "a folder" } else { "a file" };
                bail!(
                    "{} is {}, {} is {}: expected two images or two folders",
                    reference.display(),
                    kind(is_reference_folder),
                    test.display(),
                    kind(!is_reference_folder)
                )
            }
        }
    }

    fn two_images(reference: &Path, test: &Path, options: &CompareOptions) -> Self {
        let pair = Pair {
            name: stem(test),
            reference: reference.to_owned(),
            test: test.to_owned(),
            mask: options.mask.clone(),
            heatmap: options.heatmap.clone(),
        };
        Self { are_folders: false, pairs: vec![pair], only_reference: Vec::new(), only_test: Vec::new(), unmasked: Vec::new() }
    }

    fn in_folders(reference: &Path, test: &Path, options: &CompareOptions) -> Result<Self> {
        let (references, tests) = (images(reference)?, images(test)?);
        let masks = match &options.mask {
            Some(path) if is_folder(path)? => Some(images(path)?),
            _ => None,
        };
        let mut found =
            Self { are_folders: true, pairs: Vec::new(), only_reference: Vec::new(), only_test: Vec::new(), unmasked: Vec::new() };
        let names: BTreeSet<&String> = references.keys().chain(tests.keys()).collect();
        for name in names {
            match (references.get(name), tests.get(name)) {
                (Some(reference), Some(test)) => found.pairs.push(Pair {
                    name: name.clone(),
                    reference: reference.clone(),
                    test: test.clone(),
                    mask: match &masks {
                        // Images without a mask are compared whole.
                        Some(masks) => masks.get(name).cloned(),
                        None => options.mask.clone(),
                    },
                    heatmap: options.heatmap.as_ref().map(|folder| folder.join(format!("{name}.png"))),
                }),
                (Some(reference), None) => found.only_reference.push(reference.clone()),
                (None, Some(test)) => found.only_test.push(test.clone()),
                (None, None) => {}
            }
        }
        if let (Some(path), Some(masks)) = (&options.mask, &masks) {
            let is_unmasked = |pair: &&Pair| pair.mask.is_none();
            found.unmasked = found.pairs.iter().filter(is_unmasked).map(|pair| pair.reference.clone()).collect();
            if !found.pairs.is_empty() && found.unmasked.len() == found.pairs.len() {
                bail!(
                    "{} has {}, and none has the name of a reference without extension: rename them, or name one mask for all",
                    path.display(),
                    text::plural(masks.len(), "image")
                );
            }
        }
        Ok(found)
    }

    /// Returns a line for every image that has no partner, or no mask where others do.
    pub(super) fn missing_lines(&self) -> Vec<String> {
        let line = |path: &PathBuf, other: &str, what: &str| format!("{}: no {other} of this name, {what}", path.display());
        let references = self.only_reference.iter().map(|path| line(path, "test", "left out"));
        let tests = self.only_test.iter().map(|path| line(path, "reference", "left out"));
        references.chain(tests).chain(self.unmasked.iter().map(|path| line(path, "mask", "compared whole"))).collect()
    }

    /// Returns the error text of folders without a pair.
    pub(super) fn nothing_matches(&self, reference: &Path, test: &Path) -> String {
        format!(
            "{} has {}, {} has {}, and none have the same name without extension: rename them, or name two files",
            reference.display(),
            text::plural(self.only_reference.len(), "image"),
            test.display(),
            text::plural(self.only_test.len(), "image")
        )
    }
}

fn is_folder(path: &Path) -> Result<bool> {
    let metadata = std::fs::metadata(path).with_context(|| format!("{}: cannot open", path.display()))?;
    Ok(metadata.is_dir())
}

/// Returns a file's name without extension.
fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| path.display().to_string(), |stem| luxel_io::composed(&stem.to_string_lossy()))
}

/// Returns the images of a folder by name without extension; folders in it are ignored.
fn images(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let cannot = || format!("{}: cannot list the folder", folder.display());
    let mut images: BTreeMap<String, PathBuf> = BTreeMap::new();
    for entry in std::fs::read_dir(folder).with_context(cannot)? {
        let path = entry.with_context(cannot)?.path();
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if !EXTENSIONS.contains(&extension.as_str()) || !path.is_file() {
            continue;
        }
        if let Some(other) = images.insert(stem(&path), path.clone()) {
            let (first, second) = if other < path { (other, path) } else { (path, other) };
            bail!("{} and {} have one name without extension: keep one of them in the folder", first.display(), second.display());
        }
    }
    Ok(images)
}
