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

use luxel::error::{Context, bail};
use luxel::{Error, Observer, Remedy, Result};
use luxel_capture::prepare::sharpest_frames;
use luxel_capture::{Proxy, sharpness};
use luxel_io::Transfer;

use super::PrepareOptions;
use super::folders::Folders;
use super::state::key;
use crate::files::{read_text, remove_if_there, write_text};
use crate::text::plural;

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
    /// Whether the matrix from luma and chroma to RGB is stated.
    has_matrix: bool,
    transfer: Option<Transfer>,
    /// Width of a pixel to its height, where it is another.
    aspect: Option<[u32; 2]>,
    /// Whether a frame is woven of two fields of different times.
    is_interlaced: bool,
}

/// Makes pixels square: the side that is too short for the picture is stretched.
const SQUARE_PIXELS: &str = ",scale=w=if(gt(sar\\,1)\\,round(iw*sar)\\,iw):h=if(gt(sar\\,1)\\,ih\\,round(ih/sar))\
                             :flags=bicubic+accurate_rnd+full_chroma_int+full_chroma_inp,setsar=1";

impl Stream {
    /// Reads it from what ffmpeg says about a video's stream, a line such as `Video: hevc (Main
    /// 10), yuv420p10le(tv, bt2020nc/bt2020/smpte2084), 3840x2160`.
    fn of_line(line: &str) -> Self {
        let video = line.split_once("Video:").map_or(line, |(_, video)| video);
        // The pixel format follows the codec; what is known of its colours follows it at once.
        let (format, facts) = fields(video).get(1).map_or(("", ""), |field| field.split_once('(').unwrap_or((field, "")));
        let colors = || fields(facts.trim_end_matches(')')).into_iter().flat_map(|fact| fact.split('/').next());
        let has = |word: &str| facts.contains(word);
        let transfer = match () {
            () if has("smpte2084") => Some(Transfer::Pq),
            () if has("arib-std-b67") => Some(Transfer::Hlg),
            () => None,
        };
        // Formats of more than 8 bits, and a few of fewer, say which byte comes first.
        let is_small = ["rgb565", "bgr565", "rgb555", "bgr555", "rgb444", "bgr444"].iter().any(|small| format.starts_with(small));
        let is_deep = (format.ends_with("le") || format.ends_with("be")) && !is_small;
        let has_matrix = colors().any(|color| MATRICES.contains(&color));
        let is_interlaced = ["top first", "bottom first", "top coded first", "bottom coded first"].into_iter().any(has);
        Self { is_deep, has_matrix, transfer, aspect: pixel_aspect(video), is_interlaced }
    }

    /// Returns how ffmpeg makes RGB of its frames.
    ///
    /// swscale, which ffmpeg uses by default, takes 255 * 256 for white in 16 bits: all is darker
    /// by 0.4 %, which a steep curve makes a tenth of a stop of. zscale is exact. It needs the
    /// matrix; where none is stated, it gets Rec.2020's with a curve of that, and otherwise
    /// Rec.601's, which swscale takes. In 8 bits swscale is exact with the flags of
    /// [`write_frames`].
    fn conversion(self) -> Conversion {
        let (format, png) = if self.is_deep { ("gbrp16le", "rgb48be") } else { ("gbrp", "rgb24") };
        let matrix = match (self.has_matrix, self.transfer.is_some()) {
            (true, _) => "",
            (false, true) => "matrixin=2020_ncl:",
            (false, false) => "matrixin=170m:",
        };
        let is_exact = self.is_deep || self.transfer.is_some();
        let filter = if is_exact { format!(",zscale={matrix}matrix=gbr:range=full,format={format}") } else { String::new() };
        Conversion { filter: filter + self.square(), png }
    }

    /// Returns how ffmpeg makes RGB of frames that zscale cannot convert, such as grey ones, or
    /// where ffmpeg has no zscale; `None` where that would not do, because the curve is steep.
    fn rougher_conversion(self) -> Option<Conversion> {
        (self.is_deep && self.transfer.is_none()).then(|| Conversion { filter: self.square().to_owned(), png: "rgb48be" })
    }

    /// Returns what makes its pixels square.
    fn square(self) -> &'static str {
        if self.aspect.is_some() { SQUARE_PIXELS } else { "" }
    }

    /// Returns what its frames are, for people; `given` is a curve that the caller names.
    fn words(self, given: Option<Transfer>) -> String {
        let bits = if self.is_deep { 16 } else { 8 };
        let curve = match (given, self.transfer) {
            (Some(given), _) => format!(", read through {given}"),
            (None, Some(stated)) => format!(", read through {stated}, which the video states"),
            (None, None) => String::new(),
        };
        let stretched = self.aspect.map(|[a, b]| format!(", stretched to square pixels from {a}:{b}")).unwrap_or_default();
        format!("PNG with {bits} bits{curve}{stretched}")
    }
}

/// Returns the width of a pixel to its height that ffmpeg states, `[SAR 4:3 DAR 16:9]`, where they
/// differ.
fn pixel_aspect(video: &str) -> Option<[u32; 2]> {
    let (_, behind) = video.split_once("SAR ")?;
    let (a, rest) = behind.split_once(':')?;
    let b: String = rest.chars().take_while(char::is_ascii_digit).collect();
    let aspect = [a.parse().ok()?, b.parse().ok()?];
    (aspect[0] != aspect[1] && !aspect.contains(&0)).then_some(aspect)
}

/// The matrices by the names that ffmpeg prints.
const MATRICES: [&str; 12] = [
    "gbr",
    "bt709",
    "fcc",
    "bt470bg",
    "smpte170m",
    "smpte240m",
    "ycgco",
    "bt2020nc",
    "bt2020c",
    "chroma-derived-nc",
    "chroma-derived-c",
    "ictcp",
];

/// Returns what commas separate outside of parentheses, trimmed.
fn fields(text: &str) -> Vec<&str> {
    let mut depth = 0;
    let is_end = |c: char| {
        depth += i32::from(c == '(') - i32::from(c == ')');
        c == ',' && depth == 0
    };
    text.split(is_end).map(str::trim).collect()
}

/// From the pixels of a video to RGB.
#[derive(Debug, PartialEq, Eq)]
struct Conversion {
    /// The filters, each behind a comma.
    filter: String,
    /// The pixel format of the PNG files.
    png: &'static str,
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
    if stream.is_interlaced {
        observer.warn(&format!(
            "{}: interlaced, so that each frame is of two moments and shows combs where anything moves; deinterlace it first (ffmpeg -vf bwdif)",
            video.display()
        ));
    }
    observer.note(&format!("measuring the sharpness of the frames of {}", video.display()));
    let sharpness = measured(options)?;
    if sharpness.is_empty() {
        bail!("{}: ffmpeg decodes no frame of it", video.display());
    }
    let chosen = sharpest_frames(&sharpness, options.frames);
    match (write_frames(options, &frames, &stream.conversion(), &chosen), stream.rougher_conversion()) {
        (Err(error), Some(rougher)) => {
            write_frames(options, &frames, &rougher, &chosen)?;
            observer.note(&format!("frames are up to 0.4 % darker than the video, because ffmpeg's zscale does not convert it: {error}"));
        }
        (found, _) => found?,
    }
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
fn write_frames(options: &PrepareOptions, folder: &Path, conversion: &Conversion, chosen: &[usize]) -> Result<()> {
    let terms: Vec<String> = chosen.iter().map(|frame| format!("eq(n\\,{frame})")).collect();
    let output = ffmpeg(options)
        .args(["-y", "-v", "error", "-map", "0:v:0", "-sws_flags", "accurate_rnd+full_chroma_int+full_chroma_inp", "-vf"])
        .arg(format!("select={}{}", terms.join("+"), conversion.filter))
        .args(["-fps_mode", "passthrough", "-pix_fmt", conversion.png])
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
    fn pixels_that_are_not_square_and_fields_are_seen() {
        let line = "Stream #0:0: Video: h264 (High), yuv420p(tv, bt709, top first), 320x240 [SAR 4:3 DAR 16:9], 10 fps";
        let stream = Stream::of_line(line);
        assert!(stream.is_interlaced && stream.aspect == Some([4, 3]), "{stream:?}");
        assert!(stream.conversion().filter.contains("round(iw*sar)") && stream.words(None).contains("from 4:3"));
        let square = Stream::of_line("Video: h264, yuv420p(progressive), 320x240 [SAR 1:1 DAR 4:3], 10 fps");
        assert!(!square.is_interlaced && square.aspect.is_none() && square.conversion().filter.is_empty());
    }

    #[test]
    fn depth_and_curve_follow_from_the_stream() {
        let hdr = "Stream #0:0: Video: hevc (Main 10), yuv420p10le(tv, bt2020nc/bt2020/smpte2084), 3840x2160, 30 fps";
        let found = Stream::of_line(hdr);
        assert_eq!(found, Stream { is_deep: true, has_matrix: true, transfer: Some(Transfer::Pq), aspect: None, is_interlaced: false });
        assert_eq!(found.words(None), "PNG with 16 bits, read through pq, which the video states");
        assert_eq!(found.words(Some(Transfer::LogC4)), "PNG with 16 bits, read through logc4");
        let log = "Stream #0:0: Video: prores (HQ), yuv422p10le(tv, bt709, progressive), 3840x2160";
        assert_eq!(Stream::of_line(log), Stream { is_deep: true, has_matrix: true, transfer: None, aspect: None, is_interlaced: false });
        let hlg = "Stream #0:0[0x1](und): Video: hevc (Main 10), yuv420p10le(tv, bt2020nc/bt2020/arib-std-b67), 1920x1080";
        assert_eq!(Stream::of_line(hlg).transfer, Some(Transfer::Hlg));
        let plain = "Stream #0:0[0x1](und): Video: h264 (High) (avc1 / 0x31637661), yuv420p(tv, bt709), 1080x1920";
        assert_eq!(Stream::of_line(plain), Stream { is_deep: false, has_matrix: true, transfer: None, aspect: None, is_interlaced: false });
        assert_eq!(last_line("a\nInvalid data\n\n"), "Invalid data");
    }

    #[test]
    fn depth_is_that_of_the_pixel_format_and_a_matrix_may_be_missing() {
        let of = |format: &str| Stream::of_line(&format!("  Stream #0:0: Video: x (Main 4:2:2, a p10 b) (v210 / 0x1), {format}, 256x64"));
        let deep = ["yuv422p10le", "gbrp14le(pc, gbr/unknown/unknown)", "p010le(tv)", "gray16be", "rgb48le", "yuva444p12le(progressive)"];
        assert!(deep.iter().all(|format| of(format).is_deep));
        assert!(
            ["yuv420p", "nv12(tv, bt709)", "rgb24", "rgb565le", "yuvj422p(pc, bt470bg/unknown/unknown)", "pal8"]
                .iter()
                .all(|format| !of(format).is_deep)
        );
        let stated = ["yuv420p10le(pc, bt709/unknown/unknown, progressive)", "yuv420p10le(smpte170m)", "gbrp10le(pc, gbr/bt709/bt709)"];
        assert!(stated.iter().all(|format| of(format).has_matrix));
        let unknown = ["yuv420p10le", "yuv420p10le(progressive)", "yuv420p10le(tv, unknown/bt709/bt709, top first)"];
        assert!(unknown.iter().all(|format| !of(format).has_matrix));
        let hlg = of("yuv420p10le(tv, unknown/bt2020/arib-std-b67)");
        assert_eq!((hlg.has_matrix, hlg.transfer), (false, Some(Transfer::Hlg)));
        assert_eq!(hlg.conversion().filter, ",zscale=matrixin=2020_ncl:matrix=gbr:range=full,format=gbrp16le");
        assert_eq!(of(unknown[0]).conversion().filter, ",zscale=matrixin=170m:matrix=gbr:range=full,format=gbrp16le");
        assert_eq!(
            of(stated[0]).conversion(),
            Conversion { filter: ",zscale=matrix=gbr:range=full,format=gbrp16le".into(), png: "rgb48be" }
        );
        assert_eq!(of("yuv420p(tv, bt709)").conversion(), Conversion { filter: String::new(), png: "rgb24" });
        assert!(
            of("gray16le").rougher_conversion().is_some()
                && hlg.rougher_conversion().is_none()
                && of("yuv420p").rougher_conversion().is_none()
        );
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
