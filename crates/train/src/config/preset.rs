//! Recipes by name: values of options that go together, all in one table.
//!
//! A preset comes before the options given beside it and after the file of `--config`: what it sets is set whatever that file says, so
//! that one preset can take another's place. Every preset sets the same options. What the values of `fast` rest on is measured in
//! the notebook, `docs/src/notebook/index.md`.

use luxel_core::Antialias;

use super::{CutoffPreset, Preset, Strategy, TrainConfig};
use crate::ResolutionSchedule;

/// Writes the table's accessors: one line an option, with the value of each preset.
macro_rules! presets {
    ($($(#[doc = $reason:literal])+ $option:ident: $paper:expr, $full:expr, $fast:expr;)+) => {
        impl Preset {
            /// Options (by field name) that every preset sets.
            pub const OPTIONS: &[&str] = &[$(stringify!($option)),+];

            /// Sets them in `config`, except for those that were given.
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
    /// Paper: Kerbl et al. 2023. Fast: bathroom gains no more than seeds differ by in 30000, a room of 120 views nothing from 10,000 to 20,000.
    iterations:              30_000,                      30_000,                      9_000;
    /// As published: MCMC was behind at equal splats and steps.
    strategy:                Strategy::Adc,               Strategy::Adc,               Strategy::Adc;
    /// The paper names none. 3DGS's 2e-4 goes with 3DGS's weights of the loss; those of the paper make gradients 2.5 times as large, and splats twice as many, which learn by heart.
    densify_threshold:       4e-4,                        2e-4,                        2e-4;
    /// Whoever wants a number gives it.
    max_splats:              None,                        None,                        None;
    /// Paper: as many as the gradients ask for. Else: beyond this the training images are learned by heart, and the test views lose.
    pixels_per_splat:        None,                        Some(72),                    Some(72);
    /// Not in the paper, which has no bound: without it, growth ends where it stands when the bound is reached.
    turnover:                0.0,                         0.1,                         0.1;
    /// Paper: 3DGS's. Else none: bare walls and ceilings are made of large splats, and lose by it.
    prune_scale:             0.1,                         0.0,                         0.0;
    /// Not in the paper: a third of its splats, which no figure misses and which cost as much as the others. Else: the bound sees to it.
    prune_unseen:            2e-3,                       0.0,                         0.0;
    /// Full size throughout: a schedule saves little where splats, not pixels, make the cost.
    resolution_schedule:     ResolutionSchedule::Off,     ResolutionSchedule::Off,     ResolutionSchedule::Off;
    /// Paper: its equation 5 with its lambda of 0.2, to the letter. Else: 3DGS's weights.
    ssim_weight:             0.8,                         0.2,                         0.2;
    /// Not in the paper: large errors, which L1 counts like small ones, are what stays.
    squared_share:           0.0,                         0.5,                         0.5;
    /// Not in the paper: settles what Adam keeps moving.
    average_share:           0.0,                         0.15,                        0.15;
    /// Paper: 3DGS's, made for cameras all around; splats that move 2.5 times as far find their places.
    position_lr:             1.6e-4,                      4e-4,                        4e-4;
    /// A hundredth of the rate at the start.
    position_lr_final:       1.6e-6,                      4e-6,                        4e-6;
    /// Paper: 3DGS's. Else: a pixel's own filter, as what is blown up can paint no edge or lamp that is sharper than that.
    antialias:               Antialias::Off,              Antialias::Pixel,            Antialias::Pixel;
    /// Paper: those of 3DGS, derived for 8 bits. Else ours, so that a lamp's skirt does not end where eight bits would.
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
        assert_eq!(TrainConfig::of_preset(preset), TrainConfig { preset, ..TrainConfig::base() });
    }

    #[test]
    fn presets_are_valid_and_set_the_options_they_name() {
        for (preset, _) in Preset::VALUES {
            let config = TrainConfig::of_preset(*preset);
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
        let fast = TrainConfig::of_preset(Preset::Fast);
        assert_eq!(resolved, TrainConfig { iterations: 123, ..fast });
    }

    #[test]
    fn a_preset_takes_another_ones_values_back() {
        let fast = TrainConfig::of_preset(Preset::Fast);
        let back = TrainConfig { preset: Preset::Paper, ..fast }.with_preset(|_| false);
        assert_eq!(back, TrainConfig::of_preset(Preset::Paper));
    }
}
