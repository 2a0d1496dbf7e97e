//! Application of an edit to a scene.
//!
//! In: a scene, and each splat's share of painted masks. Out: the same scene with other colour
//! coefficients. These stay bit-identical: geometry and opacity; chromaticity, where the model
//! separates luminance; and all of a splat whose weight is 0 or whose luminance the maps do not
//! change. See [`crate::ColorModel::scale_radiance`], and [`super::ShMap`] for harmonics of
//! radiance under maps other than plain gains.

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
        let before = (scene.splats.sh.clone(), scene.splats.raw_luminance.clone());
        let mut hue_shift = None;
        for part in &parts {
            let changed = match part {
                Part::Luminance(chain) => recolored(scene, chain, &weights, sh_map),
                Part::Light { component, gain } => relit(scene, *component, *gain, &weights).map(|colors| (colors, None)),
            };
            match changed {
                Ok((colors, shift)) => {
                    (scene.splats.sh, scene.splats.raw_luminance) = colors;
                    hue_shift = shift;
                }
                Err(error) => {
                    (scene.splats.sh, scene.splats.raw_luminance) = before;
                    return Err(error);
                }
            }
        }
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

/// New `sh` and `raw_luminance`.
type Colors = (Vec<f32>, Vec<f32>);

/// New colours, and the hue shift.
type Recolored = (Colors, Option<f64>);

/// Multiplies the gain of a light, faded by the weights.
fn relit(scene: &Scene, component: Component, gain: f32, weights: &[f32]) -> Result<Colors, EditError> {
    let mut raw = scene.splats.raw_luminance.clone();
    let m = scene.splats.color_model.luminance_coefficients().max(1);
    for (raw, weight) in raw.chunks_exact_mut(m).zip(weights).filter(|(_, weight)| **weight > 0.0) {
        component.scale(raw, if *weight >= 1.0 { gain } else { gain.powf(*weight) });
    }
    if let Some(at) = raw.iter().position(|value| !value.is_finite()) {
        return Err(EditError::Overflow { splat: at / m, luminance: scene.luminance(at / m) });
    }
    Ok((scene.splats.sh.clone(), raw))
}

fn recolored(scene: &Scene, chain: &MapChain<'_>, weights: &[f32], sh_map: ShMap) -> Result<Recolored, EditError> {
    let Splats { color_model: model, .. } = scene.splats;
    let (k, m) = (3 * model.sh_coefficients(), model.luminance_coefficients());
    let (mut sh, mut raw) = (scene.splats.sh.clone(), scene.splats.raw_luminance.clone());
    // A gain scales harmonics exactly; the result of any other map is not a sum of harmonics.
    let refit = (!model.separates_luminance() && chain.constant_gain().is_none()).then(|| Refit::new(model));
    let (mut moved, mut light) = (0.0, 0.0);
    for (i, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
        let luminance = scene.luminance(i);
        let (sh, raw) = (&mut sh[i * k..(i + 1) * k], &mut raw[i * m..(i + 1) * m]);
        let factor = chain.factor(luminance, *weight);
        match (&refit, factor) {
            (Some(refit), factor) => {
                let base_factor = factor.unwrap_or(1.0);
                let map = SplatMap { chain, kind: sh_map, weight: *weight, scale: scene.radiance_scale.get(), base_factor };
                moved += scene.light(i) * refit.apply(sh, &map);
                light += scene.light(i);
            }
            (None, Some(factor)) if factor != 1.0 => model.scale_radiance(sh, raw, factor),
            (None, _) => {}
        }
        let is_finite = sh.iter().chain(raw.iter()).all(|v| v.is_finite());
        if !(is_finite && model.base_luminance(sh, raw).is_finite()) {
            return Err(EditError::Overflow { splat: i, luminance });
        }
    }
    let hue_shift = refit.map(|_| if light > 0.0 { moved / light } else { 0.0 });
    Ok(((sh, raw), hue_shift))
}
