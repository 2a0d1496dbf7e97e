//! A scene: N Gaussian primitives as a structure of arrays.

use crate::{ColorModel, EngineError};

/// N primitives. All arrays are splat-major and hold exactly N entries of their shape.
///
/// Radiance is in the scene's normalised units: radiance of the data set divided by [`crate::Scene::radiance_scale`].
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    /// How `sh` and `raw_luminance` become radiance.
    pub color_model: ColorModel,
    /// `[N,3]`, world.
    pub position: Vec<[f32; 3]>,
    /// `[N,4]` quaternion w x y z, of any length but zero.
    pub rotation: Vec<[f32; 4]>,
    /// `[N,3]` natural logarithm of the standard deviations along the principal axes, world units.
    pub log_scale: Vec<[f32; 3]>,
    /// `[N]` logit of the opacity.
    pub opacity_logit: Vec<f32>,
    /// `[N,K,3]` harmonics of radiance or chromaticity; K = `color_model.sh_coefficients()`.
    pub sh: Vec<f32>,
    /// `[N,M]` raw luminance; M = `color_model.luminance_coefficients()`, may be 0.
    pub raw_luminance: Vec<f32>,
    /// `[N]` standard deviation of the 3D smoothing filter (Mip-splatting), world units; empty when the scene has none.
    pub smoothing: Vec<f32>,
}

/// Why arrays do not make up a scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SplatsError {
    /// An array's length does not follow from the number of splats and the colour model.
    #[error("{array} has {found} values, expected {expected}")]
    Length {
        /// Field of [`Splats`].
        array: &'static str,
        /// Values (not rows) found.
        found: usize,
        /// Values expected.
        expected: usize,
    },
    /// The colour model's degrees are out of range.
    #[error("colour model {0} is out of range: SH degree must be 0 to 5, luminance degree 0 to 3")]
    ColorModel(String),
    /// A value is NaN or infinite.
    #[error("{array} of splat {splat} is not finite")]
    NotFinite {
        /// Field of [`Splats`].
        array: &'static str,
        /// Index of the splat.
        splat: usize,
    },
}

impl Splats {
    /// No splats.
    pub fn empty(color_model: ColorModel) -> Self {
        Self {
            color_model,
            position: Vec::new(),
            rotation: Vec::new(),
            log_scale: Vec::new(),
            opacity_logit: Vec::new(),
            sh: Vec::new(),
            raw_luminance: Vec::new(),
            smoothing: Vec::new(),
        }
    }

    /// N.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// N = 0.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Harmonics of splat `i`: `[K,3]` flattened.
    pub fn sh_of(&self, i: usize) -> &[f32] {
        let k = 3 * self.color_model.sh_coefficients();
        &self.sh[i * k..(i + 1) * k]
    }

    /// Raw luminance of splat `i`: `[M]`.
    pub fn raw_luminance_of(&self, i: usize) -> &[f32] {
        let m = self.color_model.luminance_coefficients();
        &self.raw_luminance[i * m..(i + 1) * m]
    }

    /// Appends a splat; `sh` is `[K,3]`, `raw_luminance` `[M]`.
    ///
    /// # Panics
    /// If `sh` or `raw_luminance` does not have the colour model's length.
    pub fn push(&mut self, splat: &Splat<'_>) {
        assert_eq!(splat.sh.len(), 3 * self.color_model.sh_coefficients());
        assert_eq!(splat.raw_luminance.len(), self.color_model.luminance_coefficients());
        self.position.push(splat.position);
        self.rotation.push(splat.rotation);
        self.log_scale.push(splat.log_scale);
        self.opacity_logit.push(splat.opacity_logit);
        self.sh.extend_from_slice(splat.sh);
        self.raw_luminance.extend_from_slice(splat.raw_luminance);
    }

    /// The splats that `order` names, in its order.
    ///
    /// # Panics
    /// If an index is not below [`Splats::len`].
    pub fn select(&self, order: impl IntoIterator<Item = u32>) -> Self {
        let mut selected = Self::empty(self.color_model);
        for i in order.into_iter().map(|i| i as usize) {
            selected.push(&Splat {
                position: self.position[i],
                rotation: self.rotation[i],
                log_scale: self.log_scale[i],
                opacity_logit: self.opacity_logit[i],
                sh: self.sh_of(i),
                raw_luminance: self.raw_luminance_of(i),
            });
            selected.smoothing.extend(self.smoothing.get(i));
        }
        selected
    }

    /// Radiance of splat `i` towards a viewer in `direction` (unit, from the viewer to the splat), all degrees active.
    pub fn radiance(&self, i: usize, direction: [f32; 3]) -> [f32; 3] {
        let basis = crate::ColorBasis::new(self.color_model.max_degree(), direction);
        let (sh, raw) = (self.sh_of(i), self.raw_luminance_of(i));
        self.color_model.radiance(&basis, |m, c| sh[3 * m + c], |m| raw[m])
    }

    /// Radiance of splat `i` by its degree-0 terms: the same from everywhere.
    pub fn base_radiance(&self, i: usize) -> [f32; 3] {
        self.color_model.base_radiance(self.sh_of(i), self.raw_luminance_of(i))
    }

    /// Luminance (R + G + B, normalised units) of splat `i` by its degree-0 terms.
    pub fn base_luminance(&self, i: usize) -> f32 {
        self.color_model.base_luminance(self.sh_of(i), self.raw_luminance_of(i))
    }

    /// Checks lengths and finiteness. Engines and writers may assume both.
    ///
    /// # Errors
    /// The first violation found.
    pub fn validate(&self) -> Result<(), SplatsError> {
        if !self.color_model.is_valid() {
            return Err(SplatsError::ColorModel(self.color_model.name()));
        }
        let n = self.len();
        let k = 3 * self.color_model.sh_coefficients();
        let m = self.color_model.luminance_coefficients();
        let smoothing = if self.smoothing.is_empty() { 0 } else { n };
        let lengths = [
            ("rotation", self.rotation.len() * 4, n * 4),
            ("log_scale", self.log_scale.len() * 3, n * 3),
            ("opacity_logit", self.opacity_logit.len(), n),
            ("sh", self.sh.len(), n * k),
            ("raw_luminance", self.raw_luminance.len(), n * m),
            ("smoothing", self.smoothing.len(), smoothing),
        ];
        for (array, found, expected) in lengths {
            if found != expected {
                return Err(SplatsError::Length { array, found, expected });
            }
        }
        let finite: [(&'static str, &[f32], usize); 7] = [
            ("position", self.position.as_flattened(), 3),
            ("rotation", self.rotation.as_flattened(), 4),
            ("log_scale", self.log_scale.as_flattened(), 3),
            ("opacity_logit", &self.opacity_logit, 1),
            ("sh", &self.sh, k),
            ("raw_luminance", &self.raw_luminance, m),
            ("smoothing", &self.smoothing, 1),
        ];
        for (array, values, width) in finite {
            if let Some(at) = values.iter().position(|v| !v.is_finite()) {
                return Err(SplatsError::NotFinite { array, splat: at / width.max(1) });
            }
        }
        Ok(())
    }
}

/// One primitive, borrowed; shapes as in [`Splats`].
#[derive(Clone, Copy, Debug)]
pub struct Splat<'a> {
    /// World.
    pub position: [f32; 3],
    /// w x y z.
    pub rotation: [f32; 4],
    /// Natural logarithm of the standard deviations.
    pub log_scale: [f32; 3],
    /// Logit of the opacity.
    pub opacity_logit: f32,
    /// `[K,3]`.
    pub sh: &'a [f32],
    /// `[M]`.
    pub raw_luminance: &'a [f32],
}

/// First and second moments of Adam for every parameter, in the layout of [`Splats`].
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Running mean of the gradient.
    pub first: Splats,
    /// Running mean of the squared gradient.
    pub second: Splats,
}

impl Moments {
    /// Checks that they are of `splats`: valid arrays of as many splats of the same colour model.
    ///
    /// # Errors
    /// [`EngineError::Splats`], [`EngineError::Invalid`].
    pub fn validate_for(&self, splats: &Splats) -> Result<(), EngineError> {
        for part in [&self.first, &self.second] {
            part.validate()?;
            if part.len() != splats.len() || part.color_model != splats.color_model {
                return Err(EngineError::invalid(format!(
                    "moments are of {} {} splats, the scene has {} {}",
                    part.len(),
                    part.color_model.name(),
                    splats.len(),
                    splats.color_model.name()
                )));
            }
        }
        Ok(())
    }

    /// All zero, for `count` splats.
    pub fn zeros(color_model: ColorModel, count: usize) -> Self {
        let zeros = Splats {
            color_model,
            position: vec![[0.0; 3]; count],
            rotation: vec![[0.0; 4]; count],
            log_scale: vec![[0.0; 3]; count],
            opacity_logit: vec![0.0; count],
            sh: vec![0.0; count * 3 * color_model.sh_coefficients()],
            raw_luminance: vec![0.0; count * color_model.luminance_coefficients()],
            smoothing: Vec::new(),
        };
        Self { first: zeros.clone(), second: zeros }
    }
}

/// 1 / (1 + e^-x).
#[inline]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// ln(p / (1 - p)); p is kept 1e-6 away from 0 and 1.
#[inline]
pub fn logit(p: f32) -> f32 {
    let p = p.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln()
}
