//! COLMAP's camera models: numbers, names, parameters and the lenses that they are.
//!
//! In: a model and its parameters, in COLMAP's order. Out: intrinsics with a lens. Source: COLMAP
//! 4.2, sensor/models.h. Degenerate cases: sizes, focal lengths and parameters that are out of
//! range are errors.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::DVec2;
use luxel_core::{Distortion, MAX_SIDE_PX};

use crate::IoError;
use crate::dataset::intrinsics::LensImage;
use crate::lens::{Base, Lens, Order, Warp};

/// Most parameters of a model.
pub(super) const MAX_PARAMETERS: usize = 16;

/// How many parameters a model's focal lengths and principal point are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Head {
    /// f, cx, cy.
    One,
    /// fx, fy, cx, cy.
    Two,
    /// None: the image's width and height instead, which is a panorama.
    Panorama,
}

/// A camera model.
#[derive(Clone, Copy, Debug)]
pub(super) struct CameraModel {
    pub(super) name: &'static str,
    /// Number of parameters.
    pub(super) parameters: usize,
    head: Head,
    lens: fn(&[f64]) -> Lens,
}

impl CameraModel {
    const fn new(name: &'static str, head: Head, extra: usize, lens: fn(&[f64]) -> Lens) -> Self {
        let first = match head {
            Head::One => 3,
            Head::Two => 4,
            Head::Panorama => 2,
        };
        Self { name, parameters: first + extra, head, lens }
    }

    /// Returns the model of a name.
    pub(super) fn named(name: &str) -> Option<&'static Self> {
        CAMERA_MODELS.iter().find(|model| model.name == name)
    }
}

/// All models, in the order of their numbers.
pub(super) const CAMERA_MODELS: [CameraModel; 18] = [
    CameraModel::new("SIMPLE_PINHOLE", Head::One, 0, |_| Lens::default()),
    CameraModel::new("PINHOLE", Head::Two, 0, |_| Lens::default()),
    CameraModel::new("SIMPLE_RADIAL", Head::One, 1, opencv),
    CameraModel::new("RADIAL", Head::One, 2, opencv),
    CameraModel::new("OPENCV", Head::Two, 4, opencv),
    CameraModel::new("OPENCV_FISHEYE", Head::Two, 4, fisheye),
    CameraModel::new("FULL_OPENCV", Head::Two, 8, full_opencv),
    CameraModel::new("FOV", Head::Two, 1, |p| plain(Base::FieldOfView { omega: p[0] })),
    CameraModel::new("SIMPLE_RADIAL_FISHEYE", Head::One, 1, fisheye),
    CameraModel::new("RADIAL_FISHEYE", Head::One, 2, fisheye),
    CameraModel::new("THIN_PRISM_FISHEYE", Head::Two, 8, thin_prism_fisheye),
    CameraModel::new("RAD_TAN_THIN_PRISM_FISHEYE", Head::Two, 12, rad_tan_thin_prism_fisheye),
    CameraModel::new("SIMPLE_DIVISION", Head::One, 1, |p| plain(Base::Division { k: p[0] })),
    CameraModel::new("DIVISION", Head::Two, 1, |p| plain(Base::Division { k: p[0] })),
    CameraModel::new("SIMPLE_FISHEYE", Head::One, 0, fisheye),
    CameraModel::new("FISHEYE", Head::Two, 0, fisheye),
    CameraModel::new("EUCM", Head::Two, 2, |p| plain(Base::Unified { alpha: p[0], beta: p[1] })),
    CameraModel::new("EQUIRECTANGULAR", Head::Panorama, 0, |_| plain(Base::Equirectangular)),
];

fn plain(base: Base) -> Lens {
    Lens { base, warp: Warp::default() }
}

/// Returns the coefficient of this number, 0 where the model has fewer.
fn nth(extra: &[f64], n: usize) -> f64 {
    extra.get(n).copied().unwrap_or(0.0)
}

fn opencv(extra: &[f64]) -> Lens {
    Distortion { k1: nth(extra, 0), k2: nth(extra, 1), p1: nth(extra, 2), p2: nth(extra, 3) }.into()
}

fn fisheye(extra: &[f64]) -> Lens {
    Lens::fisheye([0, 1, 2, 3].map(|n| nth(extra, n)))
}

fn full_opencv(p: &[f64]) -> Lens {
    let [k1, k2, p1, p2, k3, k4, k5, k6] = [0, 1, 2, 3, 4, 5, 6, 7].map(|n| nth(p, n));
    let warp = Warp { radial: [k1, k2, k3, 0.0, 0.0, 0.0], denominator: [k4, k5, k6], tangential: [p1, p2], ..Warp::default() };
    Lens { base: Base::Perspective, warp }
}

fn thin_prism_fisheye(p: &[f64]) -> Lens {
    let [k1, k2, p1, p2, k3, k4, sx1, sy1] = [0, 1, 2, 3, 4, 5, 6, 7].map(|n| nth(p, n));
    let warp = Warp { radial: [k1, k2, k3, k4, 0.0, 0.0], tangential: [p1, p2], prism: [sx1, 0.0, sy1, 0.0], ..Warp::default() };
    Lens { base: Base::Equidistant, warp }
}

fn rad_tan_thin_prism_fisheye(p: &[f64]) -> Lens {
    // Its p0 is OpenCV's p2, its p1 OpenCV's p1.
    let warp = Warp {
        radial: [0, 1, 2, 3, 4, 5].map(|n| nth(p, n)),
        tangential: [nth(p, 7), nth(p, 6)],
        prism: [8, 9, 10, 11].map(|n| nth(p, n)),
        order: Order::Chained,
        ..Warp::default()
    };
    Lens { base: Base::Equidistant, warp }
}

/// Returns the error about a model that COLMAP 4.2 does not have.
pub(super) fn unknown_model(path: &Path, camera: u32, model: &str) -> IoError {
    let known: Vec<&str> = CAMERA_MODELS.iter().map(|model| model.name).collect();
    IoError::unsupported(
        path,
        format!("camera {camera}: camera model {model}, expected one of {}; run `colmap image_undistorter` first", known.join(", ")),
    )
}

/// Returns the lens of a model's parameters, whose number the caller has checked.
pub(super) fn lens_image(path: &Path, camera: u32, model: &CameraModel, size: [u64; 2], params: &[f64]) -> Result<LensImage, IoError> {
    let invalid = |message: String| IoError::invalid(path, format!("camera {camera}: {message}"));
    let side = |v: u64| u32::try_from(v).ok().filter(|v| (1..=MAX_SIDE_PX).contains(v));
    let (Some(w), Some(h)) = (side(size[0]), side(size[1])) else {
        let [w, h] = size;
        return Err(invalid(format!("image size {w} x {h}, expected 1 to {MAX_SIDE_PX} pixels per side")));
    };
    let wrong_number = || invalid(format!("{} parameters, expected {} of {}", params.len(), model.parameters, model.name));
    if params.len() != model.parameters {
        return Err(wrong_number());
    }
    let [width, height] = [w, h].map(f64::from);
    let (focal, center, extra) = match (model.head, params) {
        (Head::One, [f, cx, cy, extra @ ..]) => ([*f, *f], [*cx, *cy], extra),
        (Head::Two, [fx, fy, cx, cy, extra @ ..]) => ([*fx, *fy], [*cx, *cy], extra),
        (Head::Panorama, [pw, ph]) if [*pw, *ph] == [width, height] => ([width / TAU, height / PI], [0.5 * width, 0.5 * height], &[][..]),
        (Head::Panorama, [pw, ph]) => {
            return Err(invalid(format!("parameters {pw} x {ph}, expected the image's size, {width} x {height}")));
        }
        _ => return Err(wrong_number()),
    };
    let lens = (model.lens)(extra);
    if let Base::Unified { alpha, beta } = lens.base
        && !((0.0..=1.0).contains(&alpha) && beta > 0.0)
    {
        return Err(invalid(format!("EUCM's alpha is {alpha} and its beta {beta}, expected 0 to 1 and above 0")));
    }
    if let Base::FieldOfView { omega } = lens.base
        && omega.abs() >= PI
    {
        return Err(invalid(format!("FOV's omega is {omega} radians, expected less than pi")));
    }
    Ok(LensImage { size_px: [w, h], focal_px: DVec2::from(focal), center_px: DVec2::from(center), lens })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// Returns the pixel of a direction.
    fn pixel(name: &str, params: &[f64], direction: DVec3) -> DVec2 {
        let model = CameraModel::named(name).unwrap();
        assert_eq!(model.parameters, params.len(), "{name}");
        let found = lens_image(Path::new("cameras.txt"), 1, model, [640, 480], params).unwrap();
        found.lens.prepared().project(direction).unwrap() * found.focal_px + found.center_px
    }

    /// The expected pixels are what `pycolmap.Camera.img_from_cam` of pycolmap 4.2.1 returns.
    #[test]
    fn pixels_are_those_of_pycolmap() {
        let d = DVec3::new(0.3, -0.2, 1.0);
        #[rustfmt::skip]
        let expected: [(&str, &[f64], [f64; 2]); 18] = [
            ("SIMPLE_PINHOLE", &[500.0, 320.5, 241.0], [470.5, 141.0]),
            ("PINHOLE", &[500.0, 510.0, 320.5, 241.0], [470.5, 139.0]),
            ("SIMPLE_RADIAL", &[500.0, 320.5, 241.0, -0.1], [468.54999999999995, 142.29999999999998]),
            ("RADIAL", &[500.0, 320.5, 241.0, -0.1, 0.02], [468.60069999999996, 142.26619999999997]),
            ("OPENCV", &[500.0, 510.0, 320.5, 241.0, -0.1, 0.02, 0.003, -0.004], [467.8007, 140.857624]),
            ("OPENCV_FISHEYE", &[300.0, 310.0, 320.5, 241.0, -0.1, 0.02, 0.003, -0.004], [405.8693121665422, 182.19002939638202]),
            ("FULL_OPENCV", &[500.0, 510.0, 320.5, 241.0, -0.1, 0.02, 0.003, -0.004, 0.005, 0.06, -0.01, 0.002], [466.68009680076796, 141.61963417547776]),
            ("FOV", &[500.0, 510.0, 320.5, 241.0, 0.9], [475.442377154038, 135.63918353525412]),
            ("SIMPLE_RADIAL_FISHEYE", &[300.0, 320.5, 241.0, -0.1], [405.84416539473295, 184.10388973684468]),
            ("RADIAL_FISHEYE", &[300.0, 320.5, 241.0, -0.1, 0.02], [405.8689382370324, 184.08737450864504]),
            ("THIN_PRISM_FISHEYE", &[300.0, 310.0, 320.5, 241.0, -0.1, 0.02, 0.003, -0.004, 0.005, -0.006, 0.007, -0.008], [405.67889687078815, 182.20983829301008]),
            ("RAD_TAN_THIN_PRISM_FISHEYE", &[300.0, 310.0, 320.5, 241.0, -0.1, 0.02, 0.003, -0.004, 0.005, -0.006, 0.007, -0.008, 0.009, 0.01, -0.011, 0.012], [407.0710337555019, 181.1391814484499]),
            ("SIMPLE_DIVISION", &[500.0, 320.5, 241.0, -0.2], [466.7905084377762, 143.4729943748158]),
            ("DIVISION", &[500.0, 510.0, 320.5, 241.0, -0.2], [466.7905084377762, 141.52245426231212]),
            ("SIMPLE_FISHEYE", &[300.0, 320.5, 241.0], [406.8785352103274, 183.41430985978172]),
            ("FISHEYE", &[300.0, 310.0, 320.5, 241.0], [406.8785352103274, 181.49478685510775]),
            ("EUCM", &[400.0, 410.0, 320.5, 241.0, 0.6, 1.1], [435.7220781883553, 162.26491323795722]),
            ("EQUIRECTANGULAR", &[640.0, 480.0], [349.6875453048776, 211.08133315375372]),
        ];
        for (name, params, at) in expected {
            let found = pixel(name, params, d);
            assert!(found.distance(DVec2::from(at)) < 1e-9, "{name}: {found} {at:?}");
        }
        assert_eq!(expected.map(|(name, ..)| name), CAMERA_MODELS.map(|model| model.name));
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        let error = |name: &str, params: &[f64]| {
            let model = CameraModel::named(name).unwrap();
            lens_image(Path::new("c"), 7, model, [640, 480], params).unwrap_err().message
        };
        assert!(error("EUCM", &[1.0, 1.0, 0.0, 0.0, 1.5, 1.0]).contains("alpha is 1.5"));
        assert!(error("FOV", &[1.0, 1.0, 0.0, 0.0, 4.0]).contains("omega is 4"));
        assert!(error("EQUIRECTANGULAR", &[640.0, 320.0]).contains("640 x 320, expected the image's size, 640 x 480"));
        assert!(error("OPENCV", &[1.0; 7]).contains("7 parameters, expected 8 of OPENCV"));
    }
}
