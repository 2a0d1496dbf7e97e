//! Data sets: posed images, their split into views to train on and views held out, and points.

use std::ops::Deref;
use std::path::Path;
use std::sync::mpsc::channel;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use luxel_core::{BadPixels, text};
use luxel_io::{AUTO_SIDE_PX, CheckPlan, ChosenDownscale, Downscale, ImageMemory, ImagePlan, KeepView, LoadOptions, LoadProgress, Loading};

use crate::error::Context;
use crate::{Event, ItemKind, Observer, Result};

/// Files with bad pixels that are listed one by one.
const LISTED_FILES: usize = 5;

/// A data set in memory. Dereferences to [`luxel_core::Dataset`], which has the views, points and
/// colour space.
#[derive(Clone, Debug)]
pub struct Dataset(luxel_core::Dataset);

impl Dataset {
    /// Reads the data set at `path`, a folder or a `transforms.json`, whose layout is recognised.
    ///
    /// # Errors
    /// An error if a file is missing, damaged or of an unknown layout.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_with(path, &LoadOptions::default())
    }

    /// Reads the data set at `path` as `options` ask.
    ///
    /// ```
    /// use luxel::{Dataset, LoadOptions, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # synthetic::write_dataset(folder.path(), synthetic::BallsOptions::default())?;
    /// let halved = LoadOptions { downscale: 2.into(), ..LoadOptions::default() };
    /// let dataset = Dataset::open_with(folder.path(), &halved)?;
    /// assert_eq!(dataset.train[0].camera.size_px, [12, 12]);
    /// assert!(dataset.warnings().is_empty());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// An error if a file is missing, damaged or not of the format asked for.
    pub fn open_with(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Self> {
        luxel_io::load_dataset(path.as_ref(), options).map(Self).context("cannot read the data set")
    }

    /// Reads the data set at `path`, and reports its warnings, masked pixels and size.
    ///
    /// # Errors
    /// As [`Self::open_with`].
    pub fn open_reporting(path: impl AsRef<Path>, options: &LoadOptions, observer: &dyn Observer) -> Result<Self> {
        Self::open_within(path, options, ImageLimits::default(), observer)
    }

    /// Reads the data set at `path` as [`Self::open_reporting`] does, within a limit of memory for
    /// its images. Those that have no room are read on demand: [`luxel_io::load_dataset_within`].
    ///
    /// # Errors
    /// As [`Self::open_with`]; a limit below what reading takes; a cache that cannot be written.
    pub fn open_within(path: impl AsRef<Path>, options: &LoadOptions, limits: ImageLimits<'_>, observer: &dyn Observer) -> Result<Self> {
        Self::open_planned(path.as_ref(), options, limits, observer, &|_| {})
    }

    /// Reads a data set as [`Self::open_within`] does; calls `planned` with what is known of its
    /// images before one is read.
    ///
    /// # Errors
    /// As [`Self::open_within`].
    pub fn open_planned(
        path: &Path,
        options: &LoadOptions,
        limits: ImageLimits<'_>,
        observer: &dyn Observer,
        planned: &dyn Fn(&ImagePlan),
    ) -> Result<Self> {
        let options = &Self::resolve_options(path, options, observer)?;
        let reading = Reading { path, options, limits, observer, planned };
        let dataset = Self(reading.run().context("cannot read the data set")?);
        for warning in dataset.warnings.iter().cloned().chain(bad_pixel_lines(&dataset)) {
            observer.warn(&warning);
        }
        let size = dataset.train.iter().chain(&dataset.test).next().map(|view| view.camera.size_px);
        observer.note(&format!(
            "{}: {}, {} to train on, {} to test, {}{}",
            path.display(),
            dataset.format,
            text::plural(dataset.train.len(), "view"),
            text::count(dataset.test.len()),
            text::plural(dataset.points.len(), "point"),
            size.map_or(String::new(), |[w, h]| format!(", {w}x{h}")),
        ));
        if let Some(line) = text::origin_line(&dataset.world_from_local) {
            observer.note(&line);
        }
        Ok(dataset)
    }

    /// Returns the options with a number for the reduction of the images: [`Downscale::Auto`] is
    /// resolved by the sizes of the images at `path`, and reported where it reduces them.
    ///
    /// # Errors
    /// Cameras or a split that cannot be read.
    pub fn resolve_options(path: impl AsRef<Path>, options: &LoadOptions, observer: &dyn Observer) -> Result<LoadOptions> {
        if options.downscale != Downscale::Auto {
            return Ok(options.clone());
        }
        let chosen = luxel_io::choose_downscale(path.as_ref(), options).context("cannot read the data set")?;
        if chosen.factor > 1 {
            observer.note(&reduction_line(chosen));
        }
        Ok(LoadOptions { downscale: Downscale::By(chosen.factor), ..options.clone() })
    }

    /// Makes a data set of images, cameras and points in memory, without files.
    ///
    /// ```
    /// use luxel::{Dataset, synthetic};
    /// use luxel_core::Image;
    /// use luxel_io::{MemoryDataset, MemoryView};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let camera = synthetic::room_camera([8, 6]);
    /// let image = Image::filled(8, 6, [2.0, 1.0, 0.5]);
    /// let view = MemoryView { name: "front".into(), camera, image, mask: None, is_test: false };
    /// let parts = MemoryDataset { views: vec![view], ..MemoryDataset::default() };
    /// let dataset = Dataset::from_memory(parts)?;
    /// assert_eq!(dataset.train[0].name, "front");
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// No view to train on, names that are not unique, parts whose sizes differ.
    pub fn from_memory(parts: luxel_io::MemoryDataset) -> Result<Self> {
        luxel_io::dataset_in_memory(parts).map(Self).context("cannot make the data set")
    }

    /// Returns the data set as the trainer and the readers have it.
    pub fn into_core(self) -> luxel_core::Dataset {
        self.0
    }

    /// Returns what a user should know about the data set, such as 8-bit images.
    pub fn warnings(&self) -> &[String] {
        &self.0.warnings
    }
}

impl From<luxel_core::Dataset> for Dataset {
    fn from(dataset: luxel_core::Dataset) -> Self {
        Self(dataset)
    }
}

impl Deref for Dataset {
    type Target = luxel_core::Dataset;

    fn deref(&self) -> &luxel_core::Dataset {
        &self.0
    }
}

/// How much memory the images of a data set may take, and where the others are stored.
#[derive(Clone, Copy, Default)]
pub struct ImageLimits<'a> {
    /// The memory that images may take.
    pub image_memory: ImageMemory,
    /// The folder for images that have no room. Without one, they are decoded from their files
    /// whenever they are needed.
    pub cache: Option<&'a Path>,
    /// May refuse the images before one is read, by their number and sizes.
    pub check: Option<&'a CheckPlan<'a>>,
    /// Which views stay in memory where all have room; all without it.
    pub keep: Option<&'a KeepView<'a>>,
}

/// Time after which the reading of a data set is reported view by view.
const QUIET_READING: Duration = Duration::from_secs(1);

/// The reading of a data set, with its progress.
struct Reading<'a> {
    path: &'a Path,
    options: &'a LoadOptions,
    limits: ImageLimits<'a>,
    observer: &'a dyn Observer,
    planned: &'a dyn Fn(&ImagePlan),
}

impl Reading<'_> {
    /// Reads on another thread, and reports the progress from this one.
    fn run(&self) -> std::result::Result<luxel_core::Dataset, luxel_io::IoError> {
        let start = Instant::now();
        let (sender, receiver) = channel();
        let sender = Mutex::new(sender);
        let (path, options, limits) = (self.path, self.options, self.limits);
        std::thread::scope(|scope| {
            let reader = scope.spawn(move || {
                let progress = |event| drop(sender.lock().unwrap_or_else(PoisonError::into_inner).send(event));
                let ImageLimits { image_memory, cache, check, keep } = limits;
                luxel_io::load_dataset_within(path, options, &Loading { image_memory, cache, progress: Some(&progress), check, keep })
            });
            let mut is_reported = false;
            for event in receiver {
                match event {
                    LoadProgress::Planned(plan) => {
                        (self.planned)(&plan);
                        if !plan.fits() {
                            self.observer.note(&plan_line(&plan));
                        }
                    }
                    LoadProgress::View { name, done, total } if start.elapsed() >= QUIET_READING => {
                        let [done, total] = [done, total].map(|count| u32::try_from(count).unwrap_or(u32::MAX));
                        self.observer.event(Event::Item { kind: ItemKind::LoadedView, name, done, total });
                        is_reported = true;
                    }
                    _ => {}
                }
            }
            if is_reported {
                self.observer.event(Event::StepsEnd);
            }
            reader.join().unwrap_or_else(|_| Err(luxel_io::IoError::invalid(path, "reading it stopped without a reason")))
        })
    }
}

/// Says how much images are reduced that are too large to be trained on as they are by default.
pub fn reduction_line(chosen: ChosenDownscale) -> String {
    let ([width, height], [to_width, to_height]) = (chosen.largest_px, chosen.reduced_px());
    let factor = chosen.factor;
    format!(
        "images are reduced {factor} times along each side, from {width}x{height} to {to_width}x{to_height} pixels: downscale auto keeps \
         the longer side within {AUTO_SIDE_PX} pixels, and downscale 1 takes them in full size"
    )
}

/// Says how images that have no room in memory are held.
fn plan_line(plan: &ImagePlan) -> String {
    let [decoded, limit] = [plan.decoded_bytes, plan.limit_bytes].map(text::bytes);
    let place = match &plan.cache {
        Some(folder) => format!("those to train on are stored in {} as half floats", folder.display()),
        None => "they are decoded when they are needed".to_owned(),
    };
    format!("the images take {decoded} decoded and may take {limit}: {place}")
}

/// Returns what was masked out, file by file; a long list is cut.
pub fn bad_pixel_lines(dataset: &luxel_core::Dataset) -> Vec<String> {
    let line = |bad: &BadPixels| {
        let kinds = [(bad.nan, "NaN"), (bad.infinite, "infinite"), (bad.negative, "negative")];
        let kinds: Vec<String> = kinds.into_iter().filter(|(n, _)| *n > 0).map(|(n, kind)| format!("{} {kind}", text::count(n))).collect();
        format!("{}: masked pixels: {}", bad.name, kinds.join(", "))
    };
    let mut lines: Vec<String> = dataset.bad_pixels.iter().take(LISTED_FILES).map(line).collect();
    if dataset.bad_pixels.len() > LISTED_FILES {
        let rest = &dataset.bad_pixels[LISTED_FILES..];
        let pixels = rest.iter().map(|bad| bad.nan + bad.infinite + bad.negative).sum();
        lines.push(format!("{} more with {} masked", text::plural(rest.len(), "image"), text::plural(pixels, "pixel")));
    }
    lines
}
