//! Fisheyes and panoramas: images and gradients against the oracle's, the seam, the poles, and the
//! error of the projection against integrals along rays.

use glam::{DAffine3, DMat3, DVec3};
use luxel_core::{
    Activation, Antialias, Camera, CameraProjection, ColorModel, Cutoffs, Engine, Fisheye, Image, RenderOptions, Splats, synthetic,
};
use luxel_cpu::{CpuEngine, InstructionSet};

use crate::fixture;
use crate::gradients::{self, Case};
use crate::image::assert_is_oracles;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus };

/// A lens with strong coefficients that sees 200 degrees.
fn fisheye() -> CameraProjection {
    CameraProjection::Fisheye(Fisheye::new([-0.03, 0.012, -0.004, 0.0006]))
}

fn cameras(width: u32, height: u32) -> [Camera; 2] {
    [fisheye(), CameraProjection::Equirectangular].map(|projection| fixture::wide_camera(projection, width, height))
}

fn render(splats: &Splats, camera: &Camera, options: &RenderOptions) -> Image {
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(splats, None).unwrap();
    engine.render(camera, options).unwrap()
}

/// Returns cases of both lenses over anti-aliasing and cut-offs. Their special cases include splats
/// so large that they end at a right angle to their direction.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let (off, pixel, mip) = (Antialias::Off, Antialias::Pixel, Antialias::Mip);
    let settings = [(off, Cutoffs::HDR), (mip, Cutoffs::PARITY), (pixel, Cutoffs::HDR), (mip, Cutoffs::HDR)];
    for (n, (antialias, cutoffs)) in settings.into_iter().enumerate() {
        for camera in cameras(26, 13) {
            let name = camera.projection.name();
            let mut case = gradients::case_of_camera(&camera, LCD, antialias, ("cut", cutoffs), n == 1, 70 + n as u64);
            case.name = format!("{name} {n}");
            cases.push(if n == 3 { gradients::sampled(case, 2) } else { case });
        }
    }
    cases
}

#[test]
fn oracle_gradient_is_that_of_central_differences() {
    for case in cases() {
        gradients::check(&case, &gradients::against_differences(&case), gradients::DIFFERENCES_TOLERANCE, "by differences");
    }
}

#[test]
fn engine_gradient_is_the_oracles() {
    for case in cases() {
        gradients::check(&case, &gradients::against_oracle(&case), gradients::ENGINE_TOLERANCE, "by the engine");
    }
}

#[test]
fn image_is_the_oracles() {
    for size in [[80, 40], [33, 16], [8, 4]] {
        for camera in cameras(size[0], size[1]) {
            for (antialias, cutoffs) in [(Antialias::Off, Cutoffs::HDR), (Antialias::Mip, Cutoffs::PARITY)] {
                for mut splats in [fixture::splats(LCD, 90, &camera, 5), fixture::splats_with_special_cases(LCD, &camera, 6)] {
                    splats.smoothing = fixture::smoothing(splats.len());
                    let options = fixture::options(cutoffs, antialias);
                    let name = format!("{} of {} splats {antialias:?} {size:?}", camera.projection.name(), splats.len());
                    let image = render(&splats, &camera, &options);
                    assert_is_oracles(&image, &splats, &camera, &options, &name);
                }
            }
        }
    }
}

#[test]
fn images_do_not_depend_on_threads_and_instruction_sets() {
    let splats = synthetic::room(2000, 3);
    for camera in cameras(150, 75) {
        let mut images = Vec::new();
        for threads in [1, 3] {
            for set in [InstructionSet::Best, InstructionSet::Baseline] {
                let mut engine = CpuEngine::new(threads).unwrap();
                engine.set_instruction_set(set).unwrap();
                engine.load(&splats, None).unwrap();
                images.push((set == InstructionSet::Best, engine.render(&camera, &RenderOptions::default()).unwrap()));
            }
        }
        assert_eq!(images[0], images[2]);
        assert_eq!(images[1], images[3]);
    }
}

/// Steps between neighbouring columns or rows, relative to their median.
fn largest_step(steps: &[f64]) -> f64 {
    let mut sorted = steps.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[steps.len() - 1] / sorted[steps.len() / 2]
}

#[test]
fn a_panorama_has_no_seam_and_turns_with_its_camera() {
    let splats = synthetic::room(2000, 5);
    let at = DVec3::new(0.3, -0.2, 2.6);
    let panorama = |turn: DMat3| {
        render(&splats, &Camera::panorama(DAffine3 { matrix3: turn, translation: -(turn * at) }, 256), &RenderOptions::default())
    };
    let image = panorama(DMat3::IDENTITY);
    let (width, height) = (image.width, image.height);
    let step = |a: [f32; 3], b: [f32; 3]| (0..3).map(|c| f64::from(a[c] - b[c]).abs()).sum::<f64>();
    // With the last column next to the first.
    let columns: Vec<f64> = (0..width).map(|x| (0..height).map(|y| step(image.at(x, y), image.at((x + 1) % width, y))).sum()).collect();
    let rows: Vec<f64> = (0..height - 1).map(|y| (0..width).map(|x| step(image.at(x, y), image.at(x, y + 1))).sum()).collect();
    assert!(largest_step(&columns) < 3.0 && largest_step(&rows) < 3.0, "{} {}", largest_step(&columns), largest_step(&rows));
    // Turned about the vertical by a quarter, it is the same image, shifted.
    let turned = panorama(DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2));
    for y in 0..height {
        for x in 0..width {
            let (a, b) = (image.at(x, y), turned.at((x + width / 4) % width, y));
            assert!(step(a, b) <= 2e-3 * (1e-3 + step(a, [0.0; 3])), "{x} {y}: {a:?} {b:?}");
        }
    }
    // Looking at a pole shows the same as the middle of an upright one: tilted, poles are nowhere
    // special. The middle of the tilted one is the upper pole of the first.
    let tilted = panorama(DMat3::from_rotation_x(-std::f64::consts::FRAC_PI_2));
    let pole = (0..width).map(|x| f64::from(image.at(x, 0)[1])).sum::<f64>() / width as f64;
    let middle = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[x, y]| f64::from(tilted.at(width / 2 - 1 + x, height / 2 - 1 + y)[1]));
    let expected = middle.iter().sum::<f64>() / 4.0;
    let found_other = (0..width).map(|x| f64::from(image.at(x, height - 1)[1])).sum::<f64>() / width as f64;
    let error = (pole / expected - 1.0).abs().min((found_other / expected - 1.0).abs());
    assert!(error < 0.05, "{pole} {found_other} {expected}");
}

#[test]
fn the_axis_of_a_fisheye_is_that_of_a_pinhole() {
    // Near the axis all projections agree to first order.
    let pinhole = Camera { focal_px: glam::DVec2::splat(800.0), center_px: glam::DVec2::splat(20.5), ..fixture::camera(41, 41) };
    let lens = Camera { projection: CameraProjection::Fisheye(Fisheye::new([0.0; 4])), ..pinhole.clone() };
    // A few pixels across: of large ones a plane and a sphere differ.
    let mut splats = fixture::splats(LCD, 60, &pinhole, 9);
    splats.log_scale.as_flattened_mut().iter_mut().for_each(|s| *s -= 3.0);
    let options = fixture::options(Cutoffs::HDR, Antialias::Off);
    let (straight, bent) = (render(&splats, &pinhole, &options), render(&splats, &lens, &options));
    for (a, b) in straight.pixels.iter().zip(&bent.pixels) {
        for c in 0..3 {
            assert!((a[c] - b[c]).abs() <= 0.03 * (0.02 + a[c]), "{a:?} {b:?}");
        }
    }
}

#[test]
fn nothing_is_drawn_beyond_the_circle() {
    let camera = fixture::wide_camera(fisheye(), 60, 40);
    let image = render(&synthetic::room(500, 3), &camera, &RenderOptions { background: [0.25, 0.5, 1.0], ..RenderOptions::default() });
    let mut beyond = 0;
    for (i, pixel) in image.pixels.iter().enumerate() {
        let at = glam::DVec2::new((i % 60) as f64 + 0.5, (i / 60) as f64 + 0.5);
        if !camera.shows(at) {
            beyond += 1;
            assert_eq!(*pixel, [0.25, 0.5, 1.0]);
        }
    }
    assert!(beyond > 50);
}
