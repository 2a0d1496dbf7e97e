//! Renders and contributions of a scene, light by light ([`luxel_core::Mix`]).
//!
//! In: a camera. Out: the sum over the lights, each rendered with the cut-offs of its own radiance.
//! A scene of one light is rendered once.

use luxel_core::edit::Contributions;
use luxel_core::engine::{DeepImage, Evaluations, SurfaceImage};
use luxel_core::{EngineError, Image, Layers, Remedy, Splats};

use super::state::{State, final_pixels};
use crate::passes::bin::ScreenSplats;
use crate::passes::contribute::contribute;
use crate::passes::deep::deep;
use crate::passes::evaluations::evaluations;
use crate::passes::normals::{set_normals, unit_or_zero};
use crate::passes::rasterize::{to_alpha, to_image};
use crate::passes::samples::resolve;
use crate::passes::sort_and_rasterize::sort_and_rasterize;
use crate::passes::surface::{ScreenPeaks, surface};
use crate::passes::tile_records::{Recording, TileInputs};
use crate::view::ScreenCamera;

impl State {
    /// Returns the cameras of the lights of the scene, whose images add to the image.
    fn light_cameras(&self, camera: &ScreenCamera) -> Vec<ScreenCamera> {
        let lights = self.parameters.layout.color_model.lights();
        (0..lights).map(|light| camera.for_light(light, lights)).collect()
    }

    /// Renders the image.
    pub(super) fn render(&mut self, camera: &ScreenCamera) -> Image {
        let images = self.light_cameras(camera).into_iter().map(|camera| self.render_light(&camera));
        images.reduce(Image::plus).unwrap_or_default()
    }

    /// Renders the image of one light.
    fn render_light(&mut self, camera: &ScreenCamera) -> Image {
        self.forward(camera, Recording::Nothing);
        to_image(final_pixels(camera, &self.frame.pixels, &self.frame.resolved), &camera.without_supersampling())
    }

    /// Renders the image, alpha and depth. Alpha and depth of a mix are those of its first light.
    pub(super) fn render_layers(&mut self, camera: &ScreenCamera) -> Layers {
        let layers = self.light_cameras(camera).into_iter().map(|camera| self.render_light_layers(&camera));
        layers.reduce(|sum, light| Layers { image: sum.image.plus(light.image), ..sum }).unwrap_or_default()
    }

    /// Renders the image, alpha and depth of one light.
    fn render_light_layers(&mut self, camera: &ScreenCamera) -> Layers {
        self.forward(camera, Recording::Nothing);
        let image_camera = camera.without_supersampling();
        let pixels = final_pixels(camera, &self.frame.pixels, &self.frame.resolved);
        let image = to_image(pixels, &image_camera);
        let alpha = to_alpha(pixels, &image_camera);
        self.frame.footprints.iter_mut().for_each(|footprint| footprint.radiance = [footprint.depth, 0.0, 0.0]);
        let blended = self.blend_again(camera);
        let depth = |(pixel, alpha): (&[f32; 3], &f32)| if *alpha > 0.0 { pixel[0] / alpha } else { f32::INFINITY };
        let depth = blended.pixels.iter().zip(&alpha).map(depth).collect();
        Layers { image, alpha, depth }
    }

    /// Renders unit normals, those of the first light of a mix; zero where there are no splats.
    pub(super) fn render_normals(&mut self, camera: &ScreenCamera) -> Vec<[f32; 3]> {
        let lights = self.parameters.layout.color_model.lights();
        let camera = camera.for_light(0, lights);
        self.forward(&camera, Recording::Nothing);
        set_normals(&self.parameters, &camera, &mut self.frame.footprints);
        self.blend_again(&camera).pixels.into_iter().map(unit_or_zero).collect()
    }

    /// Blends what footprints hold in place of radiance over nothing, by the lists and thresholds
    /// of the render before.
    fn blend_again(&mut self, camera: &ScreenCamera) -> Image {
        let Self { level, frame, .. } = self;
        let on_nothing = ScreenCamera { background: [0.0; 3], ..camera.clone() };
        let splats = ScreenSplats { bins: &frame.bins, footprints: &frame.footprints };
        let inputs = TileInputs { level: *level, camera: &on_nothing, splats, recording: Recording::Nothing, channels: None };
        sort_and_rasterize(&inputs, &mut frame.records, &mut frame.pixels);
        if camera.samples > 1 {
            resolve(&on_nothing, &frame.pixels, &mut frame.resolved);
        }
        to_image(final_pixels(camera, &frame.pixels, &frame.resolved), &camera.without_supersampling())
    }

    /// Lists what each pixel is blended from.
    pub(super) fn render_deep(&mut self, camera: &ScreenCamera, most_samples: usize) -> Result<DeepImage, EngineError> {
        if self.parameters.layout.color_model.lights() > 1 {
            let message = "the scene is a mix of lights, whose pixels are sums of several blended images: there is no deep image of it";
            return Err(EngineError::invalid(message).with_remedy(Remedy::advice("render the scenes that were mixed")));
        }
        if camera.samples > 1 {
            let message = format!("deep images have 1 sample along a pixel's side, found {}", camera.samples);
            return Err(EngineError::invalid(message).with_remedy(Remedy::set("samples", "1")));
        }
        self.forward(camera, Recording::Lists);
        Ok(deep(&self.tile_inputs(camera, Recording::Lists), &self.frame.records, most_samples))
    }

    /// Renders the distribution of depths of each pixel, that of the first light of a mix.
    pub(super) fn render_surface(&mut self, camera: &ScreenCamera) -> Result<SurfaceImage, EngineError> {
        if camera.rays.is_some() {
            let message = "surface images are of pinholes, found a fisheye or a panorama";
            return Err(EngineError::invalid(message).with_remedy(Remedy::advice("render pinholes that look where it does")));
        }
        if camera.samples > 1 {
            let message = format!("surface images have 1 sample along a pixel's side, found {}", camera.samples);
            return Err(EngineError::invalid(message).with_remedy(Remedy::set("samples", "1")));
        }
        let camera = camera.for_light(0, self.parameters.layout.color_model.lights());
        self.forward(&camera, Recording::Lists);
        let peaks = ScreenPeaks::new(&self.parameters, &camera, &self.frame.footprints);
        Ok(surface(&self.tile_inputs(&camera, Recording::Lists), &self.frame.records, &peaks))
    }

    /// Computes each splat's contributions. `mask` has the size of the image.
    pub(super) fn contributions(&mut self, camera: &ScreenCamera, mask: &[f32]) -> Contributions {
        let lights = self.light_cameras(camera).into_iter().map(|camera| {
            self.forward(&camera, Recording::Lists);
            contribute(&self.tile_inputs(&camera, Recording::Lists), &self.frame.records, mask, self.parameters.count)
        });
        Contributions::of_lights(lights)
    }

    /// Counts evaluations of splats at pixels.
    pub(super) fn evaluations(&mut self, camera: &ScreenCamera) -> Evaluations {
        let lights = self.light_cameras(camera).into_iter().map(|camera| {
            self.forward(&camera, Recording::Lists);
            evaluations(&self.tile_inputs(&camera, Recording::Lists), &self.frame.records)
        });
        lights
            .fold(Evaluations::default(), |sum, light| Evaluations { touched: sum.touched + light.touched, alive: sum.alive + light.alive })
    }

    /// Checks that the scene can be trained.
    pub(super) fn check_trainable(&self) -> Result<(), EngineError> {
        Splats::check_trainable(self.parameters.layout.color_model, &self.gain)
    }
}
