//! The picture that a page with its scene in it shows where it cannot render: JPEG, as the page
//! opens.
//!
//! In: a subject and the renderer of its scene. Out: the first camera's view, or without cameras
//! the whole scene from the front (twin: page/camera/places.js), at most [`WIDTH_PX`] wide.

use glam::{DMat3, DVec2, DVec3};
use luxel::preview::{self, Look};
use luxel::{Renderer, Result};
use luxel_core::{Camera, CameraProjection, Distortion, Image};

use crate::subject::Subject;

/// Largest width, pixels.
const WIDTH_PX: u32 = 640;
/// Size of a picture of a scene without cameras, pixels, and its vertical field of view, degrees,
/// which is that of the page.
const SIZE_PX: [u32; 2] = [WIDTH_PX, 360];
const FIELD_OF_VIEW: f64 = 50.0;
/// Quality of the JPEG.
const QUALITY: u8 = 82;

/// Renders and encodes the picture.
///
/// # Errors
/// A device that gave up.
pub(crate) fn jpeg(subject: &Subject, renderer: &mut Renderer) -> Result<Vec<u8>> {
    let camera = match subject.views.first() {
        Some(view) => {
            let camera = view.camera();
            camera.downscaled(camera.size_px[0].div_ceil(WIDTH_PX))
        }
        None => subject.local_camera(&overview(subject), 0),
    };
    let radiance = renderer.render(&camera)?;
    let mut image = Image { width: radiance.width(), height: radiance.height(), pixels: radiance.pixels().to_vec() };
    image.scale(subject.facts.radiance_scale.recip());
    preview::encode_jpeg(&image, subject.color_space, &Look::usual(subject.color_space), QUALITY)
}

/// Returns a camera of the world that sees most of the scene.
fn overview(subject: &Subject) -> Camera {
    let [low, high] = subject.facts.inner_bounds.map(DVec3::from_array);
    let up = DVec3::from_array(subject.facts.up).normalize_or(DVec3::Y);
    let aside = if up.z.abs() < 0.9 { DVec3::Z } else { DVec3::Y };
    let back = (aside - up * aside.dot(up)).normalize_or(DVec3::Z);
    let right = up.cross(back).normalize_or(DVec3::X);
    let eye = (low + high) / 2.0 + back * (high - low).length().max(1e-3);
    let size = DVec2::new(f64::from(SIZE_PX[0]), f64::from(SIZE_PX[1]));
    Camera {
        camera_from_world: Camera::pose_from_opengl(DMat3::from_cols(right, back.cross(right), back), eye),
        focal_px: DVec2::splat(size.y / (2.0 * (FIELD_OF_VIEW.to_radians() / 2.0).tan())),
        center_px: size / 2.0,
        size_px: SIZE_PX,
        projection: CameraProjection::Pinhole,
        distortion: Distortion::default(),
    }
}

#[cfg(test)]
mod tests {
    use luxel::{Device, synthetic};

    use super::*;

    #[test]
    fn a_scene_without_cameras_is_in_the_middle_of_the_picture() {
        let scene = synthetic::room(200, 1);
        let subject = Subject::new("room", &scene, None).unwrap();
        let camera = overview(&subject);
        assert!(camera.validate().is_ok());
        let [low, high] = subject.facts.inner_bounds.map(DVec3::from_array);
        let (middle, _) = camera.project((low + high) / 2.0).unwrap();
        assert!((middle - camera.center_px).length() < 1e-6, "{middle}");
        let (above, _) = camera.project((low + high) / 2.0 + DVec3::from_array(subject.facts.up) * 0.1).unwrap();
        assert!(above.y < middle.y && (above.x - middle.x).abs() < 1e-6, "{above}");
        let mut renderer = Renderer::new(&scene, Device::Cpu.with_threads(1)).unwrap();
        let jpeg = jpeg(&subject, &mut renderer).unwrap();
        let decoded = luxel_io::decode_codes("poster.jpg".as_ref(), &jpeg).unwrap().image;
        assert_eq!([decoded.width, decoded.height], [640, 360]);
        assert!(decoded.pixels.iter().any(|pixel| pixel[1] > 0.1), "a black picture");
    }
}
