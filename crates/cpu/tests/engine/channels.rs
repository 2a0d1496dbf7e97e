//! Steps of methods that own channels and loss, against steps of radiance and against one another.

use luxel_core::engine::{
    ChannelLoss, ChannelRoles, ChannelSource, ChannelStep, MeasuredChannels, SPLATS_PER_BLOCK, SeenSplats, SparseGradients,
    StatsCollection, StepConfig,
};
use luxel_core::{Antialias, Camera, CameraProjection, ColorModel, Cutoffs, Engine, LossWeights, Splats};
use luxel_cpu::{CpuEngine, InstructionSet};

use crate::fixture;

const MODEL: ColorModel = ColorModel::Sh { degree: 2 };

/// Copies of the splats' radiance as channels, each times a factor, and a loss that is linear in
/// the image: gradients add up over images.
struct Copies {
    factors: Vec<f32>,
    /// Factors of each image's loss.
    weights: Vec<f32>,
    shaping: usize,
    measured: MeasuredChannels,
    loss: f32,
}

impl Copies {
    fn new(images: &[(f32, f32)]) -> Self {
        let (factors, weights) = images.iter().copied().unzip();
        Self { factors, weights, shaping: 3 * images.len(), measured: MeasuredChannels::All, loss: 1.0 }
    }

    fn measured_first(self) -> Self {
        Self { measured: MeasuredChannels::FirstThree, ..self }
    }
}

impl ChannelSource for Copies {
    fn count(&self) -> usize {
        3 * self.factors.len()
    }

    fn fill(&mut self, splats: &SeenSplats<'_>, out: &mut [f32]) {
        for (row, rgb) in out.chunks_exact_mut(self.count()).zip(splats.radiance) {
            row.chunks_exact_mut(3).zip(&self.factors).for_each(|(row, factor)| row.copy_from_slice(&rgb.map(|c| c * factor)));
        }
    }
}

impl ChannelStep for Copies {
    fn roles(&self) -> ChannelRoles {
        ChannelRoles { shaping: self.shaping, measured: self.measured }
    }

    fn compare(&mut self, image: &[f32], gradient: &mut [f32]) -> ChannelLoss {
        let plane = image.len() / self.count();
        for (i, g) in gradient.iter_mut().enumerate() {
            *g = self.weights[i / (3 * plane)] * (0.37 * (i % (3 * plane)) as f32).sin() * 1e-3;
        }
        ChannelLoss { loss: self.loss, l1: 0.5, ssim: 0.25 }
    }

    fn backward(&mut self, splats: &SeenSplats<'_>, by_channels: &[f32], out: &mut [[f32; 3]]) {
        for ((out, row), _) in out.iter_mut().zip(by_channels.chunks_exact(self.count())).zip(splats.visible).filter(|(_, seen)| **seen) {
            for (image, factor) in row.chunks_exact(3).zip(&self.factors) {
                out.iter_mut().zip(image).for_each(|(out, by)| *out += factor * by);
            }
        }
    }
}

fn step(stats: StatsCollection) -> StepConfig {
    let step = fixture::step(1, fixture::options(Cutoffs::PARITY, Antialias::Pixel));
    let render = luxel_core::RenderOptions { background: [0.0; 3], ..step.render };
    StepConfig { loss: LossWeights { opacity_weight: 0.0, scale_weight: 0.0, ..step.loss }, stats, render, ..step }
}

fn scene() -> (Camera, Splats) {
    let camera = fixture::camera(45, 38);
    let splats = fixture::splats(MODEL, 123, &camera, 3);
    (camera, splats)
}

fn engine(splats: &Splats) -> CpuEngine {
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(splats, None).unwrap();
    engine
}

fn gradients(method: &mut Copies, stats: StatsCollection) -> SparseGradients {
    let (camera, splats) = scene();
    engine(&splats).channel_gradients(&camera, method, &step(stats)).unwrap().1
}

/// Returns the largest difference of two gradients, of the largest number of the row.
fn difference(a: &SparseGradients, b: &SparseGradients) -> f32 {
    assert_eq!(a.blocks(), b.blocks());
    let rows = a.rows().count();
    let of_row = |row: usize| {
        let numbers = |of: &SparseGradients| -> Vec<f32> {
            of.iter().flat_map(|(_, block)| block[row * SPLATS_PER_BLOCK..][..SPLATS_PER_BLOCK].to_vec()).collect()
        };
        let (a, b) = (numbers(a), numbers(b));
        let largest = a.iter().fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs()));
        a.iter().zip(&b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / largest
    };
    (0..rows).map(of_row).fold(0.0, f32::max)
}

/// Returns the statistics of all blocks.
fn statistics(of: &SparseGradients) -> Vec<f32> {
    of.iter().flat_map(|(_, block)| block[of.parameters_len()..].to_vec()).collect()
}

#[test]
fn gradients_of_several_images_are_the_sums_of_those_of_each() {
    let stats = StatsCollection::Gradients;
    // The loss is linear in the image, and so in its factor.
    let one = gradients(&mut Copies::new(&[(1.0, 1.0)]), stats);
    for images in [vec![(1.0, 0.75), (0.5, 0.5)], vec![(1.0, 0.25), (2.0, 0.125), (-1.0, -0.25), (1.0, 0.25)]] {
        let together = gradients(&mut Copies::new(&images), stats);
        let found = difference(&one, &together);
        assert!(found < 2e-5, "{images:?}: {found:e}");
        let first = gradients(&mut Copies::new(&images[..1]), stats);
        let measured = gradients(&mut Copies::new(&images).measured_first(), stats);
        assert_eq!(statistics(&measured), statistics(&first));
        assert!(statistics(&measured) != statistics(&together) && difference(&measured, &together) == 0.0);
    }
}

#[test]
fn channels_behind_the_shaping_ones_have_a_gradient_by_themselves_alone() {
    let stats = StatsCollection::Gradients;
    let one = gradients(&mut Copies::new(&[(1.0, 1.0)]), stats);
    let extra = gradients(&mut Copies { shaping: 3, ..Copies::new(&[(1.0, 1.0), (3.0, 1.0)]) }, stats);
    assert_eq!(statistics(&extra), statistics(&one));
    let rows = |of: &SparseGradients, rows: std::ops::Range<usize>| -> Vec<f32> {
        of.iter().flat_map(|(_, block)| block[rows.start * SPLATS_PER_BLOCK..rows.end * SPLATS_PER_BLOCK].to_vec()).collect()
    };
    // Scale, rotation and opacity to the bit; harmonics have four times the gradient.
    assert_eq!(rows(&extra, 3..11), rows(&one, 3..11));
    let (extra, one) = (rows(&extra, 11..14), rows(&one, 11..14));
    // Of the largest number, as in the test above: sums cancel, and instruction sets round them
    // differently.
    let largest = one.iter().fold(0.0f32, |most, by| most.max(by.abs()));
    for (extra, one) in extra.iter().zip(&one) {
        assert!((extra - 4.0 * one).abs() <= 2e-5 * largest, "{extra} {one} {largest}");
    }
}

#[test]
fn a_step_is_the_update_by_its_gradients_and_nothing_without_a_finite_loss() {
    let (camera, splats) = scene();
    let (mut whole, mut halves) = (engine(&splats), engine(&splats));
    for number in 1..=3 {
        let step = StepConfig { step: number, ..step(StatsCollection::Gradients) };
        let copies = || Copies::new(&[(1.0, 0.75), (0.5, 0.5)]).measured_first();
        let expected = whole.train_channels(&camera, &mut copies(), &step).unwrap();
        let (report, gradients) = halves.channel_gradients(&camera, &mut copies(), &step).unwrap();
        assert_eq!((report, report.loss, report.ssim), (expected, 1.0, 0.25));
        halves.apply_gradients(&gradients, &step).unwrap();
        assert!(halves.save().unwrap() == whole.save().unwrap() && halves.densify_stats().unwrap() == whole.densify_stats().unwrap());
    }
    let before = whole.save().unwrap();
    let report = whole.train_channels(&camera, &mut Copies { loss: f32::NAN, ..Copies::new(&[(1.0, 1.0)]) }, &step(StatsCollection::Off));
    assert!(report.unwrap().loss.is_nan() && whole.save().unwrap() == before);
}

#[test]
fn threads_and_instruction_sets_agree_and_images_are_those_of_radiance() {
    let (camera, splats) = scene();
    let step = step(StatsCollection::Gradients);
    let run = |threads: usize, set: InstructionSet| {
        let mut engine = CpuEngine::new(threads).unwrap();
        engine.set_instruction_set(set).unwrap();
        engine.load(&splats, None).unwrap();
        let mut copies = Copies::new(&[(1.0, 0.75), (0.5, 0.5)]).measured_first();
        engine.channel_gradients(&camera, &mut copies, &step).unwrap().1
    };
    let best = run(2, InstructionSet::Best);
    assert!(run(3, InstructionSet::Best) == best && run(1, InstructionSet::Best) == best);
    let baseline = run(2, InstructionSet::Baseline);
    assert!(difference(&best, &baseline) < 1e-4, "{:e}", difference(&best, &baseline));
    for (a, b) in statistics(&best).iter().zip(statistics(&baseline)) {
        assert!((a - b).abs() <= 1e-4 * a.abs().max(1e-3), "{a} {b}");
    }
    let mut engine = engine(&splats);
    let planes = engine.render_channels(&camera, &mut Copies::new(&[(1.0, 0.0), (0.5, 0.0)]), &step.render).unwrap();
    let image = engine.render(&camera, &step.render).unwrap();
    let len = image.pixels.len();
    for (i, rgb) in image.pixels.iter().enumerate() {
        for c in 0..3 {
            assert_eq!(planes[c * len + i], rgb[c]);
            assert!((planes[(3 + c) * len + i] - 0.5 * rgb[c]).abs() <= 1e-6 * rgb[c]);
        }
    }
}

#[test]
fn what_channels_cannot_be_blended_with_is_refused() {
    let (camera, splats) = scene();
    let mut engine = engine(&splats);
    let step = step(StatsCollection::Off);
    let mut refused = |camera: &Camera, render: luxel_core::RenderOptions| {
        engine.train_channels(camera, &mut Copies::new(&[(1.0, 1.0)]), &StepConfig { render, ..step }).unwrap_err().to_string()
    };
    let wide = fixture::wide_camera(CameraProjection::Equirectangular, 64, 32);
    assert!(refused(&wide, step.render).contains("expected a pinhole camera"));
    let hdr = fixture::options(Cutoffs::HDR, Antialias::Pixel);
    assert!(refused(&camera, hdr).contains("expected none that depends on radiance"));
    let mut supersampled = step.render;
    supersampled.raster.samples = 2;
    assert!(refused(&camera, supersampled).contains("2 samples a side"));
    let error = engine.train_channels(&camera, &mut Copies::new(&[]), &step).unwrap_err().to_string();
    assert!(error.contains("expected at least 3, found 0"), "{error}");
}
