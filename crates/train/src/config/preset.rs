//! Recipes by name: values of options that go together, all in one table.
//!
//! A preset comes before the options given beside it and after the file of `--config`: what it sets is set whatever that file says, so
//! that one preset can take another's place. Every preset sets the same options. `fast` follows the literature; which of its parts pay off
//! on a CPU has not been measured over full runs.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use super::{Strategy, TrainConfig};
use crate::ResolutionSchedule;

/// A recipe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// The published recipe: 30000 steps, densification by gradients (Kerbl et al. 2023)
    #[default]
    Paper,
    /// A third of the steps, the first of them on reduced images, with at most 60000 splats that are moved about (3DGS-MCMC)
    Fast,
}

/// Writes the table's accessors: one line an option, with the value of each preset.
macro_rules! presets {
    ($($(#[doc = $reason:literal])+ $option:ident: $paper:expr, $fast:expr;)+) => {
        impl Preset {
            /// Options (by field name) that every preset sets.
            pub const OPTIONS: &[&str] = &[$(stringify!($option)),+];

            /// Sets them in `config`, except for those that were given.
            pub(super) fn apply(self, config: &mut TrainConfig, is_given: impl Fn(&str) -> bool) {
                $(if !is_given(stringify!($option)) {
                    config.$option = match self {
                        Self::Paper => $paper,
                        Self::Fast => $fast,
                    };
                })+
            }
        }
    };
}

presets! {
    // option:               paper,                       fast
    /// Paper: Kerbl et al. 2023. Fast: what the time allows; most of a run's gain is in its first third.
    iterations:              30_000,                      10_000;
    /// Paper: as published. Fast: MCMC never resets opacities, from which a run this short would hardly recover, and uses every
    /// splat that is paid for.
    strategy:                Strategy::Adc,               Strategy::Mcmc;
    /// Paper: as many as the gradients ask for. Fast: a step's cost is known beforehand.
    max_splats:              None,                        Some(60_000);
    /// Paper: full size throughout. Fast: coarse steps cost a part of a full one, and structure comes first (DashGaussian).
    resolution_schedule:     ResolutionSchedule::Off,     ResolutionSchedule::Auto;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(config: &TrainConfig) -> serde_json::Map<String, serde_json::Value> {
        serde_json::to_value(config).unwrap().as_object().unwrap().clone()
    }

    #[test]
    fn the_paper_is_what_the_options_defaults_say() {
        use clap::{Args, Command, FromArgMatches};
        let matches = TrainConfig::augment_args(Command::new("train").no_binary_name(true)).get_matches_from(std::iter::empty::<&str>());
        let defaults = TrainConfig::from_arg_matches(&matches).unwrap();
        assert_eq!(TrainConfig::of_preset(Preset::Paper), TrainConfig { preset: Preset::Paper, ..defaults });
    }

    #[test]
    fn presets_are_valid_and_set_the_options_they_name() {
        for preset in Preset::value_variants() {
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
