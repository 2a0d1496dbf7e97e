//! Intrinsics as files give them: in pixels of a stated size, or as an angle of view, with a lens;
//! and the camera they make with an image.

use std::f64::consts::PI;

use glam::{DAffine3, DVec2};
use luxel_core::{Camera, CameraProjection, Distortion, Fisheye};

use crate::lens::{Base, Lens};

/// Reductions of the image against its camera that count as a smaller copy of the same
/// photograph (`images_2`, `images_4`).
const REDUCTIONS: [u32; 3] = [2, 4, 8];

/// Focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Focal {
    /// Pixels.
    Pixels(DVec2),
    /// Full angle of view in radians, horizontal or vertical, of square pixels.
    Angle {
        /// Horizontal; preferred.
        x: Option<f64>,
        /// Vertical.
        y: Option<f64>,
    },
}

/// The lens of an image, without a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Intrinsics {
    /// Size of the image that the lengths refer to; `None`: of whatever image there is.
    pub(super) size_px: Option<[u32; 2]>,
    /// Focal length.
    pub(super) focal: Focal,
    /// Principal point x and y in pixels; `None`: the middle.
    pub(super) center_px: [Option<f64>; 2],
    /// Distortion.
    pub(super) distortion: Distortion,
    /// Projection. Angles of view are those of its rays; a panorama states its focal lengths as
    /// nerfstudio does: pixels for half a turn of longitude and latitude.
    pub(super) projection: CameraProjection,
    /// Lens of the image, where no camera can have it: it is removed, and what is left is a camera
    /// of [`Self::projection`].
    pub(super) foreign_lens: Option<Lens>,
}

/// Angle from the axis to the middle of an image's edge from which on what is left of a foreign
/// lens is a fisheye instead of a pinhole, radians: 120 degrees across.
const WIDE: f64 = 60.0 / 180.0 * PI;

/// A lens with its image: what intrinsics are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LensImage {
    pub(super) size_px: [u32; 2],
    /// Focal lengths; of a panorama, pixels per radian.
    pub(super) focal_px: DVec2,
    pub(super) center_px: DVec2,
    pub(super) lens: Lens,
}

impl LensImage {
    /// Returns the intrinsics of a camera with this lens, or of the camera that remains when the
    /// lens is removed: a fisheye where the lens is one or sees far, else a pinhole.
    pub(super) fn intrinsics(&self) -> Intrinsics {
        let Self { size_px, focal_px, center_px, lens } = *self;
        let native = lens.projection();
        let projection = native.unwrap_or_else(|| match self.is_wide() {
            true => CameraProjection::Fisheye(Fisheye::new(lens.fisheye_coefficients())),
            false => CameraProjection::Pinhole,
        });
        // The focal length of a panorama is stated for half a turn.
        let unit = if projection == CameraProjection::Equirectangular { PI } else { 1.0 };
        Intrinsics {
            size_px: Some(size_px),
            focal: Focal::Pixels(focal_px * unit),
            center_px: center_px.to_array().map(Some),
            distortion: lens.distortion().unwrap_or_default(),
            projection,
            foreign_lens: native.is_none().then_some(lens),
        }
    }

    /// Returns whether the lens is a fisheye, or shows more than a pinhole can hold.
    fn is_wide(&self) -> bool {
        if matches!(self.lens.base, Base::Equidistant | Base::Equisolid) {
            return true;
        }
        let (lens, [width, height]) = (self.lens.prepared(), self.size_px.map(f64::from));
        let (x, y) = (self.center_px.x, self.center_px.y);
        let edges = [DVec2::new(0.0, y), DVec2::new(width, y), DVec2::new(x, 0.0), DVec2::new(x, height)];
        let angle = |px: DVec2| lens.direction((px - self.center_px) / self.focal_px).map(|ray| ray.z.clamp(-1.0, 1.0).acos());
        edges.into_iter().filter_map(angle).any(|angle| angle > WIDE)
    }
}

impl Intrinsics {
    /// Returns the camera of an image of `image_px` pixels, checked: with the lens where a camera
    /// can have it, without one where [`Self::foreign_lens`] is to be removed first. Errors explain
    /// what is wrong, not where.
    pub(super) fn camera(&self, camera_from_world: DAffine3, image_px: [u32; 2]) -> Result<Camera, String> {
        let size_px = self.size_px.unwrap_or(image_px);
        let [w, h] = size_px.map(f64::from);
        let radius = |angle: f64| match self.projection {
            CameraProjection::Pinhole => (0.5 * angle).tan(),
            CameraProjection::Fisheye(lens) => lens.radius(0.5 * angle),
            CameraProjection::Equirectangular => 0.5 * angle,
        };
        let focal_px = match self.focal {
            Focal::Pixels(focal) if self.projection == CameraProjection::Equirectangular => focal / PI,
            Focal::Pixels(focal) => focal,
            Focal::Angle { x: Some(x), y } => {
                let fx = 0.5 * w / radius(x);
                DVec2::new(fx, y.map_or(fx, |y| 0.5 * h / radius(y)))
            }
            Focal::Angle { x: None, y } => DVec2::splat(0.5 * h / radius(y.unwrap_or(f64::NAN))),
        };
        let center_px = DVec2::new(self.center_px[0].unwrap_or(0.5 * w), self.center_px[1].unwrap_or(0.5 * h));
        let is_finite = self.foreign_lens.is_none_or(|lens| lens.is_finite());
        if !is_finite {
            return Err("lens distortion is not finite".to_owned());
        }
        let mut camera =
            Camera { camera_from_world, focal_px, center_px, size_px, distortion: self.distortion, projection: self.projection };
        camera.validate().map_err(|e| e.to_string())?;
        if image_px != size_px {
            if !is_reduction(size_px, image_px) {
                return Err(format!(
                    "the image is {} x {} pixels, its camera {} x {}: use the images the cameras were made for, or a copy at 1/2, 1/4 or 1/8",
                    image_px[0], image_px[1], size_px[0], size_px[1]
                ));
            }
            let ratio = DVec2::new(f64::from(image_px[0]) / w, f64::from(image_px[1]) / h);
            camera = Camera { focal_px: focal_px * ratio, center_px: center_px * ratio, size_px: image_px, ..camera };
            camera.validate().map_err(|e| e.to_string())?;
        }
        Ok(camera)
    }
}

impl Intrinsics {
    /// Returns whether images of `image_px` pixels are of the stated size or a copy of it; true
    /// where none is stated.
    pub(super) fn fits(&self, image_px: [u32; 2]) -> bool {
        self.size_px.is_none_or(|size| size == image_px || is_reduction(size, image_px))
    }
}

/// Returns whether `small` is `full` divided by 2, 4 or 8, rounded either way.
fn is_reduction(full: [u32; 2], small: [u32; 2]) -> bool {
    REDUCTIONS.iter().any(|&factor| full.iter().zip(small).all(|(f, s)| s == f / factor || s == f.div_ceil(factor)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(size_px: Option<[u32; 2]>) -> Intrinsics {
        Intrinsics {
            size_px,
            focal: Focal::Pixels(DVec2::new(100.0, 110.0)),
            center_px: [Some(50.0), None],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
            foreign_lens: None,
        }
    }

    #[test]
    fn smaller_copy_of_the_image_scales_the_lens() {
        let camera = lens(Some([101, 80])).camera(DAffine3::IDENTITY, [50, 40]).unwrap();
        assert_eq!(camera.size_px, [50, 40]);
        assert!((camera.focal_px - DVec2::new(100.0 * 50.0 / 101.0, 55.0)).length() < 1e-12);
        assert!((camera.center_px - DVec2::new(50.0 * 50.0 / 101.0, 20.0)).length() < 1e-12);
    }

    #[test]
    fn other_sizes_are_refused() {
        let error = lens(Some([100, 80])).camera(DAffine3::IDENTITY, [50, 80]).unwrap_err();
        assert!(error.contains("50 x 80") && error.contains("100 x 80"), "{error}");
    }

    #[test]
    fn angle_of_view_follows_the_image() {
        let angle = Focal::Angle { x: Some(std::f64::consts::FRAC_PI_2), y: None };
        let camera = Intrinsics { focal: angle, center_px: [None; 2], ..lens(None) }.camera(DAffine3::IDENTITY, [200, 100]).unwrap();
        assert!((camera.focal_px - DVec2::splat(100.0)).length() < 1e-9);
        assert_eq!(camera.center_px, DVec2::new(100.0, 50.0));
    }
}
