//! How much memory the images of a data set may take, and whether they fit.
//!
//! In: a limit, and the sizes of images by their headers. Out: a plan: all decoded in memory, or
//! read on demand with a part that stays. Degenerate: a limit below what reading itself takes is an
//! error with the numbers.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use luxel_core::Remedy;
use serde::{Deserialize, Serialize};

use crate::memory::system_memory;
use crate::{IoError, memory};

/// Decoded views that are in memory at the same time, whatever else is: the one in use, the one
/// that is read ahead, and one that is measured, or what decoding takes besides its result.
pub const VIEWS_IN_USE: u64 = 3;

/// Decoded views for every two that are read side by side from the cache: a stored view takes half
/// of what it takes decoded, and both are in memory while it is decoded.
const VIEWS_PER_TWO_READERS: u64 = 3;

/// The share of the limit that reading side by side may take where it is more than
/// [`VIEWS_IN_USE`]: what it takes, no stored image may keep.
const READERS_SHARE: u64 = 16;

/// Views in memory that are made radiance of side by side. What that takes, 16 bytes a pixel each,
/// is less than a measurement takes later.
const READERS_IN_MEMORY: usize = 8;

/// The share of the system's memory that `auto` gives to images.
const AUTO_SHARE: u64 = 2;

/// Bytes of a decoded pixel, and of its weight.
const PIXEL_BYTES: u64 = 12;
const WEIGHT_BYTES: u64 = 4;

/// The limit on the memory that the images of a data set take, without the engine's own buffers.
///
/// ```
/// use luxel_io::ImageMemory;
///
/// assert_eq!("1.5GiB".parse(), Ok(ImageMemory::Bytes(3 << 29)));
/// assert_eq!(ImageMemory::Bytes(3 << 29).to_string(), "1536MiB");
/// assert!("1".parse::<ImageMemory>().is_err());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ImageMemory {
    /// Half of what the machine, its control group or a limit on the process allows.
    #[default]
    Auto,
    /// This many bytes.
    Bytes(u64),
}

impl ImageMemory {
    /// Returns the limit, bytes; `u64::MAX` where the system tells none.
    pub fn bytes(self) -> u64 {
        match self {
            Self::Auto => system_memory().map_or(u64::MAX, |bytes| bytes / AUTO_SHARE),
            Self::Bytes(bytes) => bytes,
        }
    }
}

/// Units of sizes, the longest first.
const UNITS: [(&str, u64); 8] = [
    ("TiB", 1 << 40),
    ("GiB", 1 << 30),
    ("MiB", 1 << 20),
    ("KiB", 1 << 10),
    ("TB", 1_000_000_000_000),
    ("GB", 1_000_000_000),
    ("MB", 1_000_000),
    ("kB", 1000),
];

impl FromStr for ImageMemory {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let error = || format!("\"{text}\" is no size, expected auto, or a number above 0 with a unit, such as 4GiB or 512MiB");
        let lower = text.to_ascii_lowercase();
        let found = UNITS.iter().find_map(|(unit, bytes)| Some((lower.strip_suffix(&unit.to_ascii_lowercase())?, *bytes)));
        let (number, unit) = found.ok_or_else(error)?;
        let number: f64 = number.trim().parse().map_err(|_| error())?;
        let bytes = number * unit as f64;
        if number.is_finite() && bytes >= 1.0 && bytes < (1u64 << 60) as f64 { Ok(Self::Bytes(bytes as u64)) } else { Err(error()) }
    }
}

impl fmt::Display for ImageMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Bytes(bytes) = self else { return f.write_str("auto") };
        let whole = UNITS.iter().take(4).find(|(_, unit)| bytes.is_multiple_of(*unit));
        match whole {
            Some((name, unit)) => write!(f, "{}{name}", bytes / unit),
            // A number of bytes that no unit divides.
            None => write!(f, "{}kB", *bytes as f64 / 1000.0),
        }
    }
}

impl TryFrom<String> for ImageMemory {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<ImageMemory> for String {
    fn from(memory: ImageMemory) -> Self {
        memory.to_string()
    }
}

/// A function that may refuse a plan before an image is read.
pub type CheckPlan<'a> = dyn Fn(&ImagePlan) -> Result<(), IoError> + Sync + 'a;

/// A view by its number among those of its side of the split, in the order of the data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewPlace {
    /// A view to train on.
    Train(usize),
    /// A view that is held out.
    Test(usize),
}

/// A function that chooses the views whose pixels stay in memory.
pub type KeepView<'a> = dyn Fn(ViewPlace) -> bool + Sync + 'a;

/// How the images of a data set are held while it is used.
#[derive(Clone, Copy, Default)]
pub struct Loading<'a> {
    /// The memory that images may take.
    pub image_memory: ImageMemory,
    /// The folder for images that memory has no room for. Without one, they are decoded from their
    /// files whenever they are needed.
    pub cache: Option<&'a Path>,
    /// Receives what is known before an image is read, and each view that was read.
    pub progress: Option<&'a (dyn Fn(LoadProgress) + Sync)>,
    /// May refuse a plan before an image is read.
    pub check: Option<&'a CheckPlan<'a>>,
    /// Which views stay in memory where all have room; the others are decoded from their files
    /// whenever they are needed. Without it, all stay.
    pub keep: Option<&'a KeepView<'a>>,
}

/// An event while a data set is read.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum LoadProgress {
    /// The images' sizes are known, but nothing is read yet.
    Planned(ImagePlan),
    /// One more view is ready.
    View {
        /// Name of the view.
        name: String,
        /// Views ready so far.
        done: usize,
        /// Views in all.
        total: usize,
    },
}

/// How the images are held.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImagePlan {
    /// The data set.
    pub path: PathBuf,
    /// Number of images.
    pub images: usize,
    /// Bytes of all images decoded.
    pub decoded_bytes: u64,
    /// Bytes of the largest image decoded.
    pub largest_bytes: u64,
    /// Pixels of the largest image.
    pub largest_px: u64,
    /// Pixels of all images to train on.
    pub train_px: u64,
    /// The limit, bytes.
    pub limit_bytes: u64,
    /// The folder of the cache, if images are read on demand from one.
    pub cache: Option<PathBuf>,
}

impl ImagePlan {
    /// Returns whether all images are held in memory, decoded.
    pub fn fits(&self) -> bool {
        self.decoded_bytes <= self.limit_bytes
    }

    /// Returns the most memory that the images take, bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.decoded_bytes.min(self.limit_bytes)
    }

    /// Returns how many views the start of a training reads side by side. A view that is decoded
    /// from its source takes as much memory as there is beside the stored ones.
    pub fn readers(&self) -> usize {
        let at_once = match self.cache {
            _ if self.fits() => return readers_in_memory(),
            Some(_) => 2 * self.decoded_views() / VIEWS_PER_TWO_READERS,
            None => self.decoded_views() / VIEWS_IN_USE,
        };
        usize::try_from(at_once).unwrap_or(usize::MAX).clamp(1, threads())
    }

    /// Returns how many decoded views there is room for beside those that stay in memory as they
    /// are stored.
    fn decoded_views(&self) -> u64 {
        let wanted = (threads() as u64 * VIEWS_PER_TWO_READERS).div_ceil(2);
        let share = self.limit_bytes / READERS_SHARE / self.largest_bytes.max(1);
        wanted.min(share).max(VIEWS_IN_USE)
    }

    /// Returns the memory in which stored images stay, bytes.
    pub(super) fn resident_bytes(&self) -> u64 {
        self.limit_bytes.saturating_sub(self.decoded_views() * self.largest_bytes)
    }

    /// Returns how many views are read at the same time.
    pub(super) fn parallel(&self) -> usize {
        let room = self.limit_bytes / (VIEWS_IN_USE * self.largest_bytes).max(1);
        usize::try_from(room).unwrap_or(usize::MAX).clamp(1, threads())
    }

    /// Refuses a limit below what reading takes.
    pub(super) fn check(&self) -> Result<(), IoError> {
        let needed = VIEWS_IN_USE * self.largest_bytes;
        if self.fits() || needed <= self.limit_bytes {
            return Ok(());
        }
        let message = format!(
            "the largest image takes {} decoded, and {VIEWS_IN_USE} are in memory at the same time: {}; the images may take {}",
            memory::mebibytes(self.largest_bytes),
            memory::mebibytes(needed),
            memory::mebibytes(self.limit_bytes)
        );
        let remedy = Remedy::set("image_memory", format!("{}MiB", needed.div_ceil(1 << 20))).or(Remedy::raise("downscale"));
        Err(IoError::unsupported(&self.path, message).with_remedy(remedy))
    }
}

/// Returns the number of threads that share the work.
fn threads() -> usize {
    rayon::current_num_threads().max(1)
}

/// Returns how many views in memory are made radiance of side by side.
pub(super) fn readers_in_memory() -> usize {
    threads().min(READERS_IN_MEMORY)
}

/// The size of an image, as its header and the options of reading say.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlannedImage {
    pub(super) size_px: [u32; 2],
    pub(super) has_weights: bool,
    pub(super) is_train: bool,
}

/// Returns the plan for images of these sizes.
pub(super) fn plan(path: &Path, sizes: impl Iterator<Item = PlannedImage>, downscale: u32, loading: &Loading<'_>) -> ImagePlan {
    let mut plan = ImagePlan {
        path: path.to_owned(),
        images: 0,
        decoded_bytes: 0,
        largest_bytes: 0,
        largest_px: 0,
        train_px: 0,
        limit_bytes: loading.image_memory.bytes(),
        cache: loading.cache.map(Path::to_owned),
    };
    for PlannedImage { size_px, has_weights, is_train } in sizes {
        let pixels: u64 = size_px.iter().map(|side| u64::from(side / downscale.max(1))).product();
        let bytes = pixels * (PIXEL_BYTES + if has_weights { WEIGHT_BYTES } else { 0 });
        plan.images += 1;
        plan.decoded_bytes += bytes;
        plan.largest_bytes = plan.largest_bytes.max(bytes);
        plan.largest_px = plan.largest_px.max(pixels);
        plan.train_px += if is_train { pixels } else { 0 };
    }
    plan
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_their_unit() {
        for (text, bytes) in [("1GiB", 1 << 30), ("512 MiB", 512 << 20), ("2gb", 2_000_000_000), ("0.5TiB", 1 << 39), ("8kB", 8000)] {
            let memory: ImageMemory = text.parse().unwrap();
            assert_eq!(memory, ImageMemory::Bytes(bytes), "{text}");
            assert_eq!(memory.to_string().parse(), Ok(memory), "{memory}");
        }
        assert_eq!("auto".parse(), Ok(ImageMemory::Auto));
        for bad in ["", "GiB", "1", "-1GiB", "0MiB", "nanGiB", "infGiB", "1e30TiB", "1 G", "1GiBs", "é", "1éiB"] {
            assert!(bad.parse::<ImageMemory>().unwrap_err().contains("expected auto"), "{bad}");
        }
    }

    #[test]
    fn a_plan_says_what_fits() {
        let loading = |bytes| Loading { image_memory: ImageMemory::Bytes(bytes), ..Loading::default() };
        let sizes = || {
            [
                PlannedImage { size_px: [100, 50], has_weights: false, is_train: true },
                PlannedImage { size_px: [81, 40], has_weights: true, is_train: false },
            ]
            .into_iter()
        };
        let all = plan(Path::new("data"), sizes(), 1, &loading(u64::MAX));
        assert_eq!((all.images, all.decoded_bytes, all.largest_bytes, all.fits(), all.train_px), (2, 60_000 + 51_840, 60_000, true, 5000));
        let half = plan(Path::new("data"), sizes(), 2, &loading(27_959));
        assert_eq!((half.decoded_bytes, half.fits()), (15_000 + 12_800, true));
        let tight = plan(Path::new("data"), sizes(), 1, &loading(111_839));
        assert!(!tight.fits());
        let error = tight.check().unwrap_err();
        assert!(error.message.contains("3 are in memory at the same time"), "{error}");
        assert!(error.remedy.is_some_and(|remedy| remedy.options().eq(["image_memory", "downscale"])));
    }

    #[test]
    fn what_is_read_side_by_side_and_what_stays_are_within_the_limit() {
        let size = || (0..300).map(|_| PlannedImage { size_px: [1000, 1000], has_weights: false, is_train: true });
        let view = 12_000_000;
        let of = |views: u64, cache, threads: usize| {
            let loading = Loading { image_memory: ImageMemory::Bytes(views * view), cache, ..Loading::default() };
            let plan = plan(Path::new("data"), size(), 1, &loading);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| (plan.readers(), plan.resident_bytes()))
        };
        let cache = Some(Path::new("run.images"));
        // A reader takes a view and a half: three views are two readers.
        assert_eq!(of(3, cache, 8), (2, 0));
        assert_eq!(of(10, cache, 8), (2, 7 * view));
        assert_eq!(of(160, cache, 8), (6, 150 * view));
        assert_eq!(of(290, cache, 8), (8, 278 * view));
        assert_eq!(of(290, cache, 1), (1, 287 * view));
        // Decoding from the source takes up to three.
        assert_eq!(of(10, None, 8), (1, 7 * view));
        assert_eq!(of(300, cache, 32).0, READERS_IN_MEMORY);
    }
}
