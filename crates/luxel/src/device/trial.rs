//! The short measurement by which [`super::Device::Auto`] chooses between a GPU that shares the
//! processor's memory, or is of an unknown kind, and the processor itself.
//!
//! In: two engines without a scene. Out: the times of a training step of a small room on each, and
//! the choice. Degenerate: an engine that fails is not chosen.

use std::time::{Duration, Instant};

use luxel_core::engine::StepConfig;
use luxel_core::{Engine, RenderOptions, Splats, View, synthetic};

use crate::Result;
use crate::error::Context;

/// Splats and image of the room.
const SPLATS: usize = 20_000;
const SIZE_PX: [u32; 2] = [320, 240];
const SEED: u64 = 1;
/// Steps that are measured, behind one that is not: it compiles shaders and makes buffers.
const STEPS: u32 = 3;
/// Greatest part of the processor's time in which a GPU is taken. The measurement is short and the
/// room is small, so that a tie goes to the processor.
const CLEARLY_FASTER: f64 = 0.8;

/// Returns the time of the fastest of a few training steps. The engine has no scene afterwards.
pub(super) fn step_time(engine: &mut dyn Engine) -> Result<Duration> {
    let splats = synthetic::room(SPLATS, SEED);
    let camera = synthetic::room_camera(SIZE_PX);
    engine.load(&splats, None).context("cannot load the room")?;
    let render = RenderOptions::default();
    let image = engine.render(&camera, &render).context("cannot render the room")?;
    let view = View::of_radiance("room", camera, image);
    let mut fastest = Duration::MAX;
    for number in 0..=STEPS {
        let config = StepConfig::at_rest(number + 1, render);
        let start = Instant::now();
        engine.train_step(&view, &config).context("cannot make a training step")?;
        engine.finish().context("cannot finish a training step")?;
        if number > 0 {
            fastest = fastest.min(start.elapsed());
        }
    }
    engine.load(&Splats::empty(splats.color_model), None).context("cannot free the room")?;
    Ok(fastest)
}

/// Returns why the GPU is not taken, for display; `None` if it is clearly faster.
pub(super) fn reason_against(gpu: &Result<Duration>, processor: &Result<Duration>) -> Option<String> {
    let milliseconds = |time: &Duration| time.as_secs_f64() * 1e3;
    match (gpu, processor) {
        (Err(error), _) => Some(format!("failed a short measurement: {error:#}")),
        (Ok(_), Err(_)) => None,
        (Ok(gpu), Ok(processor)) => (milliseconds(gpu) > CLEARLY_FASTER * milliseconds(processor))
            .then(|| format!("a step of a small room takes it {:.1} ms, and the CPU {:.1} ms", milliseconds(gpu), milliseconds(processor))),
    }
}

#[cfg(test)]
mod tests {
    use luxel_cpu::CpuEngine;

    use super::*;
    use crate::Error;

    #[test]
    fn a_gpu_is_taken_only_if_it_is_clearly_faster_than_the_processor() {
        let time = |milliseconds: u64| Ok(Duration::from_millis(milliseconds));
        for (gpu, processor, taken) in [(1, 10, true), (8, 10, true), (9, 10, false), (10, 10, false), (70, 10, false)] {
            assert_eq!(reason_against(&time(gpu), &time(processor)).is_none(), taken, "{gpu} ms, {processor} ms");
        }
        let reason = reason_against(&time(70), &time(10)).unwrap();
        assert!(reason.contains("70.0 ms") && reason.contains("10.0 ms"), "{reason}");
        let failed = || Err(Error::new("it was lost".to_owned()));
        assert!(reason_against(&failed(), &time(10)).unwrap().contains("it was lost"));
        assert_eq!(reason_against(&time(10), &failed()), None);
    }

    #[test]
    fn the_measurement_leaves_an_engine_without_a_scene() {
        let mut engine = CpuEngine::new(1).unwrap();
        assert!(step_time(&mut engine).unwrap() > Duration::ZERO);
        assert_eq!(engine.len(), 0);
    }
}
