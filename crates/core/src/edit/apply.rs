//! Application of an edit to a scene.
//!
//! In: a scene, and each splat's share of painted masks. Out: the same scene with other colour
//! coefficients. These stay bit-identical: geometry and opacity; chromaticity, where the model
//! separates luminance; and all of a splat whose weight is 0 or whose luminance the maps do not
//! change. See [`crate::ColorModel::scale_radiance`], and [`super::ShMap`] for harmonics of
//! radiance under maps other than plain gains.

use super::refit::{Refit, SplatMap};
use super::{Edit, EditError, Map, MapChain, MaskShares, ShMap};
use crate::{Scene, Splats};

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
        let (colors, hue_shift) = recolored(scene, &edit.chain(), &weights, sh_map)?;
        (scene.splats.sh, scene.splats.raw_luminance) = colors;
        scene.edits.push(edit.to_string());
        Ok(Applied { edit, weights, hue_shift })
    }
}

/// New `sh` and `raw_luminance`, and the hue shift.
type Recolored = ((Vec<f32>, Vec<f32>), Option<f64>);

fn recolored(scene: &Scene, chain: &MapChain<'_>, weights: &[f32], sh_map: ShMap) -> Result<Recolored, EditError> {
    let Splats { color_model: model, .. } = scene.splats;
    let (k, m) = (3 * model.sh_coefficients(), model.luminance_coefficients());
    let (mut sh, mut raw) = (scene.splats.sh.clone(), scene.splats.raw_luminance.clone());
    // A gain scales harmonics exactly; the result of any other map is not a sum of harmonics.
    let refit = (!model.separates_luminance() && chain.constant_gain().is_none()).then(|| Refit::new(model.sh_degree()));
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
