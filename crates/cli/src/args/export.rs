//! Arguments of `luxel export`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use luxel::Bake;
use luxel::export::{BakeKind, CropBox, ExportOptions, FileScale, Format, check_lights};
use luxel::lights::LightOptions;
use luxel_io::SpzVersion;

use super::SceneDataArgs;
use crate::args::values::{
    RotationArg, SpaceArg, TonemapArg, UpArg, parse_crop, parse_finite, parse_point, parse_positive, parse_positive_f64, parse_ratio,
    rotation,
};

/// `luxel export`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES, mut_arg("data", |arg| arg.help("Data set whose views measure, refine and prune [default for a run: the one it was trained on]")))]
pub(crate) struct ExportArgs {
    /// File to write: .ply, .usdc, .usdz, .usda or .usd (text), .glb, .spz, .sog, .html (a page to
    /// look at).
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Replace an existing file.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Kind of colours [default: exact for .ply and .glb, linear for .usd, display for .spz and
    /// .sog].
    #[arg(long, value_enum, value_name = "WHAT", help_heading = "Colour")]
    pub(crate) bake: Option<BakeArg>,
    /// Colour space of a linear bake [default: the scene's; linear-rec709 for .glb].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "Colour")]
    pub(crate) output_color_space: Option<SpaceArg>,
    /// Stops: of a linear or exact one, on radiance in the units of the data set; of a display
    /// bake, on top of its own exposure.
    #[arg(long, default_value_t = 0.0, value_name = "EV", allow_negative_numbers = true, value_parser = parse_finite, help_heading = "Colour")]
    pub(crate) exposure: f32,
    /// Curve of the display bake [default: agx, for scenes of display colours none].
    #[arg(long, value_enum, value_name = "CURVE", help_heading = "Colour")]
    pub(crate) tonemap: Option<TonemapArg>,
    /// Highest degree of the baked harmonics, 0 to 3.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=3), value_name = "DEGREE", help_heading = "Colour")]
    pub(crate) degree: u8,
    /// Improve a display bake for N steps of training against tone-mapped renders of the data set's
    /// training views: its colours, opacities and sizes. An exact model beside it stays as it is; 0
    /// leaves it out [default: 100, on at most 64 views of at most a megapixel each].
    #[arg(long, value_parser = clap::value_parser!(u32).range(..=1_000_000), value_name = "N", help_heading = "Colour")]
    pub(crate) refine: Option<u32>,
    /// Only splats whose centre is in this box, world units of the scene: x0,y0,z0,x1,y1,z1.
    #[arg(long, value_name = "BOX", allow_hyphen_values = true, value_parser = parse_crop, help_heading = "Splats")]
    pub(crate) crop: Option<CropBox>,
    /// Only the N splats that contribute most to the data set's views (without a data set: by
    /// opacity and size).
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..), value_name = "N", help_heading = "Splats")]
    pub(crate) max_splats: Option<u64>,
    /// Highest degree of the harmonics in an .html file, 0 to 5; a lower one makes it smaller
    /// [default: the scene's].
    #[arg(long, value_parser = clap::value_parser!(u8).range(0..=5), value_name = "DEGREE", help_heading = "Splats")]
    pub(crate) max_degree: Option<u8>,
    /// Shorten splats that are longer than this times their width, 1 or more: needles.
    #[arg(long, value_parser = parse_ratio, value_name = "RATIO", help_heading = "Splats")]
    pub(crate) max_aspect: Option<f32>,
    /// Point of the scene, x,y,z in the world of its data set, that becomes the origin of the file.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point, help_heading = "World")]
    pub(crate) origin: Option<[f64; 3]>,
    /// Turn the scene about its origin: x:90 is a quarter turn about the x axis of the data set's
    /// world, from y to z; the axis is x, y, z or a direction X,Y,Z. Several turns are made in
    /// order, before --up.
    #[arg(long, value_name = "AXIS:DEGREES", allow_hyphen_values = true, help_heading = "World")]
    pub(crate) rotate: Vec<RotationArg>,
    /// Direction of the scene that is up; the file is turned so that its format's up axis is there
    /// [default: .ply, .spz and .sog as they are, others by the data set's cameras; without a data
    /// set -y].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true, help_heading = "World")]
    pub(crate) up: Option<UpArg>,
    /// Lengths are multiplied by this.
    #[arg(long, default_value_t = 1.0, value_parser = parse_positive, value_name = "FACTOR", help_heading = "World")]
    pub(crate) scale: f32,
    /// Scale the scene so that a unit of the file is this long, metres: 1 for metres, 0.01 for
    /// centimetres. The scale of the scene must be known.
    #[arg(long, value_parser = parse_positive_f64, value_name = "METRES", conflicts_with = "scale", help_heading = "World")]
    pub(crate) scale_to: Option<f64>,
    /// Length of a unit of the scene, metres [default: what its data set states].
    #[arg(long, value_parser = parse_positive_f64, value_name = "METRES", help_heading = "World")]
    pub(crate) metres_per_unit: Option<f64>,
    /// Put the scene's lamps into the file, and all other light as an environment map beside it,
    /// FILE_dome.exr (in a .usdz within it): OpenUSD's lights, or lamps of glTF, which has no map.
    /// They are found as luxel lights does by default, which writes a file of their own.
    #[arg(long, help_heading = "Light")]
    pub(crate) lights: bool,
    /// Version of an .spz file.
    #[arg(long, value_enum, default_value_t, value_name = "VERSION", help_heading = "World")]
    pub(crate) spz_version: SpzVersionArg,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}

impl ExportArgs {
    /// Returns the library's form of these options.
    pub(crate) fn options(&self) -> ExportOptions {
        let bake = Bake {
            kind: self.bake.map(Into::into),
            color_space: self.output_color_space.map(Into::into),
            tonemap: self.tonemap.map(Into::into),
            exposure_ev: self.exposure,
            max_degree: self.degree,
            refine_steps: self.refine,
        };
        ExportOptions {
            bake,
            crop: self.crop,
            max_splats: self.max_splats,
            max_aspect: self.max_aspect,
            origin: self.origin,
            rotation: rotation(&self.rotate),
            up: UpArg::up(self.up),
            scale: self.scale_to.map_or(FileScale::Factor(self.scale), FileScale::MetresPerUnit),
            metres_per_unit: self.metres_per_unit,
            spz_version: self.spz_version.into(),
            lights: self.lights.then(LightOptions::default),
        }
    }
}

/// Returns whether the options contradict each other, in words.
pub(super) fn check(args: &ExportArgs) -> Result<(), String> {
    if !args.lights {
        return Ok(());
    }
    let is_page = args.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html"));
    let is_known = is_page || Format::from_path(&args.output).is_ok();
    if is_known && (is_page || check_lights(&args.output).is_err()) {
        let name = args.output.display();
        return Err(format!(
            "{name}: --lights is for .usda, .usd, .usdc, .usdz and .glb files, others hold no lights; leave it out, and write the lights to a \
             file of their own with luxel lights"
        ));
    }
    Ok(())
}

const EXAMPLES: &str = "\
  luxel export run -o set.usda --output-color-space acescg     radiance for Nuke and Houdini
  luxel export run -o set.usdc --lights                        radiance with the lamps and a dome light of the place
  luxel export run -o set.ply --bake linear                    radiance for V-Ray (raw)
  luxel export run -o set.spz --max-splats 200000              a display bake for the web
  luxel export run -o set.html --max-splats 100000             a page with the scene in it, to send to somebody
  luxel export run -o set.glb                                  a display bake for glTF viewers, and the radiance model beside it
The error of the bake is measured on the data set's held-out views. docs/src/guide/delivery.md has recipes by program.";

/// `--bake`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BakeArg {
    /// Tone-mapped colours for a screen, which viewers show unchanged.
    Display,
    /// Scene-linear radiance as harmonics.
    Linear,
    /// A display bake, and the radiance model beside it.
    Exact,
}

impl From<BakeArg> for BakeKind {
    fn from(arg: BakeArg) -> Self {
        match arg {
            BakeArg::Display => Self::Display,
            BakeArg::Linear => Self::Linear,
            BakeArg::Exact => Self::Exact,
        }
    }
}

/// `--spz-version`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum SpzVersionArg {
    /// gzip, rotations of 24 bits.
    #[value(name = "2")]
    V2,
    /// gzip.
    #[value(name = "3")]
    V3,
    /// zstd, as the reference writes.
    #[default]
    #[value(name = "4")]
    V4,
}

impl From<SpzVersionArg> for SpzVersion {
    fn from(arg: SpzVersionArg) -> Self {
        match arg {
            SpzVersionArg::V2 => Self::V2,
            SpzVersionArg::V3 => Self::V3,
            SpzVersionArg::V4 => Self::V4,
        }
    }
}
