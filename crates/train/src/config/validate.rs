//! Checks of ranges and combinations.

use super::own_steps::check_options;
use super::spec::Condition;
use super::{Freeze, LateViews, OPTIONS, OptionSpec, TrainConfig};
use crate::TrainError;

/// An option that is set although a choice that it depends on was not made.
#[derive(Clone, Copy, Debug)]
pub struct Misplaced {
    /// The option that has no effect.
    pub option: &'static OptionSpec,
    /// The choice that it depends on.
    pub condition: Condition,
}

impl TrainConfig {
    /// Checks ranges and combinations.
    ///
    /// # Errors
    /// Returns [`TrainError::Config`] or [`TrainError::Misplaced`] for the first violation found.
    pub fn validate(&self) -> Result<(), TrainError> {
        if let Some(misplaced) = self.misplaced().into_iter().next() {
            return Err(TrainError::misplaced(misplaced));
        }
        for option in OPTIONS {
            option.check(self).map_err(|reason| TrainError::config(option.name, reason))?;
        }
        if self.max_aspect > 0.0 && self.max_aspect < 1.0 {
            let reason = format!("found {}, expected 0, or 1 and above: no splat is shorter than it is wide", self.max_aspect);
            return Err(TrainError::config("max_aspect", reason));
        }
        if let (Some(from), Some(until)) = (self.pose_from, self.pose_until)
            && until <= from
        {
            return Err(TrainError::config(
                "pose_until",
                format!("found {until}, expected a step after {from}, from which poses are optimised"),
            ));
        }
        if self.freezes_geometry() && self.refine_poses {
            let reason = "poses are refined together with the splats that `freeze` keeps as they are; refine them in the run of the scene";
            return Err(TrainError::config("refine_poses", reason.to_owned()));
        }
        check_options(self)?;
        self.validate_decays()
    }

    /// Returns whether positions, rotations, scales and opacities are kept as they are.
    pub fn freezes_geometry(&self) -> bool {
        self.freeze == Freeze::Geometry
    }

    /// Returns whether steps train on strips of their views once no more splats are added: those of
    /// splats on whole views whose geometry is free, but not those of methods with steps of their
    /// own.
    pub fn takes_late_strips(&self) -> bool {
        let are_splats_free = self.method.stores_splats() && !self.method.has_own_steps() && !self.freezes_geometry();
        self.late_views == LateViews::Strips && self.crop.is_none() && are_splats_free
    }

    /// Returns the options that are set although a choice that they depend on was not made. Options
    /// that always have a value do not count.
    pub fn misplaced(&self) -> Vec<Misplaced> {
        let misplaced = |option: &'static OptionSpec| Some(Misplaced { option, condition: option.unmet_although_set(self)? });
        OPTIONS.iter().filter_map(misplaced).collect()
    }

    /// Checks that a learning rate that decays starts above 0: a decay is straight in the
    /// logarithm.
    fn validate_decays(&self) -> Result<(), TrainError> {
        let decays = [
            ("sh_lr", self.sh_lr, self.sh_lr_final),
            ("luminance_lr", self.luminance_lr, self.luminance_lr_final),
            ("opacity_lr", self.opacity_lr, self.opacity_lr_final),
            ("scale_lr", self.scale_lr, self.scale_lr_final),
        ];
        match decays.into_iter().find(|(_, first, last)| *first <= 0.0 && last.is_some()) {
            Some((option, ..)) => Err(TrainError::config(option, "found 0, expected a number above 0 to decay from")),
            None => Ok(()),
        }
    }
}
