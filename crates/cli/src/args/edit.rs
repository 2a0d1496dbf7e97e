//! `luxel edit` as text, and edits of light as options.

use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches, ValueEnum};
use luxel_core::edit::{ShMap, Statement};
use luxel_core::{Edit, Selection};

use super::SceneDataArgs;
use crate::args::values::{parse_direction, parse_point, parse_ratio};

/// `luxel edit`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES, mut_arg("data", |arg| arg.help("Data set with the views of masks, overlays and comparisons [default for a run: its own]")))]
pub(crate) struct EditArgs {
    /// Scene file to write; with --against, a new folder for the comparison.
    #[arg(long, short, value_name = "SCENE.ply|DIR", required_unless_present = "dry_run")]
    pub(crate) output: Option<PathBuf>,
    /// Replace a scene file and an overlay that exist.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Remove the splats that a selection names, by the scene as it is before the maps; with a soft
    /// edge, those of at least half its weight.
    #[arg(long, value_name = "SELECTION", value_parser = parse_selection, conflicts_with = "against", help_heading = "Splats")]
    pub(crate) delete: Option<Selection>,
    /// Remove floaters: splats that no view of the data set sees, that are far from all others and
    /// faint or seen by few views, or that are faint and larger than half of the scene.
    #[arg(long, conflicts_with = "against", help_heading = "Splats")]
    pub(crate) floaters: bool,
    /// Shorten splats that are longer than this times their width, 1 or more: needles.
    #[arg(long, value_name = "RATIO", value_parser = parse_ratio, conflicts_with = "against", help_heading = "Splats")]
    pub(crate) max_aspect: Option<f32>,
    /// Turn the scene so that this direction, X,Y,Z in the world as it is, becomes -Y: up in a
    /// scene file without a data set.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true, conflicts_with = "against", help_heading = "World")]
    pub(crate) up: Option<[f64; 3]>,
    /// Move the scene so that this point, X,Y,Z in the world as it is, becomes the origin.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true, conflicts_with = "against", help_heading = "World")]
    pub(crate) origin: Option<[f64; 3]>,
    /// Read all edits from a file, as luxel view saves them: statements as for luxel render --edit,
    /// and delete SELECTION, floaters, up X,Y,Z, origin X,Y,Z. Masks are beside the file.
    #[arg(long = "edits", value_name = "FILE", conflicts_with_all = FILE_CONFLICTS, help_heading = "Edits")]
    pub(crate) edit_file: Option<PathBuf>,
    /// Maps and selections.
    #[command(flatten)]
    pub(crate) edits: EditOptions,
    /// Quantity that is mapped in scenes of spherical harmonics, which are then fitted again.
    #[arg(long, value_enum, default_value_t, value_name = "WHAT", help_heading = "Edits")]
    pub(crate) sh_map: ShMapArg,
    /// Write no scene; report the selected splats, their share of the scene's light, the box around
    /// them, and the effect of the maps.
    #[arg(long, help_heading = "Report")]
    pub(crate) dry_run: bool,
    /// Write a picture of the selection over a render.
    #[arg(long, value_name = "FILE.png", conflicts_with = "against", help_heading = "Report")]
    pub(crate) overlay: Option<PathBuf>,
    /// View of the overlay [default: the first mask's; without masks, the first test view].
    #[arg(long, value_name = "VIEW", requires = "overlay", conflicts_with = "against", help_heading = "Report")]
    pub(crate) view: Option<String>,
    /// Compare with this scene: apply the maps to both, and measure the chromaticity error against
    /// ideally edited renders (the maps on each pixel's luminance). Spherical harmonics are mapped
    /// in both ways of --sh-map.
    #[arg(long, value_name = "RUN|SCENE.ply", conflicts_with_all = ["dry_run", "overwrite", "sh_map"], help_heading = "Report")]
    pub(crate) against: Option<PathBuf>,
    /// Print the report as one JSON object.
    #[arg(long, help_heading = "Report")]
    pub(crate) json: bool,
    /// The scene, its data set, the device and the terminal.
    #[command(flatten)]
    pub(crate) input: SceneDataArgs,
}

/// Options whose place a file of edits takes.
const FILE_CONFLICTS: [&str; 14] = [
    "where",
    "gain",
    "stops",
    "power",
    "pivot",
    "curve",
    "clamp-max",
    "compress-above",
    "lift-below",
    "light",
    "delete",
    "floaters",
    "up",
    "origin",
];

const EXAMPLES: &str = "\
L is the sum R + G + B in the units of the data set, of a splat's colour at degree 0: luminance_sum
of luxel info, not the luminance Y. Options act in the order given; a --where applies to the maps
behind it, up to the next --where. Chromaticity, opacity and shape of the splats do not change. In
scenes of spherical harmonics hues shift under every map but a gain; a warning says how far.

Selections:
  L < 0.05 ~2   L >= p90 ~2   L in 0.1..2 ~2   luminance, or a percentile of the splats
  hue in 340..20 ~20   saturation > 0.5 ~0.2   HSV of linear Rec.709; hues in degrees, upwards
  box(x0,y0,z0,x1,y1,z1)   sphere(x,y,z,radius)      the splat's centre, world
  mask(painted.png, VIEW)                 splats that make up the white part of an image painted over a view, or over
                                          the picture of a camera file: VIEW is its name, camera.json
  and, or, not, ( ), all;  TEST ~WIDTH    soft edge: stops, degrees, world units, saturation, share of the mask; a
                                          hard edge where many splats lie leaves blotches, and is warned of

Examples:
  luxel edit run --stops 1 -o brighter.ply
  luxel edit run --where \"L < 0.05 ~2\" --gain 4 -o shadows.ply
  luxel edit run --compress-above 10:3 --lift-below 0.02 -o graded.ply
  luxel edit run --where \"mask(lamp.png, 004) and L > p95 ~2\" --stops -2 --dry-run --overlay lamp-selected.png
  luxel edit run --floaters --delete \"sphere(0.2,0.1,0.8,0.3)\" -o clean.ply
  luxel edit run --edits run/edits/lamp.edits -o lamp.ply
  luxel edit evening.ply --light 2:0.5 --where \"sphere(0.2,0.1,0.8,0.3)\" --light 1:0 -o late.ply
  luxel edit run --up 0,0.02,1 --origin 1.2,0.4,-0.1 -o level.ply
  luxel edit run --power 0.8 --pivot 0.5 --where \"hue in 200..260 ~20\" --gain 0.5 -o evening.ply
  luxel edit lcd-run --against sh3-run --power 1.2 -o comparison";

/// Maps and selections, in the order of the command line.
#[derive(Clone, Debug)]
pub(crate) struct EditOptions(pub(crate) Vec<Edit>);

/// Name, value and help of each statement.
const STATEMENTS: [[&str; 3]; 10] = [
    ["where", "SELECTION", "Select the splats that the following maps apply to [default: all]; see below"],
    ["gain", "FACTOR", "Multiply luminance; 0 or more"],
    ["stops", "N", "Multiply luminance by 2^N"],
    ["power", "BETA", "L' = pivot (L / pivot)^BETA: below 1 less contrast, above 1 more"],
    ["pivot", "L", "Luminance that the preceding --power does not change [default: the scene's median]"],
    [
        "curve",
        "X:Y,X:Y,...",
        "Monotone cubic through points, luminance before : after, on logarithmic axes; the gain continues beyond the ends",
    ],
    ["clamp-max", "L", "Limit luminance to this"],
    ["compress-above", "L[:RATIO]", "Compress RATIO stops above this luminance to one [default ratio: 4]"],
    ["lift-below", "L[:AMOUNT]", "Reduce the distance in stops of everything below this luminance by this share [default amount: 0.5]"],
    ["light", "N:FACTOR", "Multiply one light of a mix, by its number from 1; see luxel mix"],
];

impl Args for EditOptions {
    fn augment_args(command: Command) -> Command {
        command.args(STATEMENTS.map(|[name, value, help]| {
            let parse = move |text: &str| Statement::parse(name, text).map_err(|e| e.to_string());
            let arg = Arg::new(name).long(name).value_name(value).help(help).help_heading("Edits");
            arg.action(ArgAction::Append).allow_negative_numbers(true).value_parser(parse)
        }))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for EditOptions {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut given: Vec<(usize, &Statement)> = Vec::new();
        for [name, ..] in STATEMENTS {
            if let (Some(values), Some(indices)) = (matches.get_many::<Statement>(name), matches.indices_of(name)) {
                given.extend(indices.zip(values));
            }
        }
        given.sort_by_key(|(index, _)| *index);
        let edits = Edit::sequence(given.into_iter().map(|(_, statement)| statement));
        edits.map(Self).map_err(|(_, message)| clap::Error::raw(ErrorKind::ArgumentConflict, format!("--pivot: {message}\n")))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// `luxel render --edit`.
#[derive(Clone, Debug)]
pub(crate) struct EditText(pub(crate) Vec<Edit>);

/// A selection in its text form.
pub(crate) fn parse_selection(text: &str) -> Result<Selection, String> {
    let selection: Selection = text.parse().map_err(|e: luxel_core::edit::EditTextError| e.to_string())?;
    selection.check().map(|()| selection).map_err(|e| e.to_string())
}

/// Edits in their text form, each of which must do something.
pub(crate) fn parse_edits(text: &str) -> Result<EditText, String> {
    let edits = Edit::parse_all(text).map_err(|e| e.to_string())?;
    if edits.is_empty() {
        return Err("nothing to do: give a map such as \"stops 1\" or \"power 0.8\"".into());
    }
    match edits.iter().find(|edit| edit.maps.is_empty()) {
        Some(edit) => Err(format!("\"where {}\" has no map behind it; add one", edit.selection)),
        None => Ok(EditText(edits)),
    }
}

/// `--sh-map`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ShMapArg {
    /// The luminance of the colour in each direction: hues shift only by the error of the fit.
    #[default]
    Luminance,
    /// Red, green and blue separately, as RGB values are usually mapped: hues shift.
    Channels,
}

impl From<ShMapArg> for ShMap {
    fn from(arg: ShMapArg) -> Self {
        match arg {
            ShMapArg::Luminance => Self::Luminance,
            ShMapArg::Channels => Self::Channels,
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::Cli;

    fn edits(args: &[&str]) -> Result<String, clap::Error> {
        let cli = Cli::try_parse_from(["luxel", "edit", "scene.ply", "-o", "out.ply"].iter().chain(args))?;
        let crate::args::Command::Edit(args) = cli.command else { unreachable!("edit was given") };
        Ok(args.edits.0.iter().map(ToString::to_string).collect::<Vec<_>>().join(" | "))
    }

    #[test]
    fn options_act_in_the_order_of_the_command_line() {
        let cases: [(&[&str], &str); 4] = [
            (&["--gain", "2", "--clamp-max", "1", "--gain", "3"], "where all; gain 2; clamp-max 1; gain 3"),
            (&["--clamp-max", "1", "--stops", "-1"], "where all; clamp-max 1; stops -1"),
            (&["--power", "2", "--pivot", "0.5", "--power", "0.5"], "where all; power 2; pivot 0.5; power 0.5"),
            (
                &["--stops=1", "--where", "L<1", "--lift-below", "1", "--where", "L > 2", "--compress-above", "4:2", "--curve", "1:1,2:1"],
                "where all; stops 1 | where L < 1; lift-below 1:0.5 | where L > 2; compress-above 4:2; curve 1:1,2:1",
            ),
        ];
        for (args, expected) in cases {
            assert_eq!(edits(args).unwrap(), expected);
        }
    }

    #[test]
    fn values_that_make_no_sense_are_usage_errors() {
        for args in [&["--gain", "-1"][..], &["--where", "L <"], &["--pivot", "1"], &["--pivot", "1", "--power", "2"], &["--curve", "1:1"]]
        {
            let error = edits(args).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{args:?}: {error}");
        }
        assert!(edits(&["--where", "L < 1 and"]).unwrap_err().to_string().contains("column 10: expected a test"));
    }

    #[test]
    fn edits_that_do_nothing_are_no_edits() {
        for (text, part) in [("", "nothing to do"), (" ; ", "nothing to do"), ("gain 2; where L > 1", "\"where L > 1\" has no map")] {
            let error = parse_edits(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
        assert_eq!(parse_edits("where L > 1; gain 2").unwrap().0.len(), 1);
    }

    #[test]
    fn every_statement_of_the_text_form_is_an_option() {
        for name in Statement::MAPS {
            assert!(STATEMENTS.iter().any(|[option, ..]| *option == name), "{name}");
        }
    }
}
