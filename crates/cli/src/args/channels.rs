//! Arguments of channels beside radiance: `luxel render`.

use clap::{Args, ValueEnum};
use luxel_core::Selection;

use super::edit::parse_selection;

/// Heading of the options in help texts.
const HEADING: &str = "Channels";

/// A kind of channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ChannelArg {
    /// A: as --alpha.
    Alpha,
    /// Z: as --depth.
    Depth,
    /// N.X, N.Y, N.Z: as --normals.
    Normal,
    /// id: number of the splat with the greatest weight; -1 where there is nothing.
    Id,
    /// forward.u, forward.v, backward.u, backward.v: motion to the next frame and to the one
    /// before, pixels, v up.
    Motion,
}

/// Channels beside radiance.
#[derive(Debug, Args)]
pub(crate) struct ChannelArgs {
    /// Add channel A, the coverage of each pixel by splats. Colours are premultiplied on a black
    /// background.
    #[arg(long, help_heading = HEADING)]
    alpha: bool,
    /// Add channel Z, 32 bits: the mean distance along the viewing axis in world units; 1e10 where
    /// there is nothing. With an aperture or a shutter, those of the sharp image in the middle of
    /// the exposure.
    #[arg(long, help_heading = HEADING)]
    depth: bool,
    /// Add channels N.X, N.Y and N.Z, 32 bits: unit normals of the world, towards the camera; 0
    /// where there is nothing. The normal of a splat is its shortest axis.
    #[arg(long, help_heading = HEADING)]
    normals: bool,
    /// Add channels of these kinds, with commas between them.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "KIND", help_heading = HEADING)]
    aov: Vec<ChannelArg>,
    /// Add a Cryptomatte: the part of each pixel that the selected splats cover, under this name.
    /// Give it once for each matte: --matte "lamp=L > p99" --matte "cup=sphere(0.1,0.2,0.3,0.1)".
    /// Selections are those of luxel edit --where.
    #[arg(long, value_name = "NAME=SELECTION", value_parser = parse_matte, help_heading = HEADING)]
    pub(crate) matte: Vec<MatteArg>,
}

/// A named selection.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatteArg {
    pub(crate) name: String,
    pub(crate) selection: Selection,
}

impl ChannelArgs {
    /// Returns whether channels of a kind are asked for.
    pub(crate) fn has(&self, kind: ChannelArg) -> bool {
        let is_flagged = match kind {
            ChannelArg::Alpha => self.alpha,
            ChannelArg::Depth => self.depth,
            ChannelArg::Normal => self.normals,
            ChannelArg::Id | ChannelArg::Motion => false,
        };
        is_flagged || self.aov.contains(&kind)
    }

    /// Returns whether there are channels that only the CPU engine renders.
    pub(crate) fn needs_cpu(&self) -> bool {
        [ChannelArg::Alpha, ChannelArg::Depth, ChannelArg::Normal, ChannelArg::Id, ChannelArg::Motion]
            .into_iter()
            .any(|kind| self.has(kind))
    }
}

fn parse_matte(text: &str) -> Result<MatteArg, String> {
    let (name, selection) = text.split_once('=').ok_or("expected NAME=SELECTION, such as \"lamp=L > p99\"")?;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    if name.is_empty() || name.len() > 64 || !name.chars().all(is_plain) {
        return Err(format!("name \"{name}\": expected 1 to 64 letters, digits, _, - and dots"));
    }
    Ok(MatteArg { name: name.to_owned(), selection: parse_selection(selection)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mattes_are_a_name_and_a_selection() {
        let matte = parse_matte("lamp=L > p99").unwrap();
        assert_eq!((matte.name.as_str(), matte.selection.to_string().as_str()), ("lamp", "L > p99"));
        for (text, expected) in [("lamp", "NAME=SELECTION"), ("=all", "letters"), ("a b=all", "letters"), ("lamp=brightest", "brightest")] {
            let error = parse_matte(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
