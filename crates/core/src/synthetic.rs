//! A synthetic scene of any size, for benchmarks and tests.
//!
//! In: a number of splats and a seed. Out: [`room`], a room of 4 x 2.6 x 4.8 m with nine boxes on
//! its floor, seen by [`room_camera`] through its open side.
//!
//! To an engine it looks like a trained scene. Most splats are flat discs on the surfaces, half of
//! them clustered around centres of detail; the rest float. Opacities lie between 0.05 and 0.99 and
//! cluster at both ends. Scales are log-normal and shrink with the square root of the number of
//! splats, so that a pixel sees about as many splats at any number. The order in memory is random.

use glam::{DAffine3, DVec2, Mat3, Quat, Vec3};

use crate::random::Stream;
use crate::{Camera, CameraProjection, ColorModel, Distortion, SH_OFFSET, Splat, Splats, logit, sh};

/// Half of the room's sides, metres; y points down.
const ROOM_HALF: Vec3 = Vec3::new(2.0, 1.3, 2.4);
/// Centre of the room, metres.
///
/// The camera is at the origin, 0.6 m in front of the open side, and looks along z.
const ROOM_CENTER: Vec3 = Vec3::new(0.0, 0.0, 3.0);
/// Number of boxes on the floor.
const BOXES: usize = 9;
/// Number of centres of detail on each face.
const DETAIL_CENTERS: usize = 12;
/// Seed of walls and boxes: rooms of every seed have the same ones.
const FURNITURE_SEED: u64 = 7;
/// Fraction of floating splats.
const FLOATERS: f32 = 0.06;
/// Median standard deviation of a splat in a room of 100,000, metres: neighbours overlap, and a
/// pixel sees some tens of splats.
const SCALE_OF_100K: f32 = 0.0152;

/// A rectangle to place splats on.
struct Face {
    corner: Vec3,
    edges: [Vec3; 2],
    normal: Vec3,
    /// Centres of detail, in units of `edges`.
    detail: [[f32; 2]; DETAIL_CENTERS],
    /// Sum of the weights of this face and all earlier ones.
    weight_up_to: f32,
}

/// The properties of a splat that depend on its kind.
struct Placement {
    position: Vec3,
    normal: Vec3,
    /// Offset of the log scales.
    log_scale: [f32; 3],
    opacity: f32,
}

/// Returns `count` splats with spherical harmonics of degree 3; equal seeds give equal splats.
pub fn room(count: usize, seed: u64) -> Splats {
    let faces = faces();
    let mut stream = Stream::new(seed);
    let log_scale = (SCALE_OF_100K * (1e5 / count.max(1) as f32).sqrt()).ln();
    let mut splats = Splats::empty(ColorModel::Sh { degree: 3 });
    splats.sh.reserve_exact(count * 3 * sh::coefficients(3));
    for _ in 0..count {
        let placement = if stream.uniform() <= FLOATERS { floater(&mut stream) } else { disc(&faces, &mut stream) };
        let [size, x, y, z] = stream.normals();
        let spread = [0.45 * x, 0.45 * y, 0.5 * z - 1.3];
        splats.push(&Splat {
            position: placement.position.to_array(),
            rotation: rotation(placement.normal, &mut stream),
            log_scale: [0, 1, 2].map(|axis| log_scale + 0.55 * size + spread[axis] + placement.log_scale[axis]),
            opacity_logit: logit(placement.opacity.clamp(0.05, 0.99)),
            sh: &color(placement.position, &mut stream),
            raw_luminance: &[],
        });
    }
    splats
}

/// Returns the camera for [`room`]: at the origin, along z, 75 degrees wide, with square pixels.
pub fn room_camera(size_px: [u32; 2]) -> Camera {
    let size = DVec2::new(size_px[0].into(), size_px[1].into());
    let focal_px = 0.5 * size.x / 37.5f64.to_radians().tan();
    Camera {
        camera_from_world: DAffine3::IDENTITY,
        focal_px: DVec2::splat(focal_px),
        center_px: size / 2.0,
        size_px,
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

/// Moves every parameter about as far as some hundred training steps would.
///
/// A render of the unperturbed scene is then a target that gives every visible splat a gradient.
/// Standard deviations of the noise: a tenth of a splat's own in position; 0.1 in log scale, raw
/// luminance and constant harmonics; 0.05 in rotations of unit length; 0.2 in the opacity's logit;
/// 0.02 in the other harmonics.
pub fn perturb(splats: &mut Splats, seed: u64) {
    let mut stream = Stream::new(seed);
    let coefficients = splats.color_model.sh_coefficients();
    let luminances = splats.color_model.luminance_coefficients();
    for i in 0..splats.len() {
        let [position, log_scale]: [[f32; 3]; 2] = [stream.normals(), stream.normals()];
        let rotation: [f32; 4] = stream.normals();
        let [opacity]: [f32; 1] = stream.normals();
        let length = splats.rotation[i].iter().map(|q| q * q).sum::<f32>().sqrt();
        for ((p, s), noise) in splats.position[i].iter_mut().zip(splats.log_scale[i]).zip(position) {
            *p += 0.1 * s.exp() * noise;
        }
        for (s, noise) in splats.log_scale[i].iter_mut().zip(log_scale) {
            *s += 0.1 * noise;
        }
        for (q, noise) in splats.rotation[i].iter_mut().zip(rotation) {
            *q += 0.05 * length * noise;
        }
        splats.opacity_logit[i] += 0.2 * opacity;
        for (m, k) in splats.sh[3 * coefficients * i..3 * coefficients * (i + 1)].chunks_exact_mut(3).enumerate() {
            let noise: [f32; 3] = stream.normals();
            let scale = if m == 0 { 0.1 } else { 0.02 };
            k.iter_mut().zip(noise).for_each(|(k, noise)| *k += scale * noise);
        }
        for raw in &mut splats.raw_luminance[luminances * i..luminances * (i + 1)] {
            let [noise]: [f32; 1] = stream.normals();
            *raw += 0.1 * noise;
        }
    }
}

/// Returns the room's five walls, seen from inside, and six faces of every box.
fn faces() -> Vec<Face> {
    let mut stream = Stream::new(FURNITURE_SEED);
    let mut faces = Vec::new();
    let open_side = |axis, sign| axis == 2 && sign < 0.0;
    add_faces(&mut faces, ROOM_CENTER, ROOM_HALF, -1.0, open_side, &mut stream);
    for _ in 0..BOXES {
        let mut within = |low: f32, high: f32| low + (high - low) * stream.uniform();
        let half = Vec3::new(within(0.15, 0.45), within(0.15, 0.7), within(0.15, 0.45));
        let center = Vec3::new(within(-1.5, 1.5), ROOM_HALF.y - half.y, within(1.6, 4.9));
        add_faces(&mut faces, center, half, 1.0, |_, _| false, &mut stream);
    }
    faces
}

/// Adds the faces of a box whose normals point outwards (`facing` 1) or inwards (-1).
///
/// Boxes that stand in the room have twice the detail of a wall.
fn add_faces(faces: &mut Vec<Face>, center: Vec3, half: Vec3, facing: f32, is_open: impl Fn(usize, f32) -> bool, stream: &mut Stream) {
    for (axis, sign) in [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (2, -1.0), (2, 1.0)] {
        if is_open(axis, sign) {
            continue;
        }
        let outwards = sign * Vec3::AXES[axis];
        let edges = [(axis + 1) % 3, (axis + 2) % 3].map(|a| 2.0 * half[a] * Vec3::AXES[a]);
        let area = edges[0].length() * edges[1].length();
        let weight = if facing > 0.0 { 2.0 * area } else { area };
        let weight_before = faces.last().map_or(0.0, |face| face.weight_up_to);
        faces.push(Face {
            corner: center + half[axis] * outwards - 0.5 * (edges[0] + edges[1]),
            edges,
            normal: facing * outwards,
            detail: std::array::from_fn(|_| [stream.uniform(), stream.uniform()]),
            weight_up_to: weight_before + weight,
        });
    }
}

/// Returns a splat on a surface.
fn disc(faces: &[Face], stream: &mut Stream) -> Placement {
    let chosen = stream.uniform() * faces.last().map_or(0.0, |face| face.weight_up_to);
    let face = &faces[faces.partition_point(|face| face.weight_up_to < chosen).min(faces.len() - 1)];
    let is_detail = stream.uniform() <= 0.5;
    let [u, v] = if is_detail {
        let center = face.detail[((stream.uniform() * DETAIL_CENTERS as f32) as usize).min(DETAIL_CENTERS - 1)];
        let [du, dv] = stream.normals();
        [center[0] + 0.08 * du, center[1] + 0.08 * dv].map(|at| at.clamp(0.0, 1.0))
    } else {
        [stream.uniform(), stream.uniform()]
    };
    let [height, nx, ny, nz] = stream.normals();
    let faint = stream.uniform() <= 0.45;
    let tangential = if is_detail { -0.35 } else { 0.0 };
    Placement {
        position: face.corner + u * face.edges[0] + v * face.edges[1] + 0.004 * height.abs() * face.normal,
        normal: (face.normal + 0.12 * Vec3::new(nx, ny, nz)).normalize_or(face.normal),
        log_scale: [tangential, tangential, 0.0],
        // Beta(1.2, 4) and Beta(4, 1).
        opacity: if faint { beta(1.2, 4.0, stream) } else { stream.uniform().powf(0.25) },
    }
}

/// Returns a splat anywhere in the room: larger than the others, and mostly faint.
fn floater(stream: &mut Stream) -> Placement {
    let at = Vec3::new(stream.uniform(), stream.uniform(), stream.uniform());
    Placement {
        position: ROOM_CENTER + (2.0 * at - 1.0) * ROOM_HALF,
        normal: Vec3::from_array(stream.normals()).normalize_or(Vec3::Z),
        log_scale: [0.4; 3],
        // Beta(1, 6).
        opacity: 1.0 - stream.uniform().powf(1.0 / 6.0),
    }
}

/// Returns a random number of the beta distribution, by Jöhnk's rejection (1964).
fn beta(a: f32, b: f32, stream: &mut Stream) -> f32 {
    loop {
        let x = stream.uniform().powf(1.0 / a);
        let y = stream.uniform().powf(1.0 / b);
        if x + y <= 1.0 {
            return x / (x + y);
        }
    }
}

/// Returns the quaternion w x y z that rotates z to `normal`, at a random angle about it.
fn rotation(normal: Vec3, stream: &mut Stream) -> [f32; 4] {
    let (a, b) = normal.any_orthonormal_pair();
    let (sin, cos) = (std::f32::consts::TAU * stream.uniform()).sin_cos();
    let tangent = cos * a + sin * b;
    let q = Quat::from_mat3(&Mat3::from_cols(tangent, normal.cross(tangent), normal)).normalize();
    [q.w, q.x, q.y, q.z]
}

/// Returns harmonics of radiance 0 to 1 in slow waves through the room, with some noise per splat
/// and a little sheen.
fn color(position: Vec3, stream: &mut Stream) -> [f32; 3 * sh::coefficients(3)] {
    let waves = [Vec3::new(3.0, 0.4, 1.4), Vec3::new(-2.1, 2.4, 0.3), Vec3::new(0.2, 2.8, 1.8)];
    let mut sh = stream.normals().map(|v: f32| 0.05 * v);
    for (c, wave) in waves.into_iter().enumerate() {
        // The first entries already hold noise of 0.05.
        let rgb = SH_OFFSET + 0.35 * (wave.dot(position) + c as f32).sin() + 1.6 * sh[c];
        sh[c] = (rgb - SH_OFFSET) / sh::C0;
    }
    sh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sigmoid;

    const COUNT: usize = 20_000;

    #[test]
    fn room_is_the_same_for_the_same_seed_only() {
        let splats = room(300, 1);
        assert_eq!((splats.len(), splats.validate()), (300, Ok(())));
        assert_eq!(room(300, 1), splats);
        assert_ne!(room(300, 2).position, splats.position);
        assert!(room(0, 1).is_empty());
    }

    #[test]
    fn room_lies_before_its_camera_on_walls_and_boxes() {
        let splats = room(COUNT, 5);
        let camera = room_camera([400, 400]);
        assert_eq!(camera.validate(), Ok(()));
        assert!((camera.focal_px.x - 260.645).abs() < 1e-3);
        let is_seen = |p: &[f32; 3]| {
            let (px, _) = camera.project(Vec3::from_array(*p).as_dvec3()).unwrap();
            (0.0..400.0).contains(&px.x) && (0.0..400.0).contains(&px.y)
        };
        let seen = splats.position.iter().filter(|p| is_seen(p)).count() as f32 / COUNT as f32;
        assert!((0.7..0.9).contains(&seen), "{seen}");
        for p in &splats.position {
            let from_center = (Vec3::from_array(*p) - ROOM_CENTER).abs();
            assert!(from_center.cmple(ROOM_HALF + 0.02).all(), "{p:?}");
        }
    }

    #[test]
    fn room_has_the_statistics_of_a_trained_scene() {
        let splats = room(COUNT, 6);
        let part = |is: &dyn Fn(usize) -> bool| (0..COUNT).filter(|i| is(*i)).count() as f32 / COUNT as f32;
        let opacity = |i: usize| sigmoid(splats.opacity_logit[i]);
        assert!((0..COUNT).all(|i| (0.0499..0.9901).contains(&opacity(i))));
        let (faint, opaque) = (part(&|i| opacity(i) < 0.3), part(&|i| opacity(i) > 0.8));
        assert!((0.25..0.45).contains(&faint) && (0.2..0.4).contains(&opaque), "{faint} {opaque}");
        // Discs are flat.
        let flat = part(&|i| splats.log_scale[i][2] < splats.log_scale[i][0].min(splats.log_scale[i][1]));
        assert!(flat > 0.85, "{flat}");
        // A quarter as many splats are twice as large.
        let mean = |splats: &Splats| splats.log_scale.iter().map(|s| s[0]).sum::<f32>() / splats.len() as f32;
        let ratio = (mean(&room(COUNT / 4, 6)) - mean(&splats)).exp();
        assert!((ratio - 2.0).abs() < 0.06, "{ratio}");
    }

    #[test]
    fn perturbed_scene_differs_in_every_parameter() {
        let splats = room(50, 8);
        let mut moved = splats.clone();
        perturb(&mut moved, 9);
        moved.validate().unwrap();
        let differ = |a: &[f32], b: &[f32]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a != b);
        assert!(differ(moved.position.as_flattened(), splats.position.as_flattened()));
        assert!(differ(moved.rotation.as_flattened(), splats.rotation.as_flattened()));
        assert!(differ(moved.log_scale.as_flattened(), splats.log_scale.as_flattened()));
        assert!(differ(&moved.opacity_logit, &splats.opacity_logit) && differ(&moved.sh, &splats.sh));
    }
}
