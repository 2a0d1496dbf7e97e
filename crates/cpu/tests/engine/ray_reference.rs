//! The error of ways to project a splat into a wide image, against the integral of the Gaussian
//! along each pixel's ray, in f64.
//!
//! In: a splat by its direction, size and shape. Out: the root mean square of alpha's error over
//! the directions around the splat, relative to that of alpha. Alpha is 1 at the splat's centre in
//! all of them.

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Fisheye};

/// A Gaussian in camera space at distance 1.
struct Gaussian {
    center: DVec3,
    /// Columns are the principal axes times their standard deviations.
    root: DMat3,
}

/// Ways of projecting.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Method {
    /// The covariance by the projection's Jacobian at the centre, an ellipse in pixels.
    Jacobian,
    /// Mean and covariance of seven projected points (Julier and Uhlmann 1997), an ellipse in
    /// pixels.
    Unscented,
    /// An ellipse on the plane that touches the sphere of directions at the centre: the engines'.
    Plane,
}

const METHODS: [Method; 3] = [Method::Jacobian, Method::Unscented, Method::Plane];

/// The normal distribution function.
fn normal(x: f64) -> f64 {
    // Abramowitz and Stegun 7.1.26, to 1.5e-7.
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let poly = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let upper = 0.5 * poly * (-z * z).exp();
    if x > 0.0 { 1.0 - upper } else { upper }
}

impl Gaussian {
    /// The integral along a ray from the camera.
    fn along(&self, ray: DVec3) -> f64 {
        let inverse = self.root.inverse();
        let (m, d) = (inverse * self.center, inverse * ray);
        let (mm, md, dd) = (m.length_squared(), m.dot(d), d.length_squared());
        (-0.5 * (mm - md * md / dd)).exp() * normal(md / dd.sqrt()) / dd.sqrt()
    }

    /// Alpha at a ray, as a method has it.
    fn alpha(&self, method: Method, camera: &Camera, ray: DVec3) -> f64 {
        let unit = self.center.normalize();
        let place = |point: DVec3| camera.project(point).map(|(px, _)| px);
        let wrapped = |d: DVec2| match camera.period_px() {
            Some(period) => DVec2::new(d.x - period * (d.x / period).round(), d.y),
            None => d,
        };
        let Some(middle) = place(self.center) else { return 0.0 };
        let (offset, columns) = match method {
            Method::Plane => {
                let first = unit.any_orthonormal_vector();
                let second = unit.cross(first);
                let on = |v: DVec3| DVec2::new(first.dot(v), second.dot(v));
                if unit.dot(ray) <= 0.0 {
                    return 0.0;
                }
                (on(ray), [self.root.x_axis, self.root.y_axis, self.root.z_axis].map(|axis| on(axis) / self.center.length()))
            }
            Method::Jacobian => {
                let Some([x, y]) = camera.jacobian(self.center) else { return 0.0 };
                let Some(at) = place(ray) else { return 0.0 };
                let columns = [self.root.x_axis, self.root.y_axis, self.root.z_axis].map(|axis| DVec2::new(x.dot(axis), y.dot(axis)));
                (wrapped(at - middle), columns)
            }
            Method::Unscented => {
                let Some(at) = place(ray) else { return 0.0 };
                let axes = [self.root.x_axis, self.root.y_axis, self.root.z_axis].map(|axis| axis * 3f64.sqrt());
                let points = axes.into_iter().flat_map(|axis| [self.center + axis, self.center - axis]);
                let offsets: Vec<DVec2> = points.map(|point| place(point).map_or(DVec2::ZERO, |px| wrapped(px - middle))).collect();
                let mean = offsets.iter().sum::<DVec2>() / 6.0;
                let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
                for d in offsets.iter().map(|d| *d - mean) {
                    (xx, xy, yy) = (xx + d.x * d.x / 6.0, xy + d.x * d.y / 6.0, yy + d.y * d.y / 6.0);
                }
                // A root of the covariance.
                let a = xx.sqrt();
                let b = xy / a;
                (wrapped(at - middle - mean), [DVec2::new(a, b), DVec2::new(0.0, (yy - b * b).max(0.0).sqrt()), DVec2::ZERO])
            }
        };
        ellipse(columns, offset)
    }
}

/// The value at an offset of a Gaussian whose covariance has these columns as a root.
fn ellipse(columns: [DVec2; 3], offset: DVec2) -> f64 {
    let sum = |f: fn(DVec2) -> f64| columns.iter().map(|c| f(*c)).sum::<f64>();
    let (xx, xy, yy) = (sum(|c| c.x * c.x), sum(|c| c.x * c.y), sum(|c| c.y * c.y));
    let determinant = xx * yy - xy * xy;
    (-0.5 * (yy * offset.x * offset.x - 2.0 * xy * offset.x * offset.y + xx * offset.y * offset.y) / determinant).exp()
}

/// Returns the errors of the methods for splats of a size (standard deviation of the largest axis
/// over the distance) in a direction, over orientations.
fn errors(camera: &Camera, direction: DVec3, size: f64) -> [f64; 3] {
    const ORIENTATIONS: u32 = 12;
    const STEPS: i32 = 24;
    let mut sums = [0.0; 3];
    let mut whole = 0.0;
    for n in 0..ORIENTATIONS {
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 2.4 * f64::from(n), 1.3 * f64::from(n), 0.7 * f64::from(n));
        let root = DMat3::from_quat(turn) * DMat3::from_diagonal(DVec3::new(1.0, 0.5, 0.15) * size);
        let gaussian = Gaussian { center: direction.normalize(), root };
        let unit = gaussian.center;
        let first = unit.any_orthonormal_vector();
        let second = unit.cross(first);
        let peak = gaussian.along(unit);
        for (x, y) in (-STEPS..=STEPS).flat_map(|x| (-STEPS..=STEPS).map(move |y| (x, y))) {
            let reach = 4.0 * size / f64::from(STEPS);
            let ray = (unit + (first * f64::from(x) + second * f64::from(y)) * reach).normalize();
            if camera.project(ray).is_none() {
                continue;
            }
            let expected = gaussian.along(ray) / peak;
            whole += expected * expected;
            for (sum, method) in sums.iter_mut().zip(METHODS) {
                *sum += (gaussian.alpha(method, camera, ray) - expected).powi(2);
            }
        }
    }
    sums.map(|sum| (sum / whole).sqrt())
}

/// Cameras and directions: the middle, between, near a pole or the border of the field.
fn places() -> Vec<(&'static str, Camera, DVec3)> {
    let panorama = Camera::panorama(DAffine3::IDENTITY, 2048);
    let at_latitude = |degrees: f64| DVec3::new(0.3 * degrees.to_radians().cos(), degrees.to_radians().sin(), degrees.to_radians().cos());
    let lens = Fisheye::new([-0.03, 0.012, -0.004, 0.0006]);
    let fisheye = Camera { focal_px: DVec2::splat(320.0), projection: CameraProjection::Fisheye(lens), ..panorama.clone() };
    let at_angle = |degrees: f64| DVec3::new(degrees.to_radians().sin(), 0.2 * degrees.to_radians().sin(), degrees.to_radians().cos());
    vec![
        ("panorama, latitude 0", panorama.clone(), at_latitude(0.0)),
        ("panorama, latitude 45", panorama.clone(), at_latitude(45.0)),
        ("panorama, latitude 80", panorama.clone(), at_latitude(80.0)),
        ("panorama, latitude 89", panorama, at_latitude(89.0)),
        ("fisheye, axis", fisheye.clone(), at_angle(1.0)),
        ("fisheye, 60 degrees", fisheye.clone(), at_angle(60.0)),
        ("fisheye, 95 degrees", fisheye, at_angle(95.0)),
    ]
}

const SIZES: [f64; 3] = [0.003, 0.03, 0.15];

#[test]
fn the_plane_is_as_near_to_integrals_along_rays_everywhere() {
    for (name, camera, direction) in places() {
        for size in SIZES {
            let [jacobian, unscented, plane] = errors(&camera, direction, size);
            let best = jacobian.min(unscented);
            assert!(plane <= 1.25 * best, "{name} {size}: {jacobian} {unscented} {plane}");
            assert!(plane < 0.8 * size, "{name} {size}: {plane}");
            if name.contains("latitude 8") {
                assert!(plane < best / 5.0, "{name} {size}: {jacobian} {unscented} {plane}");
            }
        }
    }
}

/// Prints the table of `docs/src/notebook/wide-projections.md`.
#[test]
#[ignore = "a tool: cargo test --release -p luxel-cpu --test engine projection_report -- --ignored --nocapture"]
fn projection_report() {
    println!("| place | size | Jacobian | unscented | plane |\n|---|---|---|---|---|");
    for (name, camera, direction) in places() {
        for size in SIZES {
            let [jacobian, unscented, plane] = errors(&camera, direction, size).map(|error| format!("{:.2} %", 100.0 * error));
            println!("| {name} | {size} | {jacobian} | {unscented} | {plane} |");
        }
    }
}

/// The end of a splat so large that it reaches a right angle to its direction, where the plane has
/// no coordinates.
#[derive(Clone, Copy)]
enum End {
    /// It ends there: the engines'.
    Hard,
    /// It fades from this cosine to the splat's direction on.
    Faded(f64),
    /// It goes on behind, weighted by the part of the Gaussian that is in front of the camera as
    /// its depth along the splat's direction has it.
    Weighted,
}

/// Returns the error of an end over all directions, for splats with axes in a ratio, and the alpha
/// at the right angle.
fn end_error(end: End, axes: DVec3) -> [f64; 2] {
    const ORIENTATIONS: u32 = 12;
    const DIRECTIONS: u32 = 2000;
    const EDGE: f64 = 0.01;
    let (mut sum, mut whole, mut step): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for n in 0..ORIENTATIONS {
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 2.4 * f64::from(n), 1.3 * f64::from(n), 0.7 * f64::from(n));
        let root = DMat3::from_quat(turn) * DMat3::from_diagonal(axes);
        let gaussian = Gaussian { center: DVec3::Z, root };
        let columns = [root.x_axis, root.y_axis, root.z_axis].map(DVec3::truncate);
        let depth = (root.inverse() * DVec3::Z).length();
        let peak = gaussian.along(DVec3::Z);
        for i in 0..DIRECTIONS {
            let cosine = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(DIRECTIONS);
            let turned = 2.399_963 * f64::from(i);
            let ray = (DVec2::new(turned.cos(), turned.sin()) * (1.0 - cosine * cosine).sqrt()).extend(cosine);
            let expected = gaussian.along(ray) / peak;
            let plane = ellipse(columns, ray.truncate());
            let found = match end {
                End::Hard => plane * f64::from(u8::from(cosine > 0.0)),
                End::Faded(from) => plane * (cosine / from).clamp(0.0, 1.0),
                End::Weighted => plane * normal(cosine * depth) / normal(depth),
            };
            whole += expected * expected;
            sum += (found - expected).powi(2);
            if cosine.abs() < EDGE {
                step = step.max(plane);
            }
        }
    }
    [(sum / whole).sqrt(), step]
}

/// Prints the table of large splats of the same page.
#[test]
#[ignore = "a tool: cargo test --release -p luxel-cpu --test engine large_splats_report -- --ignored --nocapture"]
fn large_splats_report() {
    println!("| axes | size | ends | fades | weighted | alpha at the edge |\n|---|---|---|---|---|---|");
    for (name, axes) in [("1 : 1 : 1", DVec3::ONE), ("1 : 0.5 : 0.15", DVec3::new(1.0, 0.5, 0.15))] {
        for size in [0.3, 0.35, 0.5, 0.7, 1.0] {
            let [[hard, step], [faded, _], [weighted, _]] =
                [End::Hard, End::Faded(0.3), End::Weighted].map(|end| end_error(end, axes * size));
            let [hard, faded, weighted] = [hard, faded, weighted].map(|error| format!("{:.1} %", 100.0 * error));
            println!("| {name} | {size} | {hard} | {faded} | {weighted} | {step:.3} |");
        }
    }
}
