//! Curves of samples: their names on the command line.

use clap::ValueEnum;
use luxel_io::Transfer;

/// `--transfer`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum TransferArg {
    /// Values are proportional to light.
    Linear,
    /// The curve of sRGB.
    Srgb,
    /// ARRI LogC3 (EI 800) and ARRI Wide Gamut 3.
    #[value(name = "logc3")]
    LogC3,
    /// ARRI LogC4 and ARRI Wide Gamut 4.
    #[value(name = "logc4")]
    LogC4,
    /// Sony S-Log3 and S-Gamut3.
    #[value(name = "slog3")]
    SLog3,
    /// Sony S-Log3 and S-Gamut3.Cine.
    #[value(name = "slog3cine")]
    SLog3Cine,
    /// Panasonic V-Log and V-Gamut.
    #[value(name = "vlog")]
    VLog,
    /// DJI D-Log and D-Gamut.
    #[value(name = "dlog")]
    DLog,
    /// Canon Log 2 and Cinema Gamut.
    #[value(name = "clog2")]
    CLog2,
    /// Canon Log 3 and Cinema Gamut.
    #[value(name = "clog3")]
    CLog3,
    /// Apple Log and Rec.2020 primaries.
    #[value(name = "applelog")]
    AppleLog,
    /// RED Log3G10 and REDWideGamutRGB.
    #[value(name = "log3g10")]
    Log3G10,
    /// ACEScct.
    #[value(name = "acescct")]
    AcesCct,
    /// PQ and Rec.2020 primaries; 1 is 100 cd/m².
    Pq,
    /// HLG and Rec.2020 primaries.
    Hlg,
}

impl From<TransferArg> for Transfer {
    fn from(arg: TransferArg) -> Self {
        match arg {
            TransferArg::Linear => Self::Linear,
            TransferArg::Srgb => Self::Srgb,
            TransferArg::LogC3 => Self::LogC3,
            TransferArg::LogC4 => Self::LogC4,
            TransferArg::SLog3 => Self::SLog3,
            TransferArg::SLog3Cine => Self::SLog3Cine,
            TransferArg::VLog => Self::VLog,
            TransferArg::DLog => Self::DLog,
            TransferArg::CLog2 => Self::CLog2,
            TransferArg::CLog3 => Self::CLog3,
            TransferArg::AppleLog => Self::AppleLog,
            TransferArg::Log3G10 => Self::Log3G10,
            TransferArg::AcesCct => Self::AcesCct,
            TransferArg::Pq => Self::Pq,
            TransferArg::Hlg => Self::Hlg,
        }
    }
}
