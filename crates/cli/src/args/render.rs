//! `luxel render` as text.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use luxel_train::parse_rgb;

use super::edit::parse_edits;
use super::{ConsoleArgs, DeviceArgs, EditText, LoadArgs, ShMapArg};
use crate::args::values::{ExrTypeArg, Frames, Shard, SpaceArg, SplitArg, TonemapArg, parse_finite, parse_frames, parse_shard};

/// `luxel render`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("look").args(["tonemap", "video"]).multiple(true)))]
pub(crate) struct RenderArgs {
    /// Folder of a run (its newest scene), or a scene file: PLY (plain and compressed 3DGS files too), USD text, GLB, SPZ.
    #[arg(value_name = "RUN|SCENE")]
    pub(crate) scene: PathBuf,
    /// Folder for the images, VIEW.exr.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Data set whose cameras are used [default for a run: the one it was trained on].
    #[arg(long, value_name = "DATASET", help_heading = "Cameras")]
    pub(crate) data: Option<PathBuf>,
    /// Cameras from a file: transforms.json, or a camera path of nerfstudio. What it leaves out (image size, lens) comes from the data
    /// set's first camera.
    #[arg(long, value_name = "FILE", conflicts_with = "split", help_heading = "Cameras")]
    pub(crate) cameras: Option<PathBuf>,
    /// Views of the data set.
    #[arg(long, value_enum, default_value_t, help_heading = "Cameras")]
    pub(crate) split: SplitArg,
    /// Only frames a to b of the list, counted from 0, both included: 0-99.
    #[arg(long, value_name = "A-B", value_parser = parse_frames, help_heading = "Cameras")]
    pub(crate) frames: Option<Frames>,
    /// Only every n-th of those, starting with the i-th, counted from 0: 0/4, 1/4, 2/4 and 3/4 are all of them.
    #[arg(long, value_name = "I/N", value_parser = parse_shard, help_heading = "Cameras")]
    pub(crate) shard: Option<Shard>,
    /// How the data set is read.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Samples along a pixel's side, 1 to 4: a pixel is the mean of their square [default: the scene's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=i64::from(luxel_core::MAX_SAMPLES)), help_heading = "Images")]
    pub(crate) samples: Option<u8>,
    /// Number format of the EXR files.
    #[arg(long, value_enum, default_value_t, help_heading = "Images")]
    pub(crate) exr_type: ExrTypeArg,
    /// Colour space of the EXR files [default: the scene's].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "Images")]
    pub(crate) colorspace: Option<SpaceArg>,
    /// Add channel A: how much of each pixel splats cover. Colours are premultiplied on a black background.
    #[arg(long, help_heading = "Images")]
    pub(crate) alpha: bool,
    /// Add channel Z, 32 bits: mean distance along the viewing axis, world units; 1e10 where there is nothing.
    #[arg(long, help_heading = "Images")]
    pub(crate) depth: bool,
    /// Also write an 8-bit preview VIEW.png with this tone curve.
    #[arg(long, value_enum, value_name = "CURVE", help_heading = "Images")]
    pub(crate) tonemap: Option<TonemapArg>,
    /// Exposure of previews and video, stops: radiance, in units of the scene's scale, is multiplied by 2^EV.
    #[arg(
        long,
        default_value_t = 0.0,
        value_name = "EV",
        allow_negative_numbers = true,
        value_parser = parse_finite,
        requires = "look",
        help_heading = "Images"
    )]
    pub(crate) exposure: f32,
    /// Also make a video of all frames with the installed ffmpeg: SDR under --tonemap, or --hdr10.
    #[arg(long, value_name = "FILE.mp4", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) video: Option<PathBuf>,
    /// Replace the video that is there. Images that are there stay in any case.
    // As --video excludes --shard, so does what goes with it: clap does not insist on an option that another one excludes.
    #[arg(long, requires = "video", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) overwrite: bool,
    /// HDR10 instead of SDR: Rec.2020, PQ, 10 bits; 1 of the scene's scale is 203 cd/m2, and highlights roll off towards this peak, 300 to 10000 cd/m2
    /// [without a value: 1000].
    #[arg(
        long,
        value_name = "PEAK",
        num_args = 0..=1,
        default_missing_value = "1000",
        value_parser = clap::value_parser!(u32).range(300..=10000),
        requires = "video",
        conflicts_with = "shard",
        help_heading = "Video"
    )]
    pub(crate) hdr10: Option<u32>,
    /// Frames a second, 1 to 1000.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=1000), value_name = "N", requires = "video", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) fps: u32,
    /// The program that encodes.
    #[arg(long, default_value = "ffmpeg", value_name = "PROGRAM", requires = "video", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) ffmpeg: PathBuf,
    /// Radiance behind everything, in the units of the data set: red,green,blue or one number for grey [default for a run: the one it was trained with; else black].
    #[arg(long, value_name = "R,G,B", value_parser = parse_rgb, help_heading = "Images")]
    pub(crate) background: Option<[f32; 3]>,
    /// Edit the scene's light first, as luxel edit does, without writing it: "where L < 0.05; gain 4; where all; power 0.8; pivot 0.5".
    /// Statements are the options of luxel edit, without dashes.
    #[arg(long, value_name = "EDITS", value_parser = parse_edits, help_heading = "Edits")]
    pub(crate) edit: Option<EditText>,
    /// What maps are applied to in scenes of spherical harmonics, which are then fitted again.
    #[arg(long, value_enum, default_value_t, value_name = "WHAT", requires = "edit", help_heading = "Edits")]
    pub(crate) sh_map: ShMapArg,
    /// Where the work is done.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// How the command talks.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}
