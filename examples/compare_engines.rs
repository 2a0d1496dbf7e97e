//! Trains the same scene on the CPU and on a GPU, step by step, and draws both losses over each
//! other.
//!
//! ```text
//! cargo run --release -p luxel --example compare_engines -- crates/cli/data/desk-lamp-200 \
//!     2 300 llvmpipe loss.svg
//! ```
//!
//! Arguments: data set, how many times its images are reduced, steps, a part of the GPU's name,
//! drawing to write.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use luxel_core::{Dataset, Engine};
use luxel_cpu::CpuEngine;
use luxel_gpu::{DeviceChoice, Gpu, GpuEngine};
use luxel_io::{LoadOptions, load_dataset};
use luxel_metrics::{Measures, evaluate};
use luxel_train::{TrainConfig, Trainer};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, downscale, steps, gpu, drawing] = arguments.as_slice() else {
        return Err("usage: compare_engines DATASET DOWNSCALE STEPS GPU DRAWING.svg".into());
    };
    let options = LoadOptions { downscale: downscale.parse()?, ..LoadOptions::default() };
    let dataset = load_dataset(Path::new(dataset), &options)?;
    let steps = steps.parse()?;
    let gpu = Gpu::open(&DeviceChoice::Named(gpu.clone()))?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let cpu = train("cpu", &dataset, steps, Box::new(CpuEngine::new(threads)?))?;
    let gpu = train(&gpu.facts().name, &dataset, steps, Box::new(GpuEngine::new(&gpu)?))?;
    let apart = |values: &[f32], other: &[f32]| values.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("losses of single steps are at most {:.2e} apart", apart(&cpu, &gpu));
    println!("means of 10 steps are at most {:.2e} apart", apart(&means(&cpu), &means(&gpu)));
    std::fs::write(drawing, svg(steps, &[("cpu", "#c33", &means(&cpu)), ("gpu", "#36c", &means(&gpu))]))?;
    Ok(())
}

/// Losses of all steps; of an engine that works ahead, without the last.
fn train(name: &str, dataset: &Dataset, iterations: u32, engine: Box<dyn Engine>) -> Result<Vec<f32>, Box<dyn Error>> {
    let config = TrainConfig { iterations, ..TrainConfig::default() };
    let mut trainer = Trainer::new(dataset, config, engine)?;
    let mut losses = Vec::new();
    while !trainer.is_finished() {
        // So that an engine that works ahead reports every step, one late.
        trainer.engine().finish()?;
        let report = trainer.step()?;
        if report.step as usize > losses.len() {
            losses.resize(report.step as usize, report.loss);
        }
    }
    let (options, scale, mu) = (trainer.render_options(), trainer.radiance_scale(), trainer.config().mu);
    let figures = evaluate(trainer.engine(), &options, &Measures::new(scale, mu), &dataset.test, &mut |_, _, _| {})?;
    println!("{name}: {} splats, test {:.3} dB by protocol scene", trainer.splats_len(), figures.mean.psnr_scene);
    Ok(losses)
}

/// Means of ten steps each.
fn means(losses: &[f32]) -> Vec<f32> {
    losses.chunks_exact(10).map(|ten| ten.iter().sum::<f32>() / 10.0).collect()
}

const WIDTH: f32 = 640.0;
const HEIGHT: f32 = 320.0;
const MARGIN: f32 = 48.0;

/// Curves over each other: the first broad and light, the second fine, so that both are seen where
/// they agree.
fn svg(steps: u32, curves: &[(&str, &str, &[f32])]) -> String {
    let values = curves.iter().flat_map(|(_, _, values)| values.iter());
    let top = values.fold(f32::MIN_POSITIVE, |top, value| top.max(*value)) * 1.05;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{HEIGHT}\" font-family=\"sans-serif\" font-size=\"12\">\n"
    );
    let (left, bottom, right) = (MARGIN, HEIGHT - MARGIN, WIDTH - 12.0);
    out += &format!(
        "<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/>\n<path d=\"M{left} 12V{bottom}H{right}\" fill=\"none\" stroke=\"#888\"/>\n"
    );
    for value in ticks(top) {
        let y = bottom - (bottom - 12.0) * value / top;
        out += &format!("<path d=\"M{left} {y:.1}H{right}\" stroke=\"#eee\"/>\n");
        out += &format!("<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{value}</text>\n", left - 6.0, y + 4.0);
    }
    let steps = steps as f32;
    for step in ticks(steps) {
        let x = left + (right - left) * step / steps;
        out += &format!("<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{step}</text>\n", bottom + 16.0);
    }
    for (n, (name, color, values)) in curves.iter().enumerate() {
        let mut path = String::new();
        for (i, value) in values.iter().enumerate() {
            let x = left + (right - left) * (10.0 * i as f32 + 5.0) / steps;
            let y = bottom - (bottom - 12.0) * value / top;
            // Writing to a string does not fail.
            let _ = write!(path, "{}{x:.1} {y:.2}", if i == 0 { "M" } else { "L" });
        }
        let width = if n == 0 { 5.0 } else { 1.2 };
        let opacity = if n == 0 { 0.4 } else { 1.0 };
        let style = format!("fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\" stroke-opacity=\"{opacity}\"");
        out += &format!("<path d=\"{path}\" {style}/>\n");
        out += &format!("<text x=\"{}\" y=\"{}\" fill=\"{color}\">{name}</text>\n", right - 60.0, 28.0 + 16.0 * n as f32);
    }
    out += &format!(
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">loss over steps, means of ten</text>\n</svg>\n",
        (left + right) / 2.0,
        HEIGHT - 10.0
    );
    out
}

/// Round numbers from 0 up to `top`, five or fewer.
fn ticks(top: f32) -> impl Iterator<Item = f32> {
    let power = 10f32.powf((top / 4.0).log10().floor());
    let step = [1.0, 2.0, 5.0].into_iter().map(|k| k * power).find(|step| *step >= top / 4.0).unwrap_or(10.0 * power);
    (0..5).map(move |n| n as f32 * step).take_while(move |value| *value <= top)
}
