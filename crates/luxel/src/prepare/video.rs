//! Frames of a video, by the system's ffmpeg.
//!
//! In: a video file and a number of views. Out: `frames/`, the sharpest frame of each window, as
//! PNG with 8 bits, or with 16 of videos that have more than 8; codes are the video's, as RGB.
//! Videos in PQ or HLG say so, and their frames are read through that curve, with Rec.2020's
//! primaries, as plates are. ffmpeg reads the video twice: for sharpness on reduced frames, then
//! for the chosen ones. Degenerate: frames that an earlier call extracted from the same file are
//! used again.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use luxel_capture::prepare::sharpest_frames;
use luxel_capture::{Proxy, sharpness};
use luxel_io::Transfer;

use super::PrepareOptions;
use super::folders::Folders;
use super::state::key;
use crate::error::{Context, bail};
use crate::files::{read_text, remove_if_there, write_text};
use crate::text::plural;
use crate::{Error, Observer, Remedy, Result};

/// Extensions of videos.
const VIDEOS: [&str; 10] = ["mp4", "mov", "mkv", "m4v", "avi", "webm", "mts", "m2ts", "mpg", "mpeg"];
/// Size at which sharpness is measured, pixels; of portraits too, which are compared with each
/// other only.
const MEASURED_PX: [usize; 2] = [960, 540];
/// Length of the file with the key, bytes.
const MAX_KEY_BYTES: u64 = 1 << 16;

/// Returns whether a path is a video by its name.
pub(super) fn is_video(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    VIDEOS.contains(&ending.as_str()) && path.is_file()
}

/// Frames of a video.
pub(super) struct Frames {
    /// Folder of their files.
    pub(super) folder: PathBuf,
    /// Curve that the video states, if it is one of light beyond white.
    pub(super) transfer: Option<Transfer>,
}

/// The facts about a stream of pictures that its frames depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stream {
    /// Whether samples have more than 8 bits.
    is_deep: bool,
    transfer: Option<Transfer>,
}

impl Stream {
    /// Reads it from what ffmpeg says about a video's stream, a line such as `Video: hevc (Main
    /// 10), yuv420p10le(tv, bt2020nc/bt2020/smpte2084), 3840x2160`.
    fn of_line(line: &str) -> Self {
        let has = |word: &str| line.contains(word);
        let is_deep = ["p10", "p12", "p16", "p010", "rgb48", "10le", "12le", "16le", "10be", "12be"].into_iter().any(has);
        let transfer = match () {
            () if has("smpte2084") => Some(Transfer::Pq),
            () if has("arib-std-b67") => Some(Transfer::Hlg),
            () => None,
        };
        Self { is_deep, transfer }
    }

    /// Returns a filter behind the choice of frames, and the pixel format of their files. ffmpeg's
    /// default conversion to RGB of 16 bits is a little too dark, which matters behind a steep
    /// curve; zscale is exact, but needs the matrix, which videos with such a curve state.
    fn encoding(self) -> (&'static str, &'static str) {
        match (self.transfer.is_some(), self.is_deep) {
            (true, true) => (",zscale=matrix=gbr:range=full,format=gbrp16le", "rgb48be"),
            (true, false) => (",zscale=matrix=gbr:range=full,format=gbrp", "rgb24"),
            (false, true) => ("", "rgb48be"),
            (false, false) => ("", "rgb24"),
        }
    }

    /// Returns what its frames are, for people; `given` is a curve that the caller names.
    fn words(self, given: Option<Transfer>) -> String {
        let bits = if self.is_deep { 16 } else { 8 };
        let curve = match (given, self.transfer) {
            (Some(given), _) => format!(", read through {given}"),
            (None, Some(stated)) => format!(", read through {stated}, which the video states"),
            (None, None) => String::new(),
        };
        format!("PNG with {bits} bits{curve}")
    }
}

/// Extracts frames.
pub(super) fn extract(options: &PrepareOptions, folders: &Folders, observer: &dyn Observer) -> Result<Frames> {
    let video = &options.photos;
    let frames = folders.output.join("frames");
    let metadata = std::fs::metadata(video).with_context(|| format!("{}: cannot read", video.display()))?;
    let facts = format!("{} {:?} {}", metadata.len(), metadata.modified().ok(), options.frames);
    let wanted = key([facts.as_str(), &*video.to_string_lossy()]);
    let key_path = folders.work.join("frames.key");
    let known = read_text(&key_path, MAX_KEY_BYTES).unwrap_or_default();
    if let Some(curve) = known.strip_prefix(&wanted).and_then(|rest| rest.strip_prefix('\n'))
        && frames.is_dir()
    {
        return Ok(Frames { folder: frames, transfer: curve.parse().ok() });
    }
    remove_if_there(&key_path)?;
    if frames.exists() {
        std::fs::remove_dir_all(&frames).with_context(|| format!("{}: cannot remove", frames.display()))?;
    }
    std::fs::create_dir_all(&frames).with_context(|| format!("{}: cannot create", frames.display()))?;
    let stream = Stream::of_line(&described(options)?);
    observer.note(&format!("measuring the sharpness of the frames of {}", video.display()));
    let sharpness = measured(options)?;
    if sharpness.is_empty() {
        bail!("{}: ffmpeg decodes no frame of it", video.display());
    }
    let chosen = sharpest_frames(&sharpness, options.frames);
    write_frames(options, &frames, stream, &chosen)?;
    let (total, count) = (plural(sharpness.len(), "frame"), chosen.len());
    observer.note(&format!("{count} of {total} are used, the sharpest of each window: {}", stream.words(options.transfer)));
    let curve = stream.transfer.map(|transfer| transfer.to_string()).unwrap_or_default();
    write_text(&key_path, &format!("{wanted}\n{curve}"))?;
    Ok(Frames { folder: frames, transfer: stream.transfer })
}

fn ffmpeg(options: &PrepareOptions) -> Command {
    let mut command = Command::new(&options.ffmpeg);
    command.args(["-hide_banner", "-nostdin", "-i"]).arg(&options.photos).stdin(Stdio::null());
    command
}

fn cannot_start(options: &PrepareOptions, error: &std::io::Error) -> Error {
    let remedy = Remedy::advice("install ffmpeg (Debian: apt-get install ffmpeg)").or(Remedy::give("ffmpeg"));
    Error::new(format!("{}: cannot start it, which reads videos: {error}", options.ffmpeg.display())).with_remedy(remedy)
}

/// Returns what ffmpeg says about the first stream of pictures.
fn described(options: &PrepareOptions) -> Result<String> {
    // Without an output ffmpeg fails, but describes the input before.
    let output = ffmpeg(options).output().map_err(|error| cannot_start(options, &error))?;
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let found = said.lines().find(|line| line.contains("Video:")).map(str::to_owned);
    found.ok_or_else(|| Error::new(format!("{}: ffmpeg finds no video in it: {}", options.photos.display(), last_line(&said))))
}

fn last_line(said: &str) -> &str {
    said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it says nothing").trim()
}

/// Returns the sharpness of each frame.
fn measured(options: &PrepareOptions) -> Result<Vec<f32>> {
    let [width, height] = MEASURED_PX;
    let mut child = ffmpeg(options)
        .args(["-v", "error", "-map", "0:v:0", "-vf"])
        .arg(format!("scale={width}:{height}:flags=area,format=rgb24"))
        .args(["-fps_mode", "passthrough", "-f", "rawvideo", "-"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| cannot_start(options, &error))?;
    // Read aside, so that neither pipe fills.
    let said = child.stderr.take().map(|mut stderr| {
        std::thread::spawn(move || {
            let mut text = Vec::new();
            // A message that cannot be read is left out.
            let _ = stderr.read_to_end(&mut text);
            String::from_utf8_lossy(&text).into_owned()
        })
    });
    let mut out = Vec::new();
    if let Some(mut pixels) = child.stdout.take() {
        let mut proxy = Proxy { width, height, rgb8: vec![0; width * height * 3], reduction: 1 };
        while pixels.read_exact(&mut proxy.rgb8).is_ok() {
            out.push(sharpness(&proxy));
        }
    }
    let status = child.wait().context("cannot wait for ffmpeg")?;
    let said = said.and_then(|thread| thread.join().ok()).unwrap_or_default();
    if !status.success() {
        bail!("{}: ffmpeg failed ({status}): {}; ffmpeg 5.1 or newer is needed", options.photos.display(), last_line(&said));
    }
    Ok(out)
}

/// Writes the chosen frames.
fn write_frames(options: &PrepareOptions, folder: &Path, stream: Stream, chosen: &[usize]) -> Result<()> {
    let terms: Vec<String> = chosen.iter().map(|frame| format!("eq(n\\,{frame})")).collect();
    let (filter, pixel_format) = stream.encoding();
    let output = ffmpeg(options)
        .args(["-v", "error", "-map", "0:v:0", "-vf"])
        .arg(format!("select={}{filter}", terms.join("+")))
        .args(["-fps_mode", "passthrough", "-pix_fmt", pixel_format])
        .arg(folder.join("frame_%05d.png"))
        .output()
        .map_err(|error| cannot_start(options, &error))?;
    let said = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        bail!("{}: ffmpeg failed ({}): {}", options.photos.display(), output.status, last_line(&said));
    }
    let count = std::fs::read_dir(folder).with_context(|| format!("{}: cannot list", folder.display()))?.count();
    if count != chosen.len() {
        bail!("{}: ffmpeg wrote {count} frames, expected {}: {}", folder.display(), chosen.len(), last_line(&said));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_and_curve_follow_from_the_stream() {
        let hdr = "Stream #0:0: Video: hevc (Main 10), yuv420p10le(tv, bt2020nc/bt2020/smpte2084), 3840x2160, 30 fps";
        let found = Stream::of_line(hdr);
        assert_eq!(found, Stream { is_deep: true, transfer: Some(Transfer::Pq) });
        assert_eq!(found.words(None), "PNG with 16 bits, read through pq, which the video states");
        assert_eq!(found.words(Some(Transfer::LogC4)), "PNG with 16 bits, read through logc4");
        let log = "Stream #0:0: Video: prores (HQ), yuv422p10le(tv, bt709, progressive), 3840x2160";
        assert_eq!(Stream::of_line(log), Stream { is_deep: true, transfer: None });
        let hlg = "Stream #0:0[0x1](und): Video: hevc (Main 10), yuv420p10le(tv, bt2020nc/bt2020/arib-std-b67), 1920x1080";
        assert_eq!(Stream::of_line(hlg).transfer, Some(Transfer::Hlg));
        let plain = "Stream #0:0[0x1](und): Video: h264 (High) (avc1 / 0x31637661), yuv420p(tv, bt709), 1080x1920";
        assert_eq!(Stream::of_line(plain), Stream { is_deep: false, transfer: None });
        assert_eq!(last_line("a\nInvalid data\n\n"), "Invalid data");
    }

    #[test]
    fn a_video_is_a_file_with_its_ending() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("walk.MP4");
        assert!(!is_video(&file));
        std::fs::write(&file, "").unwrap();
        assert!(is_video(&file) && !is_video(folder.path()));
    }
}
