//! A camera path through keyframes.
//!
//! In: cameras at times, the length of the path in seconds, its frame rate, how it starts and
//! stops, whether it is a loop, and the size of its images. Out: cameras named `frame_00000`. Eye,
//! direction and lens each follow a cubic Hermite spline over time, with the slopes of finite
//! differences (as between views); directions are unit quaternions on the shorter way. The vertical
//! field of view of a keyframe is kept, whatever its size and that of the images.
//!
//! The first frame is at 0 and the last at the end; in a loop the end is the first frame again, and
//! is left out. Degenerate: before the first keyframe and after the last the camera rests, and a
//! single keyframe is a camera that stands still.

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Distortion, MAX_SIDE_PX};
use luxel_io::PathCamera;

use super::hermite;
use crate::Result;
use crate::error::{bail, ensure};

/// Frames that a path may have.
pub const MAX_FRAMES: usize = 10_000;

/// Values of a keyframe: eye 3, quaternion 4, logarithms of the focal lengths and the principal
/// point, in heights of the image, 4.
const VALUES: usize = 11;

/// A camera at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Seconds since the start of the path.
    pub time_s: f64,
    /// The camera; its size matters as the unit of its lens alone.
    pub camera: Camera,
}

/// The places at which a path slows down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ease {
    /// Nowhere: it passes all keyframes at speed.
    #[default]
    Nowhere,
    /// It starts and ends at rest.
    Ends,
    /// It comes to rest at each keyframe.
    Keyframes,
}

/// The timing of a path and the size of its images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframeOptions {
    /// Length in seconds.
    pub duration_s: f64,
    /// Frames a second.
    pub frames_per_second: f64,
    /// The places at which it slows down.
    pub ease: Ease,
    /// Whether the end joins the beginning.
    pub is_closed: bool,
    /// Width and height of the images, pixels.
    pub size_px: [u32; 2],
}

impl KeyframeOptions {
    /// Returns the number of frames, at least 1.
    ///
    /// # Errors
    /// A length or rate that is not positive, or more than [`MAX_FRAMES`].
    pub fn frames(&self) -> Result<usize> {
        let (duration, rate) = (self.duration_s, self.frames_per_second);
        ensure!(duration.is_finite() && duration > 0.0, "the path takes {duration} seconds, expected a positive number");
        ensure!(rate.is_finite() && rate > 0.0, "{rate} frames a second, expected a positive number");
        let frames = (duration * rate).round();
        if frames > MAX_FRAMES as f64 {
            bail!("{duration} seconds of {rate} frames are {frames}, expected at most {MAX_FRAMES}");
        }
        Ok((frames as usize).max(1))
    }

    /// Returns the time of a frame of `count`, seconds.
    fn time(&self, i: usize, count: usize) -> f64 {
        let last = if self.is_closed { count } else { count - 1 };
        self.duration_s * i as f64 / last.max(1) as f64
    }
}

/// Returns the cameras of a path.
///
/// ```
/// use luxel::camera_path::keyframes::{Ease, Keyframe, KeyframeOptions, keyframe_path};
/// use luxel::synthetic::room_camera;
///
/// let keyframes = [0.0, 2.0].map(|time_s| Keyframe { time_s, camera: room_camera([64, 48]) });
/// let (duration_s, frames_per_second, size_px) = (2.0, 24.0, [160, 90]);
/// let (ease, is_closed) = (Ease::Ends, false);
/// let options = KeyframeOptions { duration_s, frames_per_second, ease, is_closed, size_px };
/// let path = keyframe_path(&keyframes, &options)?;
/// assert_eq!((path.len(), path[47].name.as_str()), (48, "frame_00047"));
/// assert_eq!(path[47].camera.size_px, [160, 90]);
/// # Ok::<(), luxel::Error>(())
/// ```
///
/// # Errors
/// No keyframes, times that do not rise or are beyond the length of the path, a camera or size that
/// cannot be rendered, too many frames.
pub fn keyframe_path(keyframes: &[Keyframe], options: &KeyframeOptions) -> Result<Vec<PathCamera>> {
    let count = options.frames()?;
    check(keyframes, options)?;
    let track = Track::new(keyframes, options);
    let camera = |i: usize| {
        let camera = camera_of(track.at(options.time(i, count)), options.size_px);
        camera.validate().map_err(|error| crate::Error::new(format!("frame {i} of the path: {error}")))?;
        Ok(PathCamera::new(format!("frame_{i:05}"), camera))
    };
    (0..count).map(camera).collect()
}

fn check(keyframes: &[Keyframe], options: &KeyframeOptions) -> Result<()> {
    let [width, height] = options.size_px;
    ensure!(
        (1..=MAX_SIDE_PX).contains(&width) && (1..=MAX_SIDE_PX).contains(&height),
        "images of {width} x {height} pixels, expected 1 to {MAX_SIDE_PX} a side"
    );
    ensure!(!keyframes.is_empty(), "the path has no keyframes, expected at least one");
    for (i, keyframe) in keyframes.iter().enumerate() {
        let projection = keyframe.camera.projection;
        ensure!(projection.is_pinhole(), "keyframe {i} has a camera with {} projection, expected pinholes", projection.name());
    }
    let mut before = f64::NEG_INFINITY;
    for (i, keyframe) in keyframes.iter().enumerate() {
        let time = keyframe.time_s;
        ensure!((0.0..=options.duration_s).contains(&time), "keyframe {i} is at {time} s, expected 0 to {} s", options.duration_s);
        if time <= before {
            bail!("keyframe {i} is at {time} s, expected a time after {before} s, that of the keyframe before");
        }
        keyframe.camera.validate().map_err(|error| crate::Error::new(format!("keyframe {i}: {error}")))?;
        before = time;
    }
    if options.is_closed && keyframes.len() > 1 && before - keyframes[0].time_s >= options.duration_s {
        bail!("the last keyframe of a loop is at its end, where the first is again; move it, or make the path longer");
    }
    Ok(())
}

/// Splines through the values of keyframes, with their slopes.
struct Track {
    times: Vec<f64>,
    values: Vec<[f64; VALUES]>,
    slopes: Vec<[f64; VALUES]>,
}

impl Track {
    fn new(keyframes: &[Keyframe], options: &KeyframeOptions) -> Self {
        let mut times: Vec<f64> = keyframes.iter().map(|keyframe| keyframe.time_s).collect();
        let mut values: Vec<[f64; VALUES]> = keyframes.iter().map(|keyframe| values_of(&keyframe.camera)).collect();
        let is_loop = options.is_closed && keyframes.len() > 1;
        if is_loop {
            // A round before and a round after, from which slopes at the seam come.
            let (n, round) = (times.len(), options.duration_s);
            times = [-round, 0.0, round].iter().flat_map(|by| times.iter().map(move |time| time + by)).collect();
            values = [&values[..], &values[..], &values[..]].concat();
            debug_assert_eq!(times.len(), 3 * n);
        }
        turn_the_shorter_way(&mut values);
        let last = times.len() - 1;
        let slope = |i: usize| -> [f64; VALUES] {
            let is_end = if is_loop { i.is_multiple_of(keyframes.len()) } else { i == 0 || i == last };
            let rests = options.ease == Ease::Keyframes || (options.ease == Ease::Ends && is_end);
            let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
            if rests || a == b {
                return [0.0; VALUES];
            }
            std::array::from_fn(|c| (values[b][c] - values[a][c]) / (times[b] - times[a]))
        };
        let slopes = (0..=last).map(slope).collect();
        Self { times, values, slopes }
    }

    fn at(&self, time: f64) -> [f64; VALUES] {
        let last = self.times.len() - 1;
        if last == 0 {
            return self.values[0];
        }
        let i = self.times.partition_point(|t| *t <= time).clamp(1, last) - 1;
        let step = self.times[i + 1] - self.times[i];
        let t = ((time - self.times[i]) / step).clamp(0.0, 1.0);
        std::array::from_fn(|c| {
            hermite([self.values[i][c], self.values[i + 1][c]], [self.slopes[i][c] * step, self.slopes[i + 1][c] * step], t)
        })
    }
}

/// Gives quaternions, which mean the same with all signs turned, those of the ones before them.
fn turn_the_shorter_way(values: &mut [[f64; VALUES]]) {
    for i in 1..values.len() {
        let dot: f64 = (3..7).map(|c| values[i][c] * values[i - 1][c]).sum();
        if dot < 0.0 {
            values[i][3..7].iter_mut().for_each(|value| *value = -*value);
        }
    }
}

fn values_of(camera: &Camera) -> [f64; VALUES] {
    let eye = camera.eye();
    let turn = DQuat::from_mat3(&camera.camera_from_world.matrix3.transpose()).to_array();
    let [w, h] = camera.size_px.map(f64::from);
    let (focal, center) = (camera.focal_px / h, (camera.center_px - 0.5 * DVec2::new(w, h)) / h);
    [eye.x, eye.y, eye.z, turn[0], turn[1], turn[2], turn[3], focal.x.ln(), focal.y.ln(), center.x, center.y]
}

fn camera_of(values: [f64; VALUES], size_px: [u32; 2]) -> Camera {
    let [x, y, z, a, b, c, d, focal_x, focal_y, center_x, center_y] = values;
    let turn = DQuat::from_array([a, b, c, d]).normalize();
    let camera_from_world = DMat3::from_quat(turn).transpose();
    let [w, h] = size_px.map(f64::from);
    Camera {
        camera_from_world: DAffine3 { matrix3: camera_from_world, translation: -(camera_from_world * DVec3::new(x, y, z)) },
        focal_px: DVec2::new(focal_x.exp(), focal_y.exp()) * h,
        center_px: 0.5 * DVec2::new(w, h) + DVec2::new(center_x, center_y) * h,
        size_px,
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::synthetic::room_camera;

    use super::*;

    fn keyframe(time_s: f64, eye: DVec3, angle: f64, focal: f64) -> Keyframe {
        let mut camera = room_camera([640, 480]);
        let matrix3 = DMat3::from_rotation_y(angle) * camera.camera_from_world.matrix3;
        camera.camera_from_world = DAffine3 { matrix3, translation: -(matrix3 * eye) };
        camera.focal_px = DVec2::splat(focal);
        Keyframe { time_s, camera }
    }

    fn three() -> [Keyframe; 3] {
        [
            keyframe(0.0, DVec3::ZERO, 0.0, 400.0),
            keyframe(1.0, DVec3::new(1.0, 0.5, 0.0), 0.4, 500.0),
            keyframe(2.0, DVec3::new(1.0, 2.0, 1.0), 2.9, 400.0),
        ]
    }

    const OPTIONS: KeyframeOptions =
        KeyframeOptions { duration_s: 2.0, frames_per_second: 20.5, ease: Ease::Nowhere, is_closed: false, size_px: [640, 480] };

    fn distance(a: &Camera, b: &Camera) -> f64 {
        let turn = (a.camera_from_world.matrix3 - b.camera_from_world.matrix3).to_cols_array().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        turn.max(a.eye().distance(b.eye())).max((a.focal_px - b.focal_px).length() / 100.0)
    }

    #[test]
    fn a_path_goes_through_its_keyframes() {
        let path = keyframe_path(&three(), &OPTIONS).unwrap();
        assert_eq!(path.len(), 41);
        for (frame, keyframe) in [0, 20, 40].into_iter().zip(three()) {
            assert!(distance(&path[frame].camera, &keyframe.camera) < 1e-12, "{frame}");
        }
        let (mut longest, mut shortest) = (0.0f64, f64::INFINITY);
        for pair in path.windows(2) {
            let step = pair[0].camera.eye().distance(pair[1].camera.eye());
            (longest, shortest) = (longest.max(step), shortest.min(step));
        }
        assert!(longest < 0.15 && shortest > 0.02, "{shortest} to {longest}");
    }

    #[test]
    fn a_loop_passes_its_seam_at_speed_and_without_a_jump() {
        let options = KeyframeOptions { duration_s: 3.0, frames_per_second: 100.0, is_closed: true, ..OPTIONS };
        let path = keyframe_path(&three(), &options).unwrap();
        assert_eq!(path.len(), 300);
        let eye = |i: usize| path[i % 300].camera.eye();
        let steps = [298, 299, 300, 301].map(|i| eye(i + 1) - eye(i));
        for pair in steps.windows(2) {
            assert!((pair[0] - pair[1]).length() < 0.15 * pair[0].length(), "{steps:?}");
        }
    }

    #[test]
    fn easing_rests_at_the_ends_or_at_every_keyframe() {
        let steps = |ease| -> Vec<f64> {
            let path = keyframe_path(&three(), &KeyframeOptions { ease, frames_per_second: 100.5, ..OPTIONS }).unwrap();
            path.windows(2).map(|pair| pair[0].camera.eye().distance(pair[1].camera.eye())).collect()
        };
        let (none, ends, all) = (steps(Ease::Nowhere), steps(Ease::Ends), steps(Ease::Keyframes));
        for (i, [rests_at_ends, rests_everywhere]) in [(0, [true, true]), (100, [false, true]), (199, [true, true])] {
            assert_eq!([ends[i] < 0.2 * none[i], all[i] < 0.2 * none[i]], [rests_at_ends, rests_everywhere], "{i}");
        }
    }

    #[test]
    fn the_field_of_view_is_that_of_the_keyframe_in_any_size() {
        let path = keyframe_path(&three()[..1], &KeyframeOptions { size_px: [320, 120], ..OPTIONS }).unwrap();
        let camera = &path[5].camera;
        assert!((camera.focal_px - DVec2::splat(100.0)).length() < 1e-9 && (camera.center_px - DVec2::new(160.0, 60.0)).length() < 1e-9);
    }

    #[test]
    fn what_cannot_be_a_path_is_refused_with_the_place() {
        let refused = |keyframes: &[Keyframe], options: KeyframeOptions| keyframe_path(keyframes, &options).unwrap_err().to_string();
        assert!(refused(&[], OPTIONS).contains("no keyframes"));
        let error = refused(&three(), KeyframeOptions { duration_s: 1e5, frames_per_second: 10.0, ..OPTIONS });
        assert!(error.contains("expected at most 10000"), "{error}");
        for duration_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(refused(&three(), KeyframeOptions { duration_s, ..OPTIONS }).contains("positive"));
        }
        assert!(refused(&three(), KeyframeOptions { duration_s: 1.5, ..OPTIONS }).contains("keyframe 2 is at 2 s"));
        assert!(refused(&three(), KeyframeOptions { is_closed: true, ..OPTIONS }).contains("loop"));
        let [a, b, _] = three();
        assert!(refused(&[b.clone(), a.clone()], OPTIONS).contains("keyframe 1 is at 0 s, expected a time after 1 s"));
        assert!(refused(&[a], KeyframeOptions { size_px: [0, 480], ..OPTIONS }).contains("0 x 480"));
    }
}
