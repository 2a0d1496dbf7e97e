//! Ranges and combinations of the options.

use super::{MAX_SEED, Method, Strategy, TrainConfig};
use crate::TrainError;

impl TrainConfig {
    /// Checks ranges and combinations.
    ///
    /// # Errors
    /// [`TrainError::Config`] for the first violation found.
    pub fn validate(&self) -> Result<(), TrainError> {
        self.validate_model()?;
        self.validate_counts()?;
        self.validate_numbers()?;
        self.validate_decays()
    }

    fn validate_model(&self) -> Result<(), TrainError> {
        if let Some((option, choice)) = self.misplaced().into_iter().next() {
            let value = if choice == "method" { "lcd" } else { "adc" };
            return Err(TrainError::config(option, format!("goes with --{choice} {value} only")));
        }
        if let Some(degree) = self.chroma_degree.filter(|d| *d > 5) {
            return Err(TrainError::config("chroma-degree", format!("found {degree}, expected 0 to 5")));
        }
        if let Some(degree) = self.luminance_degree.filter(|d| *d > 3) {
            return Err(TrainError::config("luminance-degree", format!("found {degree}, expected 0 to 3")));
        }
        Ok(())
    }

    /// Options that are set and go with another value of an option than it has: the long name of each, and of what it hangs on.
    pub fn misplaced(&self) -> Vec<(&'static str, &'static str)> {
        let (is_sh, is_mcmc) = (self.method != Method::Lcd, self.strategy == Strategy::Mcmc);
        let options = [
            ("activation", "method", is_sh && self.activation.is_some()),
            ("chroma-degree", "method", is_sh && self.chroma_degree.is_some()),
            ("luminance-degree", "method", is_sh && self.luminance_degree.is_some()),
            ("luminance-lr-final", "method", is_sh && self.luminance_lr_final.is_some()),
            ("absgrad", "strategy", is_mcmc && self.absgrad),
            ("percent-dense", "strategy", is_mcmc && self.percent_dense.is_some()),
        ];
        options.into_iter().filter(|(.., is_misplaced)| *is_misplaced).map(|(option, choice, _)| (option, choice)).collect()
    }

    fn validate_counts(&self) -> Result<(), TrainError> {
        if self.seed > MAX_SEED {
            return Err(TrainError::config("seed", format!("found {}, expected at most {MAX_SEED}", self.seed)));
        }
        let counts = [
            ("iterations", Some(self.iterations)),
            ("init-points", Some(self.init_points)),
            ("densify-interval", Some(self.densify_interval)),
            ("max-splats", self.max_splats),
            ("pixels-per-splat", self.pixels_per_splat),
            ("sh-interval", self.sh_interval),
        ];
        match counts.into_iter().find(|(_, count)| *count == Some(0)) {
            Some((option, _)) => Err(TrainError::config(option, "found 0, expected at least 1")),
            None => Ok(()),
        }
    }

    fn validate_numbers(&self) -> Result<(), TrainError> {
        let positive = [
            ("radiance-scale", self.radiance_scale),
            ("densify-threshold", Some(self.densify_threshold)),
            ("absgrad-threshold", Some(self.absgrad_threshold)),
            ("percent-dense", self.percent_dense),
            ("position-lr", Some(self.position_lr)),
            ("position-lr-final", Some(self.position_lr_final)),
            ("init-scale", self.init_scale),
        ];
        for (option, value) in positive {
            if let Some(value) = value.filter(|v| !(v.is_normal() && *v > 0.0)) {
                return Err(TrainError::config(option, format!("found {value}, expected a number above 0")));
            }
        }
        // SSIM in f32 subtracts squares of what the curve makes of radiance, next to (0.03)^2: ln(1 + mu p) / ln(1 + mu) at p = 1e4 is 13 for a mu of 1
        // and 72 for 0.1.
        if !(self.mu.is_finite() && self.mu >= 1.0) {
            return Err(TrainError::config(
                "mu",
                format!("found {}, expected a number of at least 1, below which rounding takes the SSIM of what is bright", self.mu),
            ));
        }
        let not_negative = [
            ("background", self.background.into_iter().find(|v| !(v.is_finite() && *v >= 0.0)).unwrap_or(0.0)),
            ("sh-lr", self.sh_lr),
            ("luminance-lr", self.luminance_lr),
            ("opacity-lr", self.opacity_lr),
            ("scale-lr", self.scale_lr),
            ("rotation-lr", self.rotation_lr),
            ("prune-scale", self.prune_scale),
            ("mcmc-noise", self.mcmc_noise),
            ("mcmc-opacity-weight", self.mcmc_opacity_weight),
            ("mcmc-scale-weight", self.mcmc_scale_weight),
        ];
        for (option, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(TrainError::config(option, format!("found {value}, expected a number of at least 0")));
            }
        }
        if let Some(found) = self.init_opacity.filter(|opacity| !(*opacity > 0.0 && *opacity < 1.0)) {
            return Err(TrainError::config("init-opacity", format!("found {found}, expected a number above 0 and below 1")));
        }
        if !(self.unit_exposure > 0.0 && self.unit_exposure < 1.0) {
            return Err(TrainError::config(
                "unit-exposure",
                format!("found {}, expected a number above 0 and below 1", self.unit_exposure),
            ));
        }
        if !(0.0..1.0).contains(&self.average_share) {
            return Err(TrainError::config(
                "average-share",
                format!("found {}, expected a number of at least 0 and below 1", self.average_share),
            ));
        }
        let parts = [
            ("ssim-weight", self.ssim_weight),
            ("squared-share", self.squared_share),
            ("samples-share", self.samples_share),
            ("prune-opacity", self.prune_opacity),
            ("prune-unseen", self.prune_unseen),
            ("turnover", self.turnover),
            ("mcmc-growth", self.mcmc_growth),
        ];
        for (option, value) in parts {
            if !(0.0..=1.0).contains(&value) {
                return Err(TrainError::config(option, format!("found {value}, expected 0 to 1")));
            }
        }
        Ok(())
    }

    /// A decay is straight in the logarithm, so both of its ends are above 0.
    fn validate_decays(&self) -> Result<(), TrainError> {
        let decays = [
            ("sh-lr", self.sh_lr, "sh-lr-final", self.sh_lr_final),
            ("luminance-lr", self.luminance_lr, "luminance-lr-final", self.luminance_lr_final),
            ("opacity-lr", self.opacity_lr, "opacity-lr-final", self.opacity_lr_final),
            ("scale-lr", self.scale_lr, "scale-lr-final", self.scale_lr_final),
        ];
        for (option, first, option_final, last) in decays {
            let Some(last) = last else { continue };
            if !(last.is_normal() && last > 0.0) {
                return Err(TrainError::config(option_final, format!("found {last}, expected a number above 0")));
            }
            if first <= 0.0 {
                return Err(TrainError::config(option, "found 0, expected a number above 0 to decay from"));
            }
        }
        Ok(())
    }
}
