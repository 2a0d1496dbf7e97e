//! The two helps of a command: `-h` shows the options that matter most and an example, `--help`
//! all of them and everything behind.

use clap::{Arg, Command};

/// The part of a command that `-h` shows besides its arguments without a flag.
struct ShortHelp {
    command: &'static str,
    /// Long names of options.
    options: &'static [&'static str],
    example: &'static str,
}

const SHORT: [ShortHelp; 21] = [
    ShortHelp { command: "demo", options: &["output", "iterations", "method", "device", "quiet"], example: "luxel demo -o luxel-demo" },
    ShortHelp {
        command: "prepare",
        options: &[
            "output",
            "brackets",
            "exposures",
            "white-balance",
            "output-color-space",
            "downscale",
            "sfm",
            "colmap",
            "matching",
            "known-distance",
            "quiet",
        ],
        example: "luxel prepare photographs -o my-images",
    },
    ShortHelp {
        command: "train",
        options: &["output", "resume", "overwrite", "preset", "iterations", "time", "method", "max-splats", "downscale", "device", "quiet"],
        example: "luxel train my-images -o run\n  luxel train --resume -o run",
    },
    ShortHelp { command: "view", options: &["with", "data", "ocio", "listen", "no-browser", "device", "quiet"], example: "luxel view run" },
    ShortHelp {
        command: "eval",
        options: &[
            "data",
            "output",
            "metrics",
            "lpips-weights",
            "scale",
            "peak-luminance",
            "downscale",
            "masks",
            "device",
            "json",
            "quiet",
        ],
        example: "luxel eval run --metrics all",
    },
    ShortHelp {
        command: "compare",
        options: &["reference", "metrics", "scale", "mask", "heatmap", "overwrite", "json", "quiet"],
        example: "luxel compare reference.exr render.exr --heatmap flip.png",
    },
    ShortHelp {
        command: "render",
        options: &[
            "output",
            "overwrite",
            "split",
            "cameras",
            "path",
            "tonemap",
            "exposure",
            "output-color-space",
            "edit",
            "video",
            "quiet",
        ],
        example: "luxel render run -o frames --split all --tonemap agx --exposure 2",
    },
    ShortHelp {
        command: "edit",
        options: &["output", "overwrite", "where", "gain", "stops", "compress-above", "lift-below", "dry-run", "overlay", "delete"],
        example: "luxel edit run --compress-above 10:3 -o graded.ply\n  luxel edit run --where \"L > p95 ~2\" --stops -2 --dry-run --overlay lamp.png",
    },
    ShortHelp {
        command: "mix",
        options: &["weights", "output", "overwrite", "quiet"],
        example: "luxel mix day-run lamp-run --weights 1,0.3 -o evening.ply",
    },
    ShortHelp {
        command: "export",
        options: &["output", "overwrite", "bake", "output-color-space", "exposure", "tonemap", "refine", "crop", "max-splats", "scale"],
        example: "luxel export run -o set.usda --output-color-space acescg\n  luxel export run -o set.spz --max-splats 200000",
    },
    ShortHelp { command: "lights", options: &["output", "at", "no-dome", "data", "quiet"], example: "luxel lights run -o lights.usda" },
    ShortHelp {
        command: "probe",
        options: &["at", "output", "overwrite", "size", "projection", "near", "up", "output-color-space", "tonemap", "data", "device"],
        example: "luxel probe luxel-demo --at=-1.5,-6.1,1.35 -o probe.exr",
    },
    ShortHelp {
        command: "mesh",
        options: &["output", "overwrite", "cameras", "voxel", "triangles", "min-island", "max-depth", "up", "data", "quiet"],
        example: "luxel mesh run -o proxy.usdc\n  luxel mesh run -o proxy.glb --triangles 50000",
    },
    ShortHelp {
        command: "pick",
        options: &["view", "px", "count", "json", "data", "device", "quiet"],
        example: "luxel pick run --view 004 --px 230,180",
    },
    ShortHelp {
        command: "info",
        options: &["devices", "json", "format", "layer", "downscale", "quiet"],
        example: "luxel info my-images\n  luxel info run",
    },
    ShortHelp { command: "doctor", options: &["json", "quiet"], example: "luxel doctor" },
    ShortHelp {
        command: "bench",
        options: &["workload", "camera", "generate", "size", "method", "steps", "warmup", "json", "device", "threads"],
        example: "luxel bench --generate 100000",
    },
    ShortHelp {
        command: "reproduce",
        options: &["output", "methods", "seeds", "jobs", "dry-run", "iterations", "preset", "metrics", "downscale", "quiet"],
        example: "luxel reproduce my-scene -o study --methods sh3,lcd --seeds 1,2 --dry-run",
    },
    ShortHelp {
        command: "split",
        options: &["output", "grid", "max-splats", "border", "downscale", "quiet"],
        example: "luxel split street -o blocks --max-splats 2000000 -- --iterations 30000",
    },
    ShortHelp { command: "merge", options: &["output", "overwrite", "quiet"], example: "luxel merge blocks -o street.ply" },
    ShortHelp { command: "man", options: &["quiet"], example: "luxel man ~/.local/share/man/man1" },
];

/// Returns a command whose `-h` is short.
pub(super) fn with_short_help(command: Command) -> Command {
    let Some(short) = SHORT.iter().find(|short| short.command == command.get_name()) else { return command };
    let all = command.get_after_long_help().or(command.get_after_help()).map(ToString::to_string);
    let long = all.unwrap_or_else(|| format!("Example:\n  {}", short.example));
    let name = command.get_name().to_owned();
    let brief =
        format!("Example:\n  {}\n\nThese are the options that matter most; luxel {name} --help explains all of them.", short.example);
    let hide = |arg: Arg| {
        let is_shown = arg.is_positional() || arg.get_long().is_some_and(|long| short.options.contains(&long));
        if is_shown { arg } else { arg.hide_short_help(true) }
    };
    command.mut_args(hide).after_help(brief).after_long_help(long)
}

#[cfg(test)]
mod tests {
    use crate::args::command;

    use super::*;

    #[test]
    fn the_short_help_of_every_command_is_short_and_has_an_example() {
        let mut command = command();
        command.build();
        for subcommand in command.get_subcommands_mut().filter(|subcommand| !["help", "completions"].contains(&subcommand.get_name())) {
            let name = subcommand.get_name().to_owned();
            let listed = SHORT.iter().find(|short| short.command == name);
            for option in listed.unwrap_or_else(|| panic!("{name} has no short help")).options {
                let is_there = subcommand.get_arguments().any(|arg| arg.get_long() == Some(option));
                assert!(is_there, "{name} has no --{option}");
            }
            let (short, long) = (subcommand.render_help().to_string(), subcommand.render_long_help().to_string());
            let is_shown = |arg: &&Arg| !arg.is_positional() && !arg.is_hide_set() && !arg.is_hide_short_help_set();
            let count = subcommand.get_arguments().filter(is_shown).count();
            // With those of help and version.
            assert!(count <= 13, "{name}: {count} options\n{short}");
            assert!(short.contains("Example:\n  luxel ") && short.contains("--help explains all"), "{name}\n{short}");
            for arg in subcommand.get_arguments().filter(|arg| !arg.is_hide_set()) {
                let flag = arg.get_long().map_or_else(String::new, |long| format!("--{long}"));
                assert!(long.contains(&flag), "{name}: --help lacks {flag}");
            }
        }
    }
}
