//! The part of a step that computes: one view, or a batch of views over the ranks of a run.
//!
//! In: the views of a step, one a slot. Out: the engine's scene, updated, and the report of each
//! slot, on every rank. A single view in a single process goes through
//! [`luxel_core::Engine::train_step`], which an engine may defer; a batch through gradients by
//! view, their sum ([`crate::reduce`]), and one update by their mean. Degenerate: a loss that is
//! not finite is an error of all ranks, before the update.

use std::ops::Range;
use std::time::Instant;

use luxel_core::engine::{AdamBetas, ParameterRows, SPLATS_PER_BLOCK, StepConfig};
use luxel_core::{Exchange, StepReport, View};
use luxel_metrics::{log_gain, log_gain_of_view};

use super::Trainer;
use super::vignetting::VignettedView;
use crate::TrainError;
use crate::camera_response::exposure_of;
use crate::config::{BatchRule, TrainConfig};
use crate::recorded::{curve, radiance_of};
use crate::reduce::{BlockShape, Slots, lost};
use crate::report_words;
use crate::state::State;
use crate::vignetting::Lenses;

/// A slot of a step, and the view in it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlotView {
    pub(crate) step: u32,
    pub(crate) slot: usize,
    /// Index of the training view.
    pub(crate) index: usize,
}

/// Returns the factor of learning rates, and the betas, for steps of `config.batch` views.
pub(super) fn rates_of_batch(config: &TrainConfig) -> (f32, AdamBetas) {
    let (views, one) = (config.batch as f32, AdamBetas::default());
    // As many views are forgotten in one step as in `batch` steps of one view.
    let powers = AdamBetas { first: one.first.powi(config.batch as i32), second: one.second.powi(config.batch as i32) };
    match config.batch_rule {
        _ if config.batch == 1 => (1.0, one),
        BatchRule::Keep => (1.0, one),
        BatchRule::Sqrt => (views.sqrt(), powers),
        BatchRule::Linear => (views, powers),
    }
}

/// Gives a view the response of the camera and the vignetting that the state has for it.
fn aim(view: &mut View, state: &State, lenses: Option<&Lenses>, seen: SeenAs) {
    let SeenAs { of: SlotView { step, index, .. }, gain, reduction } = seen;
    if let Some(response) = &state.response {
        view.target.curve = curve(view, &response.knots(), state.radiance_scale, gain).unwrap_or(view.target.curve);
    }
    view.target.vignetting =
        lenses.and_then(|lenses| state.vignetting_of(lenses, VignettedView { step, index, reduction, camera: &view.camera }));
}

/// How a step sees a view.
#[derive(Clone, Copy)]
struct SeenAs {
    of: SlotView,
    gain: [f32; 3],
    /// Factor by which its sides are reduced.
    reduction: u32,
}

impl Trainer {
    /// Returns the slots of a batch, and the ranks that compute them.
    pub(super) fn slots(&self) -> Slots {
        Slots { batch: self.state.config.batch as usize, ranks: self.exchange.ranks() }
    }

    /// Returns the slots that this rank computes.
    pub(super) fn own_slots(&self) -> Range<usize> {
        self.slots().of_rank(self.exchange.rank())
    }

    /// Trains on the views of a step, and returns the reports of all slots, in their order.
    pub(super) fn train_on(&mut self, views: &[SlotView], config: &StepConfig) -> Result<Vec<StepReport>, TrainError> {
        match views {
            [of] if self.method.is_some() => Ok(vec![self.train_by_method(*of, config)?]),
            [of] if self.exchange.ranks() == 1 => {
                self.ask_ahead(*of);
                let Self { engine, views, state, lenses, .. } = self;
                let view = view_of(views, state, lenses.as_ref(), *of)?;
                Ok(vec![engine.train_step(view, config)?])
            }
            _ => self.train_on_batch(views, config),
        }
    }

    fn train_on_batch(&mut self, views: &[SlotView], config: &StepConfig) -> Result<Vec<StepReport>, TrainError> {
        let (mut message, mut gradients) = (vec![u32::from(self.wants_to_stop)], Vec::new());
        for of in views.get(self.own_slots()).unwrap_or_default() {
            self.ask_ahead(*of);
            let Self { engine, views, state, lenses, .. } = self;
            let view = view_of(views, state, lenses.as_ref(), *of)?;
            let (report, of_view) = engine.view_gradients(view, config)?;
            report_words::write(&report, &mut message);
            gradients.push(of_view);
        }
        let (mut reports, slots) = (Vec::new(), self.slots());
        let mut asked_to_stop = false;
        for (rank, message) in self.exchange.all_gather(&message)?.iter().enumerate() {
            let (wish, mut message) = message.split_first().ok_or_else(|| lost("reports"))?;
            asked_to_stop |= *wish != 0;
            for _ in slots.of_rank(rank) {
                reports.push(report_words::read(&mut message).filter(|report| report.step == config.step).ok_or_else(|| lost("reports"))?);
            }
        }
        self.is_asked_to_stop = asked_to_stop;
        if let Some(slot) = reports.iter().position(|report| !report.loss.is_finite()) {
            let view = views.get(slot).map(|of| self.views.name(of.index).to_owned()).unwrap_or_default();
            return Err(TrainError::NotFinite { step: config.step, view });
        }
        let scene = BlockShape {
            rows: ParameterRows { color_model: self.state.config.color_model() },
            blocks: self.engine.len().div_ceil(SPLATS_PER_BLOCK) as u32,
        };
        let start = Instant::now();
        let mean = self.batch_mean.of(&mut *self.exchange, slots, &gradients, scene)?;
        tracing::trace!(step = config.step, seconds = start.elapsed().as_secs_f64(), blocks = mean.blocks().len(), "mean of the batch");
        gradients.into_iter().for_each(|gradients| self.engine.reuse_gradients(gradients));
        self.engine.apply_gradients(mean, config)?;
        Ok(reports)
    }

    /// Has the view of a slot read, and asks for the one that this rank computes after it.
    pub(super) fn ask_ahead(&mut self, of: SlotView) {
        let own = self.own_slots();
        let (step, slot) = if of.slot + 1 < own.end { (of.step, of.slot + 1) } else { (of.step.saturating_add(1), own.start) };
        let next = if step == of.step {
            self.step_views.get(slot).copied()
        } else {
            Some(self.state.upcoming_view(slot, &self.validation_in(of.step.saturating_add(1))))
        };
        let Self { views, state, .. } = self;
        // Looked at first, so that the reader works while the engine does. An error comes again.
        let _ = views.part_at(of.step, of.index, state.gain(of.index), state.crop(of.step, of.slot));
        if let Some(next) = next {
            views.ask(step, next, state.crop(step, slot));
        }
    }

    /// Updates the gains of a step's views, unless that is not due or opacities are still
    /// recovering from a reset.
    pub(super) fn measure_gains(&mut self, views: &[SlotView]) -> Result<(), TrainError> {
        let Some(step) = views.first().map(|of| of.step).filter(|step| !self.schedule.is_recovering(*step)) else { return Ok(()) };
        let views_before = (step - 1).saturating_mul(self.state.config.batch);
        if !self.state.gains.as_ref().is_some_and(|gains| gains.measures_after(views_before.saturating_add(1))) {
            return Ok(());
        }
        let mut message = Vec::new();
        for of in views.get(self.own_slots()).unwrap_or_default() {
            let found = self.measure_gain(*of)?;
            message.push(u32::from(found.is_some()));
            message.extend(found.unwrap_or_default().map(f32::to_bits));
        }
        let mut found = Vec::new();
        for message in self.exchange.all_gather(&message)?.iter() {
            found.extend_from_slice(message.as_chunks::<4>().0);
        }
        for (of, [is_there, log_ratio @ ..]) in views.iter().zip(found) {
            if let (Some(gains), 1) = (&mut self.state.gains, is_there) {
                gains.shift(of.index, log_ratio.map(f32::from_bits));
            }
        }
        Ok(())
    }

    /// Returns ln of the ratio by which the gain of a view is off.
    fn measure_gain(&mut self, of: SlotView) -> Result<Option<[f32; 3]>, TrainError> {
        let SlotView { step, slot, index } = of;
        let Some(channels) = self.state.config.exposure_compensation.gain_channels() else { return Ok(None) };
        let (options, gain, crop) = (self.render_options_of(step), self.state.gain(index), self.state.crop(step, slot));
        let reduction = self.views.factor(step);
        let Some(view) = self.views.part_at(step, index, gain, crop)? else { return Ok(None) };
        let mut render = self.engine.render(&view.camera, &options)?;
        let seen = VignettedView { step, index, reduction, camera: &view.camera };
        if let Some(vignetting) = self.lenses.as_ref().and_then(|lenses| self.state.vignetting_of(lenses, seen)) {
            vignetting.apply(&mut render);
        }
        Ok(match (&self.state.response, exposure_of(view)) {
            (Some(response), Some(exposure_s)) => {
                let knots = response.knots();
                let exposure = self.state.radiance_scale.exposure(1.0, gain);
                let radiance = |i: usize, c: usize| {
                    let value = view.image.pixels.get(i).filter(|_| view.is_valid(i))?[c];
                    Some(radiance_of(value, c, &knots, exposure_s)? / exposure[c])
                };
                log_gain(&render, radiance, channels)
            }
            _ => log_gain_of_view(&render, view, view.target.scale, channels),
        })
    }

    /// Connects the trainer with the ranks of a distributed run, all of which hold the same state.
    /// Their sums have the same bits for any number of ranks.
    #[must_use]
    pub fn with_exchange(mut self, exchange: Box<dyn Exchange>) -> Self {
        self.exchange = exchange;
        self
    }

    /// Returns the connection to the other ranks.
    pub fn exchange(&mut self) -> &mut dyn Exchange {
        &mut *self.exchange
    }

    /// Tells the other ranks at the next step whether this one is to stop.
    pub fn announce_stop(&mut self, wants_to_stop: bool) {
        self.wants_to_stop = wants_to_stop;
    }

    /// Returns whether all ranks are to stop after the last step, because one of them announced it:
    /// the same on every rank. A process that trains alone stops when it announces it.
    pub fn is_asked_to_stop(&self) -> bool {
        if self.exchange.ranks() == 1 { self.wants_to_stop } else { self.is_asked_to_stop }
    }
}

/// Returns the view of a slot as its step sees it.
pub(crate) fn view_of<'a>(
    views: &'a mut crate::views::TrainingViews,
    state: &State,
    lenses: Option<&Lenses>,
    of: SlotView,
) -> Result<&'a View, TrainError> {
    let (gain, reduction) = (state.gain(of.index), views.factor(of.step));
    let view = views.part_at(of.step, of.index, gain, state.crop(of.step, of.slot))?.ok_or(TrainError::NoTrainViews)?;
    aim(view, state, lenses, SeenAs { of, gain, reduction });
    Ok(view)
}

#[cfg(test)]
mod tests;
