//! Scenes, cameras and views for the tests, from fixed seeds.

use glam::{DAffine3, DQuat, DVec2, DVec3};
use luxel_core::engine::{AdamBetas, CameraGradientChoice, LearningRates, StatsCollection, StepConfig};
use luxel_core::{
    Activation, Antialias, Camera, CameraProjection, ColorModel, Cutoffs, Distortion, Image, LossWeights, Mask, Mix, PixelValues,
    RasterConfig, RenderOptions, SH_OFFSET, Splat, Splats, Target, View, random, sh,
};

/// Counter-based random numbers.
pub struct Rng {
    seed: u64,
    index: u64,
}

impl Rng {
    pub fn new(seed: u64) -> Self {
        Self { seed, index: 0 }
    }
    /// Returns a standard normal number.
    pub fn normal(&mut self) -> f32 {
        self.index += 1;
        random::standard_normal(self.seed, self.index)[0]
    }
    /// Returns a number uniform in `low..high`: the normal's distribution function, approximated by
    /// a logistic, is uniform enough for a scene.
    pub fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) / (1.0 + (-1.702 * self.normal()).exp())
    }
    pub fn normals<const K: usize>(&mut self) -> [f32; K] {
        std::array::from_fn(|_| self.normal())
    }
}

/// Returns a tilted camera with unequal focal lengths, whose centre is not the image's.
pub fn camera(width: u32, height: u32) -> Camera {
    let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.4, 0.2);
    let eye = DVec3::new(0.7, -0.4, -1.1);
    Camera {
        camera_from_world: DAffine3::from_rotation_translation(rotation, -(rotation * eye)),
        focal_px: DVec2::new(26.0, 24.5) * f64::from(width) / 24.0,
        center_px: DVec2::new(0.48 * f64::from(width), 0.53 * f64::from(height)),
        size_px: [width, height],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

/// Returns the same camera with another projection: a fisheye whose circle ends within the image,
/// or a panorama.
pub fn wide_camera(projection: CameraProjection, width: u32, height: u32) -> Camera {
    let camera = camera(width, height);
    match projection {
        CameraProjection::Equirectangular => Camera { size_px: [width, height], ..Camera::panorama(camera.camera_from_world, width) },
        _ => Camera { focal_px: DVec2::new(0.3, 0.29) * f64::from(width), projection, ..camera },
    }
}

/// Returns the world position of a point given in pixels and depth.
pub fn unproject(camera: &Camera, px: [f64; 2], depth: f64) -> [f32; 3] {
    // Beyond the image of a lens, any direction will do.
    let at = camera.unproject(px.into()).unwrap_or(DVec3::new(0.6, 0.0, -0.8)) * depth;
    camera.camera_from_world.inverse().transform_point3(at).as_vec3().to_array()
}

/// Returns the coefficients of a splat with random harmonics around `rgb`.
fn color(model: ColorModel, rgb: [f32; 3], variation: f32, rng: &mut Rng) -> (Vec<f32>, Vec<f32>) {
    let (dc, raw) = model.constant(rgb);
    let mut harmonics = dc.to_vec();
    let amplitude = match model {
        ColorModel::Sh { .. } => variation * (rgb.iter().sum::<f32>() / 3.0 + SH_OFFSET),
        ColorModel::LogSh { .. } | ColorModel::Lcd { .. } | ColorModel::Mix(_) => variation,
    };
    harmonics.extend((3..3 * model.sh_coefficients()).map(|_| amplitude * rng.normal()));
    let mut luminance = vec![raw; model.luminance_coefficients().min(1)];
    luminance.extend((1..model.luminance_coefficients()).map(|_| variation * rng.normal()));
    (harmonics, luminance)
}

/// Returns `count` splats in front of `camera`: depths 2 to 6, a few pixels across, brightness over
/// four decades.
pub fn splats(model: ColorModel, count: usize, camera: &Camera, seed: u64) -> Splats {
    let mut rng = Rng::new(seed);
    let mut splats = Splats::empty(model);
    let size = camera.size_px.map(f64::from);
    for _ in 0..count {
        let px = size.map(|s| f64::from(rng.uniform(-0.1, 1.1)) * s);
        let depth = f64::from(rng.uniform(2.0, 6.0));
        let brightness = (1.7 * rng.normal() - 1.5).exp();
        let (harmonics, luminance) = color(model, rng.normals().map(|c: f32| brightness * (0.5 * c).exp()), 0.15, &mut rng);
        splats.push(&Splat {
            position: unproject(camera, px, depth),
            rotation: rng.normals(),
            log_scale: rng.normals().map(|c: f32| 0.6 * c - 1.6),
            opacity_logit: 1.2 * rng.normal(),
            sh: &harmonics,
            raw_luminance: &luminance,
        });
    }
    splats
}

/// Returns [`splats`] with every special case of a splat, in random depth order among them.
pub fn splats_with_special_cases(model: ColorModel, camera: &Camera, seed: u64) -> Splats {
    let mut splats = splats(model, 16, camera, seed);
    let size = camera.size_px.map(f64::from);
    // Behind the camera.
    splats.position[0] = unproject(camera, [0.5 * size[0], 0.5 * size[1]], -2.0);
    // Beside the frustum and reaching into it: the Jacobian's slope is clamped.
    splats.position[1] = unproject(camera, [-1.2 * size[0], 0.4 * size[1]], 2.5);
    splats.log_scale[1] = [0.1, 0.4, 0.2];
    splats.position[2] = unproject(camera, [0.6 * size[0], 2.3 * size[1]], 3.0);
    splats.log_scale[2] = [0.3, 0.2, 0.5];
    // Two opaque ones, one behind the other: alpha is capped, pixels finish.
    for (i, depth) in [(3, 2.2), (4, 2.6), (5, 2.9)] {
        splats.position[i] = unproject(camera, [0.3 * size[0], 0.6 * size[1]], depth);
        splats.log_scale[i] = [-1.2, -1.0, -1.4];
        splats.opacity_logit[i] = 9.0;
    }
    // A chromaticity with dead channels (for Sh: black ones), and one with only dead channels.
    let k = 3 * model.sh_coefficients();
    splats.sh[6 * k] = -4.0;
    splats.sh[7 * k..7 * k + 3].fill(-4.0);
    // A quaternion far from unit length.
    splats.rotation[8] = splats.rotation[8].map(|c| 7.0 * c);
    // Smaller than a pixel.
    splats.log_scale[9] = [-5.0, -5.5, -4.5];
    splats.opacity_logit[9] = 2.0;
    splats
}

/// Returns a view of `camera`'s size with smooth, noisy radiance over four decades; `masked` masks
/// a block and some single pixels.
pub fn view(camera: &Camera, masked: bool, seed: u64) -> View {
    let mut rng = Rng::new(seed);
    let [width, height] = camera.size_px.map(|s| s as usize);
    let mut pixels = Vec::new();
    for i in 0..width * height {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        let brightness = (3.0 * (5.0 * x + 3.0 * y).sin() + 0.4 * rng.normal() - 2.0).exp();
        pixels.push(rng.normals().map(|c: f32| brightness * (0.3 * c).exp()));
    }
    let valid: Vec<bool> =
        (0..width * height).map(|i| !(masked && (i % 37 == 5 || (i % width < width / 4 && i / width > height / 2)))).collect();
    for (pixel, valid) in pixels.iter_mut().zip(&valid) {
        if !valid {
            *pixel = [0.0; 3];
        }
    }
    View {
        name: "images/000".into(),
        camera: camera.clone(),
        image: Image { width, height, pixels }.into(),
        values: PixelValues::Radiance,
        noise: None,
        mask: masked.then(|| Mask::from_valid(valid).into()),
        recordings: Vec::new(),
        target: Target { scale: TARGET_SCALE, ..Target::default() },
    }
}

/// Returns the view with weights 0, 1 and between in place of its mask.
pub fn with_weights(view: View, seed: u64) -> View {
    let mut rng = Rng::new(seed);
    let weights = view.image.pixels.iter().map(|_| rng.uniform(-0.4, 1.4).clamp(0.0, 1.0)).collect();
    View { mask: Some(Mask { weights }.into()), ..view }
}

/// Returns render options with a background that is not black.
pub fn options(cutoffs: Cutoffs, antialias: Antialias) -> RenderOptions {
    RenderOptions {
        raster: RasterConfig { cutoffs, antialias, ..RasterConfig::default() },
        background: [0.02, 0.3, 0.007],
        active_degree: sh::MAX_DEGREE,
    }
}

/// Returns learning rates as different from one another as in training.
pub const LEARNING_RATES: LearningRates = LearningRates {
    position: 1.6e-3,
    rotation: 1e-3,
    log_scale: 5e-3,
    opacity_logit: 0.05,
    sh_dc: 2.5e-3,
    sh_rest: 1.25e-4,
    luminance_dc: 0.03,
    luminance_rest: 7e-3,
};

/// The scale of the views' targets.
const TARGET_SCALE: [f32; 3] = [0.75, 1.0, 1.5];

/// Returns a training step.
pub fn step(step: u32, render: RenderOptions) -> StepConfig {
    StepConfig {
        step,
        render,
        loss: LossWeights { squared_share: 0.4, opacity_weight: 0.01, scale_weight: 0.02, ..LossWeights::default() },
        learning_rates: LEARNING_RATES,
        betas: AdamBetas::default(),
        position_noise: None,
        dropout: None,
        stats: StatsCollection::GradientsAndAbsolute,
        camera_gradient: CameraGradientChoice::Skip,
    }
}

/// Returns the 3D filter of splat `i`, world units.
pub fn smoothing(count: usize) -> Vec<f32> {
    (0..count).map(|i| 0.02 + 0.01 * (i % 5) as f32).collect()
}

/// Returns a mix of splats of equal geometry, each light with its gain in every splat.
pub fn mix(lights: &[(&Splats, f32)]) -> Splats {
    let first = lights[0].0;
    let color_model = ColorModel::Mix(Mix::new(lights.iter().map(|(splats, _)| splats.color_model)).unwrap());
    let mut mixed = Splats { color_model, sh: Vec::new(), raw_luminance: Vec::new(), ..first.clone() };
    for i in 0..first.len() {
        for (splats, gain) in lights {
            mixed.sh.extend_from_slice(splats.sh_of(i));
            mixed.raw_luminance.push(*gain);
            mixed.raw_luminance.extend_from_slice(splats.raw_luminance_of(i));
        }
    }
    mixed
}

/// Returns the splats of `geometry` with the colours of others of the same number.
pub fn with_colors_of(geometry: &Splats, colors: &Splats) -> Splats {
    Splats { color_model: colors.color_model, sh: colors.sh.clone(), raw_luminance: colors.raw_luminance.clone(), ..geometry.clone() }
}

/// Returns the scenes of three lights on equal geometry, of different colour models, with their
/// gains.
pub fn three_lights(camera: &Camera, count: usize) -> Vec<(Splats, f32)> {
    let lcd = |chroma_degree, luminance_degree, activation| ColorModel::Lcd { chroma_degree, luminance_degree, activation };
    let models = [ColorModel::Sh { degree: 3 }, lcd(3, 1, Activation::Softplus), lcd(1, 0, Activation::Exp)];
    let first = splats(models[0], count, camera, 3);
    let seeds = [3, 11, 19];
    let light = |(model, seed)| with_colors_of(&first, &splats(model, count, camera, seed));
    models.into_iter().zip(seeds).map(light).zip([1.0, 0.3, 2.5]).collect()
}
