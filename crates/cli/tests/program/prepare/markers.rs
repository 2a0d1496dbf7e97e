//! AprilTags in photographs that give lengths in metres.

use super::*;

const SIZE: [usize; 2] = [320, 240];
/// Focal length, pixels, and radial distortion of the camera.
const FOCAL: f64 = 300.0;
const K1: f64 = 0.05;
/// Edge of the black square, units of the model.
const EDGE: f64 = 0.3;

/// AprilTag 0 of family 36h11 with its white border.
const TAG: [&str; 10] = [
    "##########",
    "#........#",
    "#.##.#.#.#",
    "#..###.#.#",
    "#..##....#",
    "#.#.#....#",
    "#..#.##..#",
    "#....#...#",
    "#........#",
    "##########",
];

/// Returns how bright the wall at z = 1 with the tag in its middle is.
fn wall(at: [f64; 2]) -> f64 {
    let [column, row] = at.map(|v| (v / (EDGE / 8.0) + 5.0).floor());
    let is_on = (0.0..10.0).contains(&column) && (0.0..10.0).contains(&row);
    if is_on && TAG[row as usize].as_bytes()[column as usize] == b'.' { 0.1 } else { 0.8 }
}

/// A photograph from `x` along the x axis, without headers.
fn photograph(x: f64) -> Vec<u8> {
    let sample = |px: usize, py: usize, i: usize| {
        let [u, v] = [(px as f64 + 0.25 + 0.5 * (i % 2) as f64 - 160.0) / FOCAL, (py as f64 + 0.25 + 0.5 * (i / 2) as f64 - 120.0) / FOCAL];
        let straight = (0..20).fold([u, v], |p, _| [u, v].map(|d| d / (1.0 + K1 * (p[0] * p[0] + p[1] * p[1]))));
        wall([straight[0] + x, straight[1]])
    };
    let code = |at: usize| (0..4).map(|i| sample(at % SIZE[0], at / SIZE[0], i)).sum::<f64>() / 4.0;
    let rgb8: Vec<u8> = (0..SIZE[0] * SIZE[1]).flat_map(|at| [(255.0 * code(at)).round() as u8; 3]).collect();
    encode_jpeg(SIZE[0], SIZE[1], &rgb8, 95).unwrap()
}

fn set(photos: &Path, output: &Path, xs: [f64; 2]) {
    std::fs::create_dir_all(photos).unwrap();
    for (name, x) in ["a", "b"].iter().zip(xs) {
        std::fs::write(photos.join(format!("{name}.jpg")), photograph(x)).unwrap();
    }
    assert!(prepare(photos, output, &[]).status.success());
    let model = output.join("work/sparse/0");
    std::fs::create_dir_all(&model).unwrap();
    std::fs::write(model.join("cameras.txt"), format!("1 SIMPLE_RADIAL 320 240 {FOCAL} 160 120 {K1}\n")).unwrap();
    let [a, b] = xs.map(|x| -x);
    let images = format!("1 1 0 0 0 {a} 0 0 1 a.jpg\n60 60 1 240 120 2\n2 1 0 0 0 {b} 0 0 1 b.jpg\n54 60 1 234 120 2\n");
    std::fs::write(model.join("images.txt"), images).unwrap();
    std::fs::write(model.join("points3D.txt"), "1 -0.28 -0.12 1 9 9 9 0.5 1 0 2 0\n2 0.32 0.08 1 9 9 9 0.5 1 1 2 1\n").unwrap();
}

#[test]
fn markers_of_known_size_scale_the_set_to_metres() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    set(&photos, &output, [-0.1, 0.1]);
    let run = prepare(&photos, &output, &["--marker-size", "0.6"]);
    assert!(run.status.success() && said(&run).contains("lengths are in metres, from 1 marker with edges of 0.6 m"), "{}", said(&run));
    let world = report(&output)["world"].clone();
    let scale = world["scale"].as_f64().unwrap();
    assert!((scale / 2.0 - 1.0).abs() < 0.01, "{world}");
    assert_eq!((world["markers"]["markers"].as_u64(), world["metres_per_unit"].as_f64()), (Some(1), Some(1.0)));
    let page = std::fs::read_to_string(output.join("prepare.html")).unwrap();
    assert!(page.contains("markers give"), "the page has them, too");
    // Another family is not there; nothing that was written is lost.
    let run = prepare(&photos, &output, &["--marker-size", "0.6", "--marker-family", "25h9"]);
    let text = said(&run);
    assert!(run.status.code() == Some(1) && text.contains("AprilTags of family 25h9, seen in 0 views of 2: no marker was found"), "{text}");
    for bad in [&["--marker-size", "0"][..], &["--marker-size", "x"], &["--marker-family", "25h9"]] {
        assert_eq!(prepare(&photos, &output, bad).status.code(), Some(2), "{bad:?}");
    }
    let both = ["--marker-size", "0.6", "--known-distance", "a,b,1"];
    assert_eq!(prepare(&photos, &output, &both).status.code(), Some(2));
}

#[test]
fn a_marker_that_is_seen_from_one_place_gives_no_scale() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    set(&photos, &output, [-0.001, 0.001]);
    let run = prepare(&photos, &output, &["--marker-size", "0.6"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("marker 0 is seen from one direction only"), "{}", said(&run));
}
