//! Coverage of pixels by selected splats.

use luxel_core::edit::MaskShares;
use luxel_core::{Camera, Engine, RenderOptions, Scene, Selection};

use crate::Result;
use crate::edit::with_radiance;
use crate::error::{Context, ensure};

/// A selection with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Matte {
    /// Its name in the manifest.
    pub name: String,
    /// Weight of each splat, 0 to 1.
    pub weights: Vec<f32>,
}

impl Matte {
    /// Returns the matte of a selection in a scene.
    ///
    /// # Errors
    /// A selection that does not go with the scene, or that selects nothing.
    pub fn of(name: &str, selection: &Selection, scene: &Scene, masks: &MaskShares) -> Result<Self> {
        let weights = selection.weights(scene, masks).with_context(|| format!("cannot select matte {name}"))?;
        ensure!(weights.iter().any(|weight| *weight > 0.0), "matte {name}: no splat is selected");
        Ok(Self { name: name.to_owned(), weights })
    }
}

/// Renders mattes: of each pixel the part that the selected splats cover.
pub struct MatteRenderer {
    count: usize,
    /// Engines whose splats have three mattes as their colour.
    engines: Vec<Box<dyn Engine>>,
}

impl MatteRenderer {
    /// Loads a scene's mattes into an engine for every three.
    ///
    /// # Errors
    /// A device that gave up.
    pub fn new(scene: &Scene, mattes: &[Matte], mut open: impl FnMut() -> Result<Box<dyn Engine>>) -> Result<Self> {
        let loaded = |three: &[Matte]| {
            let mut engine = open()?;
            let color = |i: usize| std::array::from_fn(|c| three.get(c).map_or(0.0, |matte| matte.weights[i]));
            let splats = with_radiance(&scene.splats, (0..scene.splats.len()).map(color));
            engine.load(&splats, None).context("cannot load the mattes")?;
            Ok(engine)
        };
        Ok(Self { count: mattes.len(), engines: mattes.chunks(3).map(loaded).collect::<Result<_>>()? })
    }

    /// Returns the coverage of each pixel by each matte, `[mattes][H*W]`, 0 to 1.
    ///
    /// # Errors
    /// A camera that cannot be rendered; a device that gave up.
    pub fn coverage(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Vec<Vec<f32>>> {
        let options = RenderOptions { background: [0.0; 3], ..*options };
        let mut all = Vec::with_capacity(self.count);
        for engine in &mut self.engines {
            let image = engine.render(camera, &options).context("cannot render the mattes")?;
            let left = self.count - all.len();
            all.extend((0..left.min(3)).map(|c| image.pixels.iter().map(|pixel| pixel[c].clamp(0.0, 1.0)).collect()));
        }
        Ok(all)
    }
}
