//! Photographs: images through an aperture of finite size, taken while the shutter is open.
//!
//! In: a camera, its aperture and focus, the cameras before and after it in a path. Out: the mean
//! of many renders in radiance, each through one point of the aperture at one moment. What a lamp
//! out of focus or a moving edge looks like follows from that: hiding, discs and streaks are those
//! of the scene, and a lamp's disc has the lamp's radiance.
//!
//! - Lens: thin, without aberrations. Each point of the aperture sees through a shifted frustum,
//!   whose plane of focus stays where it is. The aperture is a circle, or a regular polygon with
//!   its corners on the circle, the same for all of the image (no cat's eyes towards the borders).
//! - Shutter: all pixels together. From frame to frame the camera moves on a straight line and
//!   turns evenly; before the first frame and after the last it goes on as it came. The shutter is
//!   open around the moment of the frame.
//! - Samples: a sunflower (golden angle, equal areas), the same in all frames unless asked
//!   otherwise. Moments follow a sequence that does not depend on the place in the aperture. Half
//!   of the difference of two halves of the set estimates the error, from above:
//!   [`Quality::error`].
//!
//! Degenerate: without aperture and motion it is one plain render, to the bit. Projections without
//! an axis have no plane of focus; they are refused.

mod samples;

use std::ops::RangeInclusive;

use glam::{DQuat, DVec2, DVec3};
use luxel_core::{Camera, Engine, Image, RenderOptions};

pub(crate) use self::samples::GOLDEN_TURN;
pub use self::samples::{BLADES, LensSample, lens_samples};
use crate::Result;
use crate::error::{Context, ensure};
use crate::memory;

/// Numbers of samples that may be asked for.
pub const SAMPLE_COUNTS: RangeInclusive<u32> = 1..=4096;

/// Samples that are taken at first, to see how many are needed.
const FIRST_SAMPLES: u32 = 16;
/// The most samples that are taken unless a number is given.
const MOST_SAMPLES: u32 = 1024;
/// Root mean square error, relative to that of the image, up to which samples are added.
pub const TOLERANCE: f64 = 0.01;

/// The opening of a lens. Lengths are in the coordinates of the camera that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aperture {
    /// Diameter of the circle that the opening is, or in which the blades' corners lie.
    pub diameter: f64,
    /// Distance along the camera's axis that is in focus.
    pub focus_distance: f64,
    /// Number of straight blades; `None` for a circle.
    pub blades: Option<u8>,
}

/// The movement of a camera while the shutter is open.
#[derive(Clone, Debug, PartialEq)]
pub struct ShutterMotion {
    /// Camera of the frame before; `None` at the start of a path.
    pub before: Option<Camera>,
    /// Camera of the frame after; `None` at the end of a path.
    pub after: Option<Camera>,
    /// Part of the time from frame to frame in which the shutter is open: 0.5 for 180 degrees.
    pub open: f64,
}

/// A photograph that is to be taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Photograph {
    /// The camera in the middle of the exposure.
    pub camera: Camera,
    /// The aperture; `None` for a pinhole.
    pub aperture: Option<Aperture>,
    /// The movement; `None` for an instant.
    pub motion: Option<ShutterMotion>,
}

/// The number of samples of a photograph, and which.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sampling {
    /// Number; `None` for as many as bring the error to [`TOLERANCE`], 1024 at most.
    pub count: Option<u32>,
    /// Index of the set of samples: 0 for all frames of a path, or another in each.
    pub set: u32,
}

/// A photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct Taken {
    /// Radiance in normalised units.
    pub image: Image,
    /// Coverage by splats, `[H*W]`; empty unless asked for.
    pub alpha: Vec<f32>,
    /// The samples that it is made of.
    pub quality: Quality,
}

/// The samples of a photograph, and what they leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Number of renders that the image is the mean of.
    pub samples: u32,
    /// Estimate of the root mean square error, relative to the root mean square of the image, from
    /// above; 0 for a plain render and for a single sample, of which nothing is known.
    pub error: f64,
}

impl Photograph {
    /// Checks that the photograph can be taken.
    ///
    /// # Errors
    /// A camera without an axis; numbers that are no lens or shutter.
    pub fn check(&self) -> Result<()> {
        let projection = self.camera.projection;
        if let Some(Aperture { diameter, focus_distance, blades }) = self.aperture {
            ensure!(
                projection.is_pinhole(),
                "a camera with {} projection has no plane of focus, which only straight lines leave a plane; render without an aperture, or with a pinhole's projection",
                projection.name()
            );
            ensure!(diameter.is_finite() && diameter >= 0.0, "an aperture of {diameter}, expected a number from 0 on");
            ensure!(
                focus_distance.is_finite() && focus_distance > 0.0,
                "focus at {focus_distance}, expected a distance above 0, in front of the camera"
            );
            let blades = blades.unwrap_or(*BLADES.start());
            ensure!(BLADES.contains(&blades), "{blades} blades, expected {} to {}", BLADES.start(), BLADES.end());
        }
        if let Some(ShutterMotion { open, .. }) = self.motion {
            ensure!(open > 0.0 && open <= 1.0, "a shutter that is open for {open} of a frame, expected above 0 and up to 1");
        }
        Ok(())
    }

    /// Returns whether a plain render is the photograph.
    fn is_sharp(&self) -> bool {
        self.aperture.is_none_or(|aperture| aperture.diameter == 0.0)
            && self.motion.as_ref().is_none_or(|motion| motion.before.is_none() && motion.after.is_none())
    }

    /// Returns the camera of a sample.
    pub fn camera_of(&self, sample: LensSample) -> Camera {
        let moved = self.motion.as_ref().map(|motion| motion.camera_at(&self.camera, motion.open * sample.moment));
        let mut camera = moved.unwrap_or_else(|| self.camera.clone());
        if let Some(aperture) = &self.aperture {
            let offset = 0.5 * aperture.diameter * DVec2::from_array(sample.place);
            camera.camera_from_world.translation -= offset.extend(0.0);
            camera.center_px += camera.focal_px * offset / aperture.focus_distance;
        }
        camera
    }

    /// Renders the photograph; `alpha` asks for coverage.
    ///
    /// # Errors
    /// What [`Self::check`] refuses; a device that gave up, or that has no coverage.
    pub fn take(&self, engine: &mut dyn Engine, options: &RenderOptions, sampling: Sampling, alpha: bool) -> Result<Taken> {
        self.check()?;
        memory::check_render(self.camera.size_px, options.raster.samples)?;
        let blades = self.aperture.and_then(|aperture| aperture.blades);
        let mut mean_of = |count: u32| self.mean(lens_samples(count, blades, sampling.set), engine, options, alpha);
        match sampling.count {
            _ if self.is_sharp() => {
                let Frame { image, alpha } = render(engine, &self.camera, options, alpha)?;
                Ok(Taken { image, alpha, quality: Quality { samples: 1, error: 0.0 } })
            }
            Some(count) => {
                ensure!(SAMPLE_COUNTS.contains(&count), "{count} samples, expected {} to {}", SAMPLE_COUNTS.start(), SAMPLE_COUNTS.end());
                mean_of(count)
            }
            None => {
                let (mut count, mut taken) = (FIRST_SAMPLES, mean_of(FIRST_SAMPLES)?);
                while taken.quality.error > TOLERANCE && count < MOST_SAMPLES {
                    // The error of a sunflower falls with the number of its points.
                    let needed = (f64::from(count) * taken.quality.error / TOLERANCE).ceil() as u32;
                    count = needed.next_power_of_two().clamp(2 * count, MOST_SAMPLES);
                    taken = mean_of(count)?;
                }
                Ok(taken)
            }
        }
    }
}

impl Photograph {
    /// Renders a part of the samples, in normalised units: those of `count` whose index leaves the
    /// rest `part[0]` when it is divided by `part[1]`. The mean of all parts, by their numbers of
    /// samples, is the photograph of `count` samples.
    ///
    /// # Errors
    /// Those of [`Self::take`]; a part without samples.
    pub fn take_part(&self, engine: &mut dyn Engine, options: &RenderOptions, count: u32, part: [u32; 2]) -> Result<Image> {
        self.check()?;
        memory::check_render(self.camera.size_px, options.raster.samples)?;
        let [first, parts] = part;
        ensure!(SAMPLE_COUNTS.contains(&count), "{count} samples, expected {} to {}", SAMPLE_COUNTS.start(), SAMPLE_COUNTS.end());
        ensure!(first < parts && first < count, "part {first} of {parts} of {count} samples has none");
        let blades = self.aperture.and_then(|aperture| aperture.blades);
        let samples = lens_samples(count, blades, 0).skip(first as usize).step_by(parts as usize);
        Ok(self.mean(samples, engine, options, false)?.image)
    }

    /// Returns the mean of the renders of these samples.
    fn mean(
        &self,
        samples: impl Iterator<Item = LensSample>,
        engine: &mut dyn Engine,
        options: &RenderOptions,
        alpha: bool,
    ) -> Result<Taken> {
        let mut halves = [Sum::default(), Sum::default()];
        for (i, sample) in samples.enumerate() {
            let camera = self.camera_of(sample);
            camera.validate().map_err(|error| crate::Error::new(format!("a sample of the aperture: {error}")))?;
            halves[i % 2].add(render(engine, &camera, options, alpha)?);
        }
        Ok(taken(halves, self.camera.size_px))
    }
}

impl ShutterMotion {
    /// Returns the camera at a moment, in times from frame to frame: 0 is `camera`'s.
    fn camera_at(&self, camera: &Camera, moment: f64) -> Camera {
        let (near, far) = if moment < 0.0 { (&self.before, &self.after) } else { (&self.after, &self.before) };
        match (near, far) {
            (Some(other), _) => between(camera, other, moment.abs()),
            (None, Some(other)) => between(camera, other, -moment.abs()),
            (None, None) => camera.clone(),
        }
    }
}

/// Returns the camera at `part` of the way to another; below 0 it is on the other side.
fn between(from: &Camera, to: &Camera, part: f64) -> Camera {
    let rotation = |camera: &Camera| DQuat::from_mat3(&camera.camera_from_world.matrix3);
    let turn = (rotation(to) * rotation(from).conjugate()).normalize();
    // The shorter way round.
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let turned = DQuat::from_scaled_axis(part * turn.to_scaled_axis()) * rotation(from);
    let eye: DVec3 = from.eye().lerp(to.eye(), part);
    let mut camera = from.clone();
    camera.camera_from_world.matrix3 = glam::DMat3::from_quat(turned.normalize());
    camera.camera_from_world.translation = -(camera.camera_from_world.matrix3 * eye);
    camera.focal_px = from.focal_px.lerp(to.focal_px, part).max(1e-3 * from.focal_px);
    camera.center_px = from.center_px.lerp(to.center_px, part);
    camera
}

/// One render.
struct Frame {
    image: Image,
    alpha: Vec<f32>,
}

fn render(engine: &mut dyn Engine, camera: &Camera, options: &RenderOptions, alpha: bool) -> Result<Frame> {
    if alpha {
        let layers = engine.render_layers(camera, options).context("cannot render")?;
        return Ok(Frame { image: layers.image, alpha: layers.alpha });
    }
    Ok(Frame { image: engine.render(camera, options).context("cannot render")?, alpha: Vec::new() })
}

/// The sum of renders.
#[derive(Default)]
struct Sum {
    pixels: Vec<[f32; 3]>,
    alpha: Vec<f32>,
    count: u32,
}

impl Sum {
    fn add(&mut self, frame: Frame) {
        if self.count == 0 {
            (self.pixels, self.alpha) = (frame.image.pixels, frame.alpha);
        } else {
            for (sum, pixel) in self.pixels.iter_mut().zip(&frame.image.pixels) {
                sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
            }
            self.alpha.iter_mut().zip(&frame.alpha).for_each(|(sum, value)| *sum += value);
        }
        self.count += 1;
    }
}

/// Returns the mean of both halves of the samples, and what their difference says of its error.
fn taken([first, second]: [Sum; 2], [width, height]: [u32; 2]) -> Taken {
    let samples = first.count + second.count;
    let part = 1.0 / samples.max(1) as f32;
    let (mut squares, mut differences) = (0.0f64, 0.0f64);
    let Sum { mut pixels, mut alpha, count } = first;
    let (of_first, of_second) = (1.0 / f64::from(count.max(1)), 1.0 / f64::from(second.count.max(1)));
    for (sum, other) in pixels.iter_mut().zip(&second.pixels) {
        for (sum, other) in sum.iter_mut().zip(other) {
            differences += (f64::from(*sum) * of_first - f64::from(*other) * of_second).powi(2);
            *sum = (*sum + other) * part;
            squares += f64::from(*sum).powi(2);
        }
    }
    if second.count == 0 {
        pixels.iter_mut().flatten().for_each(|value| *value *= part);
    }
    alpha.iter_mut().zip(&second.alpha).for_each(|(sum, other)| *sum += other);
    alpha.iter_mut().for_each(|value| *value *= part);
    let error = if second.count > 0 && squares > 0.0 { 0.5 * (differences / squares).sqrt() } else { 0.0 };
    Taken { image: Image { width: width as usize, height: height as usize, pixels }, alpha, quality: Quality { samples, error } }
}

#[cfg(test)]
mod tests;
