//! `luxel prepare` as a user runs it, on photographs made here; structure from motion is given, not
//! run.

#[cfg(feature = "markers")]
mod markers;
mod panoramas;
mod restart;
#[cfg(unix)]
mod video;
mod world;

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use luxel_core::{ColorSpace, Conversion, Image, tone::srgb_encode};
use luxel_io::{ExrOptions, ExrSample, ReadOptions, encode_jpeg, read_image, write_exr};

const WIDTH: usize = 48;
const HEIGHT: usize = 32;

/// A photograph as a camera describes it.
#[derive(Clone, Copy)]
struct Shot {
    model: &'static str,
    seconds: Option<f64>,
    iso: u16,
    /// Time of capture, seconds after ten.
    at: u32,
    orientation: u16,
    size: [usize; 2],
    /// Distinguishes views.
    view: usize,
}

const SHOT: Shot = Shot { model: "Test 1", seconds: Some(0.01), iso: 100, at: 0, orientation: 1, size: [WIDTH, HEIGHT], view: 0 };

/// Radiance of a view: two decades from left to right, at f/4 and ISO 100 exposed to 0.1 in the
/// middle by 1/100 s.
fn radiance(view: usize, x: usize, y: usize) -> f32 {
    let middle = 0.1 / (0.01 * 100.0 / (120.0 * 16.0));
    let wave = 1.0 + 0.2 * ((x as f32 * 0.8 + view as f32).sin() * (y as f32 * 0.6).cos());
    middle * wave * 10f32.powf(2.0 * x as f32 / WIDTH as f32 - 1.0)
}

fn tag(id: u16, kind: u16, value: &[u8], count: u32, out: &mut (Vec<u8>, Vec<u8>), values_at: usize) {
    out.0.extend(id.to_le_bytes());
    out.0.extend(kind.to_le_bytes());
    out.0.extend(count.to_le_bytes());
    if value.len() <= 4 {
        let mut inline = value.to_vec();
        inline.resize(4, 0);
        out.0.extend(inline);
    } else {
        out.0.extend(((values_at + out.1.len()) as u32).to_le_bytes());
        out.1.extend(value);
    }
}

fn rational(value: f64) -> Vec<u8> {
    [((value * 1e6).round() as u32).to_le_bytes(), 1_000_000u32.to_le_bytes()].concat()
}

/// All in the first directory, which readers take like Exif's.
fn exif(shot: &Shot) -> Vec<u8> {
    let count = if shot.seconds.is_some() { 7u16 } else { 4 };
    let values_at = 8 + 2 + 12 * usize::from(count) + 4;
    let mut out = (Vec::new(), Vec::new());
    let mut put = |id, kind, value: &[u8], count| tag(id, kind, value, count, &mut out, values_at);
    put(0x010f, 2, b"Luxel\0", 6);
    let model = format!("{}\0", shot.model);
    put(0x0110, 2, model.as_bytes(), model.len() as u32);
    put(0x0112, 3, &shot.orientation.to_le_bytes(), 1);
    let time = format!("2026:05:17 10:{:02}:{:02}\0", shot.at / 60, shot.at % 60);
    put(0x0132, 2, time.as_bytes(), 20);
    if let Some(seconds) = shot.seconds {
        put(0x829a, 5, &rational(seconds), 1);
        put(0x829d, 5, &rational(4.0), 1);
        put(0x8827, 3, &shot.iso.to_le_bytes(), 1);
    }
    let mut block = b"Exif\0\0II*\0\x08\0\0\0".to_vec();
    block.extend(count.to_le_bytes());
    block.extend(out.0);
    block.extend([0; 4]);
    block.extend(out.1);
    block
}

/// A JPEG through sRGB's curve.
fn jpeg(shot: &Shot) -> Vec<u8> {
    let [width, height] = shot.size;
    let exposure = (shot.seconds.unwrap_or(0.01) * f64::from(shot.iso) / (120.0 * 16.0)) as f32;
    let code = |i: usize| (255.0 * srgb_encode((radiance(shot.view, i % width, i / width) * exposure).min(1.0))).round() as u8;
    let rgb8: Vec<u8> = (0..width * height).flat_map(|i| [code(i); 3]).collect();
    let plain = encode_jpeg(width, height, &rgb8, 100).unwrap();
    let block = exif(shot);
    let mut out = vec![0xff, 0xd8, 0xff, 0xe1];
    out.extend((block.len() as u16 + 2).to_be_bytes());
    out.extend(block);
    out.extend(&plain[2..]);
    out
}

fn write(folder: &Path, name: &str, shot: &Shot) {
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join(name), jpeg(shot)).unwrap();
}

/// Views of three exposures two stops apart.
fn brackets(folder: &Path, views: usize) {
    for view in 0..views {
        for k in 0..3 {
            let shot = Shot { seconds: Some(0.0025 * 4f64.powi(k)), at: 20 * view as u32 + k as u32, view, ..SHOT };
            write(folder, &format!("IMG_{:04}.JPG", 3 * view as i32 + k + 1), &shot);
        }
    }
}

fn prepare(photos: &Path, output: &Path, more: &[&str]) -> Output {
    let mut command = Command::cargo_bin("luxel").unwrap();
    command.arg("prepare").arg(photos).arg("-o").arg(output).args(["--sfm", "off"]).args(more);
    command.output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

fn report(output: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(output.join("prepare.json")).unwrap()).unwrap()
}

/// A model of two views that see two points, where COLMAP would leave it.
fn write_model(output: &Path, views: [&str; 2]) {
    let model = output.join("work/sparse/0");
    std::fs::create_dir_all(&model).unwrap();
    std::fs::write(model.join("cameras.txt"), "1 SIMPLE_RADIAL 48 32 50 24 16 0.05\n").unwrap();
    let [a, b] = views;
    let images = format!("1 1 0 0 0 0 0 0 1 {a}.jpg\n10 10 1 40 20 2\n2 1 0 0 0 -0.1 0 0 1 {b}.jpg\n9 10 1 39 20 2\n");
    std::fs::write(model.join("images.txt"), images).unwrap();
    std::fs::write(model.join("points3D.txt"), "1 -0.28 -0.12 1 9 9 9 0.5 1 0 2 0\n2 0.32 0.08 1 9 9 9 0.5 1 1 2 1\n").unwrap();
}

#[test]
fn brackets_become_radiance_and_the_commands_for_poses_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 3);
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success(), "{}", said(&run));
    assert!(said(&run).contains("colmap.sh") && said(&run).contains("9 photographs in 3 views"), "{}", said(&run));
    let found = read_image(&output.join("work/radiance/IMG_0004.exr"), &ReadOptions::default()).unwrap();
    assert_eq!(found.color_space, Some(ColorSpace::LinearRec709));
    let mut worst = 0f32;
    for (i, pixel) in found.image.pixels.iter().enumerate() {
        let truth = radiance(1, i % WIDTH, i / WIDTH);
        worst = worst.max((pixel[1] / truth - 1.0).abs());
    }
    assert!(worst < 0.1, "largest error {worst}");
    let report = report(&output);
    assert_eq!(report["views"].as_array().unwrap().len(), 3);
    assert_eq!(report["views"][0]["files"].as_array().unwrap().len(), 3);
    assert!(output.join("prepare.html").is_file() && output.join("proxies/IMG_0001.jpg").is_file());
    let script = std::fs::read_to_string(output.join("colmap.sh")).unwrap();
    // It goes where the data set goes, and knows the options of old and new releases.
    for part in [
        "cd \"$(dirname \"$0\")\"",
        "colmap feature_extractor --database_path work/database.db --image_path proxies --image_list_path work/camera_0.txt",
        "--ImageReader.single_camera 1",
        "--$extraction.use_gpu 0",
        "extraction=FeatureExtraction matching=FeatureMatching",
        "mapper --database_path work/database.db --image_path proxies --output_path work/sparse",
    ] {
        assert!(script.contains(part), "{part}\n{script}");
    }
    assert!(!script.contains(&*output.to_string_lossy()), "{script}");
}

#[test]
fn a_second_run_takes_over_what_the_first_finished() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 2);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    let modified = |view: &str| std::fs::metadata(output.join(format!("work/radiance/{view}.exr"))).unwrap().modified().unwrap();
    let before = (modified("IMG_0001"), modified("IMG_0004"));
    // Another exposure of the second view's last frame: that view alone is made again.
    write(&photos, "IMG_0006.JPG", &Shot { seconds: Some(0.04), at: 22, view: 7, ..SHOT });
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && said(&run).contains("1 of 2 views are there from an earlier run"), "{}", said(&run));
    assert_eq!(modified("IMG_0001"), before.0);
    assert!(modified("IMG_0004") > before.1);
}

#[test]
fn each_fault_of_a_folder_has_its_message() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 4);
    std::fs::remove_file(photos.join("IMG_0005.JPG")).unwrap();
    // The same bytes under another name, a file cut short, another body, and one held upright whose
    // pixels were turned.
    std::fs::copy(photos.join("IMG_0001.JPG"), photos.join("IMG_0001 copy.JPG")).unwrap();
    let whole = std::fs::read(photos.join("IMG_0009.JPG")).unwrap();
    std::fs::write(photos.join("IMG_0009.JPG"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(photos.join("IMG_0100.JPG"), b"not a picture").unwrap();
    let other = Shot { model: "Other 2", at: 900, ..SHOT };
    write(&photos, "OTHER_1.JPG", &other);
    write(&photos, "OTHER_2.JPG", &Shot { orientation: 6, size: [HEIGHT, WIDTH], at: 960, ..other });
    std::fs::write(photos.join("IMG_0200.NEF"), b"MM").unwrap();
    std::fs::write(photos.join("IMG_0300.HEIC"), b"ftypheic").unwrap();
    std::fs::create_dir_all(photos.join("second day")).unwrap();
    std::fs::write(photos.join("second day/IMG_0400.JPG"), &whole).unwrap();
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    let said = said(&run);
    assert!(run.status.success(), "{said}");
    for part in [
        "IMG_0001.JPG is left out: the same file as IMG_0001 copy.JPG, byte by byte",
        "IMG_0100.JPG is left out: not an image of a known format",
        "IMG_0200.NEF is left out: a camera maker's own RAW format",
        "IMG_0300.HEIC is left out: not a supported kind of picture; export it as JPEG",
        "second day/ is left out: a folder in the folder",
        "warning: view IMG_0007: IMG_0009.JPG is left out: JPEG: ",
        "mixed cameras, lenses or sizes",
        "1 photograph of 48 x 32 from Luxel Other 2",
        "1 of 13 photographs are portraits and the others landscapes",
        "orientation tags (12 with 1, 1 with 6) are not applied",
        "view IMG_0004: its bracket has 2 of 3 exposures, missing +0.0 EV",
    ] {
        assert!(said.contains(part), "{part}\n{said}");
    }
    let report = report(&output);
    let left_out = report["left_out"].to_string();
    assert!(["IMG_0009.JPG", "IMG_0100.JPG", "IMG_0300.HEIC"].iter().all(|name| left_out.contains(name)), "{left_out}");
    let files = |view: usize| report["views"][view]["files"].to_string();
    assert!((0..6).all(|view| !files(view).contains("IMG_0009.JPG")) && files(2).contains("IMG_0008.JPG"), "{report}");
}

#[test]
fn photographs_without_exposure_are_an_error_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    write(&photos, "a_1.jpg", &SHOT);
    write(&photos, "a_2.jpg", &Shot { seconds: None, ..SHOT });
    let run = prepare(&photos, &output, &[]);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        said(&run).contains("1 of 2 photographs have no exposure time in EXIF (a_2.jpg)")
            && said(&run).contains("remedy: give --exposures"),
        "{}",
        said(&run)
    );
    let list = folder.path().join("exposures.txt");
    std::fs::write(&list, "a_1 1/100 100 4\na_2 1/25 100 4\n").unwrap();
    let run = prepare(&photos, &output, &["--exposures", list.to_str().unwrap(), "--response", "srgb", "--brackets", "names"]);
    assert!(run.status.success() && said(&run).contains("in 1 view: by name"), "{}", said(&run));
    // Without any exposure all are taken as exposed alike, with a warning.
    write(&photos, "a_1.jpg", &Shot { seconds: None, view: 3, ..SHOT });
    let run = prepare(&photos, &folder.path().join("other"), &[]);
    assert!(run.status.success() && said(&run).contains("all are treated as exposed alike"), "{}", said(&run));
}

#[test]
fn listed_times_leave_the_speed_and_aperture_of_exif() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    write(&photos, "slow.jpg", &SHOT);
    write(&photos, "fast.jpg", &Shot { seconds: Some(0.00125), iso: 800, ..SHOT });
    let list = folder.path().join("exposures.txt");
    std::fs::write(&list, "slow 1/100\nfast 1/800\n").unwrap();
    let run = prepare(&photos, &output, &["--exposures", list.to_str().unwrap()]);
    assert!(run.status.success() && !said(&run).contains("ISO speed"), "{}", said(&run));
    assert!(report(&output)["units"].to_string().contains("cd/m2"));
    let middle = |name: &str| read_image(&output.join(name), &ReadOptions::default()).unwrap().image.at(WIDTH / 2, HEIGHT / 2)[1];
    let ratio = middle("work/radiance/fast.exr") / middle("work/radiance/slow.exr");
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
}

#[test]
fn radiance_passes_through_with_its_colours_converted() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    let pixels = (0..WIDTH * HEIGHT).map(|i| [0.5 + i as f32 * 1e-3, 0.4, 0.1 + i as f32]).collect();
    let image = Image::from_pixels(WIDTH, HEIGHT, pixels).unwrap();
    let options = ExrOptions { sample: ExrSample::Float, color_space: ColorSpace::AcesCg, ..ExrOptions::default() };
    write_exr(&photos.join("a.exr"), &image, &options).unwrap();
    let run = prepare(&photos, &output, &["--output-color-space", "acescg"]);
    assert!(run.status.success(), "{}", said(&run));
    let found = read_image(&output.join("work/radiance/a.exr"), &ReadOptions::default()).unwrap();
    assert_eq!((found.image, found.color_space), (image.clone(), Some(ColorSpace::AcesCg)));
    let run = prepare(&photos, &output, &[]);
    assert!(run.status.success(), "{}", said(&run));
    let found = read_image(&output.join("work/radiance/a.exr"), &ReadOptions::default()).unwrap();
    let conversion = Conversion::between(ColorSpace::AcesCg, ColorSpace::LinearRec709);
    assert_eq!(found.color_space, Some(ColorSpace::LinearRec709));
    for (found, before) in found.image.pixels.iter().zip(&image.pixels) {
        let expected = conversion.apply(*before);
        assert!((0..3).all(|c| (found[c] - expected[c].max(0.0)).abs() <= 1e-5 * expected[c].abs().max(1.0)), "{found:?} {expected:?}");
    }
}

#[test]
fn pixels_that_are_no_numbers_are_said_with_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    let value = |i: usize, bad: bool| if bad && i < 7 { [f32::NAN, 1.0, 1.0] } else { [0.5 + i as f32 * 1e-3; 3] };
    let negative = Image::filled(WIDTH, HEIGHT, [-0.5, 1.0, 1.0]);
    write_exr(&photos.join("b.exr"), &negative, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
    for (name, bad) in [("a", false), ("c", true)] {
        let image = Image::from_pixels(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(|i| value(i, bad)).collect()).unwrap();
        write_exr(&photos.join(format!("{name}.exr")), &image, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
    }
    let run = prepare(&photos, &output, &["-q"]);
    let line = "view c: c.exr: 7 pixels are NaN or infinite; they stay so, and training masks them";
    assert!(run.status.success() && said(&run).contains(&format!("warning: {line}")), "{}", said(&run));
    assert!(std::fs::read_to_string(output.join("prepare.html")).unwrap().contains(line));
    let line = format!("view b: b.exr: all {} pixels have negative channels, which become 0", WIDTH * HEIGHT);
    assert!(said(&run).contains(&line), "{}", said(&run));
}

#[test]
fn a_model_that_was_made_elsewhere_becomes_a_data_set() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 3);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && said(&run).contains("2 of 3 views have poses"), "{}", said(&run));
    assert!(said(&run).contains("re-shoot: IMG_0007: no pose was found"), "{}", said(&run));
    let info = Command::cargo_bin("luxel").unwrap().args(["info", "--json"]).arg(&output).output().unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(info.to_string().contains("COLMAP"), "{info}");
    let image = read_image(&output.join("images/IMG_0001.exr"), &ReadOptions::default()).unwrap().image;
    assert!((image.width, image.height) == (WIDTH, HEIGHT) && image.pixels.iter().all(|p| p[1] > 0.0));
    // The same again has nothing to do.
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(said(&run).contains("is up to date"), "{}", said(&run));
}

#[test]
fn what_every_exposure_saturates_is_black_in_the_mask_of_the_undistorted_image() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    for view in 0..2 {
        write(&photos, &format!("IMG_{view}.JPG"), &Shot { seconds: Some(0.04 * (1 + view) as f64), at: 20 * view as u32, view, ..SHOT });
    }
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0", "IMG_1"]);
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && said(&run).contains("2 of 2 views have poses"), "{}", said(&run));
    let options = format!("-o run --masks {}/saturation --exposure-compensation exposure\n", output.display());
    assert!(said(&run).contains(&options), "{}", said(&run));
    let mask = read_image(&output.join("saturation/IMG_0.png"), &ReadOptions::default()).unwrap().image;
    assert_eq!((mask.width, mask.height), (WIDTH, HEIGHT));
    // Radiance rises tenfold from the middle to the right, and the middle is exposed to 0.4 of
    // saturation.
    for row in mask.pixels.chunks(WIDTH) {
        assert!(row[1] == [1.0; 3] && row[WIDTH - 2] == [0.0; 3], "{row:?}");
    }
    assert!(!output.join("work/saturation/IMG_0.png").exists());
}

#[test]
fn what_cannot_be_done_is_said_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    let run = prepare(&photos, &output, &[]);
    assert!(run.status.code() == Some(1) && said(&run).contains("cannot list it, expected a folder of photographs"), "{}", said(&run));
    assert!(!output.exists());
    std::fs::create_dir_all(photos.join("day 1")).unwrap();
    write(&photos.join("day 1"), "a.jpg", &SHOT);
    let run = prepare(&photos, &output, &[]);
    assert!(run.status.code() == Some(1) && said(&run).contains("day 1: give that folder"), "{}", said(&run));
    let run = prepare(&photos.join("day 1/a.jpg"), &output, &[]);
    assert!(run.status.code() == Some(1) && said(&run).contains("is a file, expected the folder"), "{}", said(&run));
    std::fs::remove_dir_all(photos.join("day 1")).unwrap();
    std::fs::create_dir_all(&photos).unwrap();
    let run = prepare(&photos, &output, &[]);
    assert!(run.status.code() == Some(1) && said(&run).contains("no photographs in it, expected DNG"), "{}", said(&run));
    brackets(&photos, 1);
    // A program that is named must be there.
    for sfm in ["colmap", "auto"] {
        let mut command = Command::cargo_bin("luxel").unwrap();
        command.arg("prepare").arg(&photos).arg("-o").arg(&output).args(["--sfm", sfm, "--colmap", "/nowhere/colmap"]);
        let run = command.output().unwrap();
        assert!(
            run.status.code() == Some(1) && said(&run).contains("/nowhere/colmap: no such program\n  remedy: install COLMAP"),
            "{}",
            said(&run)
        );
    }
    let image = Image::filled(WIDTH, HEIGHT, [1.0; 3]);
    write_exr(&photos.join("x.exr"), &image, &ExrOptions::default()).unwrap();
    let run = prepare(&photos, &output, &[]);
    assert!(said(&run).contains("3 JPEG, PNG or TIFF and 1 OpenEXR or HDR files, expected one kind"), "{}", said(&run));
    let run = prepare(&photos, &output, &["--brackets", "1"]);
    assert_eq!(run.status.code(), Some(2));
}

#[test]
fn options_that_a_kind_of_file_has_no_use_for_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    write_exr(&photos.join("a.exr"), &Image::filled(WIDTH, HEIGHT, [1.0; 3]), &ExrOptions::default()).unwrap();
    let list = folder.path().join("exposures.txt");
    std::fs::write(&list, "a 1/100\n").unwrap();
    let of_others = [["--frames", "5"], ["--ffmpeg", "/nowhere/ffmpeg"], ["--transfer", "linear"]];
    for option in
        [["--exposures", list.to_str().unwrap()], ["--response", "recover"], ["--white-balance", "0.5,1,0.6"]].iter().chain(&of_others)
    {
        let run = prepare(&photos, &output, option);
        assert!(run.status.code() == Some(1) && said(&run).contains(&format!("remedy: leave {} out", option[0])), "{}", said(&run));
    }
    let run = prepare(&photos, &output, &["--transfer", "logc3", "--input-color-space", "acescg"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("remedy: leave --input-color-space out"), "{}", said(&run));
    std::fs::remove_file(photos.join("a.exr")).unwrap();
    write(&photos, "a.jpg", &SHOT);
    let run = prepare(&photos, &output, &["--white-balance", "0.5,1,0.6"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("a white balance is for RAW files"), "{}", said(&run));
    assert!(!output.exists());
}

/// Everything in a folder, with its bytes.
fn contents(folder: &Path) -> Vec<(std::path::PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(contents(&path)) } else { found.push((path.clone(), std::fs::read(&path).unwrap())) }
    }
    found.sort();
    found
}

#[test]
fn what_others_made_is_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, set) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 1);
    // Photographs where the data set's images would go, by whatever way they are named.
    brackets(&set.join("images"), 1);
    let before = contents(&set);
    for photos in [set.join("images"), set.join("images/../images")] {
        let run = prepare(&photos, &set, &["--response", "srgb"]);
        assert!(run.status.code() == Some(1) && said(&run).contains("the photographs lie in its folder images"), "{}", said(&run));
    }
    // Another program's data set.
    std::fs::create_dir_all(set.join("sparse/0")).unwrap();
    std::fs::write(set.join("sparse/0/images.bin"), "of COLMAP").unwrap();
    let run = prepare(&photos, &set, &["--response", "srgb"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("not a data set that luxel prepared"), "{}", said(&run));
    std::fs::remove_dir_all(set.join("sparse")).unwrap();
    assert!(contents(&set) == before);
    // What was made of photographs is none of them.
    let own = folder.path().join("own");
    assert!(prepare(&photos, &own, &["--response", "srgb"]).status.success());
    let run = prepare(&own.join("proxies"), &own, &[]);
    assert!(run.status.code() == Some(1) && said(&run).contains("lie in its folder proxies"), "{}", said(&run));
}

#[test]
fn one_at_a_time_prepares_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 1);
    std::fs::create_dir_all(&output).unwrap();
    let lock = std::fs::File::create(output.join(".lock")).unwrap();
    lock.try_lock().unwrap();
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("another luxel"), "{}", said(&run));
    assert!(!output.join("work").exists());
    drop(lock);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
}

#[test]
fn a_set_without_its_report_is_not_finished() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 2);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    // The report cannot take the place of a folder; once it can, it is made.
    std::fs::remove_file(output.join("prepare.html")).unwrap();
    std::fs::create_dir_all(output.join("prepare.html/in the way")).unwrap();
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert_eq!(run.status.code(), Some(1), "{}", said(&run));
    std::fs::remove_dir_all(output.join("prepare.html")).unwrap();
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && !said(&run).contains("up to date"), "{}", said(&run));
    assert!(output.join("prepare.html").is_file());
}
