use super::*;
use crate::Image;

/// Returns the map of a radiance that is a function of direction.
fn map(projection: Projection, width: usize, radiance: impl Fn(DVec3) -> [f32; 3]) -> Image {
    let direction = |i: usize| projection.direction([(i % width) as f64 + 0.5, (i / width) as f64 + 0.5], width).normalize();
    let height = projection.height(width);
    Image { width, height, pixels: (0..width * height).map(|i| radiance(direction(i))).collect() }
}

#[test]
fn maps_lie_as_openexr_has_them() {
    let near = |a: DVec3, b: DVec3| (a.normalize() - b).length() < 1e-9;
    let at = |x, y| Projection::LatitudeLongitude.direction([x, y], 8);
    assert!(near(at(4.0, 2.0), DVec3::Z) && near(at(2.0, 2.0), DVec3::X) && near(at(0.0, 0.0), DVec3::Y));
    let face = |n: f64| Projection::Cube.direction([4.0, 4.0 + 8.0 * n], 8);
    for (n, axis) in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z].into_iter().enumerate() {
        assert!(near(face(n as f64), axis));
        let [forward, right, down] = FACES[n];
        assert_eq!(right.cross(down), forward);
    }
}

#[test]
fn irradiance_is_that_of_known_environments() {
    use std::f64::consts::PI;
    for projection in [Projection::LatitudeLongitude, Projection::Cube] {
        // Everywhere 1: pi. Above the horizon 1: pi, 0 and pi / 2.
        let sky = |d: DVec3| [1.0, if d.y > 0.0 { 1.0 } else { 0.0 }, (1.0 + d.y) as f32];
        let summary = Summary::new(&map(projection, 128, sky), projection);
        let expected = [PI, PI, PI, PI, PI, PI];
        for (found, expected) in summary.irradiance.iter().zip(expected) {
            assert!((found[0] - expected).abs() < 2e-3, "{projection:?} {found:?}");
        }
        for (face, expected) in [(0, PI / 2.0), (2, PI), (3, 0.0)] {
            assert!((summary.irradiance[face][1] - expected).abs() < 0.03, "{projection:?} {:?}", summary.irradiance[face]);
        }
        // L = 1 + y: pi + 2 pi / 3 upwards.
        assert!((summary.irradiance[2][2] - (PI + 2.0 * PI / 3.0)).abs() < 3e-3);
        assert!((summary.mean_radiance[0] - 1.0).abs() < 1e-3 && (summary.mean_radiance[1] - 0.5).abs() < 6e-3);
        assert!((summary.peak_radiance - 2.0).abs() < 1e-2 && summary.peak_direction[1] > 0.98);
    }
}
