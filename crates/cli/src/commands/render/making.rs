//! The choices that all images of `luxel render` share: those of the plan, with the scene's own
//! where the plan leaves them to it.

use luxel_app::output::FrameForm;
use luxel_core::{RasterConfig, RenderOptions, Scene};

use super::plan::ImagePlan;
use crate::args::channels::ChannelArg;
use crate::args::flag;
use crate::output::console::Console;

/// A scene and how its images are made.
pub(super) struct Making<'a> {
    pub(super) images: &'a ImagePlan<'a>,
    pub(super) scene: &'a Scene,
    pub(super) options: RenderOptions,
    pub(super) form: FrameForm,
}

impl<'a> Making<'a> {
    /// Returns what the images of a scene share, on a background in normalised units.
    pub(super) fn new(images: &'a ImagePlan<'a>, scene: &'a Scene, background: [f32; 3], console: &Console) -> Self {
        let raster = RasterConfig { samples: samples(images, scene, console), ..scene.raster };
        let form = FrameForm {
            color_space: images.color_space.unwrap_or(scene.color_space),
            exr_type: images.exr_type.into(),
            alpha: images.channels.has(ChannelArg::Alpha),
            depth: images.channels.has(ChannelArg::Depth),
            normals: images.channels.has(ChannelArg::Normal),
        };
        if !form.color_space.is_linear() {
            console.warn(&format!(
                "the colours of the scene are a display's (sRGB), not light: the OpenEXR files hold them as they are, and say so in \
                 colorInteropID; {} linear-rec709 makes light of them",
                flag("output_color_space")
            ));
        }
        Self { images, scene, options: RenderOptions { raster, background, ..scene.render_options() }, form }
    }
}

/// Returns the samples along a pixel's side. Deep images have one, and the images beside them are
/// what they composite to.
fn samples(images: &ImagePlan<'_>, scene: &Scene, console: &Console) -> u8 {
    let of_scene = scene.raster.samples;
    if images.samples.is_none() && images.deep.is_some() && of_scene > 1 {
        console.note(&format!(
            "deep images have 1 sample along a pixel's side, where this scene was trained with {of_scene}, and the images beside them have 1, too: \
             fine detail is less smooth. A --size {of_scene} times as large keeps it"
        ));
        return 1;
    }
    images.samples.unwrap_or(of_scene)
}
