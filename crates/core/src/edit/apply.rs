//! Application of an edit to a scene.
//!
//! In: a scene, and each splat's share of painted masks. Out: the same scene with other gains
//! ([`crate::Splats::gain`]; of a mix, the gains of its lights). All else stays bit-identical, and
//! with it the cut-offs, except for harmonics of radiance under maps other than plain gains: see
//! [`super::ShMap`].

use super::refit::{Refit, SplatMap};
use super::{Edit, EditError, Map, MapChain, MaskShares, ShMap};
use crate::{ColorModel, Component, Scene, Splats};

/// The result of an edit.
#[derive(Clone, Debug, PartialEq)]
pub struct Applied {
    /// The edit, with every pivot explicit.
    pub edit: Edit,
    /// Weights of the selection, `[N]`: see [`super::Selection::weights`].
    pub weights: Vec<f32>,
    /// Mean change of the selected splats' chromaticity, for colour models that cannot keep it.
    ///
    /// The sum of the channels' differences (0 to 2), averaged over directions, and over splats by
    /// their light.
    pub hue_shift: Option<f64>,
}

impl Edit {
    /// Checks that the parameters are in range.
    ///
    /// # Errors
    /// [`EditError::Parameter`].
    pub fn check(&self) -> Result<(), EditError> {
        self.selection.check()?;
        self.maps.iter().try_for_each(Map::check)
    }

    /// Returns the edit with the scene's median luminance for pivots that are not given.
    pub fn resolved(&self, scene: &Scene) -> Self {
        let mut edit = self.clone();
        for map in &mut edit.maps {
            if let Map::Power { pivot: pivot @ None, .. } = map {
                *pivot = Some(scene.median_luminance());
            }
        }
        edit
    }

    /// Returns the maps as one chain. Pivots that are not given count as 1, so call
    /// [`Self::resolved`] first.
    pub fn chain(&self) -> MapChain<'_> {
        MapChain::new(&self.maps, 1.0)
    }

    /// Applies the edit and adds it to [`Scene::edits`]. An edit without maps only selects and
    /// changes nothing.
    ///
    /// # Errors
    /// [`EditError`]; the scene is then unchanged.
    pub fn apply(&self, scene: &mut Scene, masks: &MaskShares, sh_map: ShMap) -> Result<Applied, EditError> {
        self.check()?;
        let edit = self.resolved(scene);
        let weights = edit.selection.weights(scene, masks)?;
        if edit.maps.is_empty() {
            return Ok(Applied { edit, weights, hue_shift: None });
        }
        let parts = parts(&edit.maps, scene.splats.color_model)?;
        let mut changed = scene.splats.clone();
        let mut hue_shift = None;
        for part in &parts {
            match part {
                Part::Luminance(chain) => hue_shift = recolor(&mut changed, scene, chain, &weights, sh_map)?,
                Part::Light { component, gain } => relight(&mut changed, *component, *gain, &weights),
            }
            if let Some(splat) = (0..changed.len()).find(|i| !changed.base_luminance(*i).is_finite()) {
                return Err(EditError::Overflow { splat, luminance: scene.luminance(splat) });
            }
        }
        changed.settle_gains();
        scene.splats = changed;
        scene.edits.push(edit.to_string());
        Ok(Applied { edit, weights, hue_shift })
    }
}

/// A part of an edit's maps that is applied at once.
enum Part<'m> {
    /// Maps on luminance, in order.
    Luminance(MapChain<'m>),
    /// A factor on one light.
    Light { component: Component, gain: f32 },
}

/// Splits maps where they change from luminance to a light.
fn parts(maps: &[Map], model: ColorModel) -> Result<Vec<Part<'_>>, EditError> {
    let is_light = |map: &Map| matches!(map, Map::Light { .. });
    maps.chunk_by(|a, b| !is_light(a) && !is_light(b)).map(|run| part(run, model)).collect()
}

fn part(run: &[Map], model: ColorModel) -> Result<Part<'_>, EditError> {
    let [Map::Light { number, gain }] = *run else { return Ok(Part::Luminance(MapChain::new(run, 1.0))) };
    let lights = model.lights();
    let component = model.component(usize::from(number).saturating_sub(1));
    let exists = component.gain.is_some() && usize::from(number) <= lights;
    if exists { Ok(Part::Light { component, gain }) } else { Err(EditError::Light { number, lights }) }
}

/// Multiplies the gain of a light, faded by the weights.
fn relight(splats: &mut Splats, component: Component, gain: f32, weights: &[f32]) {
    let m = splats.color_model.luminance_coefficients().max(1);
    for (raw, weight) in splats.raw_luminance.chunks_exact_mut(m).zip(weights).filter(|(_, weight)| **weight > 0.0) {
        component.scale(raw, if *weight >= 1.0 { gain } else { gain.powf(*weight) });
    }
}

/// Maps the luminance of splats of `scene`, and returns the hue shift where there may be one.
fn recolor(splats: &mut Splats, scene: &Scene, chain: &MapChain<'_>, weights: &[f32], sh_map: ShMap) -> Result<Option<f64>, EditError> {
    let model = splats.color_model;
    let (k, m) = (3 * model.sh_coefficients(), model.luminance_coefficients());
    // A gain scales harmonics exactly; the result of any other map is not a sum of harmonics.
    let refit = (!model.separates_luminance() && chain.constant_gain().is_none()).then(|| Refit::new(model, &scene.raster.cutoffs));
    let (mut moved, mut light) = (0.0, 0.0);
    for (i, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
        let factor = chain.factor(scene.radiance_scale.restored_value(splats.base_luminance(i)), *weight);
        match (&refit, factor) {
            (Some(refit), factor) => {
                let scale = scene.radiance_scale.restored_value(splats.gain_of(i));
                let map = SplatMap { chain, kind: sh_map, weight: *weight, scale, base_factor: factor.unwrap_or(1.0) };
                let (gain, shift) = refit.apply(&mut splats.sh[i * k..(i + 1) * k], &map);
                splats.scale_gain(i, gain);
                if splats.sh_of(i).iter().any(|v| !v.is_finite()) {
                    return Err(EditError::Overflow { splat: i, luminance: scene.luminance(i) });
                }
                moved += scene.light(i) * shift;
                light += scene.light(i);
            }
            (None, Some(factor)) if factor != 1.0 => match model {
                ColorModel::Mix(_) => model.scale_radiance(&mut [], &mut splats.raw_luminance[i * m..(i + 1) * m], factor),
                _ => splats.scale_gain(i, factor),
            },
            (None, _) => {}
        }
    }
    Ok(refit.map(|_| if light > 0.0 { moved / light } else { 0.0 }))
}
