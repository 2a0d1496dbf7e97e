//! The number of splats that there is room for, how many of them rounds relocate and steps leave
//! out, and the rates of steps on strips, all of which follow the scene.
//!
//! In: the scene while splats are added, the validation views ([`crate::validation_views`]). Out:
//! the largest number of splats of a round, and three factors. The number begins at the limit of
//! the configuration. When the scene fills it, it rises while the validation views are nearly as
//! good as their neighbours that are trained on: there is detail that more splats represent for
//! every view. Where they lag behind, more splats only overfit, and relocated splats do, too, so
//! fewer are relocated. Where they lag far behind, single splats explain single views: once no more
//! are added, a larger share is left out, and steps on strips have lower rates; where they keep up,
//! a smaller share is left out. Degenerate: a limit that the user gives stays as it is. Before a
//! lead is known, fewer are relocated; without validation views, the configuration's share is. In
//! both cases dropout is that of the configuration, and rates on strips are lower, too.

use luxel_core::Image;
use luxel_metrics::psnr_scene;

use super::Trainer;
use crate::TrainError;
use crate::validation_views::{Fit, ValidationView};

/// Largest lead of views that are trained on over validation views at which the limit rises, dB.
const MOST_LEAD_DB: f64 = 2.0;

/// Validation views that a round looks at, in turn: one alone may be harder than the others.
const VIEWS_A_ROUND: usize = 2;

/// Fraction of the limit by which a round raises it: splats that come late have few steps.
const RISE: f64 = 0.25;

/// Fraction of the limit from which the scene counts as having filled it.
const FULL: f64 = 0.97;

/// Weight of the latest round in the mean of the leads.
const LATEST: f64 = 0.2;

/// Lead at which dropout is that of the configuration, dB.
const DROPOUT_LEAD_DB: f64 = 4.0;

/// Smallest and largest factor of dropout.
const DROPOUT_FACTORS: [f64; 2] = [0.5, 2.0];

/// Factor of the rates of steps on strips where the lead is largest, or unknown.
const LEAST_STRIP_RATE: f32 = 1.0 / DROPOUT_FACTORS[1] as f32;

/// Smallest factor of relocation.
const LEAST_RELOCATION: f64 = 0.25;

impl Fit {
    /// Returns the fit after a round that found `lead_db`, with a scene of `splats` and a limit of
    /// at most `most`.
    fn after(self, lead_db: f64, splats: usize, most: usize) -> Self {
        let lead_db = self.lead_db + LATEST * (lead_db - self.lead_db);
        let rises = splats as f64 >= FULL * f64::from(self.room) && lead_db < MOST_LEAD_DB;
        let raised = if rises { f64::from(self.room) * (1.0 + RISE) } else { 0.0 };
        Self { room: self.room.max((raised as u32).min(u32::try_from(most).unwrap_or(u32::MAX))), lead_db }
    }

    /// Returns the factor of dropout.
    fn dropout_factor(self) -> f32 {
        let [least, most] = DROPOUT_FACTORS;
        (self.lead_db / DROPOUT_LEAD_DB).clamp(least, most) as f32
    }

    /// Returns the factor of the rates of steps on strips.
    fn strip_rate_factor(self) -> f32 {
        1.0 / self.dropout_factor().max(1.0)
    }

    /// Returns the factor of the share of the splats that a round relocates.
    fn relocation_factor(self) -> f32 {
        (MOST_LEAD_DB / self.lead_db.max(MOST_LEAD_DB)).max(LEAST_RELOCATION) as f32
    }
}

impl Trainer {
    /// Returns the indices of the views that `step` does not train on.
    pub(super) fn validation_in(&self, step: u32) -> Vec<usize> {
        let is_adding = self.schedule.is_densifying(step);
        self.validation.iter().filter(|_| is_adding).map(|view| view.index).collect()
    }

    /// Returns the share of the splats that `step` leaves out, if any.
    pub(super) fn dropout_rate(&self, step: u32) -> Option<f32> {
        let rate = self.schedule.dropout_rate(&self.state.config, step)?;
        let factor = self.state.fit.filter(|_| !self.schedule.is_densifying(step)).map_or(1.0, Fit::dropout_factor);
        Some((rate * factor).min(MOST_LEFT_OUT.max(rate)))
    }

    /// Returns the factor of the learning rates of `step`. On a strip, half of the splats have no
    /// gradient and the others twice that of a whole view. Scenes whose views are explained by
    /// single splats do not bear that at the rates of whole views; neither may scenes of which
    /// nothing is known.
    pub(super) fn rate_factor(&self, step: u32) -> f32 {
        match self.schedule.takes_strips(step) {
            true => self.state.fit.map_or(LEAST_STRIP_RATE, Fit::strip_rate_factor),
            false => 1.0,
        }
    }

    /// Returns the share of the largest number of splats that a round may relocate. Reduced images,
    /// on which no lead is known, are soon explained by single splats.
    pub(super) fn turnover(&self) -> f32 {
        let config = &self.state.config;
        match self.state.fit {
            Some(fit) => config.turnover * fit.relocation_factor(),
            None if self.validation.is_empty() => config.turnover,
            None => config.turnover * LEAST_RELOCATION as f32,
        }
    }

    /// Returns the largest number of splats of the round after `step`.
    pub(super) fn room(&mut self, step: u32) -> Result<usize, TrainError> {
        let train_px = self.views.train_px();
        let (limit, most) = (self.state.config.splat_limit(train_px), self.state.config.most_splats(train_px));
        let room = self.state.fit.map_or(limit, |fit| fit.room as usize);
        let round = (step / self.schedule.densify_interval.max(1)) as usize;
        let in_turn = self.validation.iter().cycle().skip(VIEWS_A_ROUND * round % self.validation.len().max(1));
        let views: Vec<ValidationView> = in_turn.take(VIEWS_A_ROUND.min(self.validation.len())).cloned().collect();
        // Reduced images have few pixels for the splats there are, so views lag behind that do not
        // later.
        if views.is_empty() || self.schedule.is_recovering(step) || self.views.factor(step) > 1 {
            return Ok(room);
        }
        let Some(lead_db) = self.shared_lead_db(step, &views)? else { return Ok(room) };
        let before = self.state.fit.unwrap_or(Fit { room: u32::try_from(limit).unwrap_or(u32::MAX), lead_db });
        let after = before.after(lead_db, self.engine.len(), most);
        tracing::debug!(step, lead_db, mean_lead_db = after.lead_db, room = after.room, "validation views");
        self.state.fit = Some(after);
        Ok(after.room as usize)
    }

    /// Returns the lead that the rank finds which has the images of all views, as only the rank of
    /// the one slot does: on every rank the same.
    fn shared_lead_db(&mut self, step: u32, views: &[ValidationView]) -> Result<Option<f64>, TrainError> {
        let mut leads = Vec::new();
        let has_images = self.own_slots().contains(&0);
        for view in views.iter().filter(|_| has_images) {
            leads.extend(self.lead_db(step, view)?);
        }
        let found = (!leads.is_empty()).then(|| leads.iter().sum::<f64>() / leads.len() as f64);
        let message = found.map(|lead_db| [lead_db.to_bits() as u32, (lead_db.to_bits() >> 32) as u32]);
        let messages = self.exchange.all_gather(message.as_ref().map_or(&[], |words| &words[..]))?;
        let lead = |words: &[u32]| match *words {
            [low, high] => Some(f64::from_bits(u64::from(high) << 32 | u64::from(low))),
            _ => None,
        };
        Ok(messages.iter().find_map(lead))
    }

    /// Returns by how many decibels the neighbours of a validation view are better than it.
    fn lead_db(&mut self, step: u32, view: &ValidationView) -> Result<Option<f64>, TrainError> {
        let Some(of_validation) = self.psnr_of(step, view.index)? else { return Ok(None) };
        let mut of_trained = Vec::new();
        for neighbour in &view.neighbours {
            of_trained.extend(self.psnr_of(step, *neighbour)?);
        }
        let mean = of_trained.iter().sum::<f64>() / of_trained.len() as f64;
        Ok((!of_trained.is_empty()).then_some(mean - of_validation))
    }

    /// Returns the PSNR of a view under the mu-law, dB; `None` if it has no valid pixel or no
    /// error.
    fn psnr_of(&mut self, step: u32, index: usize) -> Result<Option<f64>, TrainError> {
        let (options, mu) = (self.render_options_of(step), self.state.config.mu);
        let Some(view) = self.views.at(step, index, [1.0; 3])? else { return Ok(None) };
        let render = self.engine.render(&view.camera, &options)?;
        let scale = view.target.scale;
        let normalised = |pixel: &[f32; 3]| std::array::from_fn(|c| pixel[c] * scale[c]);
        let pixels = view.image.pixels.iter().map(normalised).collect();
        let target = Image { width: view.image.width, height: view.image.height, pixels };
        Ok(psnr_scene(&render, &target, view.mask.as_deref(), mu).ok().filter(|psnr| psnr.is_finite()))
    }
}

/// Largest share of the splats that a factor of dropout may lead to.
const MOST_LEFT_OUT: f32 = 0.5;

#[cfg(test)]
mod tests {
    use luxel_core::{Dataset, Image, Point};
    use luxel_cpu::CpuEngine;

    use super::*;
    use crate::TrainConfig;
    use crate::testing::{camera_at, dataset_of, view_of};

    #[test]
    fn the_limit_rises_while_validation_views_keep_up_and_the_scene_fills_it() {
        let fit = Fit { room: 1000, lead_db: 0.2 };
        assert_eq!(fit.after(0.2, 1000, 4000), Fit { room: 1250, lead_db: 0.2 });
        assert_eq!(fit.after(0.2, 900, 4000).room, 1000, "not filled");
        assert_eq!(fit.after(0.2, 1000, 1050).room, 1050, "at most");
        assert_eq!(fit.after(0.2, 1000, 1000).room, 1000, "a limit that the user gave");
        let behind = fit.after(10.2, 1000, 4000);
        assert_eq!(behind, Fit { room: 1000, lead_db: 2.2 });
        assert_eq!(behind.after(2.2, 1000, 4000).room, 1000);
    }

    #[test]
    fn dropout_grows_with_the_lead_from_half_to_twice() {
        let factor = |lead_db| Fit { room: 1, lead_db }.dropout_factor();
        assert_eq!([-1.0, 1.0, 2.0, 4.0, 6.0, 8.0, 20.0].map(factor), [0.5, 0.5, 0.5, 1.0, 1.5, 2.0, 2.0]);
    }

    #[test]
    fn fewer_splats_are_relocated_the_larger_the_lead() {
        let factor = |lead_db| Fit { room: 1, lead_db }.relocation_factor();
        assert_eq!([-1.0, 1.0, 2.0, 4.0, 8.0, 20.0].map(factor), [1.0, 1.0, 1.0, 0.5, 0.25, 0.25]);
    }

    #[test]
    fn rates_fall_on_strips_with_the_lead_and_where_it_is_unknown() {
        let mut trainer = trainer(true);
        let mut factors = |fit| {
            trainer.state.fit = fit;
            [200, 201].map(|step| trainer.rate_factor(step))
        };
        assert_eq!(factors(Some(Fit { room: 1, lead_db: 1.0 })), [1.0, 1.0]);
        assert_eq!(factors(Some(Fit { room: 1, lead_db: 8.0 })), [1.0, 0.5]);
        assert_eq!(factors(None), [1.0, 0.5]);
    }

    /// Cameras along a line before a wall of points, whose views agree or have each a grey of its
    /// own, which no scene explains.
    fn wall(agree: bool) -> Dataset {
        let points = (0..100).map(|i| Point {
            position: [0.1 * (i % 10) as f32 - 0.5, 0.1 * (i / 10) as f32 - 0.5, 4.0],
            rgb8: Some([128; 3]),
            observations: Vec::new(),
        });
        let grey = |i: usize| if agree { 0.5 } else { 0.1 + 0.9 * ((i * 7) % 13) as f32 / 13.0 };
        let view =
            |i: usize| view_of(&format!("{i:02}"), camera_at([0.02 * i as f64, 0.0, 0.0], [24, 24]), Image::filled(24, 24, [grey(i); 3]));
        let mut dataset = dataset_of((0..14).map(view).collect());
        dataset.points = points.collect();
        dataset
    }

    fn trainer(agree: bool) -> Trainer {
        let config = TrainConfig { iterations: 400, densify_from: Some(20), densify_interval: Some(20), ..TrainConfig::default() };
        Trainer::new(&wall(agree), config, Box::new(CpuEngine::new(1).unwrap())).unwrap()
    }

    #[test]
    fn views_that_disagree_lag_behind_and_all_are_trained_on_at_the_end() {
        let leads = [true, false].map(|agree| {
            let mut trainer = trainer(agree);
            let [ValidationView { index, .. }] = trainer.validation[..] else { panic!("{:?}", trainer.validation) };
            let mut trained = [false; 2];
            for step in 1..=400 {
                trainer.step().unwrap();
                trained[usize::from(step >= 200)] |= trainer.step_views == [index];
            }
            assert_eq!(trained, [false, true]);
            trainer.state.fit.unwrap().lead_db
        });
        assert!(leads[0] < 0.2 && leads[1] > 0.5, "{leads:?}");
    }

    #[test]
    fn a_resumed_run_goes_on_with_what_the_validation_views_showed() {
        let mut first = trainer(false);
        for _ in 0..110 {
            first.step().unwrap();
        }
        let mut resumed = Trainer::resume(&wall(false), first.snapshot().unwrap(), Box::new(CpuEngine::new(1).unwrap())).unwrap();
        for trainer in [&mut first, &mut resumed] {
            for _ in 0..50 {
                trainer.step().unwrap();
            }
        }
        assert!(first.state.fit.is_some() && first.state == resumed.state);
    }

    #[test]
    fn a_state_whose_option_had_another_name_is_read() {
        let mut snapshot = trainer(true).snapshot().unwrap();
        let old = snapshot.state_json.replace("\"validation_share\"", "\"hold_out\"");
        assert_ne!(old, snapshot.state_json);
        snapshot.state_json = old;
        let resumed = Trainer::resume(&wall(true), snapshot, Box::new(CpuEngine::new(1).unwrap())).unwrap();
        assert_eq!(resumed.state.config.validation_share, 0.1);
    }
}
