//! Times of rendering and of training steps, pass by pass. Renders and steps are measured in turn,
//! so that noise of the machine affects both alike.

use std::time::{Duration, Instant};

use luxel_core::engine::{Evaluations, StepConfig};
use luxel_core::{Engine, Image, Pass, RenderOptions, StepReport, Target, ToneCurve, View};

use luxel::Result;
use luxel::error::Context;

/// Settings of the measurement.
#[derive(Clone, Copy, Debug)]
pub struct Protocol {
    /// Settings of rendering.
    pub render: RenderOptions,
    /// mu of the loss.
    pub mu: f32,
    /// Renders and steps before the measured ones.
    pub warmup: u32,
    /// Renders and steps measured.
    pub steps: u32,
}

impl Protocol {
    /// Returns the view with the loss that is measured.
    pub fn view(&self, view: &View) -> View {
        View { target: Target { curve: ToneCurve::MuLaw { mu: self.mu }, ..Target::default() }, ..view.clone() }
    }

    /// Returns the settings of a training step.
    pub fn step(&self, step: u32) -> StepConfig {
        StepConfig::at_rest(step, self.render)
    }
}

/// Times in milliseconds, one entry per step.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Report of the first step.
    pub first: StepReport,
    /// Counts of blending, if the engine counts.
    pub evaluations: Option<Evaluations>,
    /// Renders.
    pub forward_ms: Vec<f64>,
    /// Whole steps.
    pub step_ms: Vec<f64>,
    /// Mean of steps without waiting in between, as training makes them.
    pub step_in_a_row_ms: f64,
    /// The passes of those steps that the engine measures, in their order.
    pub passes_ms: Vec<(Pass, Vec<f64>)>,
}

/// Measures the scene that the engine holds.
///
/// # Errors
/// A camera that cannot be rendered; a device that gave up.
pub fn measure(engine: &mut dyn Engine, view: &View, protocol: &Protocol) -> Result<Measured> {
    let view = &protocol.view(view);
    let evaluations = engine.evaluations(&view.camera, &protocol.render).context("cannot render")?;
    let mut first = None;
    let mut image = Image::default();
    let mut forward_ms = Vec::new();
    let mut step_ms = Vec::new();
    let mut passes_ms: Vec<(Pass, Vec<f64>)> = Pass::ALL.map(|pass| (pass, Vec::new())).into();
    for round in 0..protocol.warmup.saturating_add(protocol.steps) {
        let start = Instant::now();
        engine.render_into(&view.camera, &protocol.render, &mut image).context("cannot render")?;
        let forward = start.elapsed();
        let before = engine.timings().to_vec();
        let start = Instant::now();
        let report = engine.train_step(view, &protocol.step(round + 1)).context("cannot make a training step")?;
        engine.finish().context("cannot finish a training step")?;
        let whole = start.elapsed();
        first.get_or_insert(report);
        if round < protocol.warmup {
            continue;
        }
        forward_ms.push(milliseconds(forward));
        step_ms.push(milliseconds(whole));
        for (((_, times), after), before) in passes_ms.iter_mut().zip(engine.timings()).zip(&before) {
            times.push(milliseconds(after.time.saturating_sub(before.time)));
        }
    }
    let step_in_a_row_ms = in_a_row(engine, view, protocol)?;
    // Passes that the engine counts within others, and those that are no part of a step.
    passes_ms.retain(|(_, times)| times.iter().any(|ms| *ms > 0.0));
    Ok(Measured { first: first.unwrap_or_default(), evaluations, forward_ms, step_ms, step_in_a_row_ms, passes_ms })
}

/// Returns the milliseconds of a step over as many as were measured one by one.
fn in_a_row(engine: &mut dyn Engine, view: &View, protocol: &Protocol) -> Result<f64> {
    let start = Instant::now();
    let first = protocol.warmup.saturating_add(protocol.steps).saturating_add(1);
    for round in 0..protocol.steps {
        engine.train_step(view, &protocol.step(first.saturating_add(round))).context("cannot make a training step")?;
    }
    engine.finish().context("cannot finish a training step")?;
    Ok(milliseconds(start.elapsed()) / f64::from(protocol.steps.max(1)))
}

fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
