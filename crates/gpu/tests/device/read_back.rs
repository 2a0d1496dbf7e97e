//! Images on the host: how many submissions, copies and pages of memory one takes.

use std::sync::Arc;

use luxel_core::{Antialias, Cutoffs, Engine, Image, RenderOptions};
use luxel_gpu::{Gpu, GpuEngine};

use crate::Body;
use crate::fixture::{camera, options, splats};
use crate::parity::models;

pub const ALL: &[(&str, Body)] = &[
    ("a_render_is_one_submission", a_render_is_one_submission),
    ("a_render_into_an_image_is_the_render", a_render_into_an_image_is_the_render),
    ("frames_after_the_third_touch_no_new_memory", frames_after_the_third_touch_no_new_memory),
];

fn engine(gpu: &Arc<Gpu>) -> GpuEngine {
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&splats(models()[0], 30, &camera(45, 38), 1), None).unwrap();
    engine
}

fn render_options(samples: u8) -> RenderOptions {
    let mut options = options(Cutoffs::HDR, Antialias::Off);
    options.raster.samples = samples;
    options
}

fn a_render_is_one_submission(gpu: &Arc<Gpu>) {
    let mut engine = engine(gpu);
    for samples in [1, 2] {
        engine.render(&camera(45, 38), &render_options(samples)).unwrap();
        let image = 12 * 45 * 38 * u64::from(samples) * u64::from(samples);
        // A report; and where there are timestamps a pair for project, sort, bin, sort, rasterize.
        let report = if gpu.facts().timestamps { 32 + 5 * 16 } else { 32 };
        let traffic = engine.traffic();
        assert_eq!((traffic.submissions, traffic.bytes_read), (1, image + report), "{samples} samples");
    }
}

/// Tests images of the right size, of others, and supersampled ones.
fn a_render_into_an_image_is_the_render(gpu: &Arc<Gpu>) {
    let mut engine = engine(gpu);
    let mut image = Image::filled(3, 2, [f32::NAN; 3]);
    for (size, samples) in [([45, 38], 1), ([45, 38], 1), ([20, 20], 2), ([60, 50], 1), ([20, 20], 1)] {
        let camera = camera(size[0], size[1]);
        let expected = engine.render(&camera, &render_options(samples)).unwrap();
        engine.render_into(&camera, &render_options(samples), &mut image).unwrap();
        assert!(image == expected, "{size:?}, {samples} samples");
    }
    let memory = image.pixels.as_ptr();
    engine.render_into(&camera(20, 20), &render_options(1), &mut image).unwrap();
    assert_eq!(image.pixels.as_ptr(), memory, "an image of the size that is there is written anew");
}

/// Returns how many pages of memory this thread has touched first, where the system tells.
fn touched_pages() -> Option<u64> {
    let stat = std::fs::read_to_string("/proc/thread-self/stat").ok()?;
    // The name, in parentheses, may hold spaces; minflt is the eighth field behind it.
    stat.rsplit(')').next()?.split_whitespace().nth(7)?.parse().ok()
}

/// A frame of new memory touches all pages of its image; a tenth of one frame's is far more than
/// what the driver needs for five.
fn frames_after_the_third_touch_no_new_memory(gpu: &Arc<Gpu>) {
    let mut engine = engine(gpu);
    let camera = camera(1024, 768);
    let mut image = Image::default();
    let mut frames = |count: usize| (0..count).for_each(|_| engine.render_into(&camera, &render_options(1), &mut image).unwrap());
    frames(3);
    let Some(before) = touched_pages() else { return };
    frames(5);
    let touched = touched_pages().unwrap() - before;
    let pages = 12 * 1024 * 768 / 4096;
    assert!(touched < pages / 10, "{touched} new pages in five frames of {pages}");
}
