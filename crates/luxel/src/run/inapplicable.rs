//! Options that were said and change nothing, as they belong to a choice that was not made.
//!
//! Values alone are no saying: options have defaults, and a file holds them all. What has no default is judged by its value
//! ([`luxel_train::TrainConfig::misplaced`]).

use anyhow::{Result, bail};
use luxel_train::{Method, Strategy};

use super::RunConfig;
use crate::values::SupervisionArg;

impl RunConfig {
    /// Refuses what was `said` (by its ids) in vain.
    pub(crate) fn check_said(&self, said: &[String]) -> Result<()> {
        for (choice, is_made, options) in self.choices() {
            if let (false, Some(id)) = (is_made, options.iter().find(|id| said.iter().any(|said| said == *id))) {
                bail!("--{}: goes with {choice} only; say that too, or leave this out", id.replace('_', "-"));
            }
        }
        Ok(())
    }

    /// Choices as they are said, whether they are made, and the ids of the options that belong to them.
    fn choices(&self) -> [(&'static str, bool, &'static [&'static str]); 7] {
        let (train, supervision) = (&self.train, self.load.supervision);
        [
            ("--method lcd", train.method == Method::Lcd, &["luminance_lr"]),
            (
                "--strategy adc",
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
            (
                "--strategy mcmc",
                train.strategy == Strategy::Mcmc,
                &["mcmc_growth", "mcmc_noise", "mcmc_opacity_weight", "mcmc_scale_weight"],
            ),
            ("--absgrad", train.absgrad, &["absgrad_threshold"]),
            ("--samples above 1", train.samples > 1, &["samples_share"]),
            ("--supervision hdr", supervision == SupervisionArg::Hdr, &["noise_model"]),
            ("--supervision ldr", supervision == SupervisionArg::Ldr, &["unit_exposure", "exposures"]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::super::tests::{parsed, words};
    use crate::cli::Cli;

    /// Every option that belongs to a choice, with a value, and what makes the choice.
    const CASES: [(&str, &str, &str); 16] = [
        ("--luminance-lr 0.1", "--method sh3", "--method lcd"),
        ("--turnover 0.2", "--strategy mcmc", "--strategy adc"),
        ("--densify-threshold 1e-3", "--strategy mcmc", "--strategy adc"),
        ("--percent-dense 0.1", "--strategy mcmc", "--strategy adc"),
        ("--prune-scale 0.2", "--strategy mcmc", "--strategy adc"),
        ("--prune-unseen 0.1", "--strategy mcmc", "--strategy adc"),
        ("--opacity-reset-interval 100", "--strategy mcmc", "--strategy adc"),
        ("--mcmc-growth 0.1", "--strategy adc", "--strategy mcmc"),
        ("--mcmc-noise 5e4", "--seed 1", "--strategy mcmc"),
        ("--mcmc-opacity-weight 0.1", "--seed 1", "--strategy mcmc"),
        ("--mcmc-scale-weight 0.1", "--seed 1", "--strategy mcmc"),
        ("--absgrad-threshold 1e-3", "--seed 1", "--absgrad"),
        ("--samples-share 0.5", "--samples 1", "--samples 2"),
        ("--noise-model off", "--supervision ldr", "--supervision hdr"),
        ("--unit-exposure 0.7", "--seed 1", "--supervision ldr"),
        ("--exposures single", "--supervision hdr", "--supervision ldr"),
    ];

    #[test]
    fn what_belongs_to_another_choice_is_refused_where_it_is_said() {
        for (option, other, choice) in CASES {
            let check = |text: &str| {
                let (config, said) = parsed(&words(text)).unwrap();
                config.check_said(&said)
            };
            let error = check(&format!("{option} {other}")).unwrap_err().to_string();
            let name = option.split(' ').next().unwrap();
            let choice_name = if choice == "--samples 2" { "--samples above 1" } else { choice };
            assert!(error.starts_with(&format!("{name}: goes with {choice_name} only")), "{error}");
            check(&format!("{option} {choice}")).unwrap();
        }
    }

    #[test]
    fn what_a_file_holds_is_not_said() {
        let (file, _) = parsed(&words("--strategy mcmc --mcmc-noise 5e4 --luminance-lr 0.1")).unwrap();
        let (line, said) = parsed(&words("--strategy adc --method sh3")).unwrap();
        file.overlaid(&line, &said).unwrap().check_said(&said).unwrap();
    }

    #[test]
    fn the_options_are_options_of_train() {
        let command = Cli::command();
        let train = command.find_subcommand("train").unwrap();
        let (config, _) = parsed(&[]).unwrap();
        for id in config.choices().into_iter().flat_map(|(.., options)| options) {
            assert!(train.get_arguments().any(|arg| arg.get_id() == id), "{id}");
        }
    }
}
