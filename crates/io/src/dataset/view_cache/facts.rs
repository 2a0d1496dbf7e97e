//! Facts of a view besides its pixels, as a file of the cache: with it, a data set is read again
//! without decoding an image.
//!
//! In: a loaded view. Out: JSON, and the view again, whose source files are those that it was made
//! from. A source is taken for unchanged where length, times and number of its file are those of
//! before; where they are not, or are so young that a change could leave them, its content decides.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use luxel_core::{BadPixels, Camera, ColorSpace, NoiseModel, PixelValues};
use serde::{Deserialize, Serialize};

use crate::IoError;
use crate::atomic::write_cache_file;
use crate::dataset::load::LoadedView;
use crate::dataset::source::SourceFrame;
use crate::read_file::read_file;

/// Version of the layout; facts of another version are not used.
const VERSION: u32 = 3;
/// Age below which the times of a file may stay although it changes, nanoseconds.
const YOUNG_NS: u64 = 2_000_000_000;

/// The facts of a view.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Facts {
    version: u32,
    luxel_version: String,
    sources: Vec<Stamp>,
    /// When the sources were read, nanoseconds since 1970.
    read_at_ns: u64,
    digest: String,
    pub(super) photographed: Camera,
    pub(super) camera: Camera,
    noise: Option<[f32; 2]>,
    exposure_s: Option<f32>,
    pub(super) has_mask: bool,
    bad: Option<[usize; 3]>,
    color_space: Option<ColorSpace>,
    warnings: Vec<String>,
    is_black: bool,
    has_no_pixels: bool,
    hidden_by_mask: Option<f64>,
    photo_exposure: Option<f64>,
    is_display_coded: bool,
}

/// The properties of a file by which it is taken for unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    path: PathBuf,
    bytes: u64,
    changed_ns: u64,
    number: u64,
}

/// Returns the source files of a frame.
fn sources(frame: &SourceFrame) -> impl Iterator<Item = &Path> {
    std::iter::once(frame.image.as_path()).chain(frame.mask.as_deref())
}

fn now_ns() -> u64 {
    nanoseconds(SystemTime::now())
}

fn nanoseconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}

fn stamps(frame: &SourceFrame) -> Option<Vec<Stamp>> {
    sources(frame)
        .map(|path| {
            let found = std::fs::metadata(path).ok()?;
            let modified_ns = nanoseconds(found.modified().ok()?);
            let (changed_ns, number) = changed(&found, modified_ns);
            Some(Stamp { path: path.to_owned(), bytes: found.len(), changed_ns, number })
        })
        .collect()
}

/// Returns the time of the last change, which programs cannot set back, and the file's number.
#[cfg(unix)]
fn changed(found: &std::fs::Metadata, modified_ns: u64) -> (u64, u64) {
    use std::os::unix::fs::MetadataExt;
    let status_ns = (found.ctime().max(0) as u64).saturating_mul(1_000_000_000).saturating_add(found.ctime_nsec().max(0) as u64);
    (status_ns.max(modified_ns), found.ino())
}

#[cfg(not(unix))]
fn changed(_: &std::fs::Metadata, modified_ns: u64) -> (u64, u64) {
    (modified_ns, 0)
}

impl Facts {
    /// Returns the facts of a view that was read from `frame` just now; `None` where its files
    /// cannot be recognised again.
    pub(super) fn new(frame: &SourceFrame, loaded: &LoadedView) -> Option<Self> {
        let view = &loaded.view;
        Some(Self {
            version: VERSION,
            luxel_version: env!("CARGO_PKG_VERSION").to_owned(),
            sources: stamps(frame)?,
            read_at_ns: now_ns(),
            digest: loaded.digest.to_hex().to_string(),
            photographed: loaded.photographed.clone(),
            camera: view.camera.clone(),
            noise: view.noise.map(|noise| [noise.read, noise.shot]),
            exposure_s: match view.values {
                PixelValues::Radiance => None,
                PixelValues::Recorded { exposure_s } => Some(exposure_s),
            },
            has_mask: view.mask.is_some(),
            bad: loaded.bad.as_ref().map(|bad| [bad.nan, bad.infinite, bad.negative]),
            color_space: loaded.color_space,
            warnings: loaded.warnings.clone(),
            is_black: loaded.is_black,
            has_no_pixels: loaded.has_no_pixels,
            hidden_by_mask: loaded.hidden_by_mask,
            photo_exposure: loaded.photo_exposure,
            is_display_coded: loaded.is_display_coded,
        })
    }

    /// Reads the facts of `frame` from `path`; `None` unless they are of the files as they are now.
    pub(super) fn read(path: &Path, frame: &SourceFrame) -> Option<Self> {
        let bytes = std::fs::read(path).ok()?;
        let facts: Self = serde_json::from_slice(&bytes).ok()?;
        if facts.version != VERSION || facts.luxel_version != env!("CARGO_PKG_VERSION") {
            return None;
        }
        let now = stamps(frame)?;
        let is_old = |stamp: &Stamp| stamp.changed_ns.saturating_add(YOUNG_NS) < facts.read_at_ns;
        if now == facts.sources && now.iter().all(is_old) {
            return Some(facts);
        }
        let mut digest = blake3::Hasher::new();
        for source in sources(frame) {
            digest.update(&read_file(source).ok()?);
        }
        if digest.finalize().to_hex().as_str() != facts.digest {
            return None;
        }
        // The next start need not read them again.
        let facts = Self { sources: now, read_at_ns: now_ns(), ..facts };
        let _ = facts.write(path);
        Some(facts)
    }

    /// Writes the facts, whole or not at all.
    pub(super) fn write(&self, path: &Path) -> Result<(), IoError> {
        let json = serde_json::to_vec(self).map_err(|e| IoError::invalid(path, e))?;
        write_cache_file(path, |out| out.write_all(&json).map_err(|e| IoError::system(path, "write", &e)))
    }

    pub(super) fn digest(&self) -> Option<blake3::Hash> {
        blake3::Hash::from_hex(&self.digest).ok()
    }

    pub(super) fn values(&self) -> PixelValues {
        self.exposure_s.map_or(PixelValues::Radiance, |exposure_s| PixelValues::Recorded { exposure_s })
    }

    pub(super) fn noise(&self) -> Option<NoiseModel> {
        self.noise.map(|[read, shot]| NoiseModel { read, shot })
    }

    /// Returns what is known besides the view.
    pub(super) fn around(self, view: luxel_core::View) -> Option<LoadedView> {
        let digest = self.digest()?;
        let bad = self.bad.map(|[nan, infinite, negative]| BadPixels { name: view.name.clone(), nan, infinite, negative });
        Some(LoadedView {
            view,
            photographed: self.photographed,
            bad,
            color_space: self.color_space,
            warnings: self.warnings,
            is_black: self.is_black,
            has_no_pixels: self.has_no_pixels,
            hidden_by_mask: self.hidden_by_mask,
            photo_exposure: self.photo_exposure,
            is_display_coded: self.is_display_coded,
            digest,
        })
    }
}
