//! Differentiable blending, compared with the reference in f64.

use luxel_core::engine::{
    AbsoluteMeans, ActivatedSplats, BlendOptions, CameraMatrices, Channels, Differentiable, DirectionalColors, EllipseGradient,
    MatrixCamera, PixelGradient, ScreenEllipses, ShapeParameters, SplatGradient,
};
use luxel_core::{Activation, ColorBasis, ColorModel};
use luxel_cpu::CpuEngine;

use crate::blend_reference::{Ellipse, Inputs, blend, project, rotation_matrix};
use crate::fixture::{self, Rng};
use crate::number::{Gradient, Number, Var, gradient, variables};

/// Splats, cameras and channels of a test.
struct Scene {
    position: Vec<[f32; 3]>,
    rotation: Vec<[f32; 4]>,
    scale: Vec<[f32; 3]>,
    opacity: Vec<f32>,
    cameras: Vec<MatrixCamera>,
    /// `[C, N, K]`.
    channels: Vec<f32>,
    background: Vec<f32>,
    count: usize,
    options: BlendOptions,
}

/// Returns a matrix camera that shears a little: no optimiser of matrices keeps them rigid.
fn matrix_camera(camera: &luxel_core::Camera, shear: f32) -> MatrixCamera {
    let (m, t) = (camera.camera_from_world.matrix3.transpose().to_cols_array_2d(), camera.camera_from_world.translation);
    let mut rows = [0, 1, 2].map(|r| [m[r][0] as f32, m[r][1] as f32, m[r][2] as f32, t[r] as f32]);
    rows[0][1] += shear;
    rows[2][0] -= 0.5 * shear;
    MatrixCamera {
        camera_from_world: rows,
        focal_px: camera.focal_px.as_vec2().to_array(),
        center_px: camera.center_px.as_vec2().to_array(),
    }
}

impl Scene {
    /// Makes a scene of splats of all sizes, with opacities 0 and 1, a flat one, and one behind the
    /// camera.
    fn new(splats: usize, count: usize, seed: u64) -> Self {
        let camera = fixture::camera(37, 26);
        let stored = fixture::splats(ColorModel::Sh { degree: 0 }, splats, &camera, seed);
        let mut rng = Rng::new(seed + 100);
        let mut scene = Self {
            position: stored.position.clone(),
            rotation: stored.rotation.iter().map(|q| q.map(|c| 1.7 * c)).collect(),
            scale: stored.log_scale.iter().map(|s| s.map(f32::exp)).collect(),
            opacity: stored.opacity_logit.iter().map(|o| 1.0 / (1.0 + (-o).exp())).collect(),
            cameras: vec![matrix_camera(&camera, 0.0), matrix_camera(&camera, 0.06)],
            channels: (0..2 * splats * count).map(|_| rng.normal()).collect(),
            background: (0..2 * count).map(|_| rng.normal()).collect(),
            count,
            options: BlendOptions::gsplat([37, 26]),
        };
        (scene.opacity[0], scene.opacity[1]) = (1.0, 0.0);
        scene.scale[2][1] = 0.0;
        scene.position[3] = camera.eye().as_vec3().to_array().map(|c| c - 0.5);
        scene
    }

    fn splats(&self) -> ActivatedSplats<'_> {
        ActivatedSplats { position: &self.position, rotation: &self.rotation, scale: &self.scale, opacity: &self.opacity }
    }

    fn channels(&self) -> Channels<'_> {
        Channels { values: &self.channels, count: self.count, background: Some(&self.background) }
    }

    /// Returns the numbers of the reference.
    fn inputs<N: Number>(&self, mut next: impl FnMut(f32) -> N) -> Inputs<N> {
        let n = self.opacity.len();
        let mut number = |v: f32| next(v);
        Inputs {
            position: self.position.iter().map(|v| v.map(&mut number)).collect(),
            rotation: self.rotation.iter().map(|v| v.map(&mut number)).collect(),
            scale: self.scale.iter().map(|v| v.map(&mut number)).collect(),
            opacity: self.opacity.iter().map(|v| number(*v)).collect(),
            camera_from_world: self.cameras.iter().map(|c| c.camera_from_world.map(|row| row.map(&mut number))).collect(),
            channels: self
                .channels
                .chunks(n * self.count)
                .map(|camera| camera.chunks(self.count).map(|row| row.iter().map(|v| number(*v)).collect()).collect())
                .collect(),
            background: self.background.chunks(self.count).map(|row| row.iter().map(|v| number(*v)).collect()).collect(),
        }
    }

    /// Returns the numbers as independent variables.
    fn variables(&self) -> Inputs<Var> {
        let mut values = Vec::new();
        self.inputs(|v| {
            values.push(f64::from(v));
            0.0
        });
        let mut variables = variables(&values).into_iter();
        self.inputs(|_| variables.next().unwrap())
    }
}

/// Weights of the objective: what its gradient by pixels and ellipses is.
struct Weights {
    channels: Vec<f32>,
    alpha: Vec<f32>,
    mean_px: Vec<[f32; 2]>,
    covariance_px2: Vec<[f32; 3]>,
    conic: Vec<[f32; 3]>,
    depth: Vec<f32>,
    opacity: Vec<f32>,
}

impl Weights {
    /// Draws weights; pixels near a decision have none.
    fn new(scene: &Scene, seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let inputs = scene.inputs(f64::from);
        let (mut channels, mut alpha) = (Vec::new(), Vec::new());
        for (camera, intrinsics) in scene.cameras.iter().enumerate() {
            let ellipses = project(&inputs, camera, intrinsics, &scene.options);
            for margin in blend(&inputs, camera, &ellipses, &scene.options).margin {
                let is_safe = f32::from(u8::from(margin > 1e-3));
                channels.extend((0..scene.count).map(|_| is_safe * rng.normal()));
                alpha.push(is_safe * rng.normal());
            }
        }
        let total = scene.cameras.len() * scene.opacity.len();
        Self {
            channels,
            alpha,
            mean_px: (0..total).map(|_| rng.normals().map(|v: f32| 0.1 * v)).collect(),
            covariance_px2: (0..total).map(|_| rng.normals().map(|v: f32| 0.1 * v)).collect(),
            conic: (0..total).map(|_| rng.normals()).collect(),
            depth: (0..total).map(|_| rng.normal()).collect(),
            opacity: (0..total).map(|_| rng.normal()).collect(),
        }
    }

    /// Returns the objective of the reference, with the ellipses and the blended offsets.
    #[expect(clippy::type_complexity, reason = "the parts of a result, in a test")]
    fn objective(&self, scene: &Scene, inputs: &Inputs<Var>) -> (Var, Vec<Vec<Option<Ellipse<Var>>>>, Vec<Vec<(usize, [Var; 2])>>) {
        let (mut total, mut all, mut offsets) = (Var::of(0.0), Vec::new(), Vec::new());
        let mut add = |weight: f32, value: Var| total = total + Var::of(weight.into()) * value;
        let (n, [width, height]) = (scene.opacity.len(), scene.options.size_px.map(|side| side as usize));
        for (camera, intrinsics) in scene.cameras.iter().enumerate() {
            let ellipses = project(inputs, camera, intrinsics, &scene.options);
            let blended = blend(inputs, camera, &ellipses, &scene.options);
            for pixel in 0..width * height {
                let at = camera * width * height + pixel;
                add(self.alpha[at], blended.alpha[pixel]);
                for (c, value) in blended.channels[pixel].iter().enumerate() {
                    add(self.channels[at * scene.count + c], *value);
                }
            }
            for (i, e) in ellipses.iter().enumerate().filter_map(|(i, e)| Some((camera * n + i, e.as_ref()?))) {
                (0..2).for_each(|a| add(self.mean_px[i][a], e.mean_px[a]));
                (0..3).for_each(|a| add(self.covariance_px2[i][a], e.covariance[a]));
                (0..3).for_each(|a| add(self.conic[i][a], e.conic[a]));
                add(self.depth[i], e.depth);
                add(self.opacity[i], e.opacity);
            }
            all.push(ellipses);
            offsets.push(blended.offsets);
        }
        (total, all, offsets)
    }
}

/// Asserts that numbers differ by at most `tolerance` times the largest.
fn assert_near(name: &str, found: &[f32], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let largest = expected.iter().fold(1e-12, |m: f64, v| m.max(v.abs()));
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let difference = (f64::from(*found) - expected).abs();
        assert!(difference <= tolerance * largest, "{name} {i}: {found} and {expected}, largest {largest}");
    }
}

fn derivatives<const N: usize>(gradient: &Gradient, rows: &[[Var; N]]) -> Vec<f64> {
    rows.as_flattened().iter().map(|v| gradient.by(*v)).collect()
}

/// Numbers of f32 relative to the largest of an array: sums over pixels and splats round.
const TOLERANCE: f64 = 2e-5;

/// Checks that gradients by scales follow from those by covariances G: with axes r and scales s,
/// a covariance is the sum of s^2 r r^T, and the derivative by s is 2 s r^T G r.
fn check_scales(scene: &Scene, by_covariance: &[[f32; 6]], by_scale: &[[f32; 3]]) {
    let mut expected = Vec::new();
    let mut found = Vec::new();
    for (i, [xx, xy, xz, yy, yz, zz]) in by_covariance.iter().map(|row| row.map(f64::from)).enumerate() {
        let axes = rotation_matrix(scene.rotation[i].map(f64::from));
        for k in 0..3 {
            let [x, y, z] = axes.map(|row| row[k]);
            let form = xx * x * x + yy * y * y + zz * z * z + xy * x * y + xz * x * z + yz * y * z;
            expected.push(2.0 * f64::from(scene.scale[i][k]) * form);
            found.push(by_scale[i][k]);
        }
    }
    assert_near("scales by covariances", &found, &expected, TOLERANCE);
}

/// Checks ellipses, images and all gradients of a scene.
fn check(scene: &Scene, seed: u64) {
    let engine = CpuEngine::new(2).unwrap();
    let weights = Weights::new(scene, seed);
    let (ellipses, projected) = engine.project(&scene.splats(), &scene.cameras, &scene.options).unwrap();
    let (pixels, blended) = projected.blend(&scene.channels()).unwrap();
    let inputs = scene.variables();
    let (total, expected, offsets) = weights.objective(scene, &inputs);
    let exact = gradient(total);
    check_ellipses(&ellipses, &expected);
    for (camera, expected) in expected.iter().enumerate() {
        let reference = blend(&inputs, camera, expected, &scene.options);
        for (pixel, expected) in reference.channels.iter().enumerate().filter(|(pixel, _)| reference.margin[*pixel] > 1e-3) {
            let at = camera * reference.alpha.len() + pixel;
            assert!((f64::from(pixels.alpha[at]) - reference.alpha[pixel].value()).abs() < 1e-6);
            for (c, expected) in expected.iter().enumerate() {
                let found = pixels.channels[at * scene.count + c];
                assert!(
                    (f64::from(found) - expected.value()).abs() < 5e-6,
                    "pixel {pixel} of camera {camera}: {found}, {}",
                    expected.value()
                );
            }
        }
    }

    let by_pixels = PixelGradient { channels: &weights.channels, alpha: Some(&weights.alpha), absolute: AbsoluteMeans::Collect };
    let by_blend = blended.backward(&by_pixels).unwrap();
    assert_near(
        "channels",
        &by_blend.channels,
        &inputs.channels.iter().flatten().flatten().map(|v| exact.by(*v)).collect::<Vec<_>>(),
        TOLERANCE,
    );
    assert_near(
        "background",
        &by_blend.background,
        &inputs.background.iter().flatten().map(|v| exact.by(*v)).collect::<Vec<_>>(),
        TOLERANCE,
    );
    let n = scene.opacity.len();
    let mut absolute = vec![[0.0; 2]; 2 * n];
    for (camera, offsets) in offsets.iter().enumerate() {
        for (i, d) in offsets {
            (0..2).for_each(|a| absolute[camera * n + i][a] += exact.by(d[a]).abs());
        }
    }
    assert_near("absolute means", by_blend.absolute_mean_px.as_flattened(), absolute.as_flattened(), TOLERANCE);

    // The objective has weights on the ellipses, too.
    let sum = |a: &[f32], b: &[f32]| -> Vec<f32> { a.iter().zip(b).map(|(a, b)| a + b).collect() };
    let means = sum(by_blend.mean_px.as_flattened(), weights.mean_px.as_flattened());
    let covariances = sum(by_blend.covariance_px2.as_flattened(), weights.covariance_px2.as_flattened());
    let by_ellipses = EllipseGradient {
        mean_px: Some(means.as_chunks().0),
        covariance_px2: Some(covariances.as_chunks().0),
        conic: Some(&weights.conic),
        depth: Some(&weights.depth),
        opacity: Some(&sum(&by_blend.opacity, &weights.opacity)),
        shape: ShapeParameters::RotationAndScale,
        cameras: CameraMatrices::Differentiate,
    };
    let by_covariance = projected.backward(&EllipseGradient { shape: ShapeParameters::Covariance, ..by_ellipses }).unwrap();
    assert!(by_covariance.rotation.is_empty() && by_covariance.scale.is_empty());
    let found = projected.backward(&by_ellipses).unwrap();
    assert!(found.covariance.is_empty());
    assert_eq!(by_covariance.position, found.position);
    check_scales(scene, &by_covariance.covariance, &found.scale);
    assert_near("position", found.position.as_flattened(), &derivatives(&exact, &inputs.position), TOLERANCE);
    assert_near("rotation", found.rotation.as_flattened(), &derivatives(&exact, &inputs.rotation), TOLERANCE);
    assert_near("scale", found.scale.as_flattened(), &derivatives(&exact, &inputs.scale), TOLERANCE);
    assert_near("opacity", &found.opacity, &inputs.opacity.iter().map(|v| exact.by(*v)).collect::<Vec<_>>(), TOLERANCE);
    let without_cameras = projected.backward(&EllipseGradient { cameras: CameraMatrices::Skip, ..by_ellipses }).unwrap();
    assert_eq!(without_cameras, SplatGradient { camera_from_world: Vec::new(), ..found.clone() });
    let cameras = inputs.camera_from_world.as_flattened();
    assert_near("camera", found.camera_from_world.as_flattened().as_flattened(), &derivatives(&exact, cameras), TOLERANCE);
}

/// Compares ellipses, camera by camera.
fn check_ellipses(found: &ScreenEllipses, expected: &[Vec<Option<Ellipse<Var>>>]) {
    let mut visible = 0;
    for (i, expected) in expected.iter().flatten().enumerate() {
        let Some(e) = expected else {
            assert_eq!(found.radius_px[i], [0; 2]);
            continue;
        };
        visible += 1;
        assert_eq!(found.radius_px[i].map(f64::from), e.radius_px, "{i}");
        let numbers =
            [found.mean_px[i].as_slice(), &found.covariance_px2[i], &found.conic[i], &[found.depth[i], found.opacity[i]]].concat();
        let expected = [e.mean_px.as_slice(), &e.covariance, &e.conic, &[e.depth, e.opacity]].concat();
        for (found, expected) in numbers.iter().zip(expected) {
            assert!(
                (f64::from(*found) - expected.value()).abs() <= 2e-5 * (1.0 + expected.value().abs()),
                "{i}: {found}, {}",
                expected.value()
            );
        }
    }
    assert!(visible > expected[0].len(), "{visible} of {}", 2 * expected[0].len());
}

#[test]
fn images_and_all_gradients_equal_the_reference_for_any_number_of_channels() {
    for (count, seed) in [(1, 1), (3, 2), (4, 3), (7, 4)] {
        check(&Scene::new(30, count, seed), 50 + seed);
    }
}

#[test]
fn opacity_compensation_far_plane_and_least_radius_equal_the_reference() {
    let mut scene = Scene::new(30, 4, 5);
    scene.options = BlendOptions { compensates_opacity: true, far: 5.0, min_radius_px: 2.0, dilation_px2: 0.5, ..scene.options };
    check(&scene, 55);
}

/// Everything that a forward and backward pass computes, as one array.
fn results(engine: &CpuEngine, scene: &Scene) -> Vec<f32> {
    let (ellipses, projected) = engine.project(&scene.splats(), &scene.cameras, &scene.options).unwrap();
    let (pixels, blended) = projected.blend(&scene.channels()).unwrap();
    // Other work between the passes changes nothing.
    let other = Scene::new(60, 5, 77);
    let (_, other_projected) = engine.project(&other.splats(), &other.cameras, &other.options).unwrap();
    let (_, other_blended) = other_projected.blend(&other.channels()).unwrap();
    drop((other_projected, other_blended));
    let by_pixels = PixelGradient { channels: &pixels.channels, alpha: Some(&pixels.alpha), absolute: AbsoluteMeans::Collect };
    let by_blend = blended.backward(&by_pixels).unwrap();
    assert_eq!(blended.backward(&by_pixels).unwrap(), by_blend);
    let by_ellipses = EllipseGradient {
        mean_px: Some(&by_blend.mean_px),
        covariance_px2: Some(&by_blend.covariance_px2),
        opacity: Some(&by_blend.opacity),
        ..EllipseGradient::default()
    };
    let by_splats = projected.backward(&by_ellipses).unwrap();
    [
        pixels.channels,
        pixels.alpha,
        ellipses.depth,
        by_blend.channels,
        by_blend.background,
        by_blend.absolute_mean_px.as_flattened().to_vec(),
        by_splats.position.as_flattened().to_vec(),
        by_splats.rotation.as_flattened().to_vec(),
        by_splats.scale.as_flattened().to_vec(),
        by_splats.opacity,
        by_splats.camera_from_world.as_flattened().as_flattened().to_vec(),
    ]
    .concat()
}

#[test]
fn results_are_the_same_bits_for_any_threads_and_memory_after_other_work() {
    let scene = Scene::new(300, 5, 9);
    let expected = results(&CpuEngine::new(1).unwrap(), &scene);
    for (threads, bytes) in [(2, 1 << 30), (3, 0), (2, 40 << 10)] {
        let mut engine = CpuEngine::new(threads).unwrap();
        engine.set_tile_memory(bytes);
        assert!(results(&engine, &scene) == expected, "{threads} threads, {bytes} bytes");
    }
}

#[test]
fn channels_for_all_cameras_equal_the_same_channels_for_each() {
    let scene = Scene::new(40, 4, 12);
    let engine = CpuEngine::new(2).unwrap();
    let half = scene.channels.len() / 2;
    let shared = &scene.channels[..half];
    let twice = [shared, shared].concat();
    let (_, projected) = engine.project(&scene.splats(), &scene.cameras, &scene.options).unwrap();
    let [(image, one), (images, each)] =
        [shared, &twice].map(|values| projected.blend(&Channels { values, background: None, ..scene.channels() }).unwrap());
    assert_eq!(image, images);
    let by_pixels = PixelGradient { channels: &image.channels, alpha: None, absolute: AbsoluteMeans::Skip };
    let [one, each] = [one, each].map(|blended| blended.backward(&by_pixels).unwrap());
    assert_eq!(one.mean_px, each.mean_px);
    assert!(one.absolute_mean_px.is_empty());
    let sum: Vec<f64> = (0..half).map(|i| f64::from(each.channels[i]) + f64::from(each.channels[half + i])).collect();
    assert_near("channels", &one.channels, &sum, 1e-6);
}

#[test]
fn colours_and_their_gradients_equal_the_formulas_of_core() {
    let models = [
        ColorModel::Sh { degree: 3 },
        ColorModel::Sh { degree: 4 },
        ColorModel::LogSh { degree: 3 },
        ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation: Activation::Softplus },
    ];
    for (model, per_camera) in models.into_iter().zip([false, true, false, false]) {
        let (n, mut rng) = (21, Rng::new(31));
        // More coefficients than the model has.
        let k = model.sh_coefficients() + 2;
        let position: Vec<[f32; 3]> = (0..n).map(|_| rng.normals()).collect();
        let eye: Vec<[f32; 3]> = (0..2).map(|_| rng.normals().map(|v: f32| 4.0 + v)).collect();
        let sh: Vec<f32> = (0..n * 3 * k * if per_camera { 2 } else { 1 }).map(|_| 0.4 * rng.normal()).collect();
        let raw_luminance: Vec<f32> = (0..n * model.luminance_coefficients()).map(|_| rng.normal()).collect();
        let visible: Vec<bool> = (0..2 * n).map(|i| i % 5 != 3).collect();
        let weights: Vec<[f32; 3]> = (0..2 * n).map(|_| rng.normals()).collect();
        let engine = CpuEngine::new(2).unwrap();
        let colors = DirectionalColors {
            model,
            active_degree: model.max_degree(),
            position: &position,
            eye: &eye,
            sh: &sh,
            sh_per_splat: k,
            raw_luminance: &raw_luminance,
            visible: Some(&visible),
        };
        let values =
            [position.as_flattened(), eye.as_flattened(), &sh, &raw_luminance].concat().into_iter().map(f64::from).collect::<Vec<_>>();
        let v = variables(&values);
        let (by_eye, by_sh) = (3 * n, 3 * n + 6);
        let by_luminance = by_sh + sh.len();
        let found = engine.colors(&colors).unwrap();
        let mut total = Var::of(0.0);
        for (i, (found, weights)) in found.iter().zip(&weights).enumerate() {
            if !visible[i] {
                assert_eq!(*found, [0.0; 3]);
                continue;
            }
            let (camera, splat) = (i / n, i % n);
            let offset: [Var; 3] = std::array::from_fn(|a| v[3 * splat + a] - v[by_eye + 3 * camera + a]);
            let length = luxel_core::Real::sqrt(offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]);
            let basis = ColorBasis::new(model.max_degree(), offset.map(|c| c / length));
            let first = by_sh + if per_camera { i } else { splat } * 3 * k;
            let m = model.luminance_coefficients();
            let expected = model.radiance(&basis, |j, c| v[first + 3 * j + c], |j| v[by_luminance + splat * m + j]);
            for c in 0..3 {
                assert!((f64::from(found[c]) - expected[c].value()).abs() < 3e-6 * (1.0 + expected[c].value().abs()));
                total = total + Var::of(weights[c].into()) * expected[c];
            }
        }
        let exact = gradient(total);
        let expected = |range: std::ops::Range<usize>| v[range].iter().map(|v| exact.by(*v)).collect::<Vec<_>>();
        let found = engine.colors_backward(&colors, &weights).unwrap();
        assert_near("position", found.position.as_flattened(), &expected(0..by_eye), TOLERANCE);
        assert_near("eye", found.eye.as_flattened(), &expected(by_eye..by_sh), TOLERANCE);
        assert_near("harmonics", &found.sh, &expected(by_sh..by_luminance), TOLERANCE);
        if !raw_luminance.is_empty() {
            assert_near("luminance", &found.raw_luminance, &expected(by_luminance..values.len()), TOLERANCE);
        }
    }
}

#[test]
fn wrong_lengths_and_options_are_errors() {
    let (scene, engine) = (Scene::new(20, 3, 1), CpuEngine::new(1).unwrap());
    let message = |splats: &ActivatedSplats<'_>, cameras: &[MatrixCamera], options: &BlendOptions| {
        engine.project(splats, cameras, options).err().map(|e| e.to_string()).unwrap_or_default()
    };
    let short = ActivatedSplats { opacity: &scene.opacity[..19], ..scene.splats() };
    assert_eq!(message(&short, &scene.cameras, &scene.options), "opacities: expected 20 numbers or rows, found 19");
    let options = BlendOptions { size_px: [0, 4], ..scene.options };
    assert_eq!(message(&scene.splats(), &scene.cameras, &options), "image size 0 x 4, expected 1 to 65536 pixels a side");
    let options = BlendOptions { far: f32::NAN, ..scene.options };
    assert_eq!(message(&scene.splats(), &scene.cameras, &options), "far plane is NaN, expected 0 or more");
    let camera = MatrixCamera { focal_px: [-1.0, 2.0], ..scene.cameras[0] };
    assert_eq!(message(&scene.splats(), &[camera], &scene.options), "camera 0: expected focal lengths above 0, found -1 and 2");
    let (_, projected) = engine.project(&scene.splats(), &scene.cameras, &scene.options).unwrap();
    let of_blend = |channels: Channels<'_>| projected.blend(&channels).err().map(|e| e.to_string()).unwrap_or_default();
    assert_eq!(of_blend(Channels { count: 0, ..scene.channels() }), "channels: expected at least 1, found 0");
    assert_eq!(of_blend(Channels { values: &[0.0; 7], ..scene.channels() }), "channels: expected 60 numbers or rows, found 7");
    assert_eq!(of_blend(Channels { background: Some(&[0.0; 3]), ..scene.channels() }), "background: expected 6 numbers or rows, found 3");
    let (_, blended) = projected.blend(&scene.channels()).unwrap();
    let gradient = PixelGradient { channels: &[0.0], alpha: None, absolute: AbsoluteMeans::Skip };
    assert_eq!(blended.backward(&gradient).unwrap_err().to_string(), "gradient by channels: expected 5772 numbers or rows, found 1");
}
