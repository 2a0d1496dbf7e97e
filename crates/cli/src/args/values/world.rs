//! Directions, boxes and points in the world of a scene.

use clap::ValueEnum;
use glam::DVec3;
use luxel::export::{CropBox, Up};
use luxel::lens::LensKind;

/// `--up`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum UpArg {
    /// +x.
    X,
    /// +y.
    Y,
    /// +z.
    Z,
    /// -x.
    #[value(name = "-x")]
    MinusX,
    /// -y: as 3D Gaussian splatting's files have it.
    #[value(name = "-y")]
    MinusY,
    /// -z.
    #[value(name = "-z")]
    MinusZ,
    /// Axes stay as they are.
    AsIs,
}

impl UpArg {
    /// Returns the library's form of the option.
    pub(crate) fn up(arg: Option<Self>) -> Up {
        match arg.map(Self::direction) {
            None => Up::Default,
            Some(None) => Up::AsIs,
            Some(Some(axis)) => Up::Axis(axis),
        }
    }

    /// Returns the direction, of unit length; `None` for [`Self::AsIs`].
    fn direction(self) -> Option<DVec3> {
        Some(match self {
            Self::X => DVec3::X,
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
            Self::MinusX => DVec3::NEG_X,
            Self::MinusY => DVec3::NEG_Y,
            Self::MinusZ => DVec3::NEG_Z,
            Self::AsIs => return None,
        })
    }
}

/// `--projection` of a render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LensArg {
    /// Straight lines stay straight.
    Pinhole,
    /// Equidistant: the distance from the middle grows with the angle.
    Fisheye,
    /// A panorama, twice as wide as high.
    Equirectangular,
}

impl From<LensArg> for LensKind {
    fn from(arg: LensArg) -> Self {
        match arg {
            LensArg::Pinhole => Self::Pinhole,
            LensArg::Fisheye => Self::Fisheye,
            LensArg::Equirectangular => Self::Equirectangular,
        }
    }
}

/// Parses six numbers: one corner and the opposite one.
pub(crate) fn parse_crop(text: &str) -> Result<CropBox, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let Some(&[x0, y0, z0, x1, y1, z1]) = numbers.as_deref() else {
        return Err(format!("expected six numbers x0,y0,z0,x1,y1,z1, got \"{text}\""));
    };
    Ok(CropBox::between([x0, y0, z0], [x1, y1, z1]))
}

/// Parses three numbers.
pub(crate) fn parse_point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let point = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    point.ok_or_else(|| format!("expected three numbers x,y,z, got \"{text}\""))
}

/// Parses a direction: three numbers that are not all 0.
pub(crate) fn parse_direction(text: &str) -> Result<[f64; 3], String> {
    match parse_point(text)? {
        [0.0, 0.0, 0.0] => Err(format!("expected a direction x,y,z, got \"{text}\"")),
        direction => Ok(direction),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_points_are_numbers_with_commas() {
        let crop = parse_crop("1, 0,-1,-1,2,1").unwrap();
        assert!(crop.contains([0.0, 1.0, 0.0]) && crop.contains([-1.0, 2.0, 1.0]) && !crop.contains([0.0, 2.1, 0.0]));
        assert_eq!(parse_point("1,-2.5,3e1"), Ok([1.0, -2.5, 30.0]));
        for bad in ["", "1,2", "1,2,x", "1,2,nan", "1,2,3,4"] {
            assert!(parse_crop(bad).is_err() && parse_point(bad).is_err(), "{bad}");
        }
        // A word that is no number is not passed over.
        for bad in ["1,2,x,3", "1,,2,3", "nan,1,2,3", "1,2,3,"] {
            assert!(parse_point(bad).is_err() && parse_crop(&format!("0,0,0,{bad}")).is_err(), "{bad}");
        }
    }
}
