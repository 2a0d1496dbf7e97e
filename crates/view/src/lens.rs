//! The lens of a picture: an aperture of finite size, and what is in focus.
//!
//! In: the parameters `aperture` and `focus` of a request, world units, and which samples of the
//! aperture: `lens_samples` in all, the part `lens_part` of `lens_parts`. Out: a [`LensRequest`],
//! by which [`luxel::photograph`] renders. Degenerate: without an aperture it is a pinhole.

use luxel::photograph::{Aperture, Photograph};
use luxel_core::Camera;

use crate::query::Query;

/// Samples of the aperture, at most.
const MAX_SAMPLES: u32 = 1024;
/// Renders of one picture, at most: nobody sees another picture while they last.
const MAX_RENDERS: u32 = 256;

/// An aperture, and the samples of it that a picture is the mean of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LensRequest {
    /// Diameter of the aperture, world units.
    diameter: f64,
    /// Distance in focus along the camera's axis, world units.
    focus: f64,
    /// Samples in all.
    pub(crate) samples: u32,
    /// The index of a part of them, and the number of parts.
    pub(crate) part: [u32; 2],
}

impl LensRequest {
    /// Takes a lens out of a query.
    pub(crate) fn take(query: &mut Query) -> Result<Option<Self>, String> {
        let (diameter, focus) = (query.number::<f64>("aperture")?, query.number::<f64>("focus")?);
        let (samples, part) = (query.number::<u32>("lens_samples")?, query.number::<u32>("lens_part")?);
        let parts = query.number::<u32>("lens_parts")?;
        let Some(diameter) = diameter else {
            return match focus.is_some() || samples.is_some() || part.is_some() || parts.is_some() {
                true => Err("\"focus\" and \"lens_...\" go with \"aperture\", the diameter of a lens in world units".into()),
                false => Ok(None),
            };
        };
        let focus = focus.ok_or("\"focus\" is missing, expected the distance in focus, world units")?;
        for (name, value) in [("aperture", diameter), ("focus", focus)] {
            if !(value > 0.0 && value.is_normal()) {
                return Err(format!("\"{name}\" is {value}, expected a length above 0"));
            }
        }
        let (samples, part) = (samples.unwrap_or(16), [part.unwrap_or(0), parts.unwrap_or(1)]);
        let lens = Self { diameter, focus, samples, part };
        if !(1..=MAX_SAMPLES).contains(&samples) || part[0] >= part[1] || part[0] >= samples || lens.renders() > MAX_RENDERS {
            return Err(format!(
                "part {} of {} of {samples} samples, expected up to {MAX_SAMPLES} samples and {MAX_RENDERS} in a part",
                part[0], part[1]
            ));
        }
        Ok(Some(lens))
    }

    /// Returns the number of renders.
    pub(crate) fn renders(self) -> u32 {
        (self.samples - self.part[0]).div_ceil(self.part[1])
    }

    /// Returns the photograph by a camera of a scene whose unit has this length in the world.
    pub(crate) fn photograph(self, camera: &Camera, unit: f64) -> Photograph {
        let aperture = Aperture { diameter: self.diameter / unit, focus_distance: self.focus / unit, blades: None };
        Photograph { camera: camera.clone(), aperture: Some(aperture), motion: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(text: &str) -> Result<Option<LensRequest>, String> {
        LensRequest::take(&mut Query::parse(text).unwrap())
    }

    #[test]
    fn parameters_make_a_lens() {
        assert_eq!(lens(""), Ok(None));
        let found = lens("aperture=0.1&focus=2&lens_samples=10&lens_part=1&lens_parts=4").unwrap().unwrap();
        assert_eq!((found, found.renders()), (LensRequest { diameter: 0.1, focus: 2.0, samples: 10, part: [1, 4] }, 3));
        assert_eq!(lens("aperture=0.1&focus=2").unwrap().unwrap().renders(), 16);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, expected) in [
            ("focus=2", "go with \"aperture\""),
            ("lens_samples=2", "go with \"aperture\""),
            ("aperture=0.1", "\"focus\" is missing"),
            ("aperture=-1&focus=2", "\"aperture\" is -1, expected a length above 0"),
            ("aperture=0.1&focus=inf", "\"focus\" is inf"),
            ("aperture=0.1&focus=2&lens_samples=0", "expected up to 1024"),
            ("aperture=0.1&focus=2&lens_samples=1024", "256 in a part"),
            ("aperture=0.1&focus=2&lens_part=4&lens_parts=4", "part 4 of 4"),
            ("aperture=0.1&focus=2&lens_parts=0", "part 0 of 0"),
        ] {
            let error = lens(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
