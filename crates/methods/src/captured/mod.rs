//! The published methods that train on captured images, beside radiance or alone, apart from the
//! colour models: each step makes its own images and losses of channels that the engine blends, and
//! hands the engine the gradients by channels and radiance.
//!
//! A folder a method; `images` and `arithmetic` have what several of them share, [`methods`] is how
//! the trainer knows them.
//!
//! In: views with or of captured images, the options of the method. Out: steps in the form that
//! [`luxel_core::Engine::train_channels`] takes, and the shared networks of the method, which are
//! part of the run's state.
//! Sources and deviations from what was published: `docs/src/guide/published-methods.md`.
//! Degenerate: data without pairs and options that a method does not have are errors at the start.

mod arithmetic;
mod gausshdr;
mod hdr_gs;
mod images;
mod methods;
mod mono_hdr_gs;
#[cfg(test)]
pub(crate) mod testing;

use luxel_core::engine::PlanRow;
use luxel_core::{Dataset, Knots};
use luxel_train::{Method, ToneMapperRecord, TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

pub(crate) use self::arithmetic::adam::Adam;
pub(crate) use self::gausshdr::networks::tone_rate;
use self::gausshdr::networks::{GaussNetworks, GaussRates};
pub(crate) use self::gausshdr::tone::GaussTone;
pub(crate) use self::gausshdr::{GaussStep, GaussTarget};
use self::hdr_gs::tone_mappers::ToneMappers;
pub(crate) use self::images::checks::check_captured;
use self::images::checks::exposure_of;
pub use self::images::checks::one_exposure;
use self::images::pair_channels::PairTargets;
pub use self::methods::CapturedMethods;
pub(crate) use self::methods::captured_target;
use self::mono_hdr_gs::MonoNetworks;
use self::mono_hdr_gs::fold::folded;
use self::mono_hdr_gs::lifted_engine::{LiftedEngine, SharedLift};

/// The numbers that a method trains beside splats: networks that all of them share, and features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SharedNetworks {
    HdrGs(ToneMappers),
    MonoHdrGs(MonoNetworks),
    GaussHdr(Box<GaussNetworks>),
    /// Tone networks alone: anchors have features of their own.
    GaussHdrAnchors(Box<GaussTone>),
}

impl SharedNetworks {
    /// Makes the networks at the start of a run of so many splats; `None` for a method without any.
    pub(crate) fn new(config: &TrainConfig, dataset: &Dataset, splats: usize) -> Option<Self> {
        let exposures = || dataset.train.iter().flat_map(|view| &view.recordings).filter_map(exposure_of);
        match config.method {
            Method::GaussHdr => Some(Self::GaussHdr(Box::new(GaussNetworks::new(splats, config.seed)))),
            Method::GaussHdrAnchors => Some(Self::GaussHdrAnchors(Box::new(GaussTone::new(config.seed)))),
            Method::MonoHdrGs => Some(Self::MonoHdrGs(MonoNetworks::new(config))),
            Method::HdrGs => Some(Self::HdrGs(ToneMappers::new(config.tone_width, exposures(), config.seed))),
            _ => None,
        }
    }

    /// Checks networks read from a file against the options and the number of splats.
    pub(crate) fn validate(&self, config: &TrainConfig, splats: usize) -> Result<(), TrainError> {
        match (self, config.method) {
            (Self::HdrGs(mappers), Method::HdrGs) => mappers.validate(config.tone_width),
            (Self::MonoHdrGs(networks), Method::MonoHdrGs) => networks.validate(config.lift_width),
            (Self::GaussHdr(networks), Method::GaussHdr) => networks.validate(splats),
            (Self::GaussHdrAnchors(tone), Method::GaussHdrAnchors) => tone.validate(),
            _ => Err(TrainError::State("the method's networks are missing, or are those of another method".to_owned())),
        }
    }

    /// Returns the record of the tone mappers, if these are any.
    pub(crate) fn tone_mappers(&self, radiance_unit: f32) -> Option<ToneMapperRecord> {
        match self {
            Self::HdrGs(mappers) => Some(mappers.record(radiance_unit)),
            Self::MonoHdrGs(_) | Self::GaussHdr(_) | Self::GaussHdrAnchors(_) => None,
        }
    }

    /// Returns the response of the camera that the networks make up, if they see radiance alone.
    pub(crate) fn response(&self) -> Option<Knots> {
        match self {
            Self::GaussHdr(networks) => Some(networks.tone.response()),
            Self::GaussHdrAnchors(tone) => Some(tone.response()),
            Self::HdrGs(_) | Self::MonoHdrGs(_) => None,
        }
    }

    /// Follows splats through densification.
    pub(crate) fn densify(&mut self, rows: &[PlanRow]) {
        if let Self::GaussHdr(networks) = self {
            networks.densify(rows);
        }
    }

    /// Returns the lift from captured values to radiance, if the method has one.
    pub(crate) fn shared_lift(&self) -> Option<SharedLift> {
        match self {
            Self::HdrGs(_) | Self::GaussHdr(_) | Self::GaussHdrAnchors(_) => None,
            Self::MonoHdrGs(networks) => Some(SharedLift::new(networks.lift.tables())),
        }
    }
}
