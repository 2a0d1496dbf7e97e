//! Directions, boxes and points in the world of a scene.

use std::str::FromStr;

use clap::ValueEnum;
use glam::{DMat3, DVec3};
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

/// Parses a length above 0.
pub(crate) fn parse_positive_f64(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|v: &f64| v.is_normal() && *v > 0.0);
    number.ok_or_else(|| format!("expected a number above 0, got \"{text}\""))
}

/// Parses a length of 0 or more.
pub(crate) fn parse_length(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|v: &f64| v.is_finite() && *v >= 0.0);
    number.ok_or_else(|| format!("expected a number, 0 or more, got \"{text}\""))
}

/// A turn of `--rotate`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RotationArg {
    /// Unit vector.
    axis: DVec3,
    degrees: f64,
}

impl FromStr for RotationArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = || format!("expected AXIS:DEGREES, such as x:90 or 0,1,1:-30, got \"{text}\"");
        let (axis, degrees) = text.split_once(':').ok_or_else(form)?;
        let axis = match axis.trim() {
            "x" => DVec3::X,
            "y" => DVec3::Y,
            "z" => DVec3::Z,
            direction => DVec3::from_array(parse_direction(direction).map_err(|_| form())?),
        };
        let degrees = degrees.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(form)?;
        Ok(Self { axis: axis.try_normalize().ok_or_else(form)?, degrees })
    }
}

/// Returns the rotation of several turns, made in order. Quarter turns about axes are exact.
pub(crate) fn rotation(turns: &[RotationArg]) -> DMat3 {
    turns.iter().fold(DMat3::IDENTITY, |before, turn| {
        let matrix = DMat3::from_axis_angle(turn.axis, turn.degrees.to_radians());
        let is_quarter = (turn.degrees / 90.0).fract() == 0.0 && DVec3::AXES.contains(&turn.axis);
        let exact = |v: f64| if is_quarter { v.round() } else { v };
        DMat3::from_cols_array(&matrix.to_cols_array().map(exact)) * before
    })
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
    fn turns_are_an_axis_and_degrees() {
        let turns: Vec<RotationArg> = ["x:90", "0,0,2:-90"].map(|text| text.parse().unwrap()).into();
        // From y to z, and z stays.
        assert_eq!(rotation(&turns[..1]) * DVec3::Y, DVec3::Z);
        assert_eq!(rotation(&turns) * DVec3::Y, DVec3::Z);
        assert_eq!(rotation(&turns) * DVec3::X, DVec3::NEG_Y);
        assert!((rotation(&["1,1,0:30".parse().unwrap()]).determinant() - 1.0).abs() < 1e-12);
        for bad in ["", "x", "x:", "w:90", "0,0,0:90", "1,2:90", "x:nan", "90:x"] {
            assert!(bad.parse::<RotationArg>().unwrap_err().starts_with("expected AXIS:DEGREES"), "{bad}");
        }
        assert!(parse_positive_f64("0.01").is_ok() && ["0", "-1", "inf", "m"].iter().all(|bad| parse_positive_f64(bad).is_err()));
    }

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
