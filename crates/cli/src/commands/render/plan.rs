//! The plan of `luxel render`: what a command line asks for, decided once, before the scene is
//! read.
//!
//! In: the arguments. Out: a part for each room that makes something: cameras, edits, images,
//! files, video. Errors: options that contradict each other whatever the scene is, a display that
//! cannot be opened, a program that is not there.

use std::path::Path;

use anyhow::{Result, bail};
use luxel::Device;
use luxel::camera_path::PathKind;
use luxel::edit::{mask_names, needs_dataset};
use luxel::lens::{Lens, LensKind};
use luxel::preview::Curve;
use luxel::video::Mastering;
use luxel_app::output;
use luxel_app::run::ExplicitArgs;
use luxel_app::usd_space::is_usd_file;
use luxel_core::ColorSpace;
use luxel_core::edit::{EditStack, ShMap};
use luxel_io::StageMotion;

use crate::args::channels::ChannelArgs;
use crate::args::photograph::PhotographArgs;
use crate::args::values::{ExrTypeArg, Frames, Shard, SplitArg, TonemapArg};
use crate::args::{DeviceArgs, EditText, RenderArgs};
use crate::inputs::programs;
use crate::inputs::scene_source::DataRequest;

/// Frames of a path unless a number is given.
const PATH_FRAMES: usize = 120;

/// The remedy where the program is missing.
pub(super) const INSTALL_FFMPEG: &str = "install ffmpeg (Debian: apt-get install ffmpeg)";

/// Extensions by which ffmpeg chooses a container for both forms.
const VIDEO_EXTENSIONS: [&str; 3] = ["mp4", "mov", "mkv"];

/// Everything that a command line asks for.
pub(super) struct RenderPlan<'a> {
    pub(super) scene: &'a Path,
    pub(super) data: DataRequest<'a>,
    pub(super) cameras: CameraPlan<'a>,
    pub(super) edits: Option<EditPlan>,
    /// The device; `auto` means the CPU for what only that engine renders.
    pub(super) device: DeviceArgs,
    pub(super) images: ImagePlan<'a>,
    pub(super) files: FilePlan<'a>,
    pub(super) video: Option<VideoPlan<'a>>,
}

/// The cameras to render.
pub(super) struct CameraPlan<'a> {
    pub(super) choice: CameraChoice<'a>,
    /// The lens in place of the cameras' own.
    pub(super) lens: Option<Lens>,
    pub(super) size_px: Option<[u32; 2]>,
    /// Distance of the eyes of a pair, world units.
    pub(super) eye_distance: Option<f64>,
    /// The part of the frames to render.
    pub(super) frames: Option<Frames>,
    /// A file of all cameras.
    pub(super) written: Option<CameraFilePlan<'a>>,
}

/// The source of the cameras.
pub(super) enum CameraChoice<'a> {
    /// One at a point of the world.
    At([f64; 3]),
    /// Those of an OpenUSD file.
    Stage { file: &'a Path, camera: Option<&'a str> },
    /// Those of another file.
    File(&'a Path),
    /// A path made from the views of the data set.
    Path { kind: PathKind, frames: usize },
    /// Views of the data set.
    Views(SplitArg),
}

/// A file of cameras to write.
pub(super) struct CameraFilePlan<'a> {
    pub(super) path: &'a Path,
    pub(super) form: CameraFileForm,
}

/// The form of a file of cameras.
#[derive(Clone, Copy)]
pub(super) enum CameraFileForm {
    Json,
    Usd(StageMotion),
}

/// Edits before rendering.
pub(super) struct EditPlan {
    /// Axes stay, since cameras are of the world as it is.
    pub(super) stack: EditStack,
    pub(super) sh_map: ShMap,
}

/// The content and form of each image.
pub(super) struct ImagePlan<'a> {
    /// Samples along a pixel's side; `None` for those of the scene.
    pub(super) samples: Option<u8>,
    /// Radiance behind everything, in the units of the data set.
    pub(super) background: Option<[f32; 3]>,
    pub(super) channels: &'a ChannelArgs,
    pub(super) photograph: &'a PhotographArgs,
    /// Most samples of a pixel of a deep image; `None` for no deep images.
    pub(super) deep: Option<u16>,
    pub(super) exr_type: ExrTypeArg,
    /// Colour space of the files; `None` for that of the scene.
    pub(super) color_space: Option<ColorSpace>,
    pub(super) tonemap: Option<TonemapArg>,
    /// Curve of previews and SDR video; `None` without them.
    pub(super) curve: Option<Curve>,
    /// Exposure of previews and video, stops.
    pub(super) exposure_ev: f32,
    /// Frames per second, if the images are those of a video.
    pub(super) frames_per_second: Option<u32>,
}

/// The folder of the images, and the part of them to make.
pub(super) struct FilePlan<'a> {
    pub(super) folder: &'a Path,
    pub(super) overwrite: bool,
    pub(super) shard: Option<Shard>,
}

/// A video of the images.
pub(super) struct VideoPlan<'a> {
    pub(super) path: &'a Path,
    pub(super) mastering: Mastering,
    /// Stops.
    pub(super) exposure_ev: f32,
    pub(super) frames_per_second: u32,
    /// The program that encodes.
    pub(super) encoder: &'a Path,
}

impl<'a> RenderPlan<'a> {
    /// Decides what `args` ask for; `explicit` names the options that were given.
    pub(super) fn new(args: &'a RenderArgs, explicit: &'a ExplicitArgs) -> Result<Self> {
        output::check_folder_name(&args.output, &output::IMAGE_EXTENSIONS)?;
        let curve = args.ocio_look.curve(args.tonemap)?;
        Ok(Self {
            scene: &args.input.scene,
            data: DataRequest::new(&args.input, explicit),
            cameras: CameraPlan::new(args)?,
            edits: EditPlan::new(args)?,
            device: device(args),
            video: VideoPlan::new(args, curve.as_ref())?,
            images: ImagePlan::new(args, curve),
            files: FilePlan { folder: &args.output, overwrite: args.overwrite, shard: args.shard },
        })
    }

    /// Returns whether edits need the data set, even where cameras come from a file.
    pub(super) fn edits_need_dataset(&self) -> bool {
        self.edits
            .as_ref()
            .is_some_and(|EditPlan { stack, .. }| stack.floaters || mask_names(&stack.selecting()).into_iter().any(needs_dataset))
    }
}

impl<'a> CameraPlan<'a> {
    fn new(args: &'a RenderArgs) -> Result<Self> {
        let choice = CameraChoice::new(args)?;
        // Frames of a path are its length.
        let frames = args.frames.filter(|_| !matches!(choice, CameraChoice::Path { .. }));
        let lens = |kind: LensKind| Lens { kind, field_deg: args.fov.map(f64::from), size_px: args.size };
        let moving = StageMotion::Moving { frames_per_second: f64::from(args.fps) };
        let motion = if choice.is_moving() { moving } else { StageMotion::Still };
        Ok(Self {
            lens: args.projection.map(|projection| lens(projection.into())),
            size_px: args.size,
            eye_distance: args.stereo.map(f64::from),
            frames,
            written: args.write_cameras.as_deref().map(|path| CameraFilePlan::new(path, motion)).transpose()?,
            choice,
        })
    }
}

impl<'a> CameraChoice<'a> {
    fn new(args: &'a RenderArgs) -> Result<Self> {
        Ok(match (args.at, args.cameras.as_deref(), args.path) {
            (Some(at), _, _) => Self::At(at),
            (None, Some(file), _) if is_usd_file(file) => Self::Stage { file, camera: args.camera.as_deref() },
            (None, Some(file), _) if args.camera.is_some() => {
                bail!("{}: --camera chooses one of an OpenUSD file, which this is not", file.display())
            }
            (None, Some(file), _) => Self::File(file),
            (None, None, Some(kind)) => Self::Path { kind: kind.into(), frames: path_frames(args.frames)? },
            (None, None, None) => Self::Views(args.split),
        })
    }

    /// Returns whether the cameras are one that moves, not views.
    pub(super) fn is_moving(&self) -> bool {
        match self {
            Self::Stage { .. } | Self::File(_) | Self::Path { .. } => true,
            Self::At(_) | Self::Views(_) => false,
        }
    }
}

impl<'a> CameraFilePlan<'a> {
    fn new(path: &'a Path, motion: StageMotion) -> Result<Self> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        let form = match extension.as_deref() {
            Some("json") => CameraFileForm::Json,
            Some("usda" | "usd") => CameraFileForm::Usd(motion),
            _ => {
                bail!("{}: cameras are written as .json, or as OpenUSD text, .usda or .usd; choose one of these extensions", path.display())
            }
        };
        Ok(Self { path, form })
    }
}

impl EditPlan {
    fn new(args: &RenderArgs) -> Result<Option<Self>> {
        let stack = match (&args.edit, &args.edits) {
            (Some(EditText(edits)), _) => EditStack { edits: edits.clone(), ..EditStack::default() },
            (None, Some(path)) => EditStack { up: None, origin: None, ..luxel::edit::read_stack(path)? },
            (None, None) => return Ok(None),
        };
        Ok(Some(Self { stack, sh_map: args.sh_map.into() }))
    }
}

impl<'a> ImagePlan<'a> {
    fn new(args: &'a RenderArgs, curve: Option<Curve>) -> Self {
        Self {
            samples: args.samples,
            background: args.background,
            channels: &args.channels,
            photograph: &args.photograph,
            deep: args.deep,
            exr_type: args.exr_type,
            color_space: args.output_color_space.map(Into::into),
            tonemap: args.tonemap,
            curve,
            exposure_ev: args.exposure,
            frames_per_second: args.video.is_some().then_some(args.fps),
        }
    }
}

impl<'a> VideoPlan<'a> {
    /// Returns the video that is asked for, shown by `curve` unless it is HDR10.
    ///
    /// # Errors
    /// A video that could not be made, whatever the frames are.
    pub(super) fn new(args: &'a RenderArgs, curve: Option<&Curve>) -> Result<Option<Self>> {
        let Some(path) = &args.video else { return Ok(None) };
        output::check_extension(path, &VIDEO_EXTENSIONS)?;
        if path.is_dir() {
            bail!("{}: is a folder, expected a name for a file", path.display());
        }
        if args.stereo.is_some() {
            bail!("--video shows one eye, and --stereo renders two; leave one of them out");
        }
        let mastering = match (args.hdr10, curve) {
            (Some(peak), _) => Mastering::Hdr10 { peak: peak as f32 },
            (None, Some(curve)) => Mastering::Sdr(curve.clone()),
            (None, None) => bail!("--video needs --tonemap CURVE or --ocio CONFIG for SDR, or --hdr10"),
        };
        // Before any frame is rendered, which may take hours.
        programs::require(&args.ffmpeg, "--ffmpeg", INSTALL_FFMPEG)?;
        Ok(Some(Self { path, mastering, exposure_ev: args.exposure, frames_per_second: args.fps, encoder: &args.ffmpeg }))
    }
}

/// Returns the device: for channels beside radiance and deep images, which only the CPU engine
/// renders, `auto` means the CPU.
fn device(args: &RenderArgs) -> DeviceArgs {
    let mut device = args.input.device.clone();
    if (args.channels.needs_cpu() || args.deep.is_some()) && device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    device
}

/// Returns the number of frames of a path.
fn path_frames(frames: Option<Frames>) -> Result<usize> {
    match frames {
        None => Ok(PATH_FRAMES),
        Some(Frames { first, last }) if first == last && first > 0 => Ok(first),
        Some(Frames { first, last }) => {
            bail!("--frames {first}-{last}: with --path, expected the number of frames, 1 or more; --shard I/N renders a part of them")
        }
    }
}
