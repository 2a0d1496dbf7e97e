//! The sources of images and masks that are read when they are needed: a file of the cache, or the
//! file that the view came from.
//!
//! In: places of files, and how to make them anew. Out: [`Source`]s. A cached file that is gone or
//! damaged is made anew from the source file, once, and read again. Degenerate: a source file that
//! changed since the data set was read is an error, because the run would see two data sets.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use luxel_core::{Image, Make, Mask, OnDemand, ReadError, Remedy, Source, View, unreadable_image, unreadable_mask};

use super::record::{DigestCheck, Record, Shape};
use crate::{IoError, IoErrorKind};

/// Reads the view of a source file again: image and mask.
pub(crate) type Reread = dyn Fn() -> Result<View, IoError> + Send + Sync;

/// The memory that stored images may keep for themselves: a fixed part of the images, those that
/// came first.
#[derive(Debug)]
pub(crate) struct Residency {
    limit_bytes: u64,
    kept_bytes: AtomicU64,
}

impl Residency {
    pub(crate) fn new(limit_bytes: u64) -> Arc<Self> {
        Arc::new(Self { limit_bytes, kept_bytes: AtomicU64::new(0) })
    }

    /// Returns the bytes that are kept.
    #[cfg(test)]
    pub(crate) fn kept_bytes(&self) -> u64 {
        self.kept_bytes.load(Ordering::Relaxed)
    }

    fn give_back(&self, bytes: u64) {
        self.kept_bytes.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Takes `bytes` if there is room for them.
    fn take(&self, bytes: u64) -> bool {
        let room = |kept: u64| kept.checked_add(bytes).filter(|kept| *kept <= self.limit_bytes);
        self.kept_bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, room).is_ok()
    }
}

/// Extensions of the files of a view.
pub(super) const IMAGE: &str = "image";
pub(super) const MASK: &str = "mask";

/// A value that a record becomes.
pub(super) trait Stored: Sized + fmt::Debug + Send + Sync + 'static {
    const CHANNELS: usize;
    const EXTENSION: &'static str;
    fn from_values(values: Vec<f32>, size: [usize; 2]) -> Self;
    fn record(&self, size: [usize; 2]) -> Record;
    fn stand_in(size: [usize; 2]) -> Self;
}

impl Stored for Image {
    const CHANNELS: usize = 3;
    const EXTENSION: &'static str = IMAGE;

    fn from_values(values: Vec<f32>, [width, height]: [usize; 2]) -> Self {
        Self { width, height, pixels: into_pixels(values) }
    }

    fn record(&self, [width, height]: [usize; 2]) -> Record {
        Record::encode(Shape { width, height, channels: Self::CHANNELS }, self.pixels.as_flattened())
    }

    fn stand_in([width, height]: [usize; 2]) -> Self {
        unreadable_image(width, height)
    }
}

impl Stored for Mask {
    const CHANNELS: usize = 1;
    const EXTENSION: &'static str = MASK;

    fn from_values(weights: Vec<f32>, _: [usize; 2]) -> Self {
        Self { weights }
    }

    fn record(&self, [width, height]: [usize; 2]) -> Record {
        Record::encode(Shape { width, height, channels: Self::CHANNELS }, &self.weights)
    }

    fn stand_in([width, height]: [usize; 2]) -> Self {
        unreadable_mask(width * height)
    }
}

/// Returns values as pixels, without a copy where the allocation allows it.
fn into_pixels(values: Vec<f32>) -> Vec<[f32; 3]> {
    match bytemuck::try_cast_vec(values) {
        Ok(pixels) => pixels,
        Err((_, values)) => values.as_chunks::<3>().0.to_vec(),
    }
}

/// An image or a mask in a file of the cache.
pub(super) struct FileSource<T> {
    path: PathBuf,
    size: [usize; 2],
    residency: Arc<Residency>,
    make: Arc<Make<T>>,
    /// The record, if it is among those that are kept.
    kept: OnceLock<Record>,
    /// Whether the file's digest has been checked.
    checked: AtomicBool,
    /// Held while the file is made anew.
    making: Mutex<()>,
}

impl<T: Stored> FileSource<T> {
    /// Returns the source of a file, which need not exist yet.
    pub(super) fn new(path: PathBuf, size: [usize; 2], residency: &Arc<Residency>, make: Arc<Make<T>>) -> Self {
        let (kept, checked, making) = (OnceLock::new(), AtomicBool::new(false), Mutex::new(()));
        Self { path, size, residency: Arc::clone(residency), make, kept, checked, making }
    }

    /// Reads the record, and makes its file anew if it is damaged or gone.
    fn record(&self) -> Result<Record, ReadError> {
        let found = self.read_file();
        let Err(reason) = found else { return found.map_err(read_error) };
        let _alone = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        if reason.kind == IoErrorKind::Invalid {
            tracing::warn!("{reason}; it is made anew");
        }
        write(&self.path, &(self.make)()?, self.size).map_err(read_error)?;
        self.read_file().map_err(read_error)
    }

    fn read_file(&self) -> Result<Record, IoError> {
        let check = if self.checked.load(Ordering::Relaxed) { DigestCheck::No } else { DigestCheck::Yes };
        let record = Record::read(&self.path, check)?;
        let [width, height] = self.size;
        if record.shape() != (Shape { width, height, channels: T::CHANNELS }) {
            return Err(IoError::invalid(&self.path, "of another size"));
        }
        self.checked.store(true, Ordering::Relaxed);
        Ok(record)
    }
}

impl<T> Drop for FileSource<T> {
    fn drop(&mut self) {
        if let Some(record) = self.kept.get() {
            self.residency.give_back(record.bytes());
        }
    }
}

/// Writes a value into a file of the cache.
pub(super) fn write<T: Stored>(path: &Path, value: &T, size: [usize; 2]) -> Result<(), IoError> {
    value.record(size).write(path).map_err(with_remedy)
}

/// Adds to an error of writing what helps against it.
pub(super) fn with_remedy(error: IoError) -> IoError {
    let remedy = Remedy::advice("make room on that disk").or(Remedy::raise("image_memory")).or(Remedy::raise("downscale"));
    error.with_remedy(remedy)
}

impl<T> fmt::Debug for FileSource<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "stored in {}", self.path.display())
    }
}

impl<T: Stored> Source<T> for FileSource<T> {
    fn read(&self) -> Result<T, ReadError> {
        if let Some(record) = self.kept.get() {
            return Ok(T::from_values(record.decode(), self.size));
        }
        let record = self.record()?;
        let bytes = record.bytes();
        if !self.residency.take(bytes) {
            return Ok(T::from_values(record.into_values(), self.size));
        }
        let value = T::from_values(record.decode(), self.size);
        if self.kept.set(record).is_err() {
            // Another thread kept it meanwhile.
            self.residency.give_back(bytes);
        }
        Ok(value)
    }

    fn stand_in(&self) -> T {
        T::stand_in(self.size)
    }

    fn derived(&self, label: &str, size: [usize; 2], make: Arc<Make<T>>) -> Option<OnDemand<T>> {
        let stem = self.path.file_stem()?.to_str()?;
        let path = self.path.with_file_name(format!("{stem}-{label}.{}", T::EXTENSION));
        Some(OnDemand::from_source(Arc::new(Self::new(path, size, &self.residency, make))))
    }
}

/// An image or a mask that is decoded from its source file each time.
pub(super) struct RereadSource {
    pub(super) size: [usize; 2],
    pub(super) reread: Arc<Reread>,
}

impl fmt::Debug for RereadSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "view of {} x {} pixels in its file", self.size[0], self.size[1])
    }
}

impl Source<Image> for RereadSource {
    fn read(&self) -> Result<Image, ReadError> {
        Ok((self.reread)().map_err(read_error)?.image.into_value())
    }

    fn stand_in(&self) -> Image {
        Stored::stand_in(self.size)
    }
}

impl Source<Mask> for RereadSource {
    fn read(&self) -> Result<Mask, ReadError> {
        let mask = (self.reread)().map_err(read_error)?.mask;
        Ok(mask.map_or_else(|| Stored::stand_in(self.size), OnDemand::into_value))
    }

    fn stand_in(&self) -> Mask {
        Stored::stand_in(self.size)
    }
}

pub(super) fn read_error(error: IoError) -> ReadError {
    ReadError { message: error.to_string(), remedy: error.remedy }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fixed_part_stays_in_memory_and_no_more_than_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::filled(8, 4, [1.5; 3]);
        let bytes = 8 * 4 * 3 * 2;
        let residency = Residency::new(2 * bytes + 10);
        let make: Arc<Make<Image>> = {
            let image = image.clone();
            Arc::new(move || Ok(image.clone()))
        };
        let source = |i: usize| FileSource::new(folder.path().join(format!("{i}.image")), [8, 4], &residency, Arc::clone(&make));
        let sources: Vec<FileSource<Image>> = (0..4).map(source).collect();
        for round in 0..3 {
            for source in &sources {
                assert_eq!(source.read().unwrap(), image);
            }
            let kept: Vec<bool> = sources.iter().map(|source| source.kept.get().is_some()).collect();
            assert_eq!((kept, residency.kept_bytes()), (vec![true, true, false, false], 2 * bytes), "{round}");
        }
        // What is kept needs no file.
        std::fs::remove_file(folder.path().join("0.image")).unwrap();
        assert_eq!(sources[0].read().unwrap(), image);
        drop(sources);
        assert_eq!(residency.kept_bytes(), 0);
    }

    #[test]
    fn what_is_derived_is_made_once_and_kept_beside() {
        let folder = tempfile::tempdir().unwrap();
        let make = |pixel: f32| -> Arc<Make<Image>> { Arc::new(move || Ok(Image::filled(2, 2, [pixel; 3]))) };
        let source: FileSource<Image> = FileSource::new(folder.path().join("a.image"), [2, 2], &Residency::new(0), make(1.0));
        let smaller = source.derived("2", [2, 2], make(2.0)).unwrap();
        assert_eq!(smaller.loaded().unwrap().pixels[0], [2.0; 3]);
        assert!(folder.path().join("a-2.image").is_file());
        let again = source.derived("2", [2, 2], make(9.0)).unwrap();
        assert_eq!(again.loaded().unwrap().pixels[0], [2.0; 3]);
    }
}
