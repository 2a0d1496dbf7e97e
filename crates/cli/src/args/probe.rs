//! Arguments of `luxel probe`.

use std::path::PathBuf;

use clap::{ArgGroup, Args, ValueEnum};
use luxel::probe::ProbeOptions;
use luxel_core::environment::Projection;

use super::SceneDataArgs;
use super::look::OcioLookArgs;
use crate::args::values::{ExrTypeArg, SpaceArg, TonemapArg, UpArg, parse_finite, parse_point, parse_positive};

/// `luxel probe`.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("look").args(["tonemap", "ocio"])),
    mut_arg("data", |arg| arg.help("Data set whose cameras give the up direction and the resolution of rendering [default for a run: its own]")),
    after_help = "The map is the radiance that arrives at the point from every direction, in the units of the data set: light a scene with it.\n\
    Axes are those of OpenEXR: +y is up, the middle of a latitude-longitude map looks along +z, +x is to the left of it. They are those of \
    luxel export's .usda and .glb, so that both fit together."
)]
pub(crate) struct ProbeArgs {
    /// Point of the probe, world units of the scene: x,y,z.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point)]
    pub(crate) at: [f64; 3],
    /// OpenEXR file to write.
    #[arg(long, short, value_name = "FILE.exr")]
    pub(crate) output: PathBuf,
    /// Replace an existing file.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Width of the map, or of a face of a cube, in pixels, 4 to 16384.
    #[arg(long, default_value_t = 2048, value_parser = clap::value_parser!(u32).range(4..=16384), value_name = "PX", help_heading = "Map")]
    pub(crate) size: u32,
    /// Projection of directions onto the map.
    #[arg(long, value_enum, default_value_t, value_name = "KIND", help_heading = "Map")]
    pub(crate) projection: ProjectionArg,
    /// Leave out splats whose centre is nearer to the point than this, world units, above 0:
    /// objects in the place of the probe.
    #[arg(long, value_parser = parse_positive, value_name = "RADIUS", help_heading = "Map")]
    pub(crate) near: Option<f32>,
    /// Direction of the scene that is up [default: by the data set's cameras; without a data set
    /// -y].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true, help_heading = "Map")]
    pub(crate) up: Option<UpArg>,
    /// Colour space of the map [default: the scene's].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "Map")]
    pub(crate) output_color_space: Option<SpaceArg>,
    /// Number format of the file.
    #[arg(long, value_enum, default_value_t, help_heading = "Map")]
    pub(crate) exr_type: ExrTypeArg,
    /// Add channel A, the coverage of each pixel by splats.
    #[arg(long, help_heading = "Map")]
    pub(crate) alpha: bool,
    /// Also write a tone-mapped 8-bit preview beside the map, FILE.png, with this curve.
    #[arg(long, value_enum, value_name = "CURVE", conflicts_with = "ocio", help_heading = "Map")]
    pub(crate) tonemap: Option<TonemapArg>,
    #[command(flatten)]
    pub(crate) ocio_look: OcioLookArgs,
    /// Exposure of the preview in stops; 0 shows the scene's radiance scale as 1.
    #[arg(
        long,
        default_value_t = 0.0,
        value_name = "EV",
        allow_negative_numbers = true,
        value_parser = parse_finite,
        requires = "look",
        help_heading = "Map"
    )]
    pub(crate) exposure: f32,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}

impl ProbeArgs {
    /// Returns the library's form of these options, with a background in normalised units.
    pub(crate) fn options(&self, background: [f32; 3]) -> ProbeOptions {
        ProbeOptions {
            at: self.at,
            projection: self.projection.into(),
            width_px: self.size as usize,
            near: self.near,
            up: UpArg::up(self.up),
            color_space: self.output_color_space.map(Into::into),
            background,
            alpha: self.alpha,
        }
    }
}

/// `--projection`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProjectionArg {
    /// Equirectangular, twice as wide as high.
    #[default]
    Latlong,
    /// Six faces, one below the other.
    Cube,
}

impl From<ProjectionArg> for Projection {
    fn from(arg: ProjectionArg) -> Self {
        match arg {
            ProjectionArg::Latlong => Self::LatitudeLongitude,
            ProjectionArg::Cube => Self::Cube,
        }
    }
}
