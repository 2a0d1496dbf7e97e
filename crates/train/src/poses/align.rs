//! Alignment of a view to a trained scene: its pose is optimised on its own image, with the scene
//! fixed.
//!
//! In: an engine with the scene, a view. Out: its camera, moved to where the loss
//! is least of all poses that were tried; the given one is among them. Focal lengths stay. This is
//! how test views are compared with a scene whose cameras were refined: the scene lies where its
//! training cameras say it does, which the given test poses cannot know.

use glam::DVec3;
use luxel_core::engine::{AdamBetas, CameraGradientChoice, LearningRates, NumberAdam, StatsCollection, StepConfig};
use luxel_core::{Camera, CameraMotion, Engine, EngineError, Knots, LossWeights, RadianceScale, RenderOptions, Target, ToneCurve, View};

use super::{angle_of_pixel, decay};
use crate::recorded::curve;

/// Steps of an alignment.
pub const ALIGNMENT_STEPS: u32 = 48;
/// Rate at first, pixels per step.
const RATE_PX: f64 = 0.3;
/// Decay rates of the moments: for a few dozen steps on one image.
const BETAS: [f64; 2] = [0.8, 0.95];
/// Epsilon of Adam.
const EPSILON: f64 = 1e-12;

/// A scene to align views to, besides the engine that holds it.
#[derive(Clone, Debug)]
pub struct AlignmentScene {
    /// Options of rendering.
    pub render: RenderOptions,
    /// The loss that is minimised.
    pub loss: LossWeights,
    /// Radiance of one normalised unit, in the units of the views.
    pub radiance_scale: RadianceScale,
    /// mu of the mu-law, for views of radiance.
    pub mu: f32,
    /// Response of the camera, for views of captured values.
    pub response: Option<Knots>,
    /// Positions of the splats, from which the distance of the scene follows.
    pub positions: Vec<[f32; 3]>,
}

impl AlignmentScene {
    /// Returns the target through which the loss sees a view's image, with the vignetting that the
    /// view has.
    fn target(&self, view: &View) -> Target {
        let captured = self.response.as_ref().and_then(|knots| curve(view, knots, self.radiance_scale, [1.0; 3]));
        match captured {
            Some(curve) => Target { curve, scale: [1.0; 3], ..view.target },
            None => Target { curve: ToneCurve::MuLaw { mu: self.mu }, scale: self.radiance_scale.target_scale([1.0; 3]), ..view.target },
        }
    }

    /// Returns the median depth of the splats whose centres `camera` sees; 1 if it sees none.
    pub fn depth(&self, camera: &Camera) -> f64 {
        let [width, height] = camera.size_px.map(f64::from);
        let is_inside = |px: glam::DVec2| px.x >= 0.0 && px.y >= 0.0 && px.x <= width && px.y <= height;
        let seen = self.positions.iter().filter_map(|p| camera.project(DVec3::from_array(p.map(f64::from))));
        let mut depths: Vec<f64> = seen.filter(|(px, _)| is_inside(*px)).map(|(_, depth)| depth).collect();
        let middle = depths.len() / 2;
        if depths.is_empty() { 1.0 } else { *depths.select_nth_unstable_by(middle, f64::total_cmp).1 }
    }
}

/// Returns the camera of `view`, aligned to the scene in `engine`.
///
/// # Errors
/// Those of [`Engine::camera_gradient`].
pub fn align_camera(engine: &mut dyn Engine, view: &View, scene: &AlignmentScene) -> Result<Camera, EngineError> {
    let given = view.camera.clone();
    let mut view = View { target: scene.target(view), ..view.clone() };
    let angle = angle_of_pixel(&given);
    let shift = angle * scene.depth(&given);
    let units = [angle, angle, angle, shift, shift, shift];
    let (mut first, mut second) = ([0.0; 6], [0.0; 6]);
    let mut motion = CameraMotion::IDENTITY;
    let mut best = (f32::INFINITY, motion);
    for number in 1..=ALIGNMENT_STEPS {
        view.camera = motion.apply(&given);
        let report = engine.camera_gradient(&view, &step(scene))?;
        if report.loss < best.0 {
            best = (report.loss, motion);
        }
        let Some(gradient) = report.camera.filter(|gradient| gradient.is_finite() && report.loss.is_finite()) else { break };
        let rate = RATE_PX * decay(f64::from(number - 1) / f64::from(ALIGNMENT_STEPS));
        let adam = NumberAdam::new(BETAS, [number; 2], EPSILON);
        let moves: [f64; 6] = std::array::from_fn(|i| {
            let by_px = units[i] * if i < 3 { gradient.rotation[i] } else { gradient.translation[i - 3] };
            let moved = adam.update(&mut first[i], &mut second[i], by_px);
            -rate * units[i] * moved.mean / moved.deviation
        });
        let [rx, ry, rz, tx, ty, tz] = moves;
        motion = motion.then(DVec3::new(rx, ry, rz), DVec3::new(tx, ty, tz));
    }
    Ok(best.1.apply(&given))
}

/// Returns the step whose gradient is asked for; nothing is updated.
fn step(scene: &AlignmentScene) -> StepConfig {
    StepConfig {
        step: 1,
        render: scene.render,
        loss: scene.loss,
        learning_rates: LearningRates::ZERO,
        betas: AdamBetas::default(),
        position_noise: None,
        dropout: None,
        stats: StatsCollection::Off,
        camera_gradient: CameraGradientChoice::Compute,
    }
}
