//! Coordinates of data sets, and the Python package in place of the program.

use super::*;

fn run_of(photos: &Path, output: &Path, more: &[&str]) -> Output {
    prepare(photos, output, &[&["--response", "srgb"], more].concat())
}

/// The centre of a camera of the written model: -R^T t.
fn eyes(output: &Path) -> Vec<[f64; 3]> {
    let text = std::fs::read_to_string(output.join("sparse/0/images.txt")).unwrap();
    let poses = text.lines().filter(|line| line.ends_with(".exr"));
    let eye = |line: &str| {
        let v: Vec<f64> = line.split(' ').skip(1).take(7).map(|part| part.parse().unwrap()).collect();
        // The cameras of these tests are not turned.
        assert!(v[1..4].iter().all(|q| q.abs() < 1e-9), "{line}");
        [-v[4], -v[5], -v[6]]
    };
    poses.map(eye).collect()
}

#[test]
fn a_known_distance_scales_the_set_to_metres() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 2);
    assert!(run_of(&photos, &output, &[]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    let run = run_of(&photos, &output, &[]);
    assert!(run.status.success() && said(&run).contains("the scale is unknown"), "{}", said(&run));
    let world = report(&output)["world"].clone();
    assert_eq!((world["up_axis"].as_str(), world["metres_per_unit"].as_f64()), (Some("-y"), None));
    assert_eq!((world["up_from"].as_str(), world["origin_from"].as_str()), (Some("image-up"), Some("points")));
    let [a, b] = eyes(&output)[..] else { panic!("two views") };
    assert!((b[0] - a[0] - 0.1).abs() < 1e-9);
    // The cameras are 0.1 apart in the model and 2 m in the world.
    let run = run_of(&photos, &output, &["--known-distance", "IMG_0001,IMG_0004,2"]);
    assert!(run.status.success() && said(&run).contains("lengths are in metres, from the distance of 2 m"), "{}", said(&run));
    let [c, d] = eyes(&output)[..] else { panic!("two views") };
    assert!((d[0] - c[0] - 2.0).abs() < 1e-9);
    let scale = || report(&output)["world"]["scale"].as_f64().unwrap();
    assert!((scale() - 20.0).abs() < 1e-6 && report(&output)["world"]["metres_per_unit"].as_f64() == Some(1.0));
    assert_eq!(luxel_app::prepare::metres_per_unit(&output), Some(1.0));
    let page = std::fs::read_to_string(output.join("prepare.html")).unwrap();
    assert!(page.contains("up is -y, from what is up in images"));
    // Points of the coordinates before, by the same cameras.
    let points = format!("{},{},{},{},{},{},2", a[0], a[1], a[2], b[0], b[1], b[2]);
    let run = run_of(&photos, &output, &["--known-distance", &points]);
    assert!(run.status.success(), "{}", said(&run));
    assert!((scale() - 20.0).abs() < 1e-6);
    let run = run_of(&photos, &output, &["--keep-coordinates"]);
    assert!(run.status.success() && report(&output)["world"].is_null(), "{}", said(&run));
    assert_eq!(eyes(&output), [[0.0; 3], [0.1, 0.0, 0.0]]);
    let run = run_of(&photos, &output, &["--known-distance", "IMG_0001,IMG_0009,2"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("no view IMG_0009 has a pose"), "{}", said(&run));
    for bad in ["IMG_0001,2", "a,b,-1", "a,b,c"] {
        assert_eq!(run_of(&photos, &output, &["--known-distance", bad]).status.code(), Some(2), "{bad}");
    }
    assert_eq!(run_of(&photos, &output, &["--known-distance", "a,b,1", "--keep-coordinates"]).status.code(), Some(2));
}

/// A Python interpreter by name that finds a model of two views.
#[cfg(unix)]
#[test]
fn the_python_package_takes_the_place_of_the_program() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (photos, output, python) = (folder.path().join("photos"), folder.path().join("set"), folder.path().join("python3"));
    let log = folder.path().join("log.txt");
    brackets(&photos, 2);
    assert!(run_of(&photos, &output, &[]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    let model = folder.path().join("model");
    std::fs::rename(output.join("work/sparse/0"), &model).unwrap();
    std::fs::remove_dir_all(&output).unwrap();
    // Arguments are -u, -c, the script, a command and its options.
    let script = format!(
        "#!/bin/sh\n[ \"$1\" = -u ] && [ \"$2\" = -c ] || exit 9\nshift 3\ncase $1 in\ndescribe) printf 'pycolmap 4.2.1\\nglobal\\npairs\\n';;\n\
         *mapper) echo \"$@\" >> {log}; shift; while [ $# -gt 1 ]; do [ $1 = --output_path ] && cp -r {model} $2/0; shift 2; done;;\n\
         *) echo \"$@\" >> {log}; echo 'Processed file [2/2]';;\nesac\n",
        log = log.display(),
        model = model.display()
    );
    std::fs::write(&python, script).unwrap();
    std::fs::set_permissions(&python, std::fs::Permissions::from_mode(0o755)).unwrap();
    let with_python = |more: &[&str]| {
        let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin("luxel"));
        command.arg("prepare").arg(&photos).arg("-o").arg(&output).args(["--response", "srgb", "--colmap"]).arg(&python);
        command.args(more).output().unwrap()
    };
    let refused = with_python(&["--features", "aliked"]);
    assert!(refused.status.code() == Some(1) && said(&refused).contains("(pycolmap 4.2.1) has no ALIKED features"), "{}", said(&refused));
    let refused = with_python(&["--matching", "spatial"]);
    assert!(refused.status.code() == Some(1) && said(&refused).contains("0 of 2 views have a GPS position"), "{}", said(&refused));
    let run = with_python(&["--mapper", "global", "--matching", "sequential"]);
    assert!(run.status.success() && said(&run).contains("2 of 2 views have poses"), "{}", said(&run));
    let origin = report(&output)["structure_from_motion"].as_str().unwrap().to_owned();
    assert!(origin.starts_with("pycolmap 4.2.1, SIFT features, 1 pair matched") && origin.contains("global mapper"), "{origin}");
    let commands = std::fs::read_to_string(&log).unwrap();
    let names: Vec<&str> = commands.lines().filter_map(|line| line.split(' ').next()).collect();
    assert_eq!(names, ["feature_extractor", "matches_importer", "global_mapper"]);
    assert_eq!(std::fs::read_to_string(output.join("work/pairs.txt")).unwrap(), "IMG_0001.jpg IMG_0004.jpg\n");
}
