//! A video of rendered frames, encoded by the system's ffmpeg.
//!
//! In: OpenEXR frames in the units of the data set. Out: an .mp4 in one of two forms:
//! - SDR: the tone curve's display values, 8 bits, H.264, Rec.709 primaries with sRGB's curve;
//! - HDR10: Rec.2020, perceptual quantizer (SMPTE ST 2084), 10 bits, H.265, with the mastering
//!   display (Rec.2020, 0.0001 cd/m2 to the peak; SMPTE ST 2086) and the content's light levels
//!   (CTA-861.3), which a first sweep over the frames measures. 1 of the scene's scale times the
//!   exposure is reference white, 203 cd/m2 (ITU-R BT.2408).

use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

use anyhow::{Context, Result, anyhow, bail};
use luxel::preview::{self, Curve};
use luxel_app::output::{self, Recipe};
use luxel_app::text;
use luxel_core::tone::{REFERENCE_WHITE_NITS, display_rgb8, pq_encode, rec709_of};
use luxel_core::{ColorSpace, Conversion, Image, RadianceScale};
use luxel_io::{DisplayEncoding, ReadOptions};
use rayon::prelude::*;

use super::{Job, Making};
use crate::args::RenderArgs;
use crate::inputs::programs;
use crate::output::console;

/// Highlights keep their values up to this part of the peak.
const KNEE: f32 = 0.5;

/// The form of the video.
#[derive(Debug)]
enum Look {
    Sdr(Curve),
    Hdr10 { peak: f32 },
}

/// The remedy where the program is missing.
const INSTALL: &str = "install ffmpeg (Debian: apt-get install ffmpeg)";

/// Extensions by which ffmpeg chooses a container for both forms.
const EXTENSIONS: [&str; 3] = ["mp4", "mov", "mkv"];

/// Refuses a video that could not be made, whatever the frames are.
pub(super) fn check(args: &RenderArgs, path: &Path, curve: Option<&Curve>) -> Result<()> {
    output::check_extension(path, &EXTENSIONS)?;
    if path.is_dir() {
        bail!("{}: is a folder, expected a name for a file", path.display());
    }
    if args.stereo.is_some() {
        bail!("--video shows one eye, and --stereo renders two; leave one of them out");
    }
    look(args, curve)?;
    // Before any frame is rendered, which may take hours.
    programs::require(&args.ffmpeg, "--ffmpeg", INSTALL)
}

fn look(args: &RenderArgs, curve: Option<&Curve>) -> Result<Look> {
    Ok(match (args.hdr10, curve) {
        (Some(peak), _) => Look::Hdr10 { peak: peak as f32 },
        (None, Some(curve)) => Look::Sdr(curve.clone()),
        (None, None) => bail!("--video needs --tonemap CURVE or --ocio CONFIG for SDR, or --hdr10"),
    })
}

/// A video to encode.
pub(super) struct Video<'a> {
    path: &'a Path,
    look: Look,
    /// Digest of what decides its content, which its comment has.
    made_by: String,
    is_made: bool,
}

impl<'a> Video<'a> {
    /// Finds out whether the video is there, and refuses to replace another unless that is asked
    /// for.
    pub(super) fn plan(making: &Making<'_>, path: &'a Path, jobs: &[Job]) -> Result<Self> {
        let args = making.args;
        let look = look(args, making.curve.as_ref())?;
        let form = match &look {
            Look::Sdr(curve) => format!("Sdr({})", curve.recipe()),
            Look::Hdr10 { .. } => format!("{look:?}"),
        };
        let mut recipe = Recipe::new("video").with("look", form).with("exposure", args.exposure).with("fps", args.fps);
        for job in jobs {
            recipe = recipe.with("frame", &job.made_by);
        }
        let made_by = recipe.digest();
        let is_made = contains(path, made_by.as_bytes());
        if !is_made {
            output::check_free(path, args.overwrite)?;
        }
        Ok(Self { path, look, made_by, is_made })
    }

    /// Encodes `frames` in order unless the video is there; `radiance_scale` becomes 1. Returns
    /// what was done, in a line.
    pub(super) fn encode(self, args: &RenderArgs, frames: &[&Path], radiance_scale: RadianceScale) -> Result<String> {
        let (path, look) = (self.path, &self.look);
        if self.is_made {
            return Ok(format!("{}: exists already and is kept", path.display()));
        }
        let gain = radiance_scale.normalised_value(args.exposure.exp2());
        let levels = match look {
            Look::Hdr10 { peak } => light_levels(frames, gain, *peak)?,
            Look::Sdr(_) => [0; 2],
        };
        let (first, _) = read(frames.first().context("no frames to make a video of")?)?;
        let size = [first.width, first.height];
        let mut command = Command::new(&args.ffmpeg);
        command.args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo"]).args(input_options(look, size, args.fps));
        command.args(output_options(look, levels)).args(["-metadata", &format!("comment={}={}", output::MADE_BY, self.made_by)]);
        let partial = partial(path);
        // A path may look like an option or like the name of a protocol.
        let mut target = OsString::from("file:");
        target.push(&partial.0);
        let spawned = command.arg(target).stdin(Stdio::piped()).spawn();
        let mut child = spawned.with_context(|| format!("{}: cannot start; {INSTALL}, or name it with --ffmpeg", args.ffmpeg.display()))?;
        let piped = child.stdin.take().context("ffmpeg takes no input").and_then(|pipe| feed(pipe, frames, size, gain, look));
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
fn feed(mut pipe: ChildStdin, frames: &[&Path], size: [usize; 2], gain: f32, look: &Look) -> Result<()> {
    for frame in frames {
        let (image, space) = read(frame)?;
        if [image.width, image.height] != size {
            let (w, h) = (image.width, image.height);
            bail!("{}: {w} x {h} pixels, expected {} x {} as the first frame", frame.display(), size[0], size[1]);
        }
        // As text: a broken pipe in the chain of causes means that the reader of standard output
        // has left.
        pipe.write_all(&samples(&image, space, gain, look)?).map_err(|e| anyhow!("ffmpeg stopped reading: {e}"))?;
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

/// Returns the bytes of a frame for ffmpeg.
fn samples(image: &Image, space: ColorSpace, gain: f32, look: &Look) -> Result<Vec<u8>> {
    Ok(match look {
        Look::Sdr(Curve::Tonemap(tonemap)) => {
            image.pixels.par_iter().flat_map_iter(|p| display_rgb8(*tonemap, 0.0, rec709_of(space, p.map(|c| c * gain)))).collect()
        }
        Look::Sdr(curve) => {
            let mut shown = image.clone();
            shown.pixels.par_iter_mut().for_each(|p| *p = space.light(*p).map(|c| c * gain));
            preview::Look { curve: curve.clone(), exposure_ev: 0.0 }.rgb8(&shown, space.linear())?.into_flattened()
        }
        Look::Hdr10 { peak } => {
            let conversion = Conversion::between(space, ColorSpace::LinearRec2020);
            let word = |nits: f32| ((pq_encode(nits) * 65535.0 + 0.5) as u16).to_le_bytes();
            image.pixels.par_iter().flat_map_iter(|p| nits(&conversion, *p, gain, *peak).into_iter().flat_map(word)).collect()
        }
    })
}

/// Returns the display light of a radiance in cd/m2: the largest channel rolls off above the knee
/// towards the peak, and hue is kept.
fn nits(conversion: &Conversion, radiance: [f32; 3], gain: f32, peak: f32) -> [f32; 3] {
    let rgb = conversion.apply(radiance).map(|c| if c > 0.0 { (c * gain * REFERENCE_WHITE_NITS).min(1e9) } else { 0.0 });
    let largest = rgb.into_iter().fold(0.0, f32::max);
    let knee = KNEE * peak;
    if largest <= knee {
        return rgb;
    }
    // x / (1 + x) above the knee: continuous in value and slope.
    let x = (largest - knee) / (peak - knee);
    let rolled = knee + (peak - knee) * x / (1.0 + x);
    rgb.map(|c| c * rolled / largest)
}

/// Returns MaxCLL and MaxFALL in cd/m2: the brightest channel of any pixel, and the greatest mean
/// of it over the pixels of a frame.
fn light_levels(frames: &[&Path], gain: f32, peak: f32) -> Result<[u32; 2]> {
    let (mut brightest, mut average) = (0f32, 0f64);
    for frame in frames {
        let (image, space) = read(frame)?;
        let conversion = Conversion::between(space, ColorSpace::LinearRec2020);
        let light: Vec<f32> = image.pixels.iter().map(|p| nits(&conversion, *p, gain, peak).into_iter().fold(0.0, f32::max)).collect();
        brightest = light.iter().copied().fold(brightest, f32::max);
        average = average.max(light.iter().map(|v| f64::from(*v)).sum::<f64>() / light.len().max(1) as f64);
    }
    Ok([brightest.ceil() as u32, average.ceil() as u32])
}

fn input_options(look: &Look, [width, height]: [usize; 2], fps: u32) -> Vec<String> {
    let pixels = match look {
        Look::Sdr(_) => "rgb24",
        Look::Hdr10 { .. } => "rgb48le",
    };
    ["-pix_fmt", pixels, "-s", &format!("{width}x{height}"), "-r", &fps.to_string(), "-i", "-"].map(str::to_owned).to_vec()
}

/// Returns codec, colour and metadata: colour is set on the frames, where the encoders look for it.
/// Odd sizes get a black row or column, as chroma is halved.
fn output_options(look: &Look, [max_cll, max_fall]: [u32; 2]) -> Vec<String> {
    let even = "pad=ceil(iw/2)*2:ceil(ih/2)*2";
    let words = |options: &[&str]| options.iter().map(|word| (*word).to_owned()).collect();
    match look {
        Look::Sdr(curve) => {
            let [primaries, curve] = curve.encoding().and_then(DisplayEncoding::ffmpeg).unwrap_or(["bt709", "iec61966-2-1"]);
            words(&[
                "-vf",
                &format!(
                    "{even},scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,setparams=color_primaries={primaries}:color_trc={curve}:colorspace=bt709"
                ),
                "-c:v",
                "libx264",
                "-crf",
                "16",
                "-movflags",
                "+faststart",
            ])
        }
        Look::Hdr10 { peak } => {
            // In units of 0.00002 and 0.0001 cd/m2.
            let [r, g, b, w] = ColorSpace::LinearRec2020.chromaticities().map(|xy| xy.map(|v| (v * 50_000.0).round() as u32));
            let display = format!(
                "G({},{})B({},{})R({},{})WP({},{})L({},1)",
                g[0],
                g[1],
                b[0],
                b[1],
                r[0],
                r[1],
                w[0],
                w[1],
                (peak * 10_000.0) as u64
            );
            words(&[
                "-vf",
                // ffmpeg's scale takes 65280 for white in 16 bits, and makes all brighter by it.
                &format!(
                    "{even},zscale=matrix=2020_ncl:range=limited,format=yuv420p10le,setparams=color_primaries=bt2020:color_trc=smpte2084:colorspace=bt2020nc"
                ),
                "-c:v",
                "libx265",
                "-crf",
                "16",
                "-tag:v",
                "hvc1",
                "-x265-params",
                &format!(
                    "log-level=error:hdr10=1:repeat-headers=1:colorprim=bt2020:transfer=smpte2084:colormatrix=bt2020nc:range=limited:\
                     master-display={display}:max-cll={max_cll},{max_fall}"
                ),
            ])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn highlights_roll_off_smoothly_and_below_the_peak() {
        let same = Conversion::between(ColorSpace::LinearRec2020, ColorSpace::LinearRec2020);
        let of = |v: f32| nits(&same, [v, 0.5 * v, 0.0], 1.0, 1000.0);
        assert_eq!(of(1.0), [203.0, 101.5, 0.0]);
        let mut last = 0.0;
        for step in 0..2000 {
            let [r, g, _] = of(0.05 * step as f32);
            assert!(r >= last && r < 1000.0 && r - last < 12.0 && (g - 0.5 * r).abs() < 1e-3, "{r} after {last}");
            last = r;
        }
        assert_eq!(of(f32::NAN), [0.0; 3]);
        assert!(of(f32::INFINITY)[0] <= 1000.0);
    }
}
