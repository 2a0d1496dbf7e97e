//! Renders of fields and anchors that are kept while a run is measured: its splits compare the same
//! poses again, in captured images and after fitted gains, and a render takes much longer than a
//! comparison.
//!
//! In: an engine that renders. Out: the same images; each pose is rendered once as long as
//! [`KEPT_BYTES`] hold. Degenerate: with more images than that the first ones are kept, which is as
//! good as can be for splits that are gone through in one order.

use luxel_core::engine::{Engine, EngineError, RenderOnly};
use luxel_core::{Camera, Image, Layers, RenderOptions};

/// Memory of the renders that are kept, bytes: part of what a run is estimated to take.
const KEPT_BYTES: usize = 128 << 20;

/// An engine that keeps its renders.
pub(crate) struct KeptRenders<'a> {
    engine: &'a mut dyn Engine,
    kept: Vec<Kept>,
    free_bytes: usize,
}

struct Kept {
    camera: Camera,
    options: RenderOptions,
    image: Image,
}

impl<'a> KeptRenders<'a> {
    pub(crate) fn new(engine: &'a mut dyn Engine) -> Self {
        Self { engine, kept: Vec::new(), free_bytes: KEPT_BYTES }
    }
}

impl RenderOnly for KeptRenders<'_> {
    fn no_splats(&self) -> EngineError {
        EngineError::invalid("the scene has no stored splats")
    }

    fn layers(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Layers, EngineError> {
        self.engine.render_layers(camera, options)
    }

    fn image(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        if let Some(kept) = self.kept.iter().find(|kept| kept.camera == *camera && kept.options == *options) {
            return Ok(kept.image.clone());
        }
        let image = self.engine.render(camera, options)?;
        let bytes = size_of_val(image.pixels.as_slice());
        if let Some(left) = self.free_bytes.checked_sub(bytes) {
            self.free_bytes = left;
            self.kept.push(Kept { camera: camera.clone(), options: *options, image: image.clone() });
        }
        Ok(image)
    }

    fn splat_count(&self) -> usize {
        self.engine.len()
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::synthetic;

    use super::*;

    /// Renders images of one colour, each brighter than the last.
    struct Counter(f32);

    impl RenderOnly for Counter {
        fn no_splats(&self) -> EngineError {
            EngineError::invalid("a counter has no splats")
        }

        fn layers(&mut self, camera: &Camera, _: &RenderOptions) -> Result<Layers, EngineError> {
            self.0 += 1.0;
            let [width, height] = camera.size_px.map(|side| side as usize);
            Ok(Layers { image: Image::filled(width, height, [self.0; 3]), alpha: Vec::new(), depth: Vec::new() })
        }
    }

    #[test]
    fn a_pose_is_rendered_once_as_long_as_there_is_room() {
        let mut counter = Counter(0.0);
        let mut engine = KeptRenders::new(&mut counter);
        let [small, large] = [[8, 6], [4000, 3000]].map(synthetic::room_camera);
        let (options, mut bright) = (RenderOptions::default(), RenderOptions::default());
        bright.background = [1.0; 3];
        let mut number = |camera: &Camera, options: &RenderOptions| engine.render(camera, options).unwrap().pixels[0][0];
        // Images of 144 MB are never kept.
        assert_eq!([&large, &small, &large, &small].map(|camera| number(camera, &options)), [1.0, 2.0, 3.0, 2.0]);
        assert_eq!([&bright, &options, &bright].map(|options| number(&small, options)), [4.0, 2.0, 4.0]);
    }
}
