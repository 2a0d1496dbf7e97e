//! Photographs of `luxel render`: aperture, focus and shutter of its images.

use anyhow::{Context, Result, bail};
use luxel::photograph::{Aperture, Photograph, Quality, Sampling, ShutterMotion, TOLERANCE, Taken};
use luxel_app::pick::surface_distance;
use luxel_app::text;
use luxel_core::{Camera, Engine, Layers, RenderOptions, Scene};

use super::plan::RenderPlan;
use super::shots::{Shot, Shots};
use crate::args::photograph::PhotographArgs;
use crate::output::console::Console;

/// A photograph to take.
#[derive(Clone, Debug)]
pub(super) struct PhotographJob {
    photograph: Photograph,
    sampling: Sampling,
    /// The pixel that is in focus, and the camera that sees it; else the photograph has the
    /// distance.
    focus_at: Option<([u32; 2], Camera)>,
}

impl PhotographJob {
    /// Returns what decides the image beside its camera.
    pub(super) fn recipe(&self) -> String {
        format!("{:?} {:?} {:?} {:?}", self.photograph.aperture, self.photograph.motion, self.sampling, self.focus_at)
    }
}

/// Returns the photograph of each shot, if they are photographs.
///
/// # Errors
/// No focus; an f-number in a scene of unknown size; a shutter without frames; cameras without an
/// axis.
pub(super) fn photographs(plan: &RenderPlan<'_>, scene: &Scene, shots: &Shots) -> Result<Option<Vec<PhotographJob>>> {
    let asked = plan.images.photograph;
    if !asked.is_given() {
        return Ok(None);
    }
    let is_moving = plan.cameras.choice.is_moving();
    if asked.shutter.is_some() && (!is_moving || shots.frames_len() < 2) {
        bail!("--shutter needs a camera that moves from frame to frame; give --path KIND, or --cameras FILE with two frames or more");
    }
    let all = &shots.all;
    let neighbour = |i: Option<usize>| i.and_then(|i| all.get(i)).map(|shot| shot.camera.clone());
    let photograph = |(i, shot): (usize, &Shot)| {
        let step = shots.images_per_frame;
        let motion = asked.shutter.map(|degrees| ShutterMotion {
            before: neighbour(i.checked_sub(step)),
            after: neighbour(i.checked_add(step)),
            open: degrees / 360.0,
        });
        // Both eyes see through the same kind of lens, each with its own measured focus.
        let seen_by = if is_moving { &all[i % step] } else { shot };
        let focus_at = asked.focus_at.map(|pixel| (pixel, seen_by.camera.clone()));
        let aperture = aperture(asked, scene, shot).with_context(|| format!("cannot render {} through a lens", shot.name))?;
        let photograph = Photograph { camera: shot.camera.clone(), aperture, motion };
        photograph.check().with_context(|| format!("cannot render {} through a lens", shot.name))?;
        let set = if asked.vary_samples { u32::try_from(i / step).unwrap_or(u32::MAX) } else { 0 };
        Ok(PhotographJob { photograph, sampling: Sampling { count: asked.lens_samples, set }, focus_at })
    };
    all.iter().enumerate().map(photograph).collect::<Result<_>>().map(Some)
}

/// Returns the aperture of a shot in the scene's coordinates.
fn aperture(asked: &PhotographArgs, scene: &Scene, shot: &Shot) -> Result<Option<Aperture>> {
    let diameter = match (asked.aperture, asked.f_stop) {
        (Some(diameter), _) => diameter,
        (None, Some(f_stop)) => {
            let Some(metres) = scene.metres_per_unit else {
                bail!(
                    "--f-stop {f_stop}: the scene does not know how long its unit is, and an f-number is of a lens in millimetres; give \
                     --aperture DIAMETER in world units, or train on a data set with a known distance (luxel prepare --known-distance)"
                )
            };
            let focal_mm = shot.camera.focal_px.x * asked.sensor_width / f64::from(shot.camera.size_px[0]);
            1e-3 * focal_mm / f_stop / metres
        }
        (None, None) => return Ok(None),
    };
    let stated = asked.focus.or(shot.focus_distance);
    let focus = match (asked.focus_at, stated) {
        // Measured later.
        (Some(_), _) => scene.world_from_local.scale(),
        (None, Some(distance)) => distance,
        (None, None) => bail!("a lens needs something in focus; give --focus DISTANCE or --focus-at PX,PY"),
    };
    let unit = scene.world_from_local.scale();
    Ok(Some(Aperture { diameter: diameter / unit, focus_distance: focus / unit, blades: asked.blades }))
}

/// Takes photographs, and keeps the numbers to report.
pub(super) struct Photographer {
    /// Whether a number of samples was given, which is taken even if it leaves a pattern.
    has_number: bool,
    /// Distances in focus that were measured, with the camera that sees them.
    measured: Vec<(Camera, f64)>,
    taken: Vec<Quality>,
}

impl Photographer {
    /// Returns a photographer that has taken nothing yet.
    pub(super) fn new(asked: &PhotographArgs) -> Self {
        Self { has_number: asked.lens_samples.is_some(), measured: Vec::new(), taken: Vec::new() }
    }

    /// Renders a photograph, with coverage if it is asked for.
    pub(super) fn take(
        &mut self,
        job: &PhotographJob,
        scene: &Scene,
        engine: &mut dyn Engine,
        options: &RenderOptions,
        alpha: bool,
    ) -> Result<Layers> {
        let mut photograph = job.photograph.clone();
        if let (Some(aperture), Some((pixel, camera))) = (&mut photograph.aperture, &job.focus_at) {
            aperture.focus_distance = self.distance(*pixel, camera, scene, engine, options)? / scene.world_from_local.scale();
        }
        let Taken { image, alpha, quality } = photograph.take(engine, options, job.sampling, alpha)?;
        self.taken.push(quality);
        Ok(Layers { image, alpha, ..Layers::default() })
    }

    /// Returns the distance of the surface at a pixel, world units.
    fn distance(
        &mut self,
        pixel: [u32; 2],
        camera: &Camera,
        scene: &Scene,
        engine: &mut dyn Engine,
        options: &RenderOptions,
    ) -> Result<f64> {
        if let Some((_, distance)) = self.measured.iter().find(|(by, _)| by == camera) {
            return Ok(*distance);
        }
        let [x, y] = pixel;
        let found = surface_distance(scene, camera, pixel, options, engine).context("cannot measure the focus")?;
        let Some(distance) = found else { bail!("--focus-at {x},{y}: there is nothing at this pixel; choose another, or give --focus") };
        self.measured.push((camera.clone(), distance));
        Ok(distance)
    }

    /// Tells how many samples there were, and how much error they leave.
    pub(super) fn report(&self, console: &Console) {
        let samples = self.taken.iter().map(|quality| quality.samples);
        let (Some(least), Some(most)) = (samples.clone().min(), samples.max()) else { return };
        let error = self.taken.iter().map(|quality| quality.error).fold(0.0, f64::max);
        let count = if least == most { most.to_string() } else { format!("{least} to {most}") };
        let distances = || self.measured.iter().map(|(_, distance)| *distance);
        match [distances().fold(f64::INFINITY, f64::min), distances().fold(0.0, f64::max)].map(text::number) {
            _ if self.measured.is_empty() => {}
            [nearest, farthest] if nearest == farthest => console.note(&format!("in focus: {nearest} from the camera")),
            [nearest, farthest] => console.note(&format!("in focus: {nearest} to {farthest} from the cameras")),
        }
        console.note(&format!("{count} samples of the lens an image; estimated error at most {} %", text::number(100.0 * error)));
        if !self.has_number && error > TOLERANCE {
            let many = self.taken.iter().filter(|quality| quality.error > TOLERANCE).count();
            console.warn(&format!(
                "{} may show the pattern of the lens's samples, with an estimated error of up to {} %; --lens-samples takes up to 4096",
                text::plural(many, "image"),
                text::number(100.0 * error)
            ));
        }
    }
}
