//! The scenes of all blocks as one.
//!
//! In: a folder of blocks, each with a run. Out: the splats of each block that lie within its core,
//! in one scene; how many each block had and gave. Cores fill the ground without overlap, so every
//! place has splats of one block. Where training found gains of images, blocks are first brought to
//! one exposure gauge by a factor each (see `gauge`). Degenerate: a block without a run, and
//! runs whose scenes do not go together (colour model, rasteriser, radiance scale, colour space,
//! coordinates) are errors that name the block; refined poses, which each block aligned by itself,
//! are a warning.

use std::path::Path;

use luxel::error::{Context, bail};
use luxel::{Error, Observer, Result};
use luxel_core::edit::{MaskShares, ShMap};
use luxel_core::{Edit, Map, Remedy, Scene, Selection};
use luxel_io::Block;

use super::gauge::{self, Gains};
use super::{BlockList, run_folder};
use crate::run::{Captures, RunFolder, state};
use crate::text;

/// Differences between channels of a block's factor that go unmentioned, stops.
const GREY_EV: f64 = 0.01;

/// Blocks that an error lists.
const LISTED: usize = 5;

/// One block's part of a merged scene.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockPart {
    /// Name of the block's folder.
    pub name: String,
    /// Number of splats of its run.
    pub splats: usize,
    /// Number of those in its core.
    pub kept: usize,
    /// Factor of its radiance, stops; 0 unless training found gains of images.
    pub gain_ev: f64,
}

/// A merged scene.
#[derive(Debug)]
pub struct MergedScene {
    /// The scene.
    pub scene: Scene,
    /// The blocks, in order.
    pub parts: Vec<BlockPart>,
}

/// Joins the newest scenes of all blocks of a folder that [`super::split()`] made.
///
/// # Errors
/// A block without a run that can be read, scenes that do not go together.
pub fn merge(folder: &Path, observer: &dyn Observer) -> Result<MergedScene> {
    let list = BlockList::read(folder)?;
    check_runs(folder, &list)?;
    let mut gains: Vec<Gains> = Vec::with_capacity(list.blocks.len());
    for name in &list.blocks {
        gains.push(gains_of(folder, name, observer)?);
    }
    let shifts = gauge::shifts(&gains);
    let mut merged: Option<Scene> = None;
    let mut parts = Vec::with_capacity(list.blocks.len());
    for (name, shift) in list.blocks.iter().zip(&shifts) {
        let block = read_block(folder, name)?;
        let (run, _) = RunFolder::open(&run_folder(folder, name))?;
        let (_, scene) = state::newest_scene(&run, observer)?;
        if let Some(first) = &merged {
            check_fits(first, &scene).map_err(|difference| {
                Error::new(format!("{name}: {difference}")).with_remedy(Remedy::advice("train all blocks with the same options"))
            })?;
        }
        let kept: Vec<u32> =
            (0_u32..).zip(0..scene.splats.len()).filter(|(_, i)| block.owns(scene.world_position(*i))).map(|(i, _)| i).collect();
        let mut part = Scene { splats: scene.splats.select(kept.iter().copied()), ..scene };
        let gain_ev = brighten(&mut part, shift, name, observer)?;
        parts.push(BlockPart { name: name.clone(), splats: scene.splats.len(), kept: kept.len(), gain_ev });
        match &mut merged {
            None => merged = Some(part),
            Some(whole) => whole.splats.append(part.splats),
        }
    }
    let Some(mut scene) = merged else { bail!("{}: lists no block", folder.display()) };
    scene.edits = Vec::new();
    scene.splats.validate().map_err(|error| Error::new(format!("the merged scene: {error}")))?;
    Ok(MergedScene { scene, parts })
}

/// Refuses blocks that are not trained.
fn check_runs(folder: &Path, list: &BlockList) -> Result<()> {
    let is_missing = |name: &&String| !RunFolder::is_run(&run_folder(folder, name));
    let missing: Vec<&str> = list.blocks.iter().filter(is_missing).map(String::as_str).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let (named, runs) = (missing.iter().take(LISTED).copied().collect::<Vec<_>>().join(", "), folder.join("runs"));
    let more = if missing.len() > LISTED { format!(" and {} more", missing.len() - LISTED) } else { String::new() };
    let error = Error::new(format!("{}: no run of {named}{more}, expected one of each block", runs.display()));
    Err(error.with_remedy(Remedy::advice("train them with the commands in jobs.txt")))
}

fn read_block(folder: &Path, name: &str) -> Result<Block> {
    let path = folder.join(name);
    Block::read(&path)?.with_context(|| format!("{}: no block.json; split the data set again", path.display()))
}

/// Returns the gains that a block's run found, and warns of runs that are not as they should be.
fn gains_of(folder: &Path, name: &str, observer: &dyn Observer) -> Result<Gains> {
    let (run, config) = RunFolder::open(&run_folder(folder, name))?;
    let newest = run.scene_iterations().first().copied().unwrap_or(0);
    if newest < config.train.iterations && Some(newest) != config.train.early_end {
        observer.warn(&format!("{name}: {newest} of {} steps are made", text::count(config.train.iterations as usize)));
    }
    if config.train.refine_poses {
        observer.warn(&format!("{name}: its poses were refined without the other blocks, so edges may not meet"));
    }
    let stops = |log: [f32; 3]| log.map(|log| log / std::f32::consts::LN_2);
    Ok(Captures::read(&run)?.log_gains_at(newest).into_iter().map(|(view, log)| (view, stops(log))).collect())
}

/// Returns the first difference between scenes that cannot be one.
fn check_fits(first: &Scene, other: &Scene) -> std::result::Result<(), String> {
    let differs = |what: &str, a: String, b: String| Err(format!("{what} {b}, but {a} in the blocks before"));
    if first.splats.color_model != other.splats.color_model {
        return differs("colour model", first.splats.color_model.name(), other.splats.color_model.name());
    }
    if first.raster != other.raster {
        return differs("rasteriser", format!("{:?}", first.raster), format!("{:?}", other.raster));
    }
    if first.radiance_scale != other.radiance_scale {
        return differs("radiance scale", first.radiance_scale.get().to_string(), other.radiance_scale.get().to_string());
    }
    if first.color_space != other.color_space {
        return differs("colour space", first.color_space.name().into(), other.color_space.name().into());
    }
    if first.world_from_local != other.world_from_local {
        return Err("has other local coordinates than the blocks before; split the data set again".into());
    }
    if first.splats.smoothing.is_empty() != other.splats.smoothing.is_empty() && !first.splats.is_empty() && !other.splats.is_empty() {
        return Err("has another 3D filter of Mip-splatting than the blocks before".into());
    }
    Ok(())
}

/// Brings a block to the common gauge, and returns the factor in stops: the mean of its channels,
/// because a splat's colour has none per channel.
fn brighten(scene: &mut Scene, shift: &[f64; 3], name: &str, observer: &dyn Observer) -> Result<f64> {
    let mean = shift.iter().sum::<f64>() / 3.0;
    if shift.iter().any(|channel| (channel - mean).abs() > GREY_EV) {
        let [r, g, b] = shift.map(|channel| mean - channel);
        observer.warn(&format!("{name}: its white balance differs by {r:+.3}, {g:+.3}, {b:+.3} stops from the common one, and stays"));
    }
    if mean == 0.0 {
        return Ok(0.0);
    }
    let edit = Edit { selection: Selection::All, maps: vec![Map::Gain((-mean).exp2() as f32)] };
    edit.apply(scene, &MaskShares::default(), ShMap::Luminance).map_err(|error| Error::new(format!("{name}: {error}")))?;
    Ok(-mean)
}
