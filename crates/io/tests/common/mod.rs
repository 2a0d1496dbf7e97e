//! The folder that tests of data sets share, and images in it.

use std::path::{Path, PathBuf};

use luxel_core::Dataset;
use luxel_io::{IoError, LoadOptions, load_dataset};
use tempfile::TempDir;

/// Size of the test images, pixels.
pub(crate) const SIZE: [usize; 2] = [16, 8];

/// A folder that is removed at the end of the test.
pub(crate) struct TestScene(TempDir);

impl TestScene {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        path
    }

    pub(crate) fn exr(&self, name: &str, pixel: impl Fn(usize, usize) -> [f32; 3] + Sync) {
        let path = self.write(name, "");
        exr::prelude::write_rgb_file(path, SIZE[0], SIZE[1], |x, y| pixel(x, y).into()).unwrap();
    }

    pub(crate) fn png(&self, name: &str, rgba: impl Fn(u32, u32) -> [u8; 4]) {
        let path = self.write(name, "");
        image::RgbaImage::from_fn(SIZE[0] as u32, SIZE[1] as u32, |x, y| image::Rgba(rgba(x, y))).save(path).unwrap();
    }

    pub(crate) fn read(&self, options: &LoadOptions) -> Result<Dataset, IoError> {
        load_dataset(self.path(), options)
    }
}
