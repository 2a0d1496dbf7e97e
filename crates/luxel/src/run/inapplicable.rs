//! Explicit options that change nothing, because they depend on a choice that was not made.
//!
//! A value alone does not count as explicit: options have defaults, and a file holds them all. What
//! has no default is judged by its value ([`luxel_train::TrainConfig::misplaced`]).

use std::fmt;

use luxel_io::Supervision;
use luxel_train::{Method, Strategy};

use super::{ExplicitArgs, RunConfig};

/// A choice that other options depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Name of the option that makes it.
    pub option: &'static str,
    /// Value that makes it, for people; empty for an option without a value.
    pub value: &'static str,
}

/// An explicit option that changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inapplicable {
    /// Name of the option.
    pub option: &'static str,
    /// The choice that it depends on.
    pub choice: Choice,
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.value;
        if value.is_empty() { f.write_str(self.option) } else { write!(f, "{} {value}", self.option) }
    }
}

impl fmt::Display for Inapplicable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: has an effect with {} only", self.option, self.choice)
    }
}

/// Options that depend on a choice, and whether it is made.
struct Group {
    choice: Choice,
    is_made: bool,
    options: &'static [&'static str],
}

impl RunConfig {
    /// Returns the first explicit option that changes nothing.
    ///
    /// ```
    /// use luxel::TrainConfig;
    /// use luxel::run::RunConfig;
    ///
    /// let config = RunConfig::new("my-images", TrainConfig::default());
    /// let found = config.inapplicable(&["seed", "mcmc_noise"].into_iter().collect()).unwrap();
    /// assert_eq!(found.to_string(), "mcmc_noise: has an effect with strategy mcmc only");
    /// ```
    pub fn inapplicable(&self, explicit: &ExplicitArgs) -> Option<Inapplicable> {
        self.groups().into_iter().filter(|group| !group.is_made).find_map(|group| {
            let option = group.options.iter().copied().find(|option| explicit.contains(option))?;
            Some(Inapplicable { option, choice: group.choice })
        })
    }

    /// Returns every option that depends on a choice, whether that is made or not.
    pub fn dependent_options(&self) -> Vec<Inapplicable> {
        let of_group = |group: Group| group.options.iter().map(move |option| Inapplicable { option, choice: group.choice });
        self.groups().into_iter().flat_map(of_group).collect()
    }

    fn groups(&self) -> [Group; 7] {
        let (train, supervision) = (&self.train, self.load.supervision);
        let group = |option, value, is_made, options| Group { choice: Choice { option, value }, is_made, options };
        [
            group("method", "lcd", train.method == Method::Lcd, &["luminance_lr"]),
            group(
                "strategy",
                "adc",
                train.strategy == Strategy::Adc,
                &[
                    "turnover",
                    "densify_threshold",
                    "absgrad_threshold",
                    "percent_dense",
                    "prune_scale",
                    "prune_unseen",
                    "opacity_reset_interval",
                ],
            ),
            group(
                "strategy",
                "mcmc",
                train.strategy == Strategy::Mcmc,
                &["mcmc_growth", "mcmc_noise", "mcmc_opacity_weight", "mcmc_scale_weight"],
            ),
            group("absgrad", "", train.absgrad, &["absgrad_threshold"]),
            group("samples", "above 1", train.samples > 1, &["samples_share"]),
            group("supervision", "hdr", supervision == Supervision::Hdr, &["noise_model"]),
            group("supervision", "ldr", supervision == Supervision::Ldr, &["unit_exposure", "exposures"]),
        ]
    }
}
