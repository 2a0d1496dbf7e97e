//! A video of rendered frames, encoded by the system's ffmpeg.
//!
//! In: OpenEXR frames in the units of the data set. Out: an .mp4 in one of two forms, mastered by
//! `luxel::video`: SDR as H.264 of 8 bits; HDR10 as H.265 of 10 bits with the mastering display
//! (Rec.2020, 0.0001 cd/m2 to the peak; SMPTE ST 2086) and the content's light levels, which a
//! first sweep over the frames measures. 1 of the scene's scale times the exposure is white.

use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

use anyhow::{Context, Result, anyhow, bail};
use luxel::preview::Curve;
use luxel::video::{LightLevels, Mastering};
use luxel_app::output::{self, Recipe};
use luxel_app::text;
use luxel_core::{ColorSpace, Image, RadianceScale};
use luxel_io::{DisplayEncoding, ReadOptions};

use super::jobs::Job;
use super::plan::{INSTALL_FFMPEG, VideoPlan};
use crate::output::console;

/// A video to encode.
pub(super) struct Video<'a> {
    plan: &'a VideoPlan<'a>,
    /// Digest of what decides its content, which its comment has.
    made_by: String,
    is_made: bool,
}

impl<'a> Video<'a> {
    /// Finds out whether the video of these images is there, and refuses to replace another unless
    /// that is asked for.
    pub(super) fn find(plan: &'a VideoPlan<'a>, jobs: &[Job], overwrite: bool) -> Result<Self> {
        let recipe = Recipe::new("video").with("look", plan.mastering.recipe()).with("exposure", plan.exposure_ev);
        let recipe = recipe.with("fps", plan.frames_per_second);
        let made_by = jobs.iter().fold(recipe, |recipe, job| recipe.with("frame", &job.made_by)).digest();
        let is_made = contains(plan.path, made_by.as_bytes());
        if !is_made {
            output::check_free(plan.path, overwrite)?;
        }
        Ok(Self { plan, made_by, is_made })
    }

    /// Returns the name of the file.
    pub(super) fn path(&self) -> &Path {
        self.plan.path
    }

    /// Encodes `frames` in order unless the video is there; `radiance_scale` becomes 1. Returns
    /// what was done, in a line.
    pub(super) fn encode(self, frames: &[&Path], radiance_scale: RadianceScale) -> Result<String> {
        let VideoPlan { path, mastering, exposure_ev, frames_per_second, encoder } = self.plan;
        if self.is_made {
            return Ok(format!("{}: exists already and is kept", path.display()));
        }
        let gain = radiance_scale.normalised_value(exposure_ev.exp2());
        let (first, _) = read(frames.first().context("no frames to make a video of")?)?;
        let size_px = [first.width, first.height];
        let mut command = Command::new(encoder);
        command.args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo"]);
        command.args(input_options(mastering, size_px, *frames_per_second)).args(match mastering {
            Mastering::Sdr(curve) => sdr_options(curve),
            Mastering::Hdr10 { peak } => hdr10_options(*peak, light_levels(frames, gain, *peak)?),
        });
        command.args(["-metadata", &format!("comment={}={}", output::MADE_BY, self.made_by)]);
        let partial = partial(path);
        // A path may look like an option or like the name of a protocol.
        let mut target = OsString::from("file:");
        target.push(&partial.0);
        let spawned = command.arg(target).stdin(Stdio::piped()).spawn();
        let mut child =
            spawned.with_context(|| format!("{}: cannot start; {INSTALL_FFMPEG}, or name it with --ffmpeg", encoder.display()))?;
        let piped = child.stdin.take().context("ffmpeg takes no input").and_then(|pipe| feed(pipe, frames, size_px, gain, mastering));
        let status = child.wait().context("cannot wait for ffmpeg")?;
        if !status.success() {
            bail!("{}: ffmpeg failed ({status}); see its message above", path.display());
        }
        piped?;
        std::fs::rename(&partial.0, path).with_context(|| format!("{}: cannot give the video its name", path.display()))?;
        console::wrote(path);
        Ok(format!("{}: {}", path.display(), text::plural(frames.len(), "frame")))
    }
}

/// Writes the frames for ffmpeg.
fn feed(mut pipe: ChildStdin, frames: &[&Path], size_px: [usize; 2], gain: f32, mastering: &Mastering) -> Result<()> {
    for frame in frames {
        let (image, space) = read(frame)?;
        if [image.width, image.height] != size_px {
            let (w, h) = (image.width, image.height);
            bail!("{}: {w} x {h} pixels, expected {} x {} as the first frame", frame.display(), size_px[0], size_px[1]);
        }
        // As text: a broken pipe in the chain of causes means that the reader of standard output
        // has left.
        pipe.write_all(&mastering.code_values(&image, space, gain)?).map_err(|e| anyhow!("ffmpeg stopped reading: {e}"))?;
    }
    Ok(())
}

/// Returns whether a file has these bytes anywhere: containers have their comments at either end.
fn contains(path: &Path, bytes: &[u8]) -> bool {
    let Ok(mut file) = std::fs::File::open(path) else { return false };
    if !path.is_file() {
        return false;
    }
    let (mut window, mut buffer) = (Vec::<u8>::new(), vec![0; 1 << 20]);
    while let Ok(count @ 1..) = file.read(&mut buffer) {
        window.extend(buffer.iter().take(count));
        if window.windows(bytes.len()).any(|part| part == bytes) {
            return true;
        }
        window.drain(..window.len().saturating_sub(bytes.len() - 1));
    }
    false
}

/// The unfinished video; removed unless it was finished.
struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Returns a path beside the video with its extension, by which ffmpeg chooses the container.
fn partial(path: &Path) -> Partial {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Partial(path.with_file_name(format!(".luxel-{}-{name}", std::process::id())))
}

fn read(path: &Path) -> Result<(Image, ColorSpace)> {
    let decoded = luxel_io::read_image(path, &ReadOptions::default()).context("cannot read a frame back")?;
    Ok((decoded.image, decoded.color_space.unwrap_or_default()))
}

/// Measures the light levels of frames that are multiplied by `gain`, for a peak in cd/m2.
fn light_levels(frames: &[&Path], gain: f32, peak: f32) -> Result<LightLevels> {
    let mut levels = LightLevels::new(peak);
    for frame in frames {
        let (image, space) = read(frame)?;
        levels.add(&image, space, gain);
    }
    Ok(levels)
}

fn input_options(mastering: &Mastering, [width, height]: [usize; 2], frames_per_second: u32) -> Vec<String> {
    let pixels = match mastering {
        Mastering::Sdr(_) => "rgb24",
        Mastering::Hdr10 { .. } => "rgb48le",
    };
    ["-pix_fmt", pixels, "-s", &format!("{width}x{height}"), "-r", &frames_per_second.to_string(), "-i", "-"].map(str::to_owned).to_vec()
}

/// Odd sizes get a black row or column, as chroma is halved.
const EVEN: &str = "pad=ceil(iw/2)*2:ceil(ih/2)*2";

/// Returns codec and colour: colour is set on the frames, where the encoders look for it.
fn sdr_options(curve: &Curve) -> Vec<String> {
    let [primaries, curve] = curve.encoding().and_then(DisplayEncoding::ffmpeg).unwrap_or(["bt709", "iec61966-2-1"]);
    let filter = format!(
        "{EVEN},scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,setparams=color_primaries={primaries}:color_trc={curve}:colorspace=bt709"
    );
    ["-vf", &filter, "-c:v", "libx264", "-crf", "16", "-movflags", "+faststart"].map(str::to_owned).to_vec()
}

/// Returns codec, colour and metadata for a display of this peak, cd/m2.
fn hdr10_options(peak: f32, levels: LightLevels) -> Vec<String> {
    // ffmpeg's scale takes 65280 for white in 16 bits, and makes all brighter by it.
    let filter = format!(
        "{EVEN},zscale=matrix=2020_ncl:range=limited,format=yuv420p10le,setparams=color_primaries=bt2020:color_trc=smpte2084:colorspace=bt2020nc"
    );
    // In units of 0.00002 and 0.0001 cd/m2.
    let [r, g, b, w] = ColorSpace::LinearRec2020.chromaticities().map(|xy| xy.map(|v| (v * 50_000.0).round() as u32));
    let luminance = (peak * 10_000.0) as u64;
    let display = format!("G({},{})B({},{})R({},{})WP({},{})L({luminance},1)", g[0], g[1], b[0], b[1], r[0], r[1], w[0], w[1]);
    let (max_cll, max_fall) = (levels.most_of_a_pixel(), levels.most_of_a_frame());
    let parameters = format!(
        "log-level=error:hdr10=1:repeat-headers=1:colorprim=bt2020:transfer=smpte2084:colormatrix=bt2020nc:range=limited:\
         master-display={display}:max-cll={max_cll},{max_fall}"
    );
    ["-vf", &filter, "-c:v", "libx265", "-crf", "16", "-tag:v", "hvc1", "-x265-params", &parameters].map(str::to_owned).to_vec()
}
