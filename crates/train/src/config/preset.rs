//! Presets: values of options that belong together, all in one table.
//!
//! A preset takes precedence over the configuration file, and explicit options take precedence over
//! the preset. Every preset sets the same options, so that one can replace another. The
//! measurements behind the values are in the notebook, `docs/src/notebook/index.md`.

use luxel_core::Antialias;

use super::{CutoffPreset, LateViews, Preset, Strategy, TrainConfig};
use crate::ResolutionSchedule;

/// Writes the accessors of the table: one line per option, with the value of each preset.
macro_rules! presets {
    ($($(#[doc = $reason:literal])+ $option:ident: $paper:expr, $full:expr, $fast:expr;)+) => {
        impl Preset {
            /// Options (by field name) that every preset sets.
            pub const OPTIONS: &[&str] = &[$(stringify!($option)),+];

            /// Sets the options in `config`, except for those that were given.
            pub(super) fn apply(self, config: &mut TrainConfig, is_given: impl Fn(&str) -> bool) {
                $(if !is_given(stringify!($option)) {
                    config.$option = match self {
                        Self::Paper => $paper,
                        Self::Full => $full,
                        Self::Fast => $fast,
                    };
                })+
            }
        }
    };
}

presets! {
    // option:               paper,                       full,                        fast
    /// Paper: Kerbl et al. 2023. Fast: longer runs gain no more than different seeds differ by.
    iterations:              30_000,                      30_000,                      8_000;
    /// Paper: all steps, as published. Full: not measured. Fast: more steps gain little on test
    /// views where validation views lag behind.
    early_end:               None,                        None,                        Some(5_500);
    /// The published strategy, which is better than MCMC at equal splats and steps.
    strategy:                Strategy::Adc,               Strategy::Adc,               Strategy::Adc;
    /// Paper: it gives no value. 3DGS's 2e-4 suits 3DGS's loss weights. The paper's weights make
    /// gradients larger, and 2e-4 would make so many splats that they overfit.
    densify_threshold:       4e-4,                        2e-4,                        2e-4;
    /// Unset: the bound follows from the images.
    max_splats:              None,                        None,                        None;
    /// Paper: no bound. Full and fast: with more splats the training images are overfit, and the
    /// test views get worse.
    pixels_per_splat:        None,                        Some(72),                    Some(72);
    /// Paper: 0, because all images are trained on, and there is no bound.
    validation_share:        0.0,                         0.1,                         0.1;
    /// Paper: 0, because splats start at the points of the data set. Full and fast: splats start in
    /// the right places, too, where texture repeats and where the data set has no points.
    stereo_points:           Some(0),                     None,                        None;
    /// Paper: 0, because without a bound nothing is relocated. Full and fast: without relocation,
    /// growth would end when the bound is reached. Where validation views lag behind, and until
    /// that is known, it is less.
    turnover:                0.0,                         0.1,                         0.1;
    /// Paper and full: 3DGS's interval. Fast: the only reset lies early enough for opacities to
    /// recover before images have their full size.
    opacity_reset_interval:  3000,                        3000,                        2000;
    /// Paper: 3DGS's value. Full and fast: none, because large splats represent bare walls and
    /// ceilings well.
    prune_scale:             0.1,                         0.0,                         0.0;
    /// Paper: an addition to the published method. It removes splats that no metric misses and that
    /// cost as much as others. Full and fast: off, because the bound has the same effect.
    prune_unseen:            2e-3,                       0.0,                         0.0;
    /// Paper: 0, as published. Full and fast: splats directly in front of a camera explain its
    /// image alone, and are fog in others.
    clearance:               0.0,                         0.4,                         0.4;
    /// Paper: full resolution throughout, as published. Full and fast: on reduced images repeated
    /// texture finds its depth, which it otherwise misses in some runs.
    resolution_schedule:     ResolutionSchedule::Off,     ResolutionSchedule::Auto,    ResolutionSchedule::Auto;
    /// Paper: equation 5 exactly as published, with lambda 0.2. Full and fast: 3DGS's weights.
    ssim_weight:             0.8,                         0.2,                         0.2;
    /// Paper: 0, as published. Full and fast: large errors remain at the end, and L1 alone does not
    /// weight them more than small ones.
    squared_share:           0.0,                         0.5,                         0.5;
    /// Paper: whole views, as published. Full: not measured. Fast: more steps on half of a view are
    /// worth more than fewer on all of it.
    late_views:              LateViews::Whole,            LateViews::Whole,            LateViews::Strips;
    /// Paper: 0, as published. Full and fast: the mean removes the movement that Adam's steps
    /// leave.
    average_share:           0.0,                         0.15,                        0.15;
    /// Paper: 0, as published. Full and fast: few views are overfit without it.
    dropout:                 0.0,                         0.2,                         0.2;
    /// Paper: 3DGS's rate, which suits cameras all around an object. Full and fast: at a higher
    /// rate, splats reach their places in the room; in fewer steps it has to be higher still.
    position_lr:             1.6e-4,                      4e-4,                        8e-4;
    /// A hundredth of the initial rate.
    position_lr_final:       1.6e-6,                      4e-6,                        8e-6;
    /// Paper: 3DGS's dilation. Full and fast: a pixel's own filter, because enlarged splats cannot
    /// represent an edge or a lamp that is sharper than they are.
    antialias:               Antialias::Off,              Antialias::Pixel,            Antialias::Pixel;
    /// Paper: one, as published. Full and fast: by the size of the images, because one sample does
    /// not see what splats hide of each other within a pixel.
    samples:                 Some(1),                     None,                        None;
    /// Paper: 3DGS's cut-offs, derived for 8 bits. Full and fast: cut-offs for radiance, so that
    /// the faint surroundings of a lamp are not cut off.
    cutoffs:                 CutoffPreset::Parity,        CutoffPreset::Hdr,           CutoffPreset::Hdr;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NamedChoice;

    fn json(config: &TrainConfig) -> serde_json::Map<String, serde_json::Value> {
        serde_json::to_value(config).unwrap().as_object().unwrap().clone()
    }

    #[test]
    fn the_default_is_what_the_options_defaults_say() {
        let preset = Preset::default();
        assert_eq!(TrainConfig::from_preset(preset), TrainConfig { preset, ..TrainConfig::base() });
    }

    #[test]
    fn presets_are_valid_and_set_the_options_they_name() {
        for (preset, _) in Preset::VALUES {
            let config = TrainConfig::from_preset(*preset);
            config.validate().unwrap();
            let (set, default) = (json(&config), json(&TrainConfig::default()));
            for (name, value) in &set {
                let may_differ = name == "preset" || Preset::OPTIONS.contains(&name.as_str());
                assert!(may_differ || *value == default[name], "{preset:?}: {name}");
            }
            for name in Preset::OPTIONS {
                assert!(set.contains_key(*name), "{name} is not an option");
            }
        }
    }

    #[test]
    fn given_options_win_over_the_preset() {
        let given = TrainConfig { preset: Preset::Fast, iterations: 123, max_splats: Some(7), ..TrainConfig::default() };
        let resolved = given.with_preset(|name| name == "iterations");
        let fast = TrainConfig::from_preset(Preset::Fast);
        // All steps that are given are made.
        assert_eq!(resolved, TrainConfig { iterations: 123, early_end: None, ..fast });
        let both = TrainConfig { iterations: 123, early_end: Some(100), ..TrainConfig::default() };
        assert_eq!(both.clone().with_preset(|name| ["iterations", "early_end"].contains(&name)).early_end, Some(100));
    }

    #[test]
    fn a_preset_takes_another_ones_values_back() {
        let fast = TrainConfig::from_preset(Preset::Fast);
        let back = TrainConfig { preset: Preset::Paper, ..fast }.with_preset(|_| false);
        assert_eq!(back, TrainConfig::from_preset(Preset::Paper));
    }
}
