//! The lens of a frame in `transforms.json`: sizes, focal lengths, centre, distortion, projection.
//!
//! In: the fields of a frame, with the file's as defaults. Out: [`Intrinsics`]. k3 and k4 of a
//! pinhole are nerfstudio's, of r⁶ and r⁸; where the model is `FULL_OPENCV`, or k5 or k6 are there,
//! k4 to k6 are OpenCV's, of the denominator. Such lenses are removed. `OPENCV_FISHEYE`, or
//! instant-ngp's `is_fisheye`, has `k1 k2 k3 k4`, and the field of nerfstudio's
//! `fisheye_crop_radius` (pixels), or what [`Fisheye::new`] makes of the coefficients.
//! `EQUIRECTANGULAR` is a whole panorama, unless focal lengths (the pixels of half a turn) say that
//! it is a part of one.

use std::f64::consts::{PI, TAU};

use glam::DVec2;
use luxel_core::{CameraProjection, Distortion, Fisheye, MAX_FISHEYE_ANGLE_RAD};
use serde_json::Value;

use super::intrinsics::{Focal, Intrinsics};
use super::json_fields::Fields;
use crate::IoError;
use crate::lens::{Base, Lens, Warp};

/// Camera models whose lens is pinhole with k1 k2 p1 p2, and perhaps more.
const CAMERA_MODELS: [&str; 6] = ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"];
/// Camera models of other projections.
const FISHEYES: [&str; 5] = ["OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE"];
const FULL_OPENCV: &str = "FULL_OPENCV";
const EQUIRECTANGULAR: &str = "EQUIRECTANGULAR";
/// Coefficients beyond OPENCV's four: must be absent or 0.
const HIGHER_COEFFICIENTS: [&str; 6] = ["k3", "k4", "k5", "k6", "p3", "p4"];
const LENS_REMEDY: &str = "undistort the images first, for example with `colmap image_undistorter`";

/// Reads the lens of a frame.
pub(super) fn intrinsics(fields: &Fields<'_>) -> Result<Intrinsics, IoError> {
    let model = model(fields)?;
    let allowed: &[&str] = match model {
        Model::Fisheye => &["k3", "k4"],
        Model::Pinhole { .. } => &["k3", "k4", "k5", "k6"],
        Model::Equirectangular => &[],
    };
    for key in HIGHER_COEFFICIENTS.into_iter().filter(|key| !allowed.contains(key)) {
        if let Some(value) = fields.number(key)?.filter(|v| *v != 0.0) {
            return Err(
                fields.unsupported(format!("\"{key}\" is {value}, expected 0: the lens model has no such coefficient; {LENS_REMEDY}"))
            );
        }
    }
    let size_px = size(fields)?;
    let focal_fields = fields.group(&["fl_x", "fl_y", "camera_angle_x", "camera_angle_y"]);
    let focal = match (focal_fields.number("fl_x")?, focal_fields.number("fl_y")?) {
        (None, None) => angle_of_view(&focal_fields, model)?,
        (Some(x), Some(y)) => Focal::Pixels(DVec2::new(x, y)),
        (Some(f), None) | (None, Some(f)) => Focal::Pixels(DVec2::splat(f)),
    };
    if let Focal::Pixels(focal) = focal
        && (focal.x <= 0.0 || focal.y <= 0.0)
    {
        return Err(fields.error(format!("focal length {} x {} px, expected positive numbers", focal.x, focal.y)));
    }
    let mut center = fields.group(&["cx", "cy"]);
    // The centre of an image of another size is not this one's.
    if let Some(shared) = center.shared
        && size(&Fields { own: shared, shared: None, place: String::new(), ..*fields })?.is_some_and(|shared| Some(shared) != size_px)
    {
        center.shared = None;
    }
    let coefficients = fields.group(&["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"]);
    let coefficient = |key| Ok::<_, IoError>(coefficients.number(key)?.unwrap_or(0.0));
    let [k1, k2, k3, k4, p1, p2] =
        [coefficient("k1")?, coefficient("k2")?, coefficient("k3")?, coefficient("k4")?, coefficient("p1")?, coefficient("p2")?];
    let [k5, k6] = [coefficient("k5")?, coefficient("k6")?];
    let mut foreign_lens = None;
    let (distortion, projection) = match model {
        Model::Pinhole { .. } if [k3, k4, k5, k6] == [0.0; 4] => (Distortion { k1, k2, p1, p2 }, CameraProjection::Pinhole),
        Model::Pinhole { is_rational } => {
            let is_rational = is_rational || [k5, k6] != [0.0; 2];
            let (k4, denominator) = if is_rational { (0.0, [k4, k5, k6]) } else { (k4, [0.0; 3]) };
            let warp = Warp { radial: [k1, k2, k3, k4, 0.0, 0.0], denominator, tangential: [p1, p2], ..Warp::default() };
            foreign_lens = Some(Lens { base: Base::Perspective, warp });
            (Distortion::default(), CameraProjection::Pinhole)
        }
        Model::Fisheye if p1 == 0.0 && p2 == 0.0 => {
            (Distortion::default(), CameraProjection::Fisheye(fisheye(fields, Fisheye::new([k1, k2, k3, k4]), focal)?))
        }
        Model::Equirectangular if [k1, k2, p1, p2] == [0.0; 4] => (Distortion::default(), CameraProjection::Equirectangular),
        Model::Fisheye => return Err(fields.unsupported("\"p1\" and \"p2\" of a fisheye are not 0: the lens model is k1 k2 k3 k4")),
        Model::Equirectangular => return Err(fields.unsupported("a panorama with coefficients of distortion, expected none")),
    };
    let center_px = [center.number("cx")?, center.number("cy")?];
    Ok(Intrinsics { size_px, focal, center_px, distortion, projection, foreign_lens })
}

/// The projection that a frame names.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Model {
    Pinhole {
        /// Whether k4 to k6 are OpenCV's, of a denominator.
        is_rational: bool,
    },
    Fisheye,
    Equirectangular,
}

/// Reads `camera_model` and instant-ngp's `is_fisheye`, which agree or are absent.
fn model(fields: &Fields<'_>) -> Result<Model, IoError> {
    let is_fisheye = fields.get("is_fisheye").is_some_and(|v| *v == Value::Bool(true));
    match fields.string("camera_model")?.as_deref() {
        Some(model) if FISHEYES.contains(&model) => Ok(Model::Fisheye),
        Some(FULL_OPENCV) if !is_fisheye => Ok(Model::Pinhole { is_rational: true }),
        Some(EQUIRECTANGULAR) => Ok(Model::Equirectangular),
        None if is_fisheye => Ok(Model::Fisheye),
        Some(model) if !CAMERA_MODELS.contains(&model) => {
            let known = CAMERA_MODELS.join(", ");
            let fisheyes = FISHEYES.join(", ");
            Err(fields.unsupported(format!(
                "camera model {model}, expected one of {known}, {FULL_OPENCV}, {fisheyes}, {EQUIRECTANGULAR}; {LENS_REMEDY}"
            )))
        }
        Some(model) if is_fisheye => Err(fields.error(format!("\"is_fisheye\" is true of a {model} lens, expected {}", FISHEYES[0]))),
        _ => Ok(Model::Pinhole { is_rational: false }),
    }
}

/// Returns the lens with the field that `fisheye_crop_radius` states.
fn fisheye(fields: &Fields<'_>, lens: Fisheye, focal: Focal) -> Result<Fisheye, IoError> {
    const KEY: &str = "fisheye_crop_radius";
    let (Some(radius_px), Focal::Pixels(focal)) = (fields.positive(KEY)?, focal) else { return Ok(lens) };
    let widest = Fisheye { max_angle_rad: lens.growing_to(MAX_FISHEYE_ANGLE_RAD), ..lens };
    // A circle beyond what the lens images takes nothing away.
    let stated = widest.angle(radius_px / focal.min_element());
    Ok(Fisheye { max_angle_rad: stated.unwrap_or(widest.max_angle_rad), ..lens })
}

/// Returns the image's size, if it is stated.
fn size(fields: &Fields<'_>) -> Result<Option<[u32; 2]>, IoError> {
    let fields = fields.group(&["w", "h"]);
    match (fields.side("w")?, fields.side("h")?) {
        (Some(w), Some(h)) => Ok(Some([w, h])),
        (None, None) => Ok(None),
        _ => Err(fields.error("one of \"w\" and \"h\" is missing, expected both or neither")),
    }
}

fn angle_of_view(fields: &Fields<'_>, model: Model) -> Result<Focal, IoError> {
    if model == Model::Equirectangular {
        return Ok(Focal::Angle { x: Some(TAU), y: Some(PI) });
    }
    match (fields.angle("camera_angle_x")?, fields.angle("camera_angle_y")?) {
        (None, None) => Err(fields.error("no focal length: expected \"fl_x\" in pixels or \"camera_angle_x\" in radians")),
        (x, y) => Ok(Focal::Angle { x, y }),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use glam::DAffine3;
    use luxel_core::Camera;

    use super::*;
    use crate::dataset::parse_transforms;

    fn camera(lens: &str, image_px: [u32; 2]) -> Result<Camera, String> {
        let json =
            format!(r#"{{{lens}, "frames": [{{"file_path": "a.exr", "transform_matrix": [[1,0,0,0],[0,-1,0,0],[0,0,-1,0],[0,0,0,1]]}}]}}"#);
        let file = parse_transforms(Path::new("transforms.json"), json.as_bytes()).map_err(|e| e.to_string())?;
        let camera = file.frames[0].camera(image_px)?;
        assert!(camera.camera_from_world.abs_diff_eq(DAffine3::IDENTITY, 1e-12));
        Ok(camera)
    }

    #[test]
    fn fisheyes_have_four_coefficients_and_a_field() {
        let lens = r#""camera_model": "OPENCV_FISHEYE", "fl_x": 50, "fl_y": 52, "w": 200, "h": 160, "k1": 0.01, "k2": 0.02, "k3": 0, "k4": -0.001"#;
        let found = camera(lens, [200, 160]).unwrap();
        let expected = Fisheye::new([0.01, 0.02, 0.0, -0.001]);
        assert_eq!((found.projection, found.distortion), (CameraProjection::Fisheye(expected), Distortion::default()));
        assert_eq!((found.focal_px, found.center_px), (DVec2::new(50.0, 52.0), DVec2::new(100.0, 80.0)));
        let cropped = camera(&format!(r#"{lens}, "fisheye_crop_radius": 60"#), [100, 80]).unwrap();
        let CameraProjection::Fisheye(cropped) = cropped.projection else { panic!("not a fisheye") };
        assert!((cropped.radius(cropped.max_angle_rad) - 60.0 / 50.0).abs() < 1e-12);
        // As instant-ngp writes it, with an angle of view across an image of an equidistant lens.
        let angle = camera(r#""is_fisheye": true, "camera_angle_x": 3.0"#, [300, 200]).unwrap();
        assert!((angle.focal_px - DVec2::splat(100.0)).length() < 1e-12 && !angle.projection.is_pinhole());
    }

    #[test]
    fn higher_coefficients_are_nerfstudios_or_opencvs() {
        let lens = |fields: &str| {
            let frame = r#"{"file_path": "a.exr", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#;
            let json = format!(r#"{{"fl_x": 9, "k1": 0.1, "p1": 0.2, {fields}, "frames": [{frame}]}}"#);
            parse_transforms(Path::new("t"), json.as_bytes()).unwrap().frames[0].intrinsics.foreign_lens.map(|lens| lens.warp)
        };
        let polynomial = Warp { radial: [0.1, 0.0, 0.3, 0.4, 0.0, 0.0], tangential: [0.2, 0.0], ..Warp::default() };
        assert_eq!(lens(r#""k3": 0.3, "k4": 0.4"#), Some(polynomial));
        let rational = Warp { radial: [0.1, 0.0, 0.3, 0.0, 0.0, 0.0], denominator: [0.4, 0.0, 0.6], ..polynomial };
        assert_eq!(lens(r#""k3": 0.3, "k4": 0.4, "k6": 0.6"#), Some(rational));
        let full = Warp { denominator: [0.4, 0.0, 0.0], ..rational };
        assert_eq!(lens(r#""camera_model": "FULL_OPENCV", "k3": 0.3, "k4": 0.4"#), Some(full));
        assert_eq!(lens(r#""k3": 0"#), None);
    }

    #[test]
    fn panoramas_are_whole_unless_the_focal_length_says_otherwise() {
        let whole = Camera::panorama(DAffine3::IDENTITY, 64);
        let found = camera(r#""camera_model": "EQUIRECTANGULAR""#, [64, 32]).unwrap();
        assert!(
            (found.focal_px - whole.focal_px).length() < 1e-12
                && found.center_px == whole.center_px
                && found.projection == whole.projection
        );
        // nerfstudio states half the width.
        let stated =
            camera(r#""camera_model": "EQUIRECTANGULAR", "fl_x": 32, "fl_y": 32, "cx": 32, "cy": 16, "w": 64, "h": 32"#, [64, 32]).unwrap();
        assert!((stated.focal_px - whole.focal_px).length() < 1e-12);
        let half = camera(r#""camera_model": "EQUIRECTANGULAR", "fl_x": 64, "fl_y": 64"#, [64, 64]).unwrap();
        assert_eq!((half.period_px(), half.validate()), (None, Ok(())));
        let beyond = camera(r#""camera_model": "EQUIRECTANGULAR", "fl_x": 10"#, [64, 32]).unwrap_err();
        assert!(beyond.contains("the panorama spans 1152.0 x 576.0 degrees"), "{beyond}");
    }

    #[test]
    fn lenses_that_no_projection_covers_are_refused() {
        for (lens, message) in [
            (r#""camera_model": "OPENCV_FISHEYE", "fl_x": 9, "p1": 0.1"#, "the lens model is k1 k2 k3 k4"),
            (r#""camera_model": "OPENCV_FISHEYE", "fl_x": 9, "k5": 0.1"#, "\"k5\" is 0.1"),
            (r#""camera_model": "EQUIRECTANGULAR", "k1": 0.1"#, "coefficients of distortion"),
            (r#""camera_model": "OPENCV", "is_fisheye": true, "fl_x": 9"#, "\"is_fisheye\" is true of a OPENCV lens"),
            (
                r#""camera_model": "OMNIDIRECTIONAL", "fl_x": 9"#,
                "OPENCV_FISHEYE, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, SIMPLE_FISHEYE, FISHEYE, EQUIRECTANGULAR",
            ),
            (r#""camera_model": "OPENCV", "fl_x": 9, "p3": 0.1"#, "\"p3\" is 0.1"),
        ] {
            let error = camera(lens, [8, 8]).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
    }
}
