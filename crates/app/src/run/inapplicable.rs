//! Explicit options that change nothing, because they depend on a choice that was not made.
//!
//! A value alone does not count as explicit: options have defaults, and a file holds them all.
//! Options without a default are checked by their values, too
//! ([`luxel_train::TrainConfig::misplaced`]).

use std::fmt;
use std::sync::LazyLock;

use luxel_io::Supervision;
use luxel_train::{Condition, ExposureCompensation, Method, MethodSpec, NamedChoice, OPTIONS, Representation, Scheme, Strategy};

use super::{ExplicitArgs, RunConfig};

/// Names of the methods that train splats which are stored.
static METHODS_ON_SPLATS: LazyLock<String> = LazyLock::new(|| Method::names_where(Method::stores_splats));

/// Names of the methods on splats, stored or decoded, without networks of their own.
static METHODS_WITHOUT_NETWORKS: LazyLock<String> =
    LazyLock::new(|| Method::names_where(|method| method.spec().representation != Representation::Field && !method.has_own_networks()));

/// Names of the methods whose steps are those of the engine.
static METHODS_WITHOUT_OWN_STEPS: LazyLock<String> =
    LazyLock::new(|| Method::names_where(|method| method.stores_splats() && !method.has_own_steps()));

/// A choice that other options depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Name of the option that makes it.
    pub option: &'static str,
    /// Value that makes it, for people; empty for an option without a value, [`Self::LEFT_OUT`] if
    /// it is made by not giving the option.
    pub value: &'static str,
}

impl Choice {
    /// The value of a choice that is made by not giving its option.
    pub const LEFT_OUT: &str = "left out";
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
        match self.choice {
            Choice { option, value: Choice::LEFT_OUT } => write!(f, "{}: has no effect with {option}", self.option),
            choice => write!(f, "{}: has an effect with {choice} only", self.option),
        }
    }
}

/// Options of reading a data set that captured LDR images alone have.
const CAPTURED_LOAD_OPTIONS: &[&str] = &["exposures"];

/// Options of geometry and opacity, which change nothing where those are frozen, and of the
/// rasteriser, which are those of the scene.
const GEOMETRY_OPTIONS: &[&str] = &[
    "strategy",
    "max_splats",
    "pixels_per_splat",
    "validation_share",
    "early_end",
    "turnover",
    "dropout",
    "clearance",
    "absgrad",
    "densify_from",
    "densify_until",
    "densify_interval",
    "densify_threshold",
    "absgrad_threshold",
    "percent_dense",
    "prune_opacity",
    "prune_scale",
    "prune_unseen",
    "max_aspect",
    "opacity_reset_interval",
    "mcmc_growth",
    "mcmc_noise",
    "mcmc_opacity_weight",
    "mcmc_scale_weight",
    "position_lr",
    "position_lr_final",
    "opacity_lr",
    "opacity_lr_final",
    "scale_lr",
    "scale_lr_final",
    "rotation_lr",
    "refine_poses",
    "antialias",
    "samples",
    "late_views",
    "cutoffs",
];

/// Options of the first splats, which change nothing where those are of a scene.
const INITIAL_OPTIONS: &[&str] = &["init_points", "stereo_points", "init_opacity", "init_scale"];

/// Options of training that a radiance field has; all others are about splats.
const FIELD_OPTIONS: &[&str] = &[
    "preset",
    "iterations",
    "seed",
    "method",
    "scale_rule",
    "radiance_scale",
    "background",
    "mu",
    "field_loss",
    "field_network",
    "hdr_weight",
    "ldr_weight",
    "unit_exposure",
];

/// Options of training that anchors have; all others are about stored splats.
const ANCHOR_OPTIONS: &[&str] = &[
    "preset",
    "iterations",
    "seed",
    "resolution_schedule",
    "crop",
    "average_share",
    "dropout",
    "method",
    "activation",
    "scale_rule",
    "radiance_scale",
    "background",
    "mu",
    "ssim_weight",
    "squared_share",
    "tone_lr",
    "noise_model",
    "unit_exposure",
    "antialias",
    "samples",
    "samples_share",
    "cutoffs",
    "init_points",
    "stereo_points",
    "max_splats",
    "pixels_per_splat",
    "turnover",
    "densify_from",
    "densify_until",
    "densify_interval",
    "densify_threshold",
    "prune_opacity",
];

/// Options of a run that a radiance field and anchors do not have: they have no display layer, all
/// their images are in memory, they start from nothing, and their steps are not planned by time.
const SPLAT_RUN_OPTIONS: &[&str] = &["refine_display", "image_memory", "from", "time"];

/// Returns whether a method trains a field on captured images alone.
fn is_captured_field(method: &MethodSpec) -> bool {
    method.representation == Representation::Field && method.scheme == Scheme::Captured
}

/// Options that depend on a choice, and whether it is made.
struct Group {
    choice: Choice,
    is_made: bool,
    options: Vec<&'static str>,
}

impl RunConfig {
    /// Returns the first explicit option that changes nothing.
    ///
    /// ```
    /// use luxel::TrainConfig;
    /// use luxel_app::run::RunConfig;
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
        let of_group = |group: Group| group.options.into_iter().map(move |option| Inapplicable { option, choice: group.choice });
        self.groups().into_iter().flat_map(of_group).collect()
    }

    fn groups(&self) -> Vec<Group> {
        let method = self.train.method;
        let representation = method.spec().representation;
        let known = if representation == Representation::Anchors { ANCHOR_OPTIONS } else { FIELD_OPTIONS };
        let of_splats = OPTIONS.iter().map(|option| option.name).filter(|name| !known.contains(name));
        let splats = Group {
            choice: Choice { option: "method", value: &METHODS_ON_SPLATS },
            is_made: method.stores_splats(),
            options: of_splats.chain(SPLAT_RUN_OPTIONS.iter().copied()).collect(),
        };
        // Of the fields; splats learn a response from any captured images.
        let unit_exposure = Group {
            choice: Choice { option: "method", value: Method::find(is_captured_field).map_or("", NamedChoice::name) },
            is_made: representation != Representation::Field || is_captured_field(method.spec()),
            options: vec!["unit_exposure"],
        };
        let frozen = Group {
            choice: Choice { option: "freeze", value: "none" },
            is_made: !self.train.freezes_geometry(),
            options: GEOMETRY_OPTIONS.to_vec(),
        };
        let from = Group {
            choice: Choice { option: "from", value: Choice::LEFT_OUT },
            is_made: self.run.from.is_none(),
            options: INITIAL_OPTIONS.to_vec(),
        };
        let cutoffs = Group {
            choice: Choice { option: "method", value: &METHODS_WITHOUT_NETWORKS },
            is_made: !method.has_own_networks(),
            options: vec!["cutoffs"],
        };
        let train = &self.train;
        let validation = [
            ("batch", "1", train.batch == 1),
            ("crop", Choice::LEFT_OUT, train.crop.is_none()),
            ("refine_poses", Choice::LEFT_OUT, !train.refine_poses),
            ("vignetting", Choice::LEFT_OUT, !train.vignetting),
            ("exposure_compensation", "off", train.exposure_compensation == ExposureCompensation::Off),
            ("supervision", "hdr", self.load.supervision == Supervision::Hdr),
        ];
        let validation = validation.map(|(option, value, is_made)| Group {
            choice: Choice { option, value },
            is_made,
            options: vec!["validation_share", "early_end"],
        });
        let strips = |option, value, is_made| Group { choice: Choice { option, value }, is_made, options: vec!["late_views"] };
        let strips = [
            strips("crop", Choice::LEFT_OUT, train.crop.is_none()),
            strips("method", &METHODS_WITHOUT_OWN_STEPS, !method.stores_splats() || !method.has_own_steps()),
        ];
        let early_end = [
            ("time", Choice::LEFT_OUT, self.run.time.is_none()),
            ("strategy", "adc", train.strategy == Strategy::Adc),
            ("validation_share", "above 0", train.validation_share > 0.0),
            ("iterations", "above it", train.early_end.is_none_or(|end| end < train.iterations)),
        ];
        let early_end =
            early_end.map(|(option, value, is_made)| Group { choice: Choice { option, value }, is_made, options: vec!["early_end"] });
        let by_condition = Condition::all().map(|condition| self.group(condition));
        [splats, unit_exposure]
            .into_iter()
            .chain(by_condition)
            .chain([frozen, from, cutoffs])
            .chain(validation)
            .chain(strips)
            .chain(early_end)
            .collect()
    }

    fn group(&self, condition: Condition) -> Group {
        let of_train = OPTIONS.iter().filter(|option| option.conditions.contains(&condition)).map(|option| option.name);
        let of_load = if condition == Condition::CapturedImages { CAPTURED_LOAD_OPTIONS } else { &[] };
        let is_made = condition.is_met(&self.train).unwrap_or(match self.load.supervision {
            Supervision::Hdr => condition == Condition::RadianceImages,
            Supervision::Ldr => condition == Condition::CapturedImages,
            // The exposures of pairs are chosen, and their radiance has noise.
            Supervision::Both => true,
        });
        let choice = Choice { option: condition.option(), value: condition.value() };
        Group { choice, is_made, options: of_train.chain(of_load.iter().copied()).collect() }
    }
}
