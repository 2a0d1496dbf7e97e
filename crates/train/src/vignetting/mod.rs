//! Vignetting of the training images' lenses, learned with the scene.
//!
//! In: the gradient of a step's loss by the coefficients of ln gain
//! ([`luxel_core::StepReport::by_vignetting`]). Out: the [`Vignetting`] of each view for the next
//! steps. Views with the same lens share one; all channels do. The scene is without vignetting:
//! the loss multiplies its render by the gain.
//!
//! Gauge: a scene twice as bright with gains half as large explains the images equally well. The
//! mean of ln gain over the frame is therefore 0 ([`Frame`]), whatever is learned, so that
//! vignetting moves neither the exposure of an image nor the brightness of the scene. What remains,
//! the images determine where they overlap: a place that one shows in its middle and another near
//! its corner.
//!
//! ln gain is a sum of three functions of r^2 that are orthonormal over the frame. Adam moves their
//! weights, each by at most about the rate: ln gain, root mean square over the frame. The rate
//! falls log-linearly. Vignetting is fixed at 1 while the scene forms ([`WARM_UP`]), and stays as
//! it is while opacities recover from a reset.

mod frame;

use luxel_core::engine::{ADAM_BETA1, ADAM_BETA2, NumberAdam};
use luxel_core::{Camera, CameraProjection, Dataset, VIGNETTING_TERMS, View, Vignetting};
use serde::{Deserialize, Serialize};

pub(crate) use self::frame::Frame;
use self::frame::{TERMS, Terms};
use crate::lenses::groups_by_lens;
use crate::{TrainConfig, TrainError};

/// Fraction of the steps in which there is no vignetting.
const WARM_UP: f64 = 0.1;
/// Rates at the start and at the end of the steps.
const RATES: [f64; 2] = [5e-3, 1e-4];
/// Epsilon of Adam, far below typical gradients.
const EPSILON: f64 = 1e-12;
/// Largest weight of a function: ln gain, root mean square, far beyond any lens.
const MAX_WEIGHT: f64 = 2.0;

/// The vignetting of all lenses and the state of the optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Vignettings {
    lenses: Vec<LensState>,
}

/// The weights of a lens's functions, and their moments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LensState {
    weights: Terms,
    first: Terms,
    second: Terms,
    /// Number of updates.
    updates: u32,
}

/// The lenses of the training views.
pub(crate) struct Lenses {
    /// Camera of the first view of each lens, at full resolution, as the data set has it.
    cameras: Vec<Camera>,
    frames: Vec<Frame>,
    /// The lens of each view.
    by_view: Vec<usize>,
}

/// The vignetting of a lens that training found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LensVignetting {
    /// Size of the lens's images, pixels.
    pub size_px: [u32; 2],
    /// Its focal lengths in the data set, pixels.
    pub focal_px: [f64; 2],
    /// Its axis: the principal point, pixels.
    pub axis_px: [f64; 2],
    /// Number of training views.
    pub views: usize,
    /// Distance from the axis at which r is 1, pixels: the corner farthest from the axis, or the
    /// edge of a fisheye's field if that is nearer.
    pub unit_px: f64,
    /// Coefficients of 1, r^2, r^4 and r^6 in ln gain; its mean over the frame is 0.
    pub log_gain: [f64; VIGNETTING_TERMS],
    /// Gain at r = 1 relative to that on the axis, stops; negative where corners are darker.
    pub corner_ev: f64,
}

impl LensVignetting {
    /// Returns the vignetting of an image that `camera` made with the lens, at full resolution or
    /// reduced by a whole factor, or `None` for another lens.
    pub fn of_camera(&self, camera: &Camera) -> Option<Vignetting> {
        /// Largest relative difference of focal lengths and of places in the frame.
        const TOLERANCE: f64 = 1e-4;
        let ratio = f64::from(camera.size_px[0]) / f64::from(self.size_px[0].max(1));
        // A run may have been trained on smaller images than those it is compared with.
        let scale = if ratio < 1.0 { ratio.recip().round().recip() } else { ratio.round() };
        let is_near = |found: f64, full: f64, unit: f64| (found - scale * full).abs() <= TOLERANCE * scale * unit;
        let is_same = (0..2).all(|i| {
            let [size, full_size] = [camera.size_px[i], self.size_px[i]].map(f64::from);
            // Reduced sides are rounded down.
            (size - scale * full_size).abs() <= scale.max(1.0)
                && is_near(camera.center_px[i], self.axis_px[i], full_size)
                && is_near(camera.focal_px[i], self.focal_px[i], self.focal_px[i])
        });
        let can_have = camera.projection != CameraProjection::Equirectangular;
        (is_same && can_have).then(|| Vignetting {
            axis_px: camera.center_px.to_array().map(|v| v as f32),
            unit_px: (self.unit_px * scale) as f32,
            log_gain: self.log_gain.map(|c| c as f32),
        })
    }

    /// Gives views the vignetting of their lenses, where it is known, by the cameras that the data
    /// set `given` has for them.
    pub fn show_in<'a>(lenses: &[Self], given: &[View], views: impl IntoIterator<Item = &'a mut View>) {
        for (given, view) in given.iter().zip(views) {
            view.target.vignetting = lenses.iter().find_map(|lens| lens.of_camera(&given.camera));
        }
    }
}

impl Lenses {
    /// Returns the lenses of a data set's training views.
    pub(crate) fn new(dataset: &Dataset) -> Self {
        let given: Vec<Camera> = dataset.train.iter().map(|view| view.camera.clone()).collect();
        let by_view = groups_by_lens(&given);
        let count = by_view.iter().max().map_or(0, |last| last + 1);
        let first = |lens: usize| by_view.iter().position(|of_view| *of_view == lens).and_then(|view| given.get(view)).cloned();
        let cameras: Vec<Camera> = (0..count).filter_map(first).collect();
        let frames = cameras.iter().map(Frame::new).collect();
        Self { cameras, frames, by_view }
    }

    /// Returns the frame of a view's lens and its state among `states`.
    fn of_view<'a>(&'a self, states: &'a Vignettings, view: usize) -> Option<(&'a Frame, &'a LensState)> {
        let lens = *self.by_view.get(view)?;
        Some((self.frames.get(lens)?, states.lenses.get(lens)?))
    }
}

impl Vignettings {
    /// Returns no vignetting for `lenses`.
    pub(crate) fn none(lenses: &Lenses) -> Self {
        Self { lenses: vec![LensState::default(); lenses.frames.len()] }
    }

    /// Returns the vignetting of view `index` as seen by `camera`, which shows it reduced
    /// `reduction` times, or a part of that; `None` while there is none yet. `progress` is the
    /// fraction of the run's steps that are done.
    pub(crate) fn of_view(&self, lenses: &Lenses, index: usize, camera: &Camera, reduction: u32, progress: f64) -> Option<Vignetting> {
        let (frame, state) = lenses.of_view(self, index)?;
        (progress >= WARM_UP).then(|| Vignetting {
            axis_px: camera.center_px.to_array().map(|v| v as f32),
            unit_px: (frame.unit_px / f64::from(reduction.max(1))) as f32,
            log_gain: frame.log_gain(&state.weights).map(|c| c as f32),
        })
    }

    /// Changes the vignetting of view `index` by the gradient of a step. A gradient that is not
    /// finite changes nothing.
    pub(crate) fn update(&mut self, lenses: &Lenses, index: usize, by_log_gain: &[f32; VIGNETTING_TERMS], progress: f64) {
        let Some(lens) = lenses.by_view.get(index) else { return };
        let (Some(frame), Some(state)) = (lenses.frames.get(*lens), self.lenses.get_mut(*lens)) else { return };
        if by_log_gain.iter().any(|by| !by.is_finite()) {
            return;
        }
        state.updates = state.updates.saturating_add(1);
        let rate = RATES[0] * (RATES[1] / RATES[0]).powf(progress.clamp(0.0, 1.0));
        let adam = NumberAdam::new([ADAM_BETA1, ADAM_BETA2].map(f64::from), [state.updates; 2], EPSILON);
        for (k, by) in frame.gradient(by_log_gain).into_iter().enumerate() {
            let moved = adam.update(&mut state.first[k], &mut state.second[k], by);
            state.weights[k] = (state.weights[k] - rate * moved.at_rate_1()).clamp(-MAX_WEIGHT, MAX_WEIGHT);
        }
    }

    /// Returns what was found of each lens.
    pub(crate) fn report(&self, lenses: &Lenses) -> Vec<LensVignetting> {
        let found = lenses.cameras.iter().zip(&lenses.frames).zip(&self.lenses).enumerate();
        let report = |(lens, ((camera, frame), state)): (usize, ((&Camera, &Frame), &LensState))| {
            let log_gain = frame.log_gain(&state.weights);
            LensVignetting {
                size_px: camera.size_px,
                focal_px: camera.focal_px.to_array(),
                axis_px: camera.center_px.to_array(),
                views: lenses.by_view.iter().filter(|of_view| **of_view == lens).count(),
                unit_px: frame.unit_px,
                log_gain,
                corner_ev: log_gain[1..].iter().sum::<f64>() / std::f64::consts::LN_2,
            }
        };
        found.map(report).collect()
    }

    /// Checks vignetting from a file.
    pub(crate) fn validate(&self, lenses: &Lenses) -> Result<(), TrainError> {
        let (found, expected) = (self.lenses.len(), lenses.frames.len());
        if found != expected {
            return Err(TrainError::State(format!("vignetting of {found} lenses, the data set has {expected}")));
        }
        let numbers = self.lenses.iter().flat_map(|lens| [lens.weights, lens.first, lens.second].concat());
        match numbers.into_iter().find(|number| !number.is_finite()) {
            Some(number) => Err(TrainError::State(format!("a number of the vignetting is {number}, expected a finite one"))),
            None => Ok(()),
        }
    }
}

/// Checks that the training views have lenses, if their vignetting is to be learned: panoramas have
/// none.
pub(crate) fn check_lenses(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
    let is_panorama = |view: &&View| view.camera.projection == CameraProjection::Equirectangular;
    match dataset.train.iter().find(is_panorama).filter(|_| config.vignetting) {
        Some(view) => {
            let reason = format!(
                "view {} is a panorama, expected images of one lens each, whose vignetting is learned; leave the option out",
                view.name
            );
            Err(TrainError::config("vignetting", reason))
        }
        None => Ok(()),
    }
}

/// Number of functions, one for each power of r^2 above 0.
const _: () = assert!(TERMS + 1 == VIGNETTING_TERMS);

#[cfg(test)]
mod tests;
