//! Arguments of `luxel lights`.

use std::path::PathBuf;

use clap::Args;
use luxel::lights::{DomeOptions, LightOptions, WindowOptions};

use super::SceneDataArgs;
use crate::args::values::{SpaceArg, UpArg, parse_point, parse_positive, parse_zero_or_more};

/// `luxel lights`.
#[derive(Debug, Args)]
#[command(
    mut_arg("data", |arg| arg.help("Data set whose training views lamps are measured from [default for a run: its own]")),
    after_help = "A lamp is a group of splats that is many times as bright as the scene's median. Its power is fitted to what the training \
    views get from it: a ball shines alike everywhere, a flat lamp (the open side of a shade, a window) by the cosine; long and bent ones become \
    meshes. All other light goes \
    into an environment map without the lamps, FILE_dome.exr beside the file, which an OpenUSD layer loads.\n\
    The axes are those of luxel export's .usda and .glb: lamps and scene fit together. A light's intensity times its colour is radiance in \
    the units of the data set."
)]
pub(crate) struct LightsArgs {
    /// File to write: OpenUSD (.usda), glTF without sizes and map (.glb), or a table (.json, .csv).
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// How many times as bright as the median of all pixels a lamp is.
    #[arg(long, default_value_t = 100.0, value_parser = parse_positive, value_name = "FACTOR", help_heading = "Lamps")]
    pub(crate) medians: f32,
    /// Make windows rectangles of light that the map leaves out, and other large, flat and even
    /// parts that are this many times as bright as the median; 0 for none. Lower ones find fainter
    /// windows, and may take a lit surface for one.
    #[arg(long, default_value_t = 30.0, value_parser = parse_zero_or_more, value_name = "FACTOR", help_heading = "Lamps")]
    pub(crate) windows: f32,
    /// Leave the light of windows in the map, and write them as its portals, which help a renderer
    /// to find it. OpenUSD and tables have them; some programs make stray lamps of them.
    #[arg(long, conflicts_with = "no_dome", help_heading = "Lamps")]
    pub(crate) portals: bool,
    /// Most lamps; weaker ones stay in the map.
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=1000), value_name = "N", help_heading = "Lamps")]
    pub(crate) most: u16,
    /// Colour space of lamps and map.
    #[arg(long, value_enum, default_value = "linear-rec709", value_name = "SPACE", help_heading = "Lamps")]
    pub(crate) output_color_space: SpaceArg,
    /// Direction of the scene that is up [default: by the data set's cameras].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true, help_heading = "Lamps")]
    pub(crate) up: Option<UpArg>,
    /// Write no map.
    #[arg(long, conflicts_with_all = ["at", "size", "no_fill"], help_heading = "Map of all other light")]
    pub(crate) no_dome: bool,
    /// Point of the map, world units of the scene: x,y,z [default: halfway between the cameras and
    /// what they look at].
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point, help_heading = "Map of all other light")]
    pub(crate) at: Option<[f64; 3]>,
    /// Width of the map in pixels, 4 to 16384.
    #[arg(
        long,
        default_value_t = 1024,
        value_parser = clap::value_parser!(u32).range(4..=16384),
        value_name = "PX",
        help_heading = "Map of all other light"
    )]
    pub(crate) size: u32,
    /// Leave directions black that no view saw; else they get the median radiance of
    /// the training views.
    #[arg(long, help_heading = "Map of all other light")]
    pub(crate) no_fill: bool,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}

impl LightsArgs {
    /// Returns the library's form of these options.
    pub(crate) fn options(&self) -> LightOptions {
        let dome = DomeOptions { at: self.at, width_px: self.size as usize, fill: !self.no_fill, up: UpArg::up(self.up) };
        LightOptions {
            medians: self.medians.into(),
            windows: (self.windows > 0.0).then_some(WindowOptions { medians: self.windows.into(), are_portals: self.portals }),
            most: self.most.into(),
            color_space: self.output_color_space.into(),
            dome: (!self.no_dome).then_some(dome),
            ..LightOptions::default()
        }
    }
}
