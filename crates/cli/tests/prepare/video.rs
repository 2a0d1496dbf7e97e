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
