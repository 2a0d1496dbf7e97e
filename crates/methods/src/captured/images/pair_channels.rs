//! A step on a pair of images, as HDR-GS and Mono-HDR-GS make it: captured values and radiance,
//! blended with the same weights over black.
//!
//! In: splats whose colour model gives one of the two, a [`ColorMap`] that gives the other, a view
//! of radiance with a captured image. Out: channels, the loss, and gradients by the colours, the
//! map's numbers and those of the network of pixels. The loss is `ldr_weight` times that of the
//! captured image, `hdr_weight` times that of radiance under the mu-law, and, with a network of
//! pixels, `cycle_weight` times that of the captured values that it makes of the rendered radiance
//! under the mu-law. Captured values come first, so that their gradients alone decide where splats
//! are added, as published; those of radiance do, if captured values have no weight. An image
//! without weight is not rendered.

use luxel_core::engine::{ChannelLoss, ChannelRoles, ChannelSource, ChannelStep, MeasuredChannels, SeenSplats};
use luxel_core::{LossWeights, View};
use luxel_train::TrainConfig;
use rayon::prelude::*;

use super::image_loss::{Compared, ComparedOut, Comparison, compare};
use super::radiance_loss::{RadianceCurve, planes_of};
use crate::captured::arithmetic::color_map::{ColorMap, MappedColors, SplatRows, mapped, mapped_backward};
use crate::captured::mono_hdr_gs::cycle::{Cycle, CycleGradient};
use crate::networks::relu_line::LineSums;

/// Splats of a chunk of work.
const CHUNK: usize = 2048;

/// The images of a step, and how they are compared.
#[derive(Clone, Copy)]
pub(crate) struct PairTargets<'a> {
    /// Radiance, with its target.
    pub(crate) view: &'a View,
    /// The captured image.
    pub(crate) recording: &'a View,
    pub(crate) config: &'a TrainConfig,
    pub(crate) loss: LossWeights,
}

/// The colours that the map of a method gives.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mapped {
    /// Captured values, of splats that are radiance.
    Captured,
    /// Radiance, of splats that are captured values.
    Radiance,
}

/// A step on a pair of images.
pub(crate) struct PairChannels<'a, M> {
    targets: PairTargets<'a>,
    map: M,
    mapped: Mapped,
    cycle: Option<&'a Cycle>,
    kept: Option<MappedColors>,
    /// Sums of the gradient by the map's numbers, if its image has any weight.
    sums: Option<[LineSums; 3]>,
    cycle_gradient: Option<CycleGradient>,
}

/// The gradients by the shared numbers of a step.
pub(crate) struct PairGradients<M> {
    /// The map, with the sums by its numbers if its image has any weight.
    pub(crate) map: M,
    pub(crate) sums: Option<[LineSums; 3]>,
    /// The gradient by the network of pixels, if its image has any weight.
    pub(crate) cycle: Option<CycleGradient>,
}

impl<'a, M: ColorMap> PairChannels<'a, M> {
    pub(crate) fn new(targets: PairTargets<'a>, map: M, mapped: Mapped, cycle: Option<&'a Cycle>) -> Self {
        let cycle = cycle.filter(|_| targets.config.cycle_weight > 0.0);
        Self { targets, map, mapped, cycle, kept: None, sums: None, cycle_gradient: None }
    }

    fn has_captured(&self) -> bool {
        self.targets.config.ldr_weight > 0.0
    }

    fn has_radiance(&self) -> bool {
        self.targets.config.hdr_weight > 0.0 || self.cycle.is_some()
    }

    /// Returns the first channel of the map's image, and that of the other; `None` for an image
    /// that is not rendered.
    fn channels(&self) -> [Option<usize>; 2] {
        let captured = self.has_captured().then_some(0);
        let radiance = self.has_radiance().then_some(if self.has_captured() { 3 } else { 0 });
        match self.mapped {
            Mapped::Captured => [captured, radiance],
            Mapped::Radiance => [radiance, captured],
        }
    }

    /// Returns the gradients by the shared numbers, after the step.
    pub(crate) fn gradients(self) -> PairGradients<M> {
        PairGradients { map: self.map, sums: self.sums, cycle: self.cycle_gradient }
    }
}

impl PairTargets<'_> {
    fn size(&self) -> [usize; 2] {
        self.view.camera.size_px.map(|side| side as usize)
    }

    fn compare(&self, view: &View, prediction: &[f32], target: &[f32], factor: f32, by_value: &mut [f32]) -> Comparison {
        let pixels = view.mask.as_deref().map(|mask| &mask.weights[..]);
        let of = Compared { size: self.size(), prediction, target, pixels, values: None, factor };
        compare(&of, &self.loss, ComparedOut { by_value, dissimilarity: None })
    }

    /// Compares captured values with the captured image; the gradient has the factor.
    fn compare_captured(&self, values: &[f32], factor: f32, by_value: &mut [f32]) -> Comparison {
        self.compare(self.recording, values, &planes_of(&self.recording.image.pixels), factor, by_value)
    }

    /// Compares rendered radiance with the view, and the captured values that a network makes of it
    /// with the captured image.
    fn compare_radiance(
        &self,
        radiance: &[f32],
        cycle: Option<&Cycle>,
        gradient: &mut [f32],
    ) -> (Comparison, Option<(Comparison, CycleGradient)>) {
        let TrainConfig { mu, hdr_normalisation: normalisation, hdr_weight, cycle_weight, .. } = *self.config;
        let curve = RadianceCurve { mu, normalisation };
        let values = curve.values(radiance);
        // The two losses do not depend on each other.
        let (compared, of_cycle) = rayon::join(
            || self.compare(self.view, &values, &curve.target(self.view), hdr_weight, gradient),
            || {
                cycle.map(|cycle| {
                    let image = cycle.apply(&values);
                    let mut by_value = vec![0.0; values.len()];
                    let compared = self.compare_captured(&image.values, cycle_weight, &mut by_value);
                    (compared, cycle.backward(&image, &by_value))
                })
            },
        );
        if let Some((_, of_cycle)) = &of_cycle {
            gradient.iter_mut().zip(&of_cycle.by_pixel).for_each(|(sum, part)| *sum += part);
        }
        curve.by_radiance(radiance, gradient);
        (compared, of_cycle)
    }
}

impl<M: ColorMap> ChannelSource for PairChannels<'_, M> {
    fn count(&self) -> usize {
        3 * usize::from(self.has_captured()) + 3 * usize::from(self.has_radiance())
    }

    fn fill(&mut self, splats: &SeenSplats<'_>, out: &mut [f32]) {
        let ([of_map, of_model], count) = (self.channels(), self.count());
        self.kept = of_map.map(|_| mapped(&self.map, splats));
        let images = [(of_map, self.kept.as_ref().map(|kept| &kept.colors[..])), (of_model, Some(splats.radiance))];
        for (first, colors) in images {
            let (Some(first), Some(colors)) = (first, colors) else { continue };
            out.par_chunks_mut(CHUNK * count).zip(colors.par_chunks(CHUNK)).for_each(|(out, colors)| {
                out.chunks_exact_mut(count).zip(colors).for_each(|(row, rgb)| row[first..first + 3].copy_from_slice(rgb));
            });
        }
    }
}

impl<M: ColorMap> ChannelStep for PairChannels<'_, M> {
    fn roles(&self) -> ChannelRoles {
        ChannelRoles { shaping: self.count(), measured: MeasuredChannels::FirstThree }
    }

    fn compare(&mut self, image: &[f32], gradient: &mut [f32]) -> ChannelLoss {
        let Self { targets, cycle, .. } = *self;
        let config = targets.config;
        let captured_len = if self.has_captured() { 3 * targets.size().iter().product::<usize>() } else { 0 };
        let (captured, radiance) = image.split_at(captured_len);
        let (by_captured, by_radiance) = gradient.split_at_mut(captured_len);
        // The losses of the two images do not depend on each other.
        let (of_captured, of_radiance) = rayon::join(
            || (captured_len > 0).then(|| targets.compare_captured(captured, config.ldr_weight, by_captured)),
            || (!radiance.is_empty()).then(|| targets.compare_radiance(radiance, cycle, by_radiance)),
        );
        let mut report = ChannelLoss::default();
        if let Some(found) = of_captured {
            report = ChannelLoss { loss: config.ldr_weight * found.loss, l1: found.l1, ssim: found.ssim };
        }
        if let Some((found, of_cycle)) = of_radiance {
            // Where several images are compared, radiance is reported, as by other methods.
            report = ChannelLoss { loss: report.loss + config.hdr_weight * found.loss, l1: found.l1, ssim: found.ssim };
            if let Some((compared, gradient)) = of_cycle {
                report.loss += config.cycle_weight * compared.loss;
                self.cycle_gradient = Some(gradient);
            }
        }
        report
    }

    fn backward(&mut self, splats: &SeenSplats<'_>, by_channels: &[f32], out: &mut [[f32; 3]]) {
        let ([of_map, of_model], stride) = (self.channels(), self.count());
        if let Some(first) = of_model {
            let rows = SplatRows { values: by_channels, stride, first };
            out.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, out)| *out = rows.row(i));
        }
        if let (Some(first), Some(kept)) = (of_map, &self.kept) {
            let rows = SplatRows { values: by_channels, stride, first };
            self.sums = Some(mapped_backward(&self.map, splats, kept, rows, out));
        }
    }
}
