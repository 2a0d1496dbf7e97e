//! Arguments of `luxel render`.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use luxel_train::parse_rgb;

use super::channels::ChannelArgs;
use super::edit::parse_edits;
use super::look::OcioLookArgs;
use super::photograph::PhotographArgs;
use super::{EditText, SceneDataArgs, ShMapArg};
use crate::args::values::{
    ExrTypeArg, Frames, LensArg, PathArg, Shard, SpaceArg, SplitArg, TonemapArg, parse_finite, parse_frames, parse_point, parse_positive,
    parse_shard, parse_size,
};

/// `luxel render`.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("look").args(["tonemap", "ocio", "video"]).multiple(true)),
    mut_arg("data", |arg| arg.help("Data set whose cameras are rendered [default for a run: its own]"))
)]
pub(crate) struct RenderArgs {
    /// Folder for the images, VIEW.exr.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Replace images, previews and a video that other scenes, cameras or options made. Those that
    /// would come out the same are kept in any case.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// File of cameras to render: transforms.json, a camera path of nerfstudio, or OpenUSD (.usda,
    /// .usdc, .usdz), in the axes and units that luxel export writes. Image size and lens come from
    /// the data set's first camera where the file leaves them out; the size from --size, if given.
    #[arg(long, value_name = "FILE", conflicts_with = "split", help_heading = "Cameras")]
    pub(crate) cameras: Option<PathBuf>,
    /// Name or path of the camera in an OpenUSD file of --cameras [default: the only one, or all
    /// if none moves].
    #[arg(long, value_name = "NAME", requires = "cameras", help_heading = "Cameras")]
    pub(crate) camera: Option<String>,
    /// Write the cameras that are rendered to a file: .json, which --cameras takes, or .usda for
    /// other programs, in the axes and units that luxel export writes. Views of a data set are a
    /// camera each, other cameras the frames of one that moves.
    #[arg(long, value_name = "FILE", help_heading = "Cameras")]
    pub(crate) write_cameras: Option<PathBuf>,
    /// Views of the data set to render.
    #[arg(long, value_enum, default_value_t, help_heading = "Cameras")]
    pub(crate) split: SplitArg,
    /// Render a path made from the data set's cameras, and write it as cameras.json, which
    /// --cameras takes.
    #[arg(long, value_enum, conflicts_with_all = ["cameras", "split"], help_heading = "Cameras")]
    pub(crate) path: Option<PathArg>,
    /// Render with this projection in place of the cameras' own. Their positions and directions
    /// stay.
    #[arg(long, value_enum, value_name = "KIND", help_heading = "Cameras")]
    pub(crate) projection: Option<LensArg>,
    /// Field of view of --projection, degrees: across the image, or the circle of a fisheye
    /// [default: 90, 180 for a fisheye, 360 for a panorama].
    #[arg(long, value_name = "DEGREES", value_parser = parse_positive, requires = "projection", help_heading = "Cameras")]
    pub(crate) fov: Option<f32>,
    /// Render one image from this point of the world, x,y,z, with --projection. The camera is level
    /// and faces the centre of the map that luxel probe makes there.
    #[arg(
        long,
        value_name = "X,Y,Z",
        allow_hyphen_values = true,
        value_parser = parse_point,
        requires = "projection",
        conflicts_with_all = ["cameras", "split", "path", "frames", "shard"],
        help_heading = "Cameras"
    )]
    pub(crate) at: Option<[f64; 3]>,
    /// Render pairs for two eyes this far apart in world units: NAME_left and NAME_right.
    #[arg(long, value_name = "DISTANCE", value_parser = parse_positive, help_heading = "Cameras")]
    pub(crate) stereo: Option<f32>,
    /// Size of the images, pixels: 1920x1080. The field of view stays in one direction and is
    /// cropped in the other [default: that of the cameras].
    #[arg(long, value_name = "WxH", value_parser = parse_size, help_heading = "Cameras")]
    pub(crate) size: Option<[u32; 2]>,
    /// Render frames A to B only, counted from 0, both included: 0-99. With --path, the number of
    /// frames [default: 120]. A pair of --stereo is one frame.
    #[arg(long, value_name = "A-B|N", value_parser = parse_frames, help_heading = "Cameras")]
    pub(crate) frames: Option<Frames>,
    /// Render every N-th frame only, starting with frame I, counted from 0. For example, 0/4, 1/4,
    /// 2/4 and 3/4 together render all frames.
    #[arg(long, value_name = "I/N", value_parser = parse_shard, help_heading = "Cameras")]
    pub(crate) shard: Option<Shard>,
    /// Supersampling: samples along each side of a pixel, 1 to 4 [default: the scene's; 1 with
    /// --deep].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=i64::from(luxel_core::MAX_SAMPLES)), help_heading = "Images")]
    pub(crate) samples: Option<u8>,
    /// Number format of the EXR files.
    #[arg(long, value_enum, default_value_t, help_heading = "Images")]
    pub(crate) exr_type: ExrTypeArg,
    /// Colour space of the EXR files [default: the scene's].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "Images")]
    pub(crate) output_color_space: Option<SpaceArg>,
    #[command(flatten)]
    pub(crate) channels: ChannelArgs,
    /// Also write deep/VIEW.exr, a deep image of the splats on black: samples R, G, B, A, Z and
    /// ZBack, at most N a pixel, 1 to 1024 [without a value: 32]. Neighbours are merged;
    /// composited, the samples give the image.
    #[arg(
        long,
        value_name = "N",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "32",
        value_parser = clap::value_parser!(u16).range(1..=1024),
        conflicts_with = "exposed",
        help_heading = "Images"
    )]
    pub(crate) deep: Option<u16>,
    #[command(flatten)]
    pub(crate) photograph: PhotographArgs,
    /// Also write a tone-mapped 8-bit preview VIEW.png with this curve.
    #[arg(long, value_enum, value_name = "CURVE", conflicts_with = "ocio", help_heading = "Images")]
    pub(crate) tonemap: Option<TonemapArg>,
    #[command(flatten)]
    pub(crate) ocio_look: OcioLookArgs,
    /// Exposure of previews and video in stops; 0 shows the scene's radiance scale as 1.
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
    /// Also encode a video of all frames with the installed ffmpeg: SDR with --tonemap, or HDR10
    /// with --hdr10.
    #[arg(long, value_name = "FILE.mp4", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) video: Option<PathBuf>,
    // --video excludes --shard, and so must the options that need --video: clap does not require an
    // option that another one excludes.
    /// Encode HDR10 (Rec.2020, PQ, 10 bits) with this peak in cd/m2, 300 to 10000 [without a value:
    /// 1000]. The scene's radiance scale is shown at 203 cd/m2, and highlights roll off towards the
    /// peak.
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
    /// Frames per second, 1 to 1000.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=1000), value_name = "N", requires = "video", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) fps: u32,
    /// Program that encodes.
    #[arg(long, default_value = "ffmpeg", value_name = "PROGRAM", requires = "video", conflicts_with = "shard", help_heading = "Video")]
    pub(crate) ffmpeg: PathBuf,
    /// Radiance of the background in the units of the data set, R,G,B or one number for grey
    /// [default for a run: that of its training; else black].
    #[arg(long, value_name = "R,G,B", value_parser = parse_rgb, help_heading = "Images")]
    pub(crate) background: Option<[f32; 3]>,
    /// Edit the scene's light before rendering, without writing the scene: "where L < 0.05 ~2; gain
    /// 4; where all; power 0.8; pivot 0.5". Statements are the options of luxel edit without
    /// dashes.
    #[arg(long, value_name = "EDITS", value_parser = parse_edits, group = "edited", help_heading = "Edits")]
    pub(crate) edit: Option<EditText>,
    /// Read the edits from a file, as luxel view saves them and luxel edit --edits takes them; up
    /// and origin are left out, since cameras are of the world as it is.
    #[arg(long, value_name = "FILE", conflicts_with = "edit", group = "edited", help_heading = "Edits")]
    pub(crate) edits: Option<PathBuf>,
    /// Quantity that maps apply to in scenes of spherical harmonics, which are then fitted again.
    #[arg(long, value_enum, default_value_t, value_name = "WHAT", requires = "edited", help_heading = "Edits")]
    pub(crate) sh_map: ShMapArg,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}
