//! Digest of a data set: equal exactly for equal inputs read in the same way.

use luxel_core::{CameraProjection, PixelValues, Point, Similarity, View};

use super::{LoadOptions, MaskSource};
use crate::lens::Lens;

/// Collects the content of a data set. Every text and list is preceded by its length, so that no
/// two inputs run together.
pub(super) struct Fingerprint(blake3::Hasher);

impl Fingerprint {
    pub(super) fn new(format: &str, options: &LoadOptions) -> Self {
        let mut this = Self(blake3::Hasher::new());
        this.text(format);
        this.text(&format!("{:?} {:?} {}", options.transfer, options.color_space, options.downscale.factor()));
        // Masks of files count by their bytes; of other data sets nothing is added, so that they
        // keep the digests they have always had.
        if options.masks == MaskSource::Alpha {
            this.text("masks of alpha");
        }
        if let Some(layer) = &options.layer {
            this.text("layer");
            this.text(layer);
        }
        this
    }

    fn number(&mut self, value: u64) {
        self.0.update(&value.to_le_bytes());
    }

    pub(super) fn text(&mut self, text: &str) {
        self.number(text.len() as u64);
        self.0.update(text.as_bytes());
    }

    /// Adds the view with the digest of its files.
    pub(super) fn view(&mut self, view: &View, files: &blake3::Hash) {
        let camera = &view.camera;
        self.text(&view.name);
        for value in camera.camera_from_world.to_cols_array() {
            self.number(value.to_bits());
        }
        let d = camera.distortion;
        for value in camera.focal_px.to_array().into_iter().chain(camera.center_px.to_array()).chain([d.k1, d.k2, d.p1, d.p2]) {
            self.number(value.to_bits());
        }
        // Of a pinhole nothing is added, so that data sets keep the digests they have always had.
        if !camera.projection.is_pinhole() {
            self.text(camera.projection.name());
            if let CameraProjection::Fisheye(lens) = camera.projection {
                lens.coefficients.iter().chain([&lens.max_angle_rad]).for_each(|v| self.number(v.to_bits()));
            }
        }
        camera.size_px.iter().for_each(|side| self.number((*side).into()));
        self.0.update(files.as_bytes());
        // Of radiance without known noise nothing is added: such data sets keep the digests they
        // have always had.
        if let PixelValues::Recorded { exposure_s } = view.values {
            self.text("recorded");
            self.number(exposure_s.to_bits().into());
        }
        if let Some(noise) = view.noise {
            self.text("noise");
            [noise.read, noise.shot].iter().for_each(|v| self.number(v.to_bits().into()));
        }
    }

    /// Adds a lens that no camera can have; of other views nothing is added, so that they keep the
    /// digests they have always had.
    pub(super) fn foreign_lens(&mut self, lens: Option<Lens>) {
        if let Some(lens) = lens {
            self.text("lens");
            self.text(&format!("{lens:?}"));
        }
    }

    pub(super) fn points(&mut self, points: &[Point]) {
        self.number(points.len() as u64);
        for point in points {
            self.0.update(bytemuck::cast_slice(&point.position.map(f32::to_bits).map(u32::to_le)));
            self.0.update(&point.rgb8.map_or([0, 0, 0, 0], |[r, g, b]| [1, r, g, b]));
            self.number(point.observations.len() as u64);
            for o in &point.observations {
                let [x, y] = o.pixel_px.map(f32::to_bits);
                self.0.update(bytemuck::cast_slice(&[o.view.to_le(), x.to_le(), y.to_le()]));
            }
        }
    }

    /// Adds the local coordinates; of a data set that is held in its own nothing is added, so that
    /// it keeps the digest it has always had.
    pub(super) fn local_coordinates(&mut self, world_from_local: &Similarity) {
        if world_from_local.is_identity() {
            return;
        }
        self.text("local coordinates");
        let origin = world_from_local.translation().to_array();
        origin.into_iter().chain([world_from_local.scale()]).for_each(|v| self.number(v.to_bits()));
    }

    pub(super) fn finish(self) -> String {
        self.0.finalize().to_hex().to_string()
    }
}
