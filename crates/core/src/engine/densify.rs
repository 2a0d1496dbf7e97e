//! Densification data: the statistics and geometry a policy reads, and the plan by which an engine
//! rebuilds the scene.

use super::EngineError;
use crate::SplatsError;

/// Densification statistics per splat since the last densification, `[N]` each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensifyStats {
    /// Sum over visible views of |dL/dmean|, mean in NDC units (half the image's side).
    pub gradient: Vec<f32>,
    /// Sum over visible views of the norm of the sums of absolute per-pixel gradients by x and y
    /// (AbsGS), NDC units.
    pub abs_gradient: Vec<f32>,
    /// Number of views in which the splat was visible.
    pub views: Vec<u32>,
}

impl DensifyStats {
    /// Returns statistics of `count` splats, all zero.
    pub fn zeros(count: usize) -> Self {
        Self { gradient: vec![0.0; count], abs_gradient: vec![0.0; count], views: vec![0; count] }
    }

    /// Checks that these are the statistics of `count` splats.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if a length differs.
    pub fn check(&self, count: usize) -> Result<(), EngineError> {
        if [self.gradient.len(), self.abs_gradient.len(), self.views.len()] != [count; 3] {
            return Err(EngineError::invalid(format!("statistics of {} splats, the scene has {count}", self.views.len())));
        }
        Ok(())
    }
}

/// The geometry that densification policies read, `[N]` each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// World coordinates.
    pub position: Vec<[f32; 3]>,
    /// Natural logarithm of the standard deviations.
    pub log_scale: Vec<[f32; 3]>,
    /// Logit of the opacity.
    pub opacity_logit: Vec<f32>,
}

impl Geometry {
    /// Checks that all values are finite.
    ///
    /// # Errors
    /// [`SplatsError::NotFinite`] for the first that is not.
    pub fn check_finite(&self) -> Result<(), SplatsError> {
        let arrays: [(&'static str, &[f32], usize); 3] = [
            ("position", self.position.as_flattened(), 3),
            ("log_scale", self.log_scale.as_flattened(), 3),
            ("opacity_logit", &self.opacity_logit, 1),
        ];
        match arrays.into_iter().find_map(|(array, values, width)| Some((array, values.iter().position(|v| !v.is_finite())? / width))) {
            Some((array, splat)) => Err(SplatsError::NotFinite { array, splat }),
            None => Ok(()),
        }
    }
}

/// One splat of the scene after densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanRow {
    /// Index of the splat that this one is made from.
    pub source: u32,
    /// Displacement along the source's principal axes, in standard deviations of the source.
    pub offset_sigma: [f32; 3],
    /// Offset of the log scale.
    pub log_scale_shift: f32,
    /// New opacity logit; `None` keeps the source's.
    pub opacity_logit: Option<f32>,
    /// Whether Adam's moments are kept; otherwise they start at zero.
    pub keep_moments: bool,
}

impl PlanRow {
    /// Returns the row that keeps `source` unchanged.
    pub fn keep(source: u32) -> Self {
        Self { source, offset_sigma: [0.0; 3], log_scale_shift: 0.0, opacity_logit: None, keep_moments: true }
    }
}

/// The scene after densification, row by row. Statistics restart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensifyPlan {
    /// One row per new splat.
    pub rows: Vec<PlanRow>,
    /// Upper bound of opacity logits, applied after `rows`: higher ones are lowered to it and their
    /// moments set to zero.
    pub opacity_logit_cap: Option<f32>,
    /// New 3D smoothing filter, one value per row.
    pub smoothing: Option<Vec<f32>>,
}

impl DensifyPlan {
    /// Checks that the plan fits a scene of `count` splats.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if a row names a splat that does not exist, or the smoothing filter
    /// has another length than the rows.
    pub fn check(&self, count: usize) -> Result<(), EngineError> {
        if let Some((row, PlanRow { source, .. })) = self.rows.iter().enumerate().find(|(_, row)| row.source as usize >= count) {
            return Err(EngineError::invalid(format!("densify plan: row {row} names splat {source}, the scene has {count}")));
        }
        match &self.smoothing {
            Some(smoothing) if smoothing.len() != self.rows.len() => {
                Err(EngineError::invalid(format!("densify plan: {} smoothing values for {} rows", smoothing.len(), self.rows.len())))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_names_splats_that_exist_and_filters_for_all_rows() {
        let mut plan = DensifyPlan { rows: vec![PlanRow::keep(2), PlanRow::keep(0)], ..DensifyPlan::default() };
        assert!(plan.check(3).is_ok());
        assert_eq!(plan.check(2).unwrap_err().to_string(), "densify plan: row 0 names splat 2, the scene has 2");
        plan.smoothing = Some(vec![0.1]);
        assert_eq!(plan.check(3).unwrap_err().to_string(), "densify plan: 1 smoothing values for 2 rows");
    }

    #[test]
    fn statistics_are_of_all_splats() {
        assert!(DensifyStats::zeros(3).check(3).is_ok());
        assert_eq!(DensifyStats::zeros(2).check(3).unwrap_err().to_string(), "statistics of 2 splats, the scene has 3");
    }
}
