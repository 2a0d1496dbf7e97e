//! Images through lenses that no camera can have, resampled in linear light into cameras.
//!
//! In: an image, its camera (focal lengths, principal point, size, and the projection that is to
//! remain) and its lens. Out: the image of the same camera without the lens, bilinearly. Pixel
//! centres at +0.5. What falls outside of the image, or on an invalid pixel, is invalid and 0.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Image, Mask};
use rayon::prelude::*;

use super::resample::sample;
use crate::lens::PreparedLens;

/// Share of a lens's field of view whose loss is not worth a warning.
const NEGLIGIBLE_LOSS: f64 = 0.03;

/// Resamples an image of `lens` into its camera without a lens.
pub(crate) fn straighten(image: &Image, mask: Option<&Mask>, camera: &Camera, lens: &PreparedLens) -> (Image, Mask) {
    let (width, height) = (image.width, image.height);
    let pixel = |index: usize| {
        let target = DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let direction = camera.unproject(target);
        let source = direction.and_then(|direction| lens.project(direction)).map(|place| place * camera.focal_px + camera.center_px);
        source.and_then(|source| sample(image, mask, source)).unwrap_or(([0.0; 3], 0.0))
    };
    let (pixels, weights) = (0..width * height).into_par_iter().map(pixel).unzip();
    (Image { width, height, pixels }, Mask { weights })
}

/// Returns a warning where what is left of a lens holds less than the lens sees.
pub(crate) fn lost_field(camera: &Camera, lens: &PreparedLens, name: &str) -> Option<String> {
    let [width, height] = camera.size_px.map(f64::from);
    let (x, y) = (camera.center_px.x, camera.center_px.y);
    let angle = |px: DVec2| {
        let place = (px - camera.center_px) / camera.focal_px;
        // Where the image reaches further than the lens, its last direction counts.
        let inner = place * (lens.reach() / place.length()).min(1.0);
        let to_axis = |direction: DVec3| direction.normalize().z.clamp(-1.0, 1.0).acos();
        let seen = lens.direction(inner).map_or(0.0, to_axis);
        let most = if let CameraProjection::Fisheye(fisheye) = camera.projection { fisheye.max_angle_rad } else { PI };
        [seen, camera.unproject(px).map_or(most, to_axis)]
    };
    let ends = [[DVec2::new(0.0, y), DVec2::new(width, y)], [DVec2::new(x, 0.0), DVec2::new(x, height)]];
    let fields = ends.map(|ends| {
        let [[a, b], [c, d]] = ends.map(angle);
        [a + c, b + d].map(f64::to_degrees)
    });
    let [[across, kept_across], [down, kept_down]] = fields;
    let is_lost = |seen: f64, kept: f64| kept < (1.0 - NEGLIGIBLE_LOSS) * seen;
    (is_lost(across, kept_across) || is_lost(down, kept_down)).then(|| {
        format!(
            "the {name} lens sees {across:.0} x {down:.0} degrees, of which the {} image of the same focal length keeps {kept_across:.0} x {kept_down:.0}: the rest is lost",
            camera.projection.name()
        )
    })
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec2, DVec3};
    use luxel_core::Distortion;

    use super::*;
    use crate::lens::{Base, Lens, Warp};

    fn camera() -> Camera {
        let (focal_px, center_px) = (DVec2::new(40.0, 42.0), DVec2::new(33.0, 23.5));
        Camera {
            camera_from_world: DAffine3::IDENTITY,
            focal_px,
            center_px,
            size_px: [64, 48],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        }
    }

    /// Every pixel holds its own coordinates, on which bilinear resampling is exact.
    fn grid() -> Image {
        let pixels = (0..64 * 48).map(|i| [(i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5, 1.0]).collect();
        Image { width: 64, height: 48, pixels }
    }

    #[test]
    fn a_straight_pixel_holds_what_the_lens_imaged_there() {
        let bent = Warp { radial: [-0.1, 0.02, 0.001, 0.0, 0.0, 0.0], tangential: [0.002, -0.003], shear: 0.01, ..Warp::default() };
        for base in [Base::Perspective, Base::Equidistant, Base::FieldOfView { omega: 0.9 }, Base::Division { k: -0.1 }] {
            let lens = Lens { base, warp: bent }.prepared();
            let (image, mask) = straighten(&grid(), None, &camera(), &lens);
            let mut checked = 0;
            for (x, y) in [(5, 5), (20, 30), (33, 23), (50, 40), (60, 10)] {
                let direction = DVec3::new((x as f64 + 0.5 - 33.0) / 40.0, (y as f64 + 0.5 - 23.5) / 42.0, 1.0);
                let at = lens.project(direction).unwrap() * camera().focal_px + camera().center_px;
                let is_inside = at.x > 0.5 && at.x < 63.5 && at.y > 0.5 && at.y < 47.5;
                if is_inside {
                    let [u, v, _] = image.at(x, y);
                    assert!(DVec2::new(u.into(), v.into()).distance(at) < 1e-3 && mask.is_valid(y * 64 + x), "{base:?} {at} {u} {v}");
                    checked += 1;
                }
            }
            assert!(checked >= 4, "{base:?} {checked}");
        }
    }

    #[test]
    fn what_a_pinhole_cannot_hold_is_said() {
        let fisheye = Lens::fisheye([0.0; 4]).prepared();
        let warning = lost_field(&camera(), &fisheye, "equidistant fisheye").unwrap();
        // 33 / 40 + 31 / 40 radians, and the angles whose tangents these are.
        assert!(warning.contains("sees 92 x 65 degrees") && warning.contains("keeps 77 x 59"), "{warning}");
        let mild = Lens { warp: Warp { radial: [0.01, 0.0, 0.0, 0.0, 0.0, 0.0], ..Warp::default() }, ..Lens::default() }.prepared();
        assert_eq!(lost_field(&camera(), &mild, "perspective"), None);
        let wide = Camera { projection: CameraProjection::Fisheye(luxel_core::Fisheye::new([0.0; 4])), ..camera() };
        assert_eq!(lost_field(&wide, &fisheye, "equidistant fisheye"), None);
    }
}
