//! Frames of a video, by a program that stands in for ffmpeg.

use std::os::unix::fs::PermissionsExt;

use luxel_io::encode_png;

use super::*;

/// Describes a video of 8 bits, decodes three black frames, and writes two.
fn write_ffmpeg(folder: &Path, curve: &str) -> std::path::PathBuf {
    let rgb8: Vec<u8> = (0..WIDTH * HEIGHT * 3).map(|i| (i * 7 % 251) as u8).collect();
    let frame = folder.join("frame.png");
    std::fs::write(&frame, encode_png(WIDTH, HEIGHT, &rgb8).unwrap()).unwrap();
    let other = folder.join("other.png");
    std::fs::write(&other, encode_png(WIDTH, HEIGHT, &rgb8.iter().map(|v| 255 - v).collect::<Vec<_>>()).unwrap()).unwrap();
    let (path, log) = (folder.join("ffmpeg"), folder.join("ffmpeg.log"));
    let script = format!(
        "#!/bin/sh\necho \"$@\" >> {log}\nfor last; do :; done\ncase \"$*\" in\n*rawvideo*) head -c {bytes} /dev/zero;;\n\
         *frame_*) cp {frame} \"${{last%/*}}/frame_00001.png\"; cp {other} \"${{last%/*}}/frame_00002.png\";;\n\
         *) echo '  Stream #0:0: Video: h264, yuv420p(tv, {curve}), 48x32' >&2; exit 1;;\nesac\n",
        log = log.display(),
        bytes = 3 * 960 * 540 * 3,
        frame = frame.display(),
        other = other.display()
    );
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

#[test]
fn the_sharpest_frames_of_a_video_become_views() {
    let folder = tempfile::tempdir().unwrap();
    let (video, output) = (folder.path().join("walk.mp4"), folder.path().join("set"));
    std::fs::write(&video, "a video").unwrap();
    let ffmpeg = write_ffmpeg(folder.path(), "bt709");
    let run = prepare(&video, &output, &["--frames", "2", "--ffmpeg", ffmpeg.to_str().unwrap()]);
    assert!(run.status.success() && said(&run).contains("2 of 3 frames are used"), "{}", said(&run));
    assert_eq!(report(&output)["views"][1]["name"], "frame_00002");
    let log = || std::fs::read_to_string(folder.path().join("ffmpeg.log")).unwrap();
    assert!(log().contains("select=eq(n\\,0)+eq(n\\,1) -fps_mode passthrough -pix_fmt rgb24"), "{}", log());
    // Another call takes the frames that are there; another number of frames does not.
    let calls = log().lines().count();
    let again = prepare(&video, &output, &["--frames", "2", "--ffmpeg", ffmpeg.to_str().unwrap()]);
    assert!(again.status.success() && log().lines().count() == calls, "{}", said(&again));
    let fewer = prepare(&video, &output, &["--frames", "3", "--ffmpeg", ffmpeg.to_str().unwrap()]);
    assert!(fewer.status.code() == Some(1) && said(&fewer).contains("ffmpeg wrote 2 frames, expected 3"), "{}", said(&fewer));
}

#[test]
fn a_video_in_hlg_is_light_through_its_curve_or_the_one_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("walk.mp4");
    std::fs::write(&video, "a video").unwrap();
    let ffmpeg = write_ffmpeg(folder.path(), "bt2020nc/bt2020/arib-std-b67");
    let convert = Conversion::between(ColorSpace::LinearRec2020, ColorSpace::LinearRec709);
    for (more, curve) in [(&[][..], luxel_io::Transfer::Hlg), (&["--transfer", "pq"], luxel_io::Transfer::Pq)] {
        let output = folder.path().join(curve.to_string());
        let arguments = [&["--frames", "2", "--ffmpeg", ffmpeg.to_str().unwrap()], more].concat();
        for _ in 0..2 {
            let run = prepare(&video, &output, &arguments);
            assert!(run.status.success(), "{}", said(&run));
            let read = read_image(&output.join("work/radiance/frame_00001.exr"), &ReadOptions::default()).unwrap();
            // Codes of the pixel in row 2, column 3, as the stand-in for ffmpeg wrote them.
            let code = |c: usize| ((2 * WIDTH + 3) * 3 + c) * 7 % 251;
            let light = convert.apply([0, 1, 2].map(|c| curve.light(code(c) as f64 / 255.0) as f32)).map(|v| v.max(0.0));
            let found = read.image.at(3, 2);
            assert!((0..3).all(|c| (found[c] - light[c]).abs() < 2e-3 * light[c].max(0.01)), "{curve} {found:?} {light:?}");
        }
    }
}

#[test]
fn a_video_without_ffmpeg_is_refused_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let (video, output) = (folder.path().join("walk.mov"), folder.path().join("set"));
    std::fs::write(&video, "a video").unwrap();
    let run = prepare(&video, &output, &["--ffmpeg", "/nowhere/ffmpeg"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("remedy: install ffmpeg"), "{}", said(&run));
    assert_eq!(prepare(&video, &output, &["--frames", "1"]).status.code(), Some(2));
}

/// A video without loss of four grey areas from black to white, of these codes.
fn write_grey_video(path: &Path, format: &str, codes: [u16; 4], facts: &[&str]) {
    use std::io::Write;
    let is_deep = format.ends_with("le");
    let bytes = |code: u16| if is_deep { code.to_le_bytes().to_vec() } else { vec![code as u8] };
    let bits = if format.contains("p12") {
        12
    } else if is_deep {
        10
    } else {
        8
    };
    let luma = (0..64).flat_map(|_| (0..256).flat_map(|x| bytes(codes[x / 64]))).collect::<Vec<u8>>();
    let chroma = (0..2 * 32 * 128).flat_map(|_| bytes(1 << (bits - 1))).collect::<Vec<u8>>();
    let frame = [luma, chroma].concat();
    let mut child = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", format, "-s", "256x64", "-r", "25", "-i", "-"])
        .args(facts)
        .args(["-c:v", "ffv1"])
        .arg(path)
        .stdin(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    for _ in 0..4 {
        child.stdin.as_mut().unwrap().write_all(&frame).unwrap();
    }
    assert!(child.wait().unwrap().success());
}

#[test]
#[ignore = "needs ffmpeg: cargo test --release -p luxel-cli --test program -- --ignored"]
fn levels_of_videos_are_those_of_their_codes() {
    let folder = tempfile::tempdir().unwrap();
    let (limited, full): (&[&str], &[&str]) =
        (&["-color_range", "tv", "-colorspace", "bt709"], &["-color_range", "pc", "-colorspace", "bt709"]);
    let hlg = ["-color_range", "tv", "-color_primaries", "bt2020", "-color_trc", "arib-std-b67"];
    let cases: [(&str, u16, bool, &[&str]); 9] = [
        ("yuv420p", 8, true, limited),
        ("yuv420p", 8, false, full),
        ("yuv420p", 8, true, &[]),
        ("yuv420p10le", 10, true, limited),
        ("yuv420p10le", 10, false, full),
        // Neither range nor matrix are stated.
        ("yuv420p10le", 10, true, &[]),
        ("yuv420p12le", 12, true, limited),
        ("yuv420p12le", 12, false, full),
        // A curve, but no matrix.
        ("yuv420p10le", 10, true, &hlg),
    ];
    for (i, (format, bits, is_limited, facts)) in cases.into_iter().enumerate() {
        let (video, output) = (folder.path().join(format!("{i}.mkv")), folder.path().join(format!("{i}")));
        let unit = 1u16 << (bits - 8);
        let most = ((1u32 << bits) - 1) as u16;
        let codes = if is_limited { [16 * unit, 126 * unit, 180 * unit, 235 * unit] } else { [0, most / 2, most / 4 * 3, most] };
        write_grey_video(&video, format, codes, facts);
        let run = prepare(&video, &output, &["--frames", "2"]);
        assert!(run.status.success(), "{}", said(&run));
        assert!(!said(&run).contains("darker"), "{}", said(&run));
        let png = image::open(output.join("frames/frame_00001.png")).unwrap().into_rgb16();
        for (area, code) in codes.into_iter().enumerate() {
            let level = match is_limited {
                true => f64::from(code - 16 * unit) / f64::from(219 * unit),
                false => f64::from(code) / f64::from(most),
            };
            let found = png.get_pixel(64 * area as u32 + 32, 32).0.map(|v| f64::from(v) / 65535.0);
            // Half a code of the file.
            let close = if bits == 8 { 0.51 / 255.0 } else { 1.5 / 65535.0 };
            assert!(found.iter().all(|v| (v - level).abs() <= close), "{format} {facts:?} {code}: {found:?}, expected {level}");
        }
    }
}
