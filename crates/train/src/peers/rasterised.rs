//! The splats of a step on the screen of its view, for steps that blend colours of their own.
//!
//! In: the engine's splats and its rasteriser with gradients, a camera, the step's options. Out:
//! colours towards the camera, blended images, and from the gradients by images and colours those
//! by the splats' parameters, in the form that [`luxel_core::Engine::apply_gradients`] takes, with
//! the densification statistics of one image.
//!
//! Cut-offs are those of 3DGS, which do not depend on colours. Degenerate: splats that the view
//! does not show have no gradient.

use luxel_core::engine::{
    ActivatedSplats, BlendGradient, BlendOptions, BlendedSplats, Channels, Differentiable, DirectionalColors, Dropout, EllipseGradient,
    MatrixCamera, ParameterRows, PixelGradient, ProjectedSplats, SPLATS_PER_BLOCK, ScreenEllipses, ShapeParameters, SparseGradients,
    StatsCollection, StepConfig,
};
use luxel_core::{Camera, EngineError, RenderOptions, Splats, sigmoid};

/// Depth beyond which splats are culled: none.
const FAR: f32 = f32::MAX;

/// How splats are seen.
#[derive(Clone, Copy)]
pub(crate) struct SeenWith<'a> {
    pub(crate) render: &'a RenderOptions,
    /// The splats that a step leaves out.
    pub(crate) dropout: Option<Dropout>,
}

/// Splats on the screen of a view.
pub(crate) struct Rasterised<'a> {
    raster: &'a dyn Differentiable,
    splats: &'a Splats,
    active_degree: usize,
    eye: [f32; 3],
    size_px: [u32; 2],
    scale: Vec<[f32; 3]>,
    /// Factors of the opacities: 0 for splats that the step leaves out.
    opacity_factor: Vec<f32>,
    ellipses: ScreenEllipses,
    ellipses_to_pixels: Box<dyn ProjectedSplats>,
    /// Whether the view shows a splat.
    visible: Vec<bool>,
}

/// A blended image.
pub(crate) struct BlendedImage {
    /// Interleaved pixels.
    pub(crate) pixels: Vec<[f32; 3]>,
    blended: Box<dyn BlendedSplats>,
}

/// Blended images of any number of channels.
pub(crate) struct BlendedChannels {
    /// `[H, W, K]`.
    pub(crate) channels: Vec<f32>,
    blended: Box<dyn BlendedSplats>,
}

impl BlendedChannels {
    /// Returns the gradient by the channels `[N, K]` and by the splats on the screen, from that by
    /// the pixels.
    pub(crate) fn backward(&self, by_pixel: &[f32]) -> Result<BlendGradient, EngineError> {
        self.blended.backward(&PixelGradient { channels: by_pixel, alpha: None, absolute: Default::default() })
    }
}

/// The gradients of the splats' colours and geometry, summed over images.
#[derive(Default)]
pub(crate) struct ImageGradients {
    geometry: Option<BlendGradient>,
    /// |dL/dmean| in NDC units of the image that decides where splats are added.
    norms: Option<Vec<f32>>,
}

impl BlendedImage {
    /// Returns the gradient by the image's colours `[N]` and by the splats on the screen, from that
    /// by its pixels.
    pub(crate) fn backward(&self, by_pixel: &[[f32; 3]]) -> Result<BlendGradient, EngineError> {
        let gradient = PixelGradient { channels: by_pixel.as_flattened(), alpha: None, absolute: Default::default() };
        self.blended.backward(&gradient)
    }
}

impl ImageGradients {
    /// Adds the gradient by the splats of an image.
    pub(crate) fn add(&mut self, of_image: BlendGradient) {
        let Some(sum) = &mut self.geometry else {
            self.geometry = Some(of_image);
            return;
        };
        let add = |sum: &mut [f32], part: &[f32]| sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        add(sum.mean_px.as_flattened_mut(), of_image.mean_px.as_flattened());
        add(sum.covariance_px2.as_flattened_mut(), of_image.covariance_px2.as_flattened());
        add(&mut sum.opacity, &of_image.opacity);
    }

    /// Adds the gradient by the splats of the image whose gradients decide where splats are added.
    pub(crate) fn add_with_statistics(&mut self, of_image: BlendGradient, size_px: [u32; 2]) {
        let ndc = size_px.map(|side| 0.5 * side as f32);
        let norm = |[x, y]: &[f32; 2]| {
            let (x, y) = (x * ndc[0], y * ndc[1]);
            (x * x + y * y).sqrt()
        };
        self.norms = Some(of_image.mean_px.iter().map(norm).collect());
        self.add(of_image);
    }
}

impl<'a> Rasterised<'a> {
    /// Projects the splats to the screen of a step's pinhole camera.
    pub(crate) fn new(raster: &'a dyn Differentiable, splats: &'a Splats, camera: &Camera, step: &StepConfig) -> Result<Self, EngineError> {
        Self::projected(raster, splats, camera, SeenWith { render: &step.render, dropout: step.dropout })
    }

    /// Projects the splats to the screen of a pinhole camera: all of them, unless a step leaves
    /// some out.
    pub(crate) fn projected(
        raster: &'a dyn Differentiable,
        splats: &'a Splats,
        camera: &Camera,
        options: SeenWith<'_>,
    ) -> Result<Self, EngineError> {
        let config = options.render.raster;
        let blending = BlendOptions {
            size_px: camera.size_px,
            cutoffs: config.cutoffs,
            far: FAR,
            min_radius_px: 0.0,
            dilation_px2: config.antialias.dilation_px2(),
            compensates_opacity: config.antialias.compensates_opacity(),
        };
        let factor = |splat: u32| match options.dropout {
            None => 1.0,
            Some(dropout) if dropout.keeps(splat) => dropout.opacity_factor(),
            Some(_) => 0.0,
        };
        let opacity_factor: Vec<f32> = (0..splats.len() as u32).map(factor).collect();
        let scale: Vec<[f32; 3]> = splats.log_scale.iter().map(|s| s.map(f32::exp)).collect();
        let opacity: Vec<f32> = splats.opacity_logit.iter().zip(&opacity_factor).map(|(logit, factor)| sigmoid(*logit) * factor).collect();
        let activated = ActivatedSplats { position: &splats.position, rotation: &splats.rotation, scale: &scale, opacity: &opacity };
        let (ellipses, ellipses_to_pixels) = raster.project(&activated, &[matrix_camera(camera)], &blending)?;
        let visible = ellipses.radius_px.iter().map(|radius| radius[0] > 0).collect();
        let eye = camera.eye().to_array().map(|v| v as f32);
        let (active_degree, size_px) = (options.render.active_degree, camera.size_px);
        Ok(Self { raster, splats, active_degree, eye, size_px, scale, opacity_factor, ellipses, ellipses_to_pixels, visible })
    }

    /// Returns whether the view shows each splat.
    pub(crate) fn visible(&self) -> &[bool] {
        &self.visible
    }

    /// Returns the number of splats that the view shows.
    pub(crate) fn visible_count(&self) -> u32 {
        self.visible.iter().filter(|visible| **visible).count() as u32
    }

    /// Returns the size of the image.
    pub(crate) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn directional(&self) -> DirectionalColors<'_> {
        DirectionalColors {
            model: self.splats.color_model,
            active_degree: self.active_degree,
            position: &self.splats.position,
            eye: std::slice::from_ref(&self.eye),
            sh: &self.splats.sh,
            sh_per_splat: self.splats.color_model.sh_coefficients(),
            raw_luminance: &self.splats.raw_luminance,
            visible: Some(&self.visible),
        }
    }

    /// Returns the colours of the splats by their model, 0 where the view does not show them.
    pub(crate) fn colors(&self) -> Result<Vec<[f32; 3]>, EngineError> {
        self.raster.colors(&self.directional())
    }

    /// Blends colours over black.
    pub(crate) fn blend(&self, colors: &[[f32; 3]]) -> Result<BlendedImage, EngineError> {
        self.blend_over(colors, None)
    }

    /// Blends channels `[N, count]` over 0.
    pub(crate) fn blend_channels(&self, values: &[f32], count: usize) -> Result<BlendedChannels, EngineError> {
        let (pixels, blended) = self.ellipses_to_pixels.blend(&Channels { values, count, background: None })?;
        Ok(BlendedChannels { channels: pixels.channels, blended })
    }

    /// Blends colours over a background, or over black.
    pub(crate) fn blend_over(&self, colors: &[[f32; 3]], background: Option<[f32; 3]>) -> Result<BlendedImage, EngineError> {
        let background = background.as_ref().map(|rgb| &rgb[..]);
        let (pixels, blended) = self.ellipses_to_pixels.blend(&Channels { values: colors.as_flattened(), count: 3, background })?;
        Ok(BlendedImage { pixels: pixels.channels.as_chunks::<3>().0.to_vec(), blended })
    }

    /// Returns the gradients by the splats' parameters, from those by images and by the colours of
    /// the model.
    pub(crate) fn gradients(
        &self,
        images: &ImageGradients,
        by_color: &[[f32; 3]],
        stats: StatsCollection,
    ) -> Result<SparseGradients, EngineError> {
        let rows = ParameterRows { color_model: self.splats.color_model };
        let mut gradients = SparseGradients::none(rows);
        let Some(geometry) = &images.geometry else { return Ok(gradients) };
        let by_ellipse = EllipseGradient {
            mean_px: Some(&geometry.mean_px),
            covariance_px2: Some(&geometry.covariance_px2),
            opacity: Some(&geometry.opacity),
            shape: ShapeParameters::RotationAndScale,
            ..EllipseGradient::default()
        };
        let by_splat = self.ellipses_to_pixels.backward(&by_ellipse)?;
        let colors = self.raster.colors_backward(&self.directional(), by_color)?;
        let (k, m) = (3 * rows.color_model.sh_coefficients(), rows.color_model.luminance_coefficients());
        let norms = images.norms.as_deref().filter(|_| stats != StatsCollection::Off);
        for (block, visible) in (0..).zip(self.visible.chunks(SPLATS_PER_BLOCK)) {
            if !visible.contains(&true) {
                continue;
            }
            let values = gradients.push(block);
            let first = block as usize * SPLATS_PER_BLOCK;
            for (lane, i) in (first..first + visible.len()).enumerate().filter(|(lane, _)| visible[*lane]) {
                let mut set = |row: usize, value: f32| values[row * SPLATS_PER_BLOCK + lane] = if value.is_finite() { value } else { 0.0 };
                // d sigmoid(l) = o (1 - o) dl.
                let opacity = sigmoid(self.splats.opacity_logit[i]);
                let by_logit = by_splat.opacity[i] * self.opacity_factor[i] * opacity * (1.0 - opacity);
                for c in 0..3 {
                    set(ParameterRows::POSITION + c, by_splat.position[i][c] + colors.position[i][c]);
                    set(ParameterRows::LOG_SCALE + c, by_splat.scale[i][c] * self.scale[i][c]);
                }
                (0..4).for_each(|c| set(ParameterRows::ROTATION + c, by_splat.rotation[i][c]));
                set(ParameterRows::OPACITY, by_logit);
                colors.sh[i * k..(i + 1) * k].iter().enumerate().for_each(|(c, value)| set(ParameterRows::SH + c, *value));
                let luminance = &colors.raw_luminance[i * m..(i + 1) * m];
                luminance.iter().enumerate().for_each(|(c, value)| set(rows.luminance() + c, *value));
                if let Some(norms) = norms {
                    set(rows.count(), norms[i]);
                    set(rows.count() + 2, 1.0);
                }
            }
        }
        Ok(gradients)
    }

    /// Gives back memory that later steps can use.
    pub(crate) fn recycle(self, images: ImageGradients) {
        if let Some(BlendGradient { channels, .. }) = images.geometry {
            self.raster.recycle(channels);
        }
        self.raster.recycle(self.ellipses.depth);
    }
}

/// Returns a pinhole camera as a matrix, rounded as the engines round it.
fn matrix_camera(camera: &Camera) -> MatrixCamera {
    let rows = camera.camera_from_world.matrix3.transpose().to_cols_array_2d();
    let translation = camera.camera_from_world.translation.to_array();
    let row = |i: usize| [rows[i][0] as f32, rows[i][1] as f32, rows[i][2] as f32, translation[i] as f32];
    MatrixCamera {
        camera_from_world: [row(0), row(1), row(2)],
        focal_px: camera.focal_px.to_array().map(|v| v as f32),
        center_px: camera.center_px.to_array().map(|v| v as f32),
    }
}
