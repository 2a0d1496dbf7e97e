//! The methods as the trainer knows them: steps, numbers for checkpoints, and checks of data.
//!
//! In: the views of a step, an engine that blends channels. Out: the engine's scene and the
//! networks, updated. Degenerate: a loss that is not finite is an error before the networks'
//! update.

use luxel_core::engine::PlanRow;
use luxel_core::{Camera, Dataset, Engine, Knots, RadianceScale, Splats, StepReport, View};
use luxel_train::{
    MethodState, MethodStep, NamedChoice, Scheme, StepImages, StepMethod, StepMethods, ToneMapperRecord, TrainConfig, TrainError,
};

use super::{GaussRates, GaussStep, GaussTarget, LiftedEngine, PairTargets, SharedLift, SharedNetworks, folded, tone_rate};
use crate::captured::images::checks::{check_captured, check_pairs, exposure_of, one_exposure};

/// Exponent of a camera's response that first colours assume: that of displays.
const DISPLAY_GAMMA: f32 = 2.2;

/// HDR-GS, Mono-HDR-GS and GaussHDR on plain splats.
#[derive(Clone, Copy, Debug)]
pub struct CapturedMethods;

/// One of them in training.
struct InTraining {
    networks: SharedNetworks,
    /// The lift that makes radiance of the splats' colours, as the engine has it, too.
    lift: Option<SharedLift>,
}

impl InTraining {
    fn boxed(networks: SharedNetworks) -> Box<dyn StepMethod> {
        let lift = networks.shared_lift();
        Box::new(Self { networks, lift })
    }
}

impl StepMethods for CapturedMethods {
    fn check(&self, dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
        let method = config.method.name();
        match config.method.spec().scheme {
            Scheme::Pairs => check_pairs(&dataset.train, method)?,
            _ => check_captured(&dataset.train, method)?,
        }
        if config.method.lifts_colors() {
            one_exposure(&dataset.train, method)?;
        }
        Ok(())
    }

    fn first_splats(&self, splats: Splats, scale: RadianceScale, dataset: &Dataset, config: &TrainConfig) -> Result<Splats, TrainError> {
        if config.method.lifts_colors() { captured_colors(splats, scale, dataset, config) } else { Ok(splats) }
    }

    fn start(&self, dataset: &Dataset, config: &TrainConfig, splats: usize) -> Result<Box<dyn StepMethod>, TrainError> {
        let networks = SharedNetworks::new(config, dataset, splats);
        networks.map(InTraining::boxed).ok_or_else(|| TrainError::config("method", format!("{} has no networks", config.method.name())))
    }

    fn resume(&self, state: &MethodState, config: &TrainConfig, splats: usize) -> Result<Box<dyn StepMethod>, TrainError> {
        let networks: SharedNetworks = state.numbers()?;
        networks.validate(config, splats)?;
        Ok(InTraining::boxed(networks))
    }
}

impl StepMethod for InTraining {
    fn step(&mut self, engine: &mut dyn Engine, images: StepImages<'_>, step: MethodStep<'_>) -> Result<StepReport, TrainError> {
        let view = images.view;
        let check = |report: StepReport| match report.loss.is_finite() {
            true => Ok(report),
            false => Err(TrainError::NotFinite { step: step.engine.step, view: view.name.clone() }),
        };
        let config = step.train;
        match &mut self.networks {
            SharedNetworks::HdrGs(mappers) => {
                let pair = pair_of(images, &step)?;
                let mut channels = pair.hdr_gs(mappers);
                let report = check(engine.train_channels(&view.camera, &mut channels, step.engine)?)?;
                mappers.learn(&channels.gradients(), config.tone_lr.into());
                Ok(report)
            }
            SharedNetworks::MonoHdrGs(networks) => {
                let pair = pair_of(images, &step)?;
                let mut channels = pair.mono_hdr_gs(networks);
                let report = check(engine.train_channels(&view.camera, &mut channels, step.engine)?)?;
                let found = channels.gradients();
                networks.update(&found, config);
                self.lift.iter().for_each(|lift| lift.set(networks.lift.tables()));
                Ok(report)
            }
            SharedNetworks::GaussHdr(networks) => {
                let target = captured_target(view, &step)?;
                let mut channels = GaussStep::new(target, networks.tone(), networks.features());
                let report = check(engine.train_channels(&view.camera, &mut channels, step.engine)?)?;
                let found = channels.gradients();
                let tone = tone_rate(config, step.engine.step, step.planned_iterations);
                let rates = GaussRates { tone, features: config.feature_lr.into() };
                networks.update(&found.by_numbers, &found.by_features, rates);
                Ok(report)
            }
            SharedNetworks::GaussHdrAnchors(_) => Err(TrainError::State("the tone networks of anchors, for splats".to_owned())),
        }
    }

    fn saved(&self) -> Result<MethodState, TrainError> {
        MethodState::of(&self.networks)
    }

    fn densify(&mut self, rows: &[PlanRow]) {
        self.networks.densify(rows);
    }

    fn response(&self) -> Option<Knots> {
        self.networks.response()
    }

    fn tone_mappers(&self, radiance_unit: f32) -> Option<ToneMapperRecord> {
        self.networks.tone_mappers(radiance_unit)
    }

    fn rendering(&self, engine: Box<dyn Engine>) -> Box<dyn Engine> {
        match &self.lift {
            None => engine,
            Some(lift) => Box::new(LiftedEngine::new(engine, lift.clone())),
        }
    }

    fn plain_splats(&self, splats: Splats, cameras: &[&Camera]) -> Splats {
        match &self.lift {
            None => splats,
            Some(lift) => folded(&splats, &lift.get(), cameras),
        }
    }
}

/// Returns the pair of images of a step.
fn pair_of<'a>(images: StepImages<'a>, step: &MethodStep<'a>) -> Result<PairTargets<'a>, TrainError> {
    let StepImages { view, captured } = images;
    let no_pair = || {
        let (method, view) = (step.train.method.name(), view.name.clone());
        TrainError::NeedsPairs { method, view, reason: "has no captured image beside its radiance" }
    };
    let recording = captured.ok_or_else(no_pair)?;
    Ok(PairTargets { view, recording, config: step.train, loss: step.engine.loss })
}

/// Returns the target of a step of GaussHDR, on splats or anchors.
pub(crate) fn captured_target<'a>(view: &'a View, step: &MethodStep<'a>) -> Result<GaussTarget<'a>, TrainError> {
    let no_image = || {
        let (method, view) = (step.train.method.name(), view.name.clone());
        TrainError::NeedsCaptured { method, view, reason: "is radiance, expected a captured image" }
    };
    let exposure = step.radiance_scale.restored_value(exposure_of(view).ok_or_else(no_image)?);
    Ok(GaussTarget { view, exposure, unit_value: step.train.unit_exposure, loss: step.engine.loss })
}

/// Returns the splats with the values that a camera of a usual response would capture of their
/// radiance, in its place.
fn captured_colors(splats: Splats, scale: RadianceScale, dataset: &Dataset, config: &TrainConfig) -> Result<Splats, TrainError> {
    let exposure_s = one_exposure(&dataset.train, config.method.name())?;
    let (mut splats, k) = (splats, 3 * config.color_model().sh_coefficients());
    for i in 0..splats.len() {
        let exposures = splats.base_radiance(i).map(|x| scale.restored_value(x) * exposure_s);
        let (dc, _) = splats.color_model.constant(exposures.map(|x| (x / (x + 1.0)).powf(DISPLAY_GAMMA.recip())));
        splats.sh[i * k..i * k + 3].copy_from_slice(&dc);
    }
    Ok(splats)
}
