//! Runs that were stopped, and runs that find other photographs or options than the one before.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use super::*;

fn bytes(output: &Path, name: &str) -> Vec<u8> {
    std::fs::read(output.join(name)).unwrap()
}

#[test]
fn a_set_that_another_run_began_to_write_over_is_not_finished() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 2);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    let image = bytes(&output, "images/IMG_0004.exr");
    // Other options, stopped after the images: the report cannot take the place of a folder.
    std::fs::remove_file(output.join("prepare.html")).unwrap();
    std::fs::create_dir_all(output.join("prepare.html/in the way")).unwrap();
    assert_eq!(prepare(&photos, &output, &["--response", "linear"]).status.code(), Some(1));
    std::fs::remove_dir_all(output.join("prepare.html")).unwrap();
    assert!(bytes(&output, "images/IMG_0004.exr") != image);
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && !said(&run).contains("up to date"), "{}", said(&run));
    assert!(bytes(&output, "images/IMG_0004.exr") == image);
    // Nor is one that lacks an image.
    std::fs::remove_file(output.join("images/IMG_0004.exr")).unwrap();
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && !said(&run).contains("up to date"), "{}", said(&run));
    assert!(bytes(&output, "images/IMG_0004.exr") == image);
    assert!(said(&prepare(&photos, &output, &["--response", "srgb"])).contains("up to date"));
}

#[test]
fn a_view_that_a_killed_run_wrote_over_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    let names: Vec<String> = (0..8).map(|view| format!("work/radiance/view{view}.exr")).collect();
    for view in 0..8 {
        write(&photos, &format!("view{view}.jpg"), &Shot { size: [480, 320], at: 20 * view as u32, view, ..SHOT });
    }
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    let before: Vec<Vec<u8>> = names.iter().map(|name| bytes(&output, name)).collect();
    let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin("luxel"));
    command.arg("prepare").arg(&photos).arg("-o").arg(&output).args(["--sfm", "off", "--response", "linear", "--log-format", "json"]);
    let mut run = command.stdout(Stdio::piped()).spawn().unwrap();
    let told = BufReader::new(run.stdout.take().unwrap()).lines().map_while(Result::ok).any(|line| line.contains("\"event\":\"view\""));
    run.kill().unwrap();
    run.wait().unwrap();
    assert!(told && names.iter().zip(&before).any(|(name, before)| bytes(&output, name) != *before));
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    for (name, before) in names.iter().zip(&before) {
        assert!(bytes(&output, name) == *before, "{name}");
    }
}

#[test]
fn a_model_of_other_pictures_is_not_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 3);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    // Other options make the same pictures, and a view that is gone leaves the others where they
    // are.
    for name in ["IMG_0007.JPG", "IMG_0008.JPG", "IMG_0009.JPG"] {
        std::fs::remove_file(photos.join(name)).unwrap();
    }
    let run = prepare(&photos, &output, &["--response", "linear"]);
    assert!(said(&run).contains("2 of 2 views have poses"), "{}", said(&run));
    // Of another size: set aside, and not taken the next time either.
    for _ in 0..2 {
        let run = prepare(&photos, &output, &["--response", "srgb", "--downscale", "2"]);
        assert!(run.status.success() && said(&run).contains("poses: none yet"), "{}", said(&run));
    }
    assert!(output.join("work/sparse.old/0/images.txt").is_file() && !output.join("work/sparse").exists());
    // Put there by hand: its camera has the size of the former pictures.
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    let run = prepare(&photos, &output, &["--response", "srgb", "--downscale", "2"]);
    assert!(
        run.status.code() == Some(1) && said(&run).contains("has 48 x 32 pixels in the model, expected 24 x 16 as in proxies/"),
        "{}",
        said(&run)
    );
    // Other photographs under the same names.
    std::fs::remove_dir_all(output.join("work/sparse")).unwrap();
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    write(&photos, "IMG_0005.JPG", &Shot { at: 21, view: 7, ..SHOT });
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.success() && said(&run).contains("is of other pictures than proxies/ has now"), "{}", said(&run));
    let script = std::fs::read_to_string(output.join("colmap.sh")).unwrap();
    assert!(script.contains("\nrm -rf work/sparse work/database.db "), "{script}");
}

#[test]
fn a_view_that_cannot_be_written_is_not_left_out_for_good() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    brackets(&photos, 3);
    std::fs::create_dir_all(output.join("proxies/IMG_0004.jpg/in the way")).unwrap();
    std::fs::create_dir_all(output.join("work")).unwrap();
    std::fs::write(output.join("work/state.json"), "{}").unwrap();
    let run = prepare(&photos, &output, &["--response", "srgb"]);
    assert!(run.status.code() == Some(1) && said(&run).contains("view IMG_0004: cannot be made"), "{}", said(&run));
    assert!(said(&run).contains("IMG_0004.jpg: cannot write"), "{}", said(&run));
    std::fs::remove_dir_all(output.join("proxies/IMG_0004.jpg")).unwrap();
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    assert_eq!(report(&output)["views"].as_array().unwrap().len(), 3);
}

/// A program that is COLMAP by name, and finds nothing.
#[cfg(unix)]
#[test]
fn a_model_that_the_user_made_is_taken_once_colmap_is_there_too() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (photos, output, colmap) = (folder.path().join("photos"), folder.path().join("set"), folder.path().join("colmap"));
    std::fs::write(&colmap, "#!/bin/sh\ncase \"$*\" in *-h) echo COLMAP 3.8;; *) exit 1;; esac\n").unwrap();
    std::fs::set_permissions(&colmap, std::fs::Permissions::from_mode(0o755)).unwrap();
    brackets(&photos, 2);
    assert!(prepare(&photos, &output, &["--response", "srgb"]).status.success());
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    let with_colmap = || {
        let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin("luxel"));
        command.arg("prepare").arg(&photos).arg("-o").arg(&output).args(["--response", "srgb", "--colmap"]).arg(&colmap);
        command.output().unwrap()
    };
    let run = with_colmap();
    assert!(run.status.success() && said(&run).contains("2 of 2 views have poses"), "{}", said(&run));
    // What this command began itself is begun again.
    std::fs::remove_dir_all(output.join("work/sparse")).unwrap();
    std::fs::remove_dir_all(output.join("sparse")).unwrap();
    assert_eq!(with_colmap().status.code(), Some(1));
    write_model(&output, ["IMG_0001", "IMG_0004"]);
    assert_eq!(with_colmap().status.code(), Some(1));
}
