//! Arguments of `luxel mesh`.

use std::path::PathBuf;

use clap::Args;
use luxel::mesh::MeshOptions;

use super::SceneDataArgs;
use crate::args::values::{SpaceArg, UpArg, parse_length, parse_positive_f64};

/// `luxel mesh`.
#[derive(Debug, Args)]
#[command(
    mut_arg("data", |arg| arg.help("Data set whose training cameras look at the scene, and tell where up is [default for a run: its own]")),
    after_help = EXAMPLES
)]
pub(crate) struct MeshArgs {
    /// File to write: .usdc, .usdz, .usda or .usd (text), .glb, .ply, .obj.
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Replace an existing file.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// File of cameras that look at the scene, instead of those of the data set: transforms.json, a
    /// camera path of nerfstudio, or OpenUSD (.usda, .usdc, .usdz).
    #[arg(long, value_name = "FILE", help_heading = "Views")]
    pub(crate) cameras: Option<PathBuf>,
    /// Longest side of the depth images in pixels, 16 to 4096.
    #[arg(long, default_value_t = 400, value_parser = clap::value_parser!(u32).range(16..=4096), value_name = "PX", help_heading = "Views")]
    pub(crate) image_size: u32,
    /// Most cameras that are rendered; of more, evenly spread ones, 3 or more.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(3..), value_name = "N", help_heading = "Views")]
    pub(crate) max_views: u32,
    /// Depth up to which pixels count, world units, above 0 [default: where a pixel is as wide as
    /// four voxels].
    #[arg(long, value_parser = parse_positive_f64, value_name = "DEPTH", help_heading = "Views")]
    pub(crate) max_depth: Option<f64>,
    /// Side of a voxel, world units, above 0: smaller ones show finer detail and take more memory
    /// [default: 1/256 of the scene's diagonal, or the size of a pixel there].
    #[arg(long, value_parser = parse_positive_f64, value_name = "SIZE", help_heading = "Surface")]
    pub(crate) voxel: Option<f64>,
    /// Simplify the mesh to about N triangles [default: as many as the voxels make].
    #[arg(long, value_parser = clap::value_parser!(u32).range(4..), value_name = "N", help_heading = "Surface")]
    pub(crate) triangles: Option<u32>,
    /// Remove parts of the surface that hang together and are smaller across than this, world
    /// units, above 0 [default: 16 voxels].
    #[arg(long, value_parser = parse_positive_f64, value_name = "SIZE", help_heading = "Surface")]
    pub(crate) min_island: Option<f64>,
    /// Fill flat holes that are smaller across than this, world units, 0 for none [default: 32
    /// voxels].
    #[arg(long, value_parser = parse_length, value_name = "SIZE", help_heading = "Surface")]
    pub(crate) max_hole: Option<f64>,
    /// Colour space of the radiance at the vertices [default: the scene's].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "World")]
    pub(crate) output_color_space: Option<SpaceArg>,
    /// Direction of the scene that is up; the file is turned so that its format's up axis is there
    /// [default: .ply as it is, others by the data set's cameras; without a data set -y].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true, help_heading = "World")]
    pub(crate) up: Option<UpArg>,
    /// Length of a unit of the scene, metres [default: what its data set states].
    #[arg(long, value_parser = parse_positive_f64, value_name = "METRES", help_heading = "World")]
    pub(crate) metres_per_unit: Option<f64>,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}

impl MeshArgs {
    /// Returns the library's form of these options.
    pub(crate) fn options(&self) -> MeshOptions {
        MeshOptions {
            voxel: self.voxel,
            triangles: self.triangles.map(|triangles| triangles as usize),
            min_island: self.min_island,
            max_hole: self.max_hole,
            max_depth: self.max_depth,
            image_size: self.image_size,
            max_views: self.max_views as usize,
            up: UpArg::up(self.up),
            metres_per_unit: self.metres_per_unit,
            color_space: self.output_color_space.map(Into::into),
        }
    }
}

const EXAMPLES: &str = "\
  luxel mesh run -o proxy.usdc                                 shadow catcher and holdout for Houdini, Nuke, Blender
  luxel mesh run -o proxy.glb --triangles 50000                a light collider
  luxel mesh scene.ply --cameras path.json -o proxy.ply        a scene without its run
The mesh is what the cameras saw, in the world that luxel export writes splats in: what none of them saw is cut away. Vertices carry linear \
radiance. docs/src/guide/mesh.md says what to do with it.";
