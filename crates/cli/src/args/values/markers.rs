//! Markers in photographs.

use clap::ValueEnum;
use luxel_app::prepare::MarkerFamily;

/// `--marker-family`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum MarkerFamilyArg {
    /// 36 bits: AprilTag's usual family.
    #[default]
    #[value(name = "36h11")]
    Tag36h11,
    /// 25 bits.
    #[value(name = "25h9")]
    Tag25h9,
    /// 16 bits.
    #[value(name = "16h5")]
    Tag16h5,
}

impl From<MarkerFamilyArg> for MarkerFamily {
    fn from(family: MarkerFamilyArg) -> Self {
        match family {
            MarkerFamilyArg::Tag36h11 => Self::Tag36h11,
            MarkerFamilyArg::Tag25h9 => Self::Tag25h9,
            MarkerFamilyArg::Tag16h5 => Self::Tag16h5,
        }
    }
}
