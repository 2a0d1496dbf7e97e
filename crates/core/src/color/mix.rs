//! Mixes of light: light adds linearly, so scenes of the same geometry and opacity under different
//! light add to a scene under all of it.
//!
//! A mix holds the coefficients of every light and a gain of each per splat: its `sh` is the
//! harmonics of light 0, of light 1 and so on, `[K_0 + K_1 + .., 3]`; its `raw_luminance` is, for
//! each light in turn, the gain and then the light's own raw luminance, `[1 + M_0 + 1 + M_1 + ..]`.
//! The gain is linear, so a weight is exact for every colour model, though a product of luminance
//! and chromaticity plus another is no such product.
//!
//! Engines render the lights one after another and add the images, each light with the cut-offs of
//! its own radiance before the gain: a render of a mix is the weighted sum of the renders of what
//! was mixed, to rounding.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::{ColorBasis, ColorModel, Light};
use crate::Real;

/// Largest number of lights in a mix.
pub const MAX_LIGHTS: usize = 8;

/// The colour models of the lights of a mix, 1 to [`MAX_LIGHTS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Mix {
    first: Light,
    rest: [Option<Light>; MAX_LIGHTS - 1],
}

/// A light of a colour model, with the places of its coefficients among those of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component {
    /// Its formula.
    pub light: Light,
    /// Its first harmonic, coefficients per channel.
    pub sh: usize,
    /// Its first raw luminance.
    pub luminance: usize,
    /// The place of its gain among the raw luminances; `None` outside of a mix.
    pub gain: Option<usize>,
}

impl Mix {
    /// Returns the mix of lights of these models, in this order; a mix among them contributes all
    /// of its lights. `None` for no light or more than [`MAX_LIGHTS`].
    ///
    /// ```
    /// use luxel_core::{ColorModel, Mix};
    ///
    /// let sh3 = ColorModel::Sh { degree: 3 };
    /// let mix = ColorModel::Mix(Mix::new([sh3, sh3]).unwrap());
    /// assert_eq!((mix.name(), mix.lights()), ("sh3+sh3".to_owned(), 2));
    /// assert_eq!((mix.sh_coefficients(), mix.luminance_coefficients()), (32, 2));
    /// assert!(Mix::new([]).is_none());
    /// ```
    pub fn new(models: impl IntoIterator<Item = ColorModel>) -> Option<Self> {
        let mut lights = models.into_iter().flat_map(ColorModel::components).map(|component| component.light);
        let first = lights.next()?;
        let mut rest = [None; MAX_LIGHTS - 1];
        for light in lights {
            *rest.iter_mut().find(|place| place.is_none())? = Some(light);
        }
        Some(Self { first, rest })
    }

    /// Returns the lights.
    pub fn lights(self) -> impl Iterator<Item = Light> {
        std::iter::once(self.first).chain(self.rest.into_iter().flatten())
    }

    /// Returns the number of lights.
    #[expect(clippy::len_without_is_empty, reason = "a mix has one light or more")]
    pub fn len(self) -> usize {
        self.lights().count()
    }

    /// Returns light `index`; the last one if there are fewer.
    pub(super) fn component(self, index: usize) -> Component {
        let mut at = Component { light: self.first, sh: 0, luminance: 1, gain: Some(0) };
        for light in self.rest.into_iter().flatten().take(index) {
            let gain = at.luminance + at.light.luminance_coefficients();
            at = Component { light, sh: at.sh + at.light.sh_coefficients(), luminance: gain + 1, gain: Some(gain) };
        }
        at
    }
}

impl Component {
    /// Returns the light of a model that has no other.
    #[inline(always)]
    pub(super) fn alone(light: Light) -> Self {
        Self { light, sh: 0, luminance: 0, gain: None }
    }

    /// Returns the light's radiance towards a viewer, before the gain. `sh(m, channel)` and
    /// `raw_luminance(m)` fetch the coefficients of the whole model.
    #[inline(always)]
    pub fn radiance<R: Real>(self, basis: &ColorBasis<R>, sh: impl Fn(usize, usize) -> R, raw_luminance: impl Fn(usize) -> R) -> [R; 3] {
        self.light.radiance(basis, |m, c| sh(self.sh + m, c), |m| raw_luminance(self.luminance + m))
    }

    /// Returns the splat's gain of the light; `None` outside of a mix.
    #[inline(always)]
    pub fn gain<R>(self, raw_luminance: impl Fn(usize) -> R) -> Option<R> {
        self.gain.map(raw_luminance)
    }

    /// Returns R + G + B of the light's degree-0 terms, with the gain.
    pub fn base_luminance(self, sh: &[f32], raw_luminance: &[f32]) -> f32 {
        let gain = self.gain(|m| raw_luminance[m]).unwrap_or(1.0);
        gain * self.light.base_luminance(&sh[3 * self.sh..], &raw_luminance[self.luminance..])
    }

    /// Multiplies the splat's gain of the light; changes nothing outside of a mix.
    pub fn scale(self, raw_luminance: &mut [f32], factor: f32) {
        if let Some(gain) = self.gain.and_then(|at| raw_luminance.get_mut(at)) {
            *gain *= factor;
        }
    }
}

/// The form of a mix in files.
#[derive(Serialize, Deserialize)]
struct Stored {
    lights: Vec<ColorModel>,
}

impl Serialize for Mix {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Stored { lights: self.lights().map(Light::model).collect() }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Mix {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Stored { lights } = Stored::deserialize(deserializer)?;
        if lights.iter().any(|model| model.single().is_none()) {
            return Err(de::Error::custom("a mix within a mix"));
        }
        Self::new(lights).ok_or_else(|| de::Error::custom(format!("a mix of no light or more than {MAX_LIGHTS}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Activation;

    const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 1, luminance_degree: 1, activation: Activation::Softplus };
    const SH: ColorModel = ColorModel::Sh { degree: 2 };

    fn mix(models: &[ColorModel]) -> ColorModel {
        ColorModel::Mix(Mix::new(models.iter().copied()).unwrap())
    }

    fn noise(count: usize, seed: u32) -> Vec<f32> {
        (0..count as u32).map(|i| ((i + 31 * seed).wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 23) as f32 - 1.0).collect()
    }

    #[test]
    fn a_mix_is_the_weighted_sum_of_its_lights_in_every_direction() {
        let models = [LCD, SH, ColorModel::Lcd { chroma_degree: 0, luminance_degree: 0, activation: Activation::Exp }];
        let weights = [1.0, 0.3, 2.5];
        let parts: Vec<_> = models
            .iter()
            .zip(0..)
            .map(|(model, seed)| (noise(3 * model.sh_coefficients(), seed), noise(model.luminance_coefficients(), seed + 9)))
            .collect();
        let sh: Vec<f32> = parts.iter().flat_map(|(sh, _)| sh.clone()).collect();
        let raw: Vec<f32> =
            parts.iter().zip(weights).flat_map(|((_, raw), weight)| std::iter::once(weight).chain(raw.iter().copied())).collect();
        let mixed = mix(&models);
        assert_eq!([sh.len(), raw.len()], [3 * mixed.sh_coefficients(), mixed.luminance_coefficients()]);
        for direction in [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [-0.48, 0.64, 0.6]] {
            let basis = ColorBasis::new(5, direction);
            let found = mixed.radiance(&basis, |m, c| sh[3 * m + c], |m| raw[m]);
            let mut expected = [0.0; 3];
            for ((model, (sh, raw)), weight) in models.iter().zip(&parts).zip(weights) {
                let radiance = model.radiance(&basis, |m, c| sh[3 * m + c], |m| raw[m]);
                (0..3).for_each(|c| expected[c] += weight * radiance[c]);
            }
            for c in 0..3 {
                assert!((found[c] - expected[c]).abs() <= 1e-6 * expected[c].abs(), "{found:?} {expected:?}");
            }
        }
        let base: f32 = mixed.base_radiance(&sh, &raw).iter().sum();
        assert!((mixed.base_luminance(&sh, &raw) - base).abs() < 2e-3 * base);
    }

    #[test]
    fn the_gradient_of_a_mix_is_that_of_its_differences() {
        let model = mix(&[LCD, SH]);
        let [k, m] = [3 * model.sh_coefficients(), model.luminance_coefficients()];
        let parameters: Vec<f64> = noise(k + m, 3).into_iter().map(f64::from).collect();
        let weights = [0.7, -1.1, 0.4];
        let direction = [0.48f64, -0.64, 0.6];
        let loss = |p: &[f64]| {
            let c = model.radiance(&ColorBasis::new(3, direction), |m, c| p[3 * m + c], |m| p[k + m]);
            (0..3).map(|i| weights[i] * c[i]).sum::<f64>()
        };
        let gradient = std::cell::RefCell::new(vec![0.0; k + m]);
        model.backward(
            &ColorBasis::new(3, direction),
            |m, c| parameters[3 * m + c],
            |m| parameters[k + m],
            weights,
            |m, c, g| gradient.borrow_mut()[3 * m + c] += g,
            |m, g| gradient.borrow_mut()[k + m] += g,
        );
        for i in 0..k + m {
            let at = |h: f64| {
                let mut p = parameters.clone();
                p[i] += h;
                loss(&p)
            };
            let expected = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((gradient.borrow()[i] - expected).abs() < 1e-6, "parameter {i}: {} {expected}", gradient.borrow()[i]);
        }
    }

    #[test]
    fn a_mix_survives_json_and_only_lights_mix() {
        let model = mix(&[LCD, SH]);
        let json = serde_json::to_string(&model).unwrap();
        assert_eq!(serde_json::from_str::<ColorModel>(&json).unwrap(), model, "{json}");
        assert_eq!(mix(&[model, SH]), mix(&[LCD, SH, SH]));
        assert_eq!(Mix::new([SH; MAX_LIGHTS + 1]), None);
        let nested = format!(r#"{{"kind":"mix","lights":[{json}]}}"#);
        for text in [nested.as_str(), r#"{"kind":"mix","lights":[]}"#, r#"{"kind":"mix"}"#] {
            assert!(serde_json::from_str::<ColorModel>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_factor_changes_gains_alone() {
        let model = mix(&[LCD, SH]);
        let mut sh = noise(3 * model.sh_coefficients(), 1);
        let mut raw = vec![1.0; model.luminance_coefficients()];
        let before = sh.clone();
        model.scale_radiance(&mut sh, &mut raw, 0.25);
        assert_eq!((sh, raw), (before, vec![0.25, 1.0, 1.0, 1.0, 1.0, 0.25]));
    }
}
