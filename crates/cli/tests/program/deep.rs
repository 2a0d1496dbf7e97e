//! `luxel render --deep`: deep images beside the images.

use crate::common::Workplace;

#[test]
fn deep_images_are_written_kept_and_removed_with_their_images() {
    let place = Workplace::new();
    place.train("run", &[]);
    let deep = ["render", "run", "-o", "frames", "--deep"];
    place.ok(&deep);
    let bytes = || std::fs::read(place.path("frames/deep/000.exr")).unwrap();
    let first = bytes();
    // Version 2 with the flag of deep data.
    assert_eq!(first[..6], [0x76, 0x2f, 0x31, 0x01, 2, 0x08]);
    place.ok(&deep);
    assert!(bytes() == first);
    // Without the record of its image, and with another number of samples, it is another file.
    place.error(&["render", "run", "-o", "frames", "--deep=4"], &["frames/deep/000.exr", "exists already", "--overwrite"]);
    place.ok(&["render", "run", "-o", "frames", "--deep=4", "--overwrite"]);
    assert!(bytes().len() < first.len());
    // An image that is replaced without one takes it along.
    place.ok(&["render", "run", "-o", "frames", "--exr-type", "float", "--overwrite"]);
    assert!(!place.path("frames/deep/000.exr").exists());
}

#[test]
fn what_has_no_deep_image_is_an_error() {
    let place = Workplace::new();
    place.train("run", &[]);
    // The scene has two samples, of which the images do without.
    let notes = place.notes(&["render", "run", "-o", "ones", "--deep"]);
    assert!(notes.contains("deep images have 1 sample along a pixel's side, where this scene was trained with 2"), "{notes}");
    place.error(&["render", "run", "-o", "frames", "--deep", "--samples", "2"], &["1 sample along a pixel's side, found 2", "--samples 1"]);
    place.fails(2, &["render", "run", "-o", "frames", "--deep=0"]);
    place.error(
        &["render", "run", "-o", "frames", "--deep=1024", "--size", "2000x2000", "--memory", "1"],
        &["a deep image of 2000 x 2000", "MiB"],
    );
}
