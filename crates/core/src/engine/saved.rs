//! The arrays that an engine holds of its splats, by name, so that a state can be saved in pieces.
//!
//! In: an array, and a range of splats. Out: its values, splat by splat. Degenerate: the smoothing
//! filter of a scene without one has no values.

use std::ops::Range;

use super::ParameterRows;
use crate::{ColorModel, EngineError, SplatsError};

/// Numbers of the same shape that an engine holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SavedPart {
    /// The scene's parameters.
    Parameters,
    /// Adam's first moments.
    FirstMoments,
    /// Adam's second moments.
    SecondMoments,
}

/// An array of [`crate::Splats`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SplatArray {
    /// Positions, three numbers a splat.
    Position,
    /// Quaternions w x y z.
    Rotation,
    /// Natural logarithms of the standard deviations, three numbers.
    LogScale,
    /// Logits of opacities.
    OpacityLogit,
    /// Harmonics, coefficient by coefficient, then channel.
    Sh,
    /// Raw luminances.
    RawLuminance,
    /// The 3D smoothing filter: one number a splat, or none in the whole scene.
    Smoothing,
}

impl SplatArray {
    /// All arrays, in the order of [`ParameterRows`].
    pub const ALL: [Self; 7] =
        [Self::Position, Self::Rotation, Self::LogScale, Self::OpacityLogit, Self::Sh, Self::RawLuminance, Self::Smoothing];

    /// Returns the name of the field of [`crate::Splats`].
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Rotation => "rotation",
            Self::LogScale => "log_scale",
            Self::OpacityLogit => "opacity_logit",
            Self::Sh => "sh",
            Self::RawLuminance => "raw_luminance",
            Self::Smoothing => "smoothing",
        }
    }

    /// Returns how many numbers a splat has; 1 for the smoothing filter.
    ///
    /// ```
    /// use luxel_core::ColorModel;
    /// use luxel_core::engine::SplatArray;
    ///
    /// assert_eq!(SplatArray::Sh.width(ColorModel::Sh { degree: 3 }), 48);
    /// ```
    pub fn width(self, color_model: ColorModel) -> usize {
        match self {
            Self::Position | Self::LogScale => 3,
            Self::Rotation => 4,
            Self::OpacityLogit | Self::Smoothing => 1,
            Self::Sh => 3 * color_model.sh_coefficients(),
            Self::RawLuminance => color_model.luminance_coefficients(),
        }
    }

    /// Checks that values of this array are finite. They are `width` numbers a splat, of splats
    /// from `first` on.
    ///
    /// # Errors
    /// [`SplatsError::NotFinite`] for the first splat that is not.
    pub fn check_finite(self, values: &[f32], width: usize, first: usize) -> Result<(), SplatsError> {
        let at = values.iter().position(|value| !value.is_finite());
        at.map_or(Ok(()), |at| Err(SplatsError::NotFinite { array: self.name(), splat: first + at / width.max(1) }))
    }

    /// Returns the rows of the array, of which the smoothing filter has none.
    pub fn rows(self, color_model: ColorModel) -> Range<usize> {
        let first = match self {
            Self::Position => ParameterRows::POSITION,
            Self::Rotation => ParameterRows::ROTATION,
            Self::LogScale => ParameterRows::LOG_SCALE,
            Self::OpacityLogit => ParameterRows::OPACITY,
            Self::Sh => ParameterRows::SH,
            Self::RawLuminance => ParameterRows { color_model }.luminance(),
            Self::Smoothing => return ParameterRows { color_model }.count()..ParameterRows { color_model }.count(),
        };
        first..first + self.width(color_model)
    }
}

/// Checks that an engine has these splats.
///
/// # Errors
/// [`EngineError::Invalid`] for a range beyond the last of `count` splats.
pub fn check_range(splats: &Range<usize>, count: usize) -> Result<(), EngineError> {
    match splats.start <= splats.end && splats.end <= count {
        true => Ok(()),
        false => Err(EngineError::invalid(format!("splats {} to {} of a scene of {count}", splats.start, splats.end))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_follow_each_other_without_gaps() {
        for color_model in [
            ColorModel::Sh { degree: 0 },
            ColorModel::LogSh { degree: 3 },
            ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation: crate::Activation::Softplus },
        ] {
            let mut next = 0;
            for array in SplatArray::ALL {
                let rows = array.rows(color_model);
                assert_eq!(rows.start, next, "{array:?}");
                next = rows.end;
            }
            assert_eq!(next, ParameterRows { color_model }.count());
        }
    }
}
