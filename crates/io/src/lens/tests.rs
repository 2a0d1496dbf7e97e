use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use luxel_core::Distortion;
use proptest::prelude::*;

use super::*;

fn direction(angle_deg: f64, around_deg: f64) -> DVec3 {
    let (angle, around) = (angle_deg.to_radians(), around_deg.to_radians());
    DVec3::new(angle.sin() * around.cos(), angle.sin() * around.sin(), angle.cos())
}

fn bases() -> Vec<(Base, f64)> {
    vec![
        (Base::Perspective, 80.0),
        (Base::Equidistant, 170.0),
        (Base::Equisolid, 170.0),
        (Base::FieldOfView { omega: 1.2 }, 85.0),
        (Base::FieldOfView { omega: 1e-6 }, 60.0),
        (Base::Division { k: -0.4 }, 100.0),
        (Base::Division { k: 0.1 }, 55.0),
        (Base::Unified { alpha: 0.6, beta: 1.1 }, 110.0),
        (Base::Unified { alpha: 0.3, beta: 0.9 }, 85.0),
    ]
}

#[test]
fn every_base_is_inverted() {
    for (base, most) in bases() {
        let lens = Lens { base, warp: Warp::default() }.prepared();
        for angle in [0.0, 0.001, 10.0, 30.0, 0.6 * most, most] {
            for around in [0.0, 45.0, 137.0, -90.0] {
                let ray = direction(angle, around);
                let place = lens.project(3.0 * ray).unwrap();
                assert!(lens.direction(place).unwrap().distance(ray) < 1e-6, "{base:?} {angle} {around}");
            }
        }
    }
}

#[test]
fn radii_are_those_of_the_formulas() {
    let radius = |base: Base, angle_deg: f64| base.radius(f64::to_radians(angle_deg)).unwrap();
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    near(radius(Base::Perspective, 45.0), 1.0);
    near(radius(Base::Equidistant, 120.0), 2.0 * PI / 3.0);
    near(radius(Base::Equisolid, 90.0), 2.0f64.sqrt());
    near(radius(Base::FieldOfView { omega: 1.0 }, 45.0), (2.0 * 0.5f64.tan()).atan());
    // tan t = r / (1 + k r²).
    let r = radius(Base::Division { k: -0.2 }, 40.0);
    near(r / (1.0 - 0.2 * r * r), 40.0f64.to_radians().tan());
    near(radius(Base::Unified { alpha: 0.0, beta: 1.0 }, 45.0), 1.0);
    // alpha = 1/2 and beta = 1 is the stereographic projection, up to a factor of 2.
    near(radius(Base::Unified { alpha: 0.5, beta: 1.0 }, 100.0), 2.0 * 50.0f64.to_radians().tan());
}

#[test]
fn the_panorama_has_forward_in_the_middle_and_up_at_the_top() {
    let lens = Lens { base: Base::Equirectangular, warp: Warp::default() }.prepared();
    assert_eq!(lens.project(DVec3::Z), Some(DVec2::ZERO));
    assert!(lens.project(DVec3::X).unwrap().distance(DVec2::new(0.5 * PI, 0.0)) < 1e-15);
    assert!(lens.project(-DVec3::Y).unwrap().distance(DVec2::new(0.0, -0.5 * PI)) < 1e-15);
    assert_eq!(lens.project(DVec3::ZERO), None);
    let ray = DVec3::new(-0.3, 0.5, -0.8).normalize();
    assert!(lens.direction(lens.project(ray).unwrap()).unwrap().distance(ray) < 1e-12);
}

#[test]
fn what_a_lens_cannot_image_is_none() {
    assert_eq!(Lens::default().prepared().project(-DVec3::Z), None);
    assert_eq!(Lens::fisheye([0.0; 4]).prepared().project(-DVec3::Z), None);
    assert_eq!(Lens { base: Base::Division { k: 0.5 }, warp: Warp::default() }.prepared().project(direction(80.0, 0.0)), None);
    let fold = Lens::from(Distortion { k1: -1.0, ..Distortion::default() }).prepared();
    assert_eq!(fold.project(direction(40.0, 10.0)), None);
    assert!(fold.project(direction(28.0, 10.0)).is_some());
    assert_eq!(fold.direction(DVec2::new(0.9, 0.0)), None);
    assert!((fold.reach() - 2.0 / 27.0f64.sqrt()).abs() < 1e-3);
}

#[test]
fn the_pinholes_distortion_is_the_cores() {
    let distortion = Distortion { k1: -0.2, k2: 0.05, p1: 0.01, p2: -0.015 };
    let lens = Lens::from(distortion);
    assert_eq!(lens.distortion(), Some(distortion));
    assert_eq!(Lens::fisheye([0.0; 4]).distortion(), None);
    for p in [DVec2::new(0.3, -0.2), DVec2::new(-0.5, 0.4)] {
        assert!(lens.prepared().project(p.extend(1.0)).unwrap().distance(distortion.distort(p)) < 1e-15);
    }
}

proptest! {
    #[test]
    fn warps_are_inverted(
        x in -0.7f64..0.7, y in -0.6f64..0.6, k in prop::array::uniform4(-0.03f64..0.03), d in prop::array::uniform3(0.0f64..0.02),
        p in prop::array::uniform2(-0.01f64..0.01), s in prop::array::uniform4(-0.01f64..0.01), shear in -0.02f64..0.02, chained: bool,
    ) {
        let warp = Warp {
            radial: [k[0], k[1], k[2], k[3], 0.0, 0.0], denominator: d, tangential: p, tangential_radial: [p[1], 0.0], prism: s, shear,
            order: if chained { Order::Chained } else { Order::Parallel },
        };
        for base in [Base::Perspective, Base::Equidistant] {
            let lens = Lens { base, warp }.prepared();
            let ray = DVec3::new(x, y, 1.0).normalize();
            let found = lens.direction(lens.project(ray).unwrap()).unwrap();
            prop_assert!(found.distance(ray) < 1e-6, "{found} {ray}");
        }
    }

    #[test]
    fn any_lens_answers_without_a_panic(k in prop::array::uniform6(prop::num::f64::ANY), x: f64, y: f64, z: f64) {
        for base in bases().into_iter().map(|(base, _)| base).chain([Base::Division { k: k[0] }, Base::Unified { alpha: k[0], beta: k[1] }]) {
            let lens = Lens { base, warp: Warp { radial: k, prism: [k[0]; 4], ..Warp::default() } }.prepared();
            let _ = (lens.project(DVec3::new(x, y, z)), lens.direction(DVec2::new(x, y)), lens.reach());
        }
    }
}
