//! From frames to a data set: names checked, split applied, images loaded in parallel, points
//! mapped, digest taken.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DAffine3, DVec3};
use luxel_core::{BadPixels, ColorSpace, Dataset, Point, PointCoverage, SceneBounds, Similarity, View};
use rayon::prelude::*;

use super::block::Block;
use super::checks::{self, CheckedView};
use super::developed::is_developed;
use super::fingerprint::Fingerprint;
use super::image_memory::{PlannedImage, ViewPlace, plan};
use super::load::{LoadedView, load_view};
use super::metres::metres_per_unit;
use super::observations::{ObservedView, map_points};
use super::selected::{Role, SelectedFrame, Split, select, with_captured};
use super::source::{DatasetSource, SourceFrame, SourcePoint};
use super::split::{Part, SplitRule, assign};
use super::view_cache::{CachedFrame, Residency, ViewCache};
use super::{LoadOptions, LoadProgress, Loading, Supervision, masks, recordings};
use crate::IoError;
use crate::image::image_size;

/// Names that a warning lists.
const MAX_LISTED: usize = 3;

/// The block that a data set is reduced to, and its folder.
#[derive(Clone, Copy)]
pub(super) struct BlockOf<'a> {
    pub(super) block: &'a Block,
    pub(super) folder: &'a Path,
}

pub(super) fn assemble(
    path: &Path,
    source: DatasetSource,
    block: Option<BlockOf<'_>>,
    options: &LoadOptions,
    loading: &Loading<'_>,
) -> Result<Dataset, IoError> {
    let DatasetSource { format, folder, frames, split, points, points_from, mut warnings, .. } = source;
    let mut frames = supervised(path, frames, &split, options)?;
    let world_from_local = local_coordinates(&frames, &points);
    let local_from_world = world_from_local.inverse();
    frames.iter_mut().for_each(|frame| local_from_world.apply_to_pose(&mut frame.camera_from_world));
    let Arranged { sorted, order, mut parts } = Arranged::new(&frames, &split)?;
    block.map_or(Ok(()), |of| of.block.restrict(&sorted, &mut parts, of.folder))?;
    let of = |part| indices_of(&parts, part);
    let (train, test, left_out) = (of(Some(Part::Train)), of(Some(Part::Test)), of(None));
    if train.is_empty() {
        return Err(IoError::invalid(path, format!("no training images among {}, expected at least one", sorted.len())));
    }
    if block.is_none() {
        warnings.extend(left_out_warning(left_out.iter().map(|i| sorted[*i].name.as_str()).collect()));
    }
    if test.is_empty() {
        warnings.push("no test views: no image is held out to measure quality with".to_owned());
    }

    let mut used = select(path, &Split { frames: &sorted, order: &order, train: &train, test: &test }, options)?;
    warnings.extend(masks::attach(&folder, used.iter_mut().map(|used| &mut used.frame), &options.masks)?);
    let (loaded, readers) = load_views(path, &used, options, loading)?;
    warnings.extend(grouped_warnings(&loaded));

    let mut targets: Vec<Vec<ObservedView<'_>>> = frames.iter().map(|_| Vec::new()).collect();
    for (index, (used, l)) in (0u32..).zip(used.iter().zip(&loaded)).filter(|(_, (used, _))| used.role == Role::Train) {
        let foreign_lens = used.frame.intrinsics.foreign_lens.map(|lens| lens.prepared());
        targets[used.source].push(ObservedView { index, photographed: &l.photographed, foreign_lens, view: &l.view });
    }
    let mut points = map_points(points, &targets, &local_from_world).map_err(|error| IoError::invalid(path, error))?;
    if let Some(BlockOf { block, .. }) = block {
        block.choose_points(&mut points, &train_views(&used, &loaded), &world_from_local);
    }
    let checked: Vec<CheckedView<'_>> = used.iter().zip(&loaded).map(|(used, loaded)| CheckedView { frame: &used.frame, loaded }).collect();
    warnings.extend(checks::warnings(&folder, &checked, &points));
    warnings.extend(checks::idle_transfer(&checked, options));
    let color_space = common_color_space(&used, &loaded, options)?;

    let fingerprint = fingerprint(Fingerprint::new(&format, options), &used, &loaded, &points, &world_from_local);

    let (bad_pixels, is_developed) = (bad_pixels(&loaded), is_developed(&folder, &loaded));
    let (train, test) = with_captured(path, loaded.into_iter().map(|l| l.view), &used)?;
    warnings.extend(PointCoverage::new(&points, &train).warning(&points_from));
    let metres_per_unit = metres_per_unit(path, &folder)?;
    Ok(Dataset {
        format,
        train,
        test,
        points,
        color_space,
        bad_pixels,
        fingerprint,
        warnings,
        world_from_local,
        metres_per_unit,
        is_developed,
        readers,
    })
}

/// Frames by name, with the sides of the split that they are on.
pub(super) struct Arranged<'a> {
    pub(super) sorted: Vec<&'a SourceFrame>,
    /// Index of each among those of the source.
    pub(super) order: Vec<usize>,
    pub(super) parts: Vec<Option<Part>>,
}

impl<'a> Arranged<'a> {
    /// Sorts frames, whose names must be unique, and applies the split.
    pub(super) fn new(frames: &'a [SourceFrame], split: &SplitRule) -> Result<Self, IoError> {
        let mut order: Vec<usize> = (0..frames.len()).collect();
        order.sort_by(|a, b| frames[*a].name.cmp(&frames[*b].name));
        let sorted: Vec<&SourceFrame> = order.iter().map(|i| &frames[*i]).collect();
        check_names(&sorted)?;
        let names: Vec<&str> = sorted.iter().map(|frame| frame.name.as_str()).collect();
        let own: Vec<Option<Part>> = sorted.iter().map(|frame| frame.part).collect();
        let parts = assign(split, &names, &own)?;
        Ok(Self { sorted, order, parts })
    }
}

/// Returns the indices of the frames on one side of a split; of those on none, without a side.
pub(super) fn indices_of(parts: &[Option<Part>], part: Option<Part>) -> Vec<usize> {
    (0..parts.len()).filter(|i| parts[*i] == part).collect()
}

/// Returns the frames that have images of the kinds that are asked for, at least one.
pub(super) fn supervised(
    path: &Path,
    frames: Vec<SourceFrame>,
    split: &SplitRule,
    options: &LoadOptions,
) -> Result<Vec<SourceFrame>, IoError> {
    let frames = match options.supervision {
        Supervision::Hdr => recordings::radiance_alone(frames, split),
        Supervision::Ldr => recordings::pair_unlisted(frames, split),
        Supervision::Both => recordings::pair(path, frames)?,
    };
    if frames.is_empty() { Err(IoError::invalid(path, "no images, expected at least one")) } else { Ok(frames) }
}

/// Returns what was masked, by name.
fn bad_pixels(loaded: &[LoadedView]) -> Vec<BadPixels> {
    let mut found: Vec<BadPixels> = loaded.iter().filter_map(|loaded| loaded.bad.clone()).collect();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// Returns the views to train on.
fn train_views<'a>(used: &[SelectedFrame], loaded: &'a [LoadedView]) -> Vec<&'a View> {
    used.iter().zip(loaded).filter(|(used, _)| used.role == Role::Train).map(|(_, loaded)| &loaded.view).collect()
}

/// Returns a warning of views that are on no side of the split.
fn left_out_warning(names: Vec<&str>) -> Option<String> {
    (!names.is_empty()).then(|| format!("left out, neither in train nor in test: {}", count_and_names(&names)))
}

/// Returns the digest of the data set, of which `begun` has the options.
fn fingerprint(
    mut begun: Fingerprint,
    used: &[SelectedFrame],
    loaded: &[LoadedView],
    points: &[Point],
    world_from_local: &Similarity,
) -> String {
    for (used, l) in used.iter().zip(loaded) {
        begun.text(match used.role {
            Role::Train => "train",
            Role::Test => "test",
            Role::Captured | Role::CapturedTest => "captured",
        });
        begun.view(&l.view, &l.digest);
        begun.foreign_lens(used.frame.intrinsics.foreign_lens);
    }
    begun.points(points);
    begun.local_coordinates(world_from_local);
    begun.finish()
}

/// Returns the transform from the coordinates in which the data set is held to its own. It depends
/// on all frames, whatever the split.
fn local_coordinates(frames: &[SourceFrame], points: &[SourcePoint]) -> Similarity {
    let eyes: Vec<DVec3> = frames.iter().map(|frame| eye(&frame.camera_from_world)).collect();
    let points: Vec<DVec3> = points.iter().map(|point| point.position.into()).collect();
    SceneBounds::from_views(&eyes, &points).map_or(Similarity::IDENTITY, |bounds| bounds.world_from_local())
}

fn eye(camera_from_world: &DAffine3) -> DVec3 {
    -(camera_from_world.matrix3.transpose() * camera_from_world.translation)
}

/// Returns the views in the order of `used`, with their pixels in memory if all have room there,
/// and how many of them memory has room for reading side by side. Of several that cannot be read,
/// the first by name is reported, whichever thread came upon one first; once one failed, no view
/// behind it is begun.
fn load_views(
    path: &Path,
    used: &[SelectedFrame],
    options: &LoadOptions,
    loading: &Loading<'_>,
) -> Result<(Vec<LoadedView>, usize), IoError> {
    let mut by_name: Vec<usize> = (0..used.len()).collect();
    by_name.sort_by(|a, b| used[*a].frame.name.cmp(&used[*b].frame.name));
    let mut rank = vec![0; used.len()];
    by_name.iter().enumerate().for_each(|(place, i)| rank[*i] = place);
    // A header that cannot be read is an error of the image, below.
    let sizes = used.iter().filter_map(|used| {
        let (mask, lens) = (&used.frame.mask, &used.frame.intrinsics);
        Some(PlannedImage {
            size_px: image_size(&used.frame.image).ok()?,
            has_weights: mask.is_some() || !lens.distortion.is_none() || !lens.projection.is_pinhole(),
            is_train: !matches!(used.role, Role::Test | Role::CapturedTest),
        })
    });
    let plan = plan(path, sizes, options.downscale.factor(), loading);
    if let Some(progress) = loading.progress {
        progress(LoadProgress::Planned(plan.clone()));
    }
    plan.check()?;
    if let Some(check) = loading.check {
        check(&plan)?;
    }
    let places = places(used);
    let elsewhere = ViewCache::new(None, Residency::new(0));
    let cache = (!plan.fits()).then(|| ViewCache::new(loading.cache, Residency::new(plan.resident_bytes())));
    let (first_bad, done, total) = (AtomicUsize::new(usize::MAX), AtomicUsize::new(0), used.len());
    let captured = LoadOptions { supervision: Supervision::Ldr, ..options.clone() };
    let load = |((used, &rank), &place): ((&SelectedFrame, &usize), &ViewPlace)| {
        if rank > first_bad.load(Ordering::Relaxed) {
            return None;
        }
        let options = used.options(options, &captured);
        let loaded = match &cache {
            None if loading.keep.is_some_and(|keep| !keep(place)) => {
                load_view(&used.frame, options).and_then(|view| elsewhere.store(&used.frame, options, view))
            }
            None => load_view(&used.frame, options),
            Some(cache) => match cache.find(&used.frame, options) {
                Some(view) => Ok(view),
                None => load_view(&used.frame, options).and_then(|view| cache.store(&used.frame, options, view)),
            },
        };
        match (&loaded, loading.progress) {
            (Err(_), _) => drop(first_bad.fetch_min(rank, Ordering::Relaxed)),
            (Ok(view), Some(progress)) => {
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                progress(LoadProgress::View { name: view.view.name.clone(), done, total });
            }
            (Ok(_), None) => {}
        }
        Some(loaded)
    };
    // Memory has room for a few images only while they are decoded.
    let parallel = if cache.is_some() { plan.parallel() } else { used.len() };
    let chunks = used.chunks(parallel.max(1)).zip(rank.chunks(parallel.max(1))).zip(places.chunks(parallel.max(1)));
    let loaded: Vec<Option<Result<LoadedView, IoError>>> =
        chunks.flat_map(|((used, rank), place)| used.par_iter().zip(rank).zip(place).map(load).collect::<Vec<_>>()).collect();
    if let Some(cache) = &cache {
        cache.prune(used.iter().map(|used| CachedFrame { frame: &used.frame, options: used.options(options, &captured) }));
    }
    let mut views = Vec::with_capacity(used.len());
    let mut bad: Option<(usize, IoError)> = None;
    for (&rank, loaded) in rank.iter().zip(loaded) {
        match loaded {
            Some(Ok(view)) => views.push(view),
            Some(Err(error)) if bad.as_ref().is_none_or(|(first, _)| rank < *first) => bad = Some((rank, error)),
            Some(Err(_)) | None => {}
        }
    }
    bad.map_or(Ok((views, plan.readers())), |(_, error)| Err(error))
}

/// Returns the place of each view; those to train on come first. A captured image goes with the
/// training view of its pose.
fn places(used: &[SelectedFrame]) -> Vec<ViewPlace> {
    let train = used.iter().filter(|used| used.role == Role::Train).count();
    let of_pose = |view: &SelectedFrame, role| used.iter().position(|other| other.role == role && other.source == view.source);
    let place = |(i, view): (usize, &SelectedFrame)| match view.role {
        Role::Train => ViewPlace::Train(i),
        Role::Test => ViewPlace::Test(i - train),
        Role::Captured => ViewPlace::Train(of_pose(view, Role::Train).unwrap_or(0)),
        Role::CapturedTest => ViewPlace::Test(of_pose(view, Role::Test).map_or(0, |i| i - train)),
    };
    used.iter().enumerate().map(place).collect()
}

/// Names are unique and not empty.
fn check_names(sorted: &[&SourceFrame]) -> Result<(), IoError> {
    if let Some(nameless) = sorted.iter().find(|frame| frame.name.is_empty()) {
        return Err(nameless.origin.error("the image has no name"));
    }
    match sorted.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some([a, b]) => {
            let first = format!("{}: {}", a.origin.path.display(), a.origin.place);
            Err(b.origin.error(format!("the image is named {:?} like that of {first}, expected each image once", b.name)))
        }
        _ => Ok(()),
    }
}

/// Returns `image a` or "35 images (a, b, c, ...)".
fn count_and_names(names: &[&str]) -> String {
    match names {
        [one] => format!("image {one}"),
        many => {
            let listed = many.iter().take(MAX_LISTED).copied().collect::<Vec<_>>().join(", ");
            let more = if many.len() > MAX_LISTED { ", ..." } else { "" };
            format!("{} images ({listed}{more})", many.len())
        }
    }
}

/// Returns each warning once, with the images it is about.
fn grouped_warnings(loaded: &[LoadedView]) -> Vec<String> {
    let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
    for l in loaded {
        for warning in &l.warnings {
            match groups.iter_mut().find(|(text, _)| text == warning) {
                Some((_, names)) => names.push(&l.view.name),
                None => groups.push((warning, vec![&l.view.name])),
            }
        }
    }
    let line = |(text, mut names): (&str, Vec<&str>)| {
        names.sort_unstable();
        format!("{}: {text}", count_and_names(&names))
    };
    groups.into_iter().map(line).collect()
}

/// Returns the one colour space.
fn common_color_space(used: &[SelectedFrame], loaded: &[LoadedView], options: &LoadOptions) -> Result<ColorSpace, IoError> {
    let space = |l: &LoadedView| l.color_space.or(options.color_space).unwrap_or_default();
    let Some(first) = loaded.first() else { return Ok(ColorSpace::default()) };
    match loaded.iter().zip(used).find(|(l, _)| space(l) != space(first)) {
        None => Ok(space(first)),
        Some((l, used)) => Err(IoError::invalid(
            &used.frame.image,
            format!(
                "colour space {}, but image {} has {}: expected one for all, convert the images first",
                space(l).name(),
                first.view.name,
                space(first).name()
            ),
        )),
    }
}
