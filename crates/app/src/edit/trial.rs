//! A scene under an edit beside the ideal: each view rendered unedited and edited, on black, and
//! the unedited render with the maps on each pixel's luminance.
//!
//! In: [`EditTrial`]. Out: the fidelity over all views, and the images of each, in the units of the
//! data set. Degenerate: views that are black before or after are an error.

use luxel::error::Context;
use luxel::{DeviceOptions, Result, SelectedEngine};
use luxel_core::edit::{Fidelity, FidelityMeter, MaskShares, ShMap, ideally_edited};
use luxel_core::{Edit, Engine, Image, Map, MapChain, Scene, View};

/// A scene, and one way to edit it.
pub(crate) struct EditTrial<'a> {
    /// Name for errors.
    pub(crate) name: &'a str,
    /// The scene before the edit.
    pub(crate) scene: &'a Scene,
    /// Edits of the whole scene, whose pivots are given.
    pub(crate) edits: &'a [Edit],
    /// Quantity that is mapped in scenes of spherical harmonics.
    pub(crate) sh_map: ShMap,
}

/// The images of a view, in the units of the data set.
pub(crate) struct EditedView {
    pub(crate) before: Image,
    pub(crate) after: Image,
    pub(crate) ideal: Image,
}

/// An engine for a scene as it is and one for it edited: each view is rendered by both.
pub(crate) struct EditEngines {
    before: Box<dyn Engine>,
    after: Box<dyn Engine>,
}

impl EditEngines {
    /// Opens both.
    pub(crate) fn open(device: &DeviceOptions) -> Result<Self> {
        Ok(Self { before: SelectedEngine::open(device)?.engine, after: SelectedEngine::open(device)?.engine })
    }

    /// Renders all views unedited and edited, hands each with its number to `each`, and compares
    /// with the ideal.
    pub(crate) fn measure(
        &mut self,
        trial: &EditTrial<'_>,
        views: &[View],
        each: &mut dyn FnMut(usize, EditedView) -> Result<()>,
    ) -> Result<Fidelity> {
        let mut edited = trial.scene.clone();
        for edit in trial.edits {
            edit.apply(&mut edited, &MaskShares::new(), trial.sh_map).with_context(|| format!("cannot apply \"{edit}\""))?;
        }
        for (engine, scene) in [(&mut self.before, trial.scene), (&mut self.after, &edited)] {
            engine.load(&scene.splats, None).context("cannot load the scene")?;
        }
        let maps: Vec<Map> = trial.edits.iter().flat_map(|edit| edit.maps.clone()).collect();
        let chain = MapChain::new(&maps, 1.0);
        let mut meter = FidelityMeter::default();
        for (i, view) in views.iter().enumerate() {
            let before = render(trial.scene, view, self.before.as_mut())?;
            let after = render(trial.scene, view, self.after.as_mut())?;
            let ideal = ideally_edited(&before, &chain);
            meter.add(&after, &ideal);
            each(i, EditedView { before, after, ideal })?;
        }
        meter.fidelity().with_context(|| format!("{}: all pixels are black, before or after", trial.name))
    }
}

/// Renders a view of a loaded scene in the units of the data set. A background is not made of
/// splats and would not be edited, so it is black.
fn render(scene: &Scene, view: &View, engine: &mut dyn Engine) -> Result<Image> {
    let options = scene.render_options();
    let mut image = engine.render(&view.camera, &options).with_context(|| format!("cannot render view {}", view.name))?;
    scene.radiance_scale.restore(&mut image);
    Ok(image)
}
