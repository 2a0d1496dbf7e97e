//! Gaussian splats as a structure of arrays, and Adam's moments in the same layout.

use crate::engine::SplatArray;
use crate::{ColorModel, EngineError};

/// A set of N Gaussian splats.
///
/// All arrays are splat-major and hold exactly N entries of their shape.
///
/// Radiance is in the scene's normalised units: radiance of the data set divided by
/// [`crate::Scene::radiance_scale`].
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    /// Colour model that turns `sh` and `raw_luminance` into radiance.
    pub color_model: ColorModel,
    /// Positions `[N,3]`, world units.
    pub position: Vec<[f32; 3]>,
    /// Rotations `[N,4]`: quaternions w x y z, of any length but zero.
    pub rotation: Vec<[f32; 4]>,
    /// Natural logarithms `[N,3]` of the standard deviations along the principal axes, world units.
    pub log_scale: Vec<[f32; 3]>,
    /// Logits `[N]` of the opacity.
    pub opacity_logit: Vec<f32>,
    /// Harmonics `[N,K,3]` of radiance or chromaticity; K = `color_model.sh_coefficients()`.
    pub sh: Vec<f32>,
    /// Raw luminance `[N,M]`; M = `color_model.luminance_coefficients()`, may be 0.
    pub raw_luminance: Vec<f32>,
    /// Standard deviations `[N]` of the 3D smoothing filter (Mip-splatting), world units; empty
    /// without the filter.
    pub smoothing: Vec<f32>,
    /// Gains `[N]` of the splats' light since training, 0 or more; empty for 1 everywhere.
    ///
    /// A splat's radiance is that of the colour model times its gain. Cut-offs
    /// ([`crate::Cutoffs`]) follow the radiance before the gain: they are part of what was trained,
    /// so that an edit changes light and nothing else.
    pub gain: Vec<f32>,
}

/// Explains why arrays do not form valid splats.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SplatsError {
    /// The length of an array does not match the number of splats and the colour model.
    #[error("{array} has {found} values, expected {expected}")]
    Length {
        /// Field of [`Splats`].
        array: &'static str,
        /// Number of values (not rows) found.
        found: usize,
        /// Number of values expected.
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
    /// A gain is below 0.
    #[error("gain of splat {splat} is {found}, expected 0 or more")]
    Gain {
        /// Index of the splat.
        splat: usize,
        /// Its gain.
        found: f32,
    },
}

impl Splats {
    /// Returns an empty set of splats.
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
            gain: Vec::new(),
        }
    }

    /// Returns N, the number of splats.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Returns whether there are no splats.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Returns the harmonics of splat `i`: `[K,3]` flattened.
    pub fn sh_of(&self, i: usize) -> &[f32] {
        let k = 3 * self.color_model.sh_coefficients();
        &self.sh[i * k..(i + 1) * k]
    }

    /// Returns the raw luminance of splat `i`: `[M]`.
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

    /// Appends all splats of another scene.
    ///
    /// # Panics
    /// If the colour models differ.
    pub fn append(&mut self, from: Self) {
        assert_eq!(self.color_model, from.color_model);
        if !(self.gain.is_empty() && from.gain.is_empty()) {
            let ones = |gain: &[f32], splats: usize| vec![1.0; splats - gain.len()];
            self.gain.extend(ones(&self.gain, self.len()));
            self.gain.extend(if from.gain.is_empty() { ones(&from.gain, from.len()) } else { from.gain });
        }
        self.position.extend(from.position);
        self.rotation.extend(from.rotation);
        self.log_scale.extend(from.log_scale);
        self.opacity_logit.extend(from.opacity_logit);
        self.sh.extend(from.sh);
        self.raw_luminance.extend(from.raw_luminance);
        self.smoothing.extend(from.smoothing);
    }

    /// Returns the splats at the indices of `order`, in its order.
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
            selected.gain.extend(self.gain.get(i));
        }
        selected
    }

    /// Returns the radiance of splat `i` towards a viewer in `direction` (unit, from the viewer to
    /// the splat), with all degrees active.
    pub fn radiance(&self, i: usize, direction: [f32; 3]) -> [f32; 3] {
        let basis = crate::ColorBasis::new(self.color_model.max_degree(), direction);
        let (sh, raw) = (self.sh_of(i), self.raw_luminance_of(i));
        self.color_model.radiance(&basis, |m, c| sh[3 * m + c], |m| raw[m]).map(|c| c * self.gain_of(i))
    }

    /// Returns the gain of splat `i`.
    pub fn gain_of(&self, i: usize) -> f32 {
        self.gain.get(i).copied().unwrap_or(1.0)
    }

    /// Multiplies the gain of splat `i`; [`Self::settle_gains`] removes gains that came to nothing.
    pub fn scale_gain(&mut self, i: usize, factor: f32) {
        if self.gain.is_empty() {
            self.gain = vec![1.0; self.len()];
        }
        self.gain[i] *= factor;
    }

    /// Removes the gains if all are 1.
    pub fn settle_gains(&mut self) {
        if self.gain.iter().all(|gain| *gain == 1.0) {
            self.gain = Vec::new();
        }
    }

    /// Takes the gains into the colours ([`ColorModel::scale_radiance`]): cut-offs then follow the
    /// radiance with them. For training, which owns its cut-offs, and for files that have no gains.
    pub fn fold_gains(&mut self) {
        let (k, m) = (3 * self.color_model.sh_coefficients(), self.color_model.luminance_coefficients());
        for (i, gain) in std::mem::take(&mut self.gain).into_iter().enumerate().filter(|(_, gain)| *gain != 1.0) {
            let (sh, raw) = (&mut self.sh[i * k..(i + 1) * k], &mut self.raw_luminance[i * m..(i + 1) * m]);
            self.color_model.scale_radiance(sh, raw, gain);
        }
    }

    /// Checks that the splats can be trained: a mix cannot, nor can splats with gains.
    ///
    /// # Errors
    /// [`EngineError::Invalid`].
    pub fn check_trainable(color_model: ColorModel, gain: &[f32]) -> Result<(), EngineError> {
        color_model.check_trainable()?;
        if gain.is_empty() {
            return Ok(());
        }
        Err(EngineError::invalid("the splats have gains of edits, which no step changes: take them into the colours first (fold_gains)"))
    }

    /// Returns the radiance of splat `i` from its degree-0 terms: the same in every direction.
    pub fn base_radiance(&self, i: usize) -> [f32; 3] {
        self.color_model.base_radiance(self.sh_of(i), self.raw_luminance_of(i)).map(|c| c * self.gain_of(i))
    }

    /// Returns the luminance (R + G + B, normalised units) of splat `i` from its degree-0 terms.
    pub fn base_luminance(&self, i: usize) -> f32 {
        self.color_model.base_luminance(self.sh_of(i), self.raw_luminance_of(i)) * self.gain_of(i)
    }

    /// Returns the values of an array, splat by splat.
    pub fn array(&self, array: SplatArray) -> &[f32] {
        match array {
            SplatArray::Position => self.position.as_flattened(),
            SplatArray::Rotation => self.rotation.as_flattened(),
            SplatArray::LogScale => self.log_scale.as_flattened(),
            SplatArray::OpacityLogit => &self.opacity_logit,
            SplatArray::Sh => &self.sh,
            SplatArray::RawLuminance => &self.raw_luminance,
            SplatArray::Smoothing => &self.smoothing,
        }
    }

    /// Returns the values of an array, splat by splat, to be changed.
    pub fn array_mut(&mut self, array: SplatArray) -> &mut [f32] {
        match array {
            SplatArray::Position => self.position.as_flattened_mut(),
            SplatArray::Rotation => self.rotation.as_flattened_mut(),
            SplatArray::LogScale => self.log_scale.as_flattened_mut(),
            SplatArray::OpacityLogit => &mut self.opacity_logit,
            SplatArray::Sh => &mut self.sh,
            SplatArray::RawLuminance => &mut self.raw_luminance,
            SplatArray::Smoothing => &mut self.smoothing,
        }
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
        let width = |array: SplatArray| array.width(self.color_model);
        for array in SplatArray::ALL {
            let found = self.array(array).len();
            let expected = if array == SplatArray::Smoothing && found == 0 { 0 } else { n * width(array) };
            if found != expected {
                return Err(SplatsError::Length { array: array.name(), found, expected });
            }
        }
        if ![0, n].contains(&self.gain.len()) {
            return Err(SplatsError::Length { array: "gain", found: self.gain.len(), expected: n });
        }
        if let Some(splat) = self.gain.iter().position(|gain| !gain.is_finite()) {
            return Err(SplatsError::NotFinite { array: "gain", splat });
        }
        if let Some(splat) = self.gain.iter().position(|gain| *gain < 0.0) {
            return Err(SplatsError::Gain { splat, found: self.gain[splat] });
        }
        SplatArray::ALL.into_iter().try_for_each(|array| array.check_finite(self.array(array), width(array), 0))
    }
}

/// One splat, borrowed; shapes as in [`Splats`].
#[derive(Clone, Copy, Debug)]
pub struct Splat<'a> {
    /// Position, world units.
    pub position: [f32; 3],
    /// Quaternion w x y z.
    pub rotation: [f32; 4],
    /// Natural logarithm of the standard deviations.
    pub log_scale: [f32; 3],
    /// Logit of the opacity.
    pub opacity_logit: f32,
    /// Harmonics `[K,3]`.
    pub sh: &'a [f32],
    /// Raw luminance `[M]`.
    pub raw_luminance: &'a [f32],
}

/// Adam's first and second moments of every parameter, in the layout of [`Splats`].
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Running mean of the gradient.
    pub first: Splats,
    /// Running mean of the squared gradient.
    pub second: Splats,
}

impl Moments {
    /// Checks that the moments belong to `splats`: valid arrays of as many splats of the same
    /// colour model.
    ///
    /// # Errors
    /// [`EngineError::Splats`] for invalid arrays, [`EngineError::Invalid`] for moments of other
    /// splats.
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

    /// Returns moments of zero for `count` splats.
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
            gain: Vec::new(),
        };
        Self { first: zeros.clone(), second: zeros }
    }
}

/// Returns the logistic function 1 / (1 + e^-x).
#[inline]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Returns the logit ln(p / (1 - p)); p is kept 1e-6 away from 0 and 1.
#[inline]
pub fn logit(p: f32) -> f32 {
    let p = p.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln()
}
