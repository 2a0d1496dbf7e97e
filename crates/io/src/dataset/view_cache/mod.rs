//! Views whose images memory has no room for: in a cache of files, or in the files that they came
//! from.
//!
//! In: frames and loaded views. Out: views whose image and mask are read on demand. Training views
//! are stored, in half floats ([`record`]), because training reads each of them hundreds of times;
//! without a folder for that, and for test views, the source file is decoded each time, which is
//! exact. A view of the cache is found by its files, camera and the options of reading; what is
//! damaged or of changed files is made anew. Files of views that are no longer used are removed.
//!
//! Files are read, not mapped: what a process maps counts as its memory, and a file that another
//! process shortens would end it.

mod facts;
mod record;
mod sources;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use luxel_core::{Image, Make, Mask, OnDemand, ReadError, Target, View};

use self::facts::Facts;
pub use self::record::MAX_RELATIVE_ERROR;
use self::sources::{FileSource, IMAGE, MASK, RereadSource, read_error, with_remedy, write};
pub(super) use self::sources::{Reread, Residency};
use super::LoadOptions;
use super::load::{LoadedView, load_view};
use super::source::SourceFrame;
use super::split::Part;
use crate::IoError;

/// Extension of the files with the facts of a view.
const FACTS: &str = "json";

/// A frame with the options that it is read with.
pub(super) struct CachedFrame<'a> {
    pub(super) frame: &'a SourceFrame,
    pub(super) options: &'a LoadOptions,
}

/// The cache of a data set, or its absence.
pub(super) struct ViewCache {
    /// Folder of the files; without one, views are decoded from their sources each time.
    folder: Option<PathBuf>,
    residency: Arc<Residency>,
}

impl ViewCache {
    pub(super) fn new(folder: Option<&Path>, residency: Arc<Residency>) -> Self {
        Self { folder: folder.map(Path::to_owned), residency }
    }

    /// Returns the name of a view's files, without extension: a digest of what its pixels depend
    /// on.
    fn stem(&self, frame: &SourceFrame, options: &LoadOptions) -> Option<PathBuf> {
        let image = std::fs::canonicalize(&frame.image).ok()?;
        let mask = frame.mask.as_ref().map(std::fs::canonicalize).transpose().ok()?;
        let pose = (frame.camera_from_world, frame.exposure_s, frame.noise, &frame.intrinsics);
        let read = (options.transfer, options.downscale.factor(), options.supervision, &options.masks, &options.layer, options.color_space);
        let text = format!("{image:?} {mask:?} {pose:?} {read:?}");
        Some(self.folder.as_ref()?.join(blake3::hash(text.as_bytes()).to_hex().as_str()))
    }

    /// Returns the view of a frame from the cache; `None` if it is not there or no longer right.
    pub(super) fn find(&self, frame: &SourceFrame, options: &LoadOptions) -> Option<LoadedView> {
        let stem = self.stem(frame, options)?;
        let facts = Facts::read(&stem.with_extension(FACTS), frame)?;
        let size = facts.camera.size_px.map(|side| side as usize);
        let expected = |channels| record::Shape { width: size[0], height: size[1], channels };
        let is_there =
            |extension, channels| record::Record::read_shape(&stem.with_extension(extension)).is_ok_and(|s| s == expected(channels));
        if frame.part == Some(Part::Train) && !(is_there(IMAGE, 3) && (!facts.has_mask || is_there(MASK, 1))) {
            return None;
        }
        let reread = reread(frame, options, facts.digest()?);
        let (image, mask) = self.on_demand(frame, &stem, size, &reread);
        let view = View {
            name: frame.name.clone(),
            camera: facts.camera.clone(),
            image,
            values: facts.values(),
            noise: facts.noise(),
            mask: facts.has_mask.then_some(mask),
            recordings: Vec::new(),
            target: Target::default(),
        };
        facts.around(view)
    }

    /// Stores a view and returns it without its pixels.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(super) fn store(&self, frame: &SourceFrame, options: &LoadOptions, loaded: LoadedView) -> Result<LoadedView, IoError> {
        let size = loaded.view.camera.size_px.map(|side| side as usize);
        let reread = reread(frame, options, loaded.digest);
        let stem = self.stem(frame, options);
        if let Some(stem) = &stem {
            if frame.part == Some(Part::Train) {
                write::<Image>(&stem.with_extension(IMAGE), &loaded.view.image, size)?;
                if let Some(mask) = &loaded.view.mask {
                    write::<Mask>(&stem.with_extension(MASK), mask, size)?;
                }
            }
            // Last: they say that the others are whole.
            if let Some(facts) = Facts::new(frame, &loaded) {
                facts.write(&stem.with_extension(FACTS)).map_err(with_remedy)?;
            }
        }
        let (image, mask) = self.on_demand(frame, stem.as_deref().unwrap_or(Path::new("")), size, &reread);
        let mask = loaded.view.mask.is_some().then_some(mask);
        Ok(LoadedView { view: View { image, mask, ..loaded.view }, ..loaded })
    }

    fn on_demand(&self, frame: &SourceFrame, stem: &Path, size: [usize; 2], reread: &Arc<Reread>) -> (OnDemand<Image>, OnDemand<Mask>) {
        if self.folder.is_none() || frame.part != Some(Part::Train) {
            let source = Arc::new(RereadSource { size, reread: Arc::clone(reread) });
            return (OnDemand::from_source(source.clone()), OnDemand::from_source(source));
        }
        let make_image: Arc<Make<Image>> = {
            let reread = Arc::clone(reread);
            Arc::new(move || Ok(reread().map_err(read_error)?.image.into_value()))
        };
        let make_mask: Arc<Make<Mask>> = {
            let reread = Arc::clone(reread);
            let missing = || ReadError { message: "the view has lost its mask".into(), remedy: None };
            Arc::new(move || Ok(reread().map_err(read_error)?.mask.ok_or_else(missing)?.into_value()))
        };
        let image = FileSource::new(stem.with_extension(IMAGE), size, &self.residency, make_image);
        let mask = FileSource::new(stem.with_extension(MASK), size, &self.residency, make_mask);
        (OnDemand::from_source(Arc::new(image)), OnDemand::from_source(Arc::new(mask)))
    }

    /// Removes the files of views that are not among `frames`. What cannot be removed stays.
    pub(super) fn prune<'a>(&self, frames: impl Iterator<Item = CachedFrame<'a>>) {
        let Some(folder) = &self.folder else { return };
        let stems = frames.filter_map(|CachedFrame { frame, options }| Some(self.stem(frame, options)?.file_name()?.to_owned()));
        let used: BTreeSet<_> = stems.collect();
        let Ok(entries) = std::fs::read_dir(folder) else { return };
        for entry in entries.flatten() {
            let name = entry.file_name();
            let Some(stem) = name.to_str().and_then(|name| name.get(..DIGEST_DIGITS)) else { continue };
            let is_ours = stem.bytes().all(|byte| byte.is_ascii_hexdigit())
                && [IMAGE, MASK, FACTS].iter().any(|extension| name.to_str().is_some_and(|name| name.ends_with(&format!(".{extension}"))));
            if is_ours && !used.contains(std::ffi::OsStr::new(stem)) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}

/// Digits of a digest in the name of a file.
const DIGEST_DIGITS: usize = 64;

/// Returns how the view of a frame is read again; fails where the file has another digest now.
fn reread(frame: &SourceFrame, options: &LoadOptions, digest: blake3::Hash) -> Arc<Reread> {
    let (frame, options) = (frame.clone(), options.clone());
    Arc::new(move || {
        let loaded = load_view(&frame, &options)?;
        if loaded.digest != digest {
            return Err(IoError::invalid(&frame.image, "the file changed since the data set was read; start again"));
        }
        Ok(loaded.view)
    })
}
