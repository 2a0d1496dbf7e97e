//! Runs that were stopped, and runs that find other photographs or options than the one before.

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
