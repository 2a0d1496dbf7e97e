//! The scene model and its formulas: splats, colour model, cameras, images, tone curves, the loss,
//! and the contract that engines fulfil.
//!
//! This crate uses no files, threads, SIMD or GPU.

mod aspect;
mod camera;
mod camera_motion;
mod capture;
mod color;
mod colorspace;
mod dataset;
pub mod edit;
pub mod engine;
pub mod environment;
mod exchange;
mod image;
pub mod least_squares;
mod local_frame;
mod loss;
pub mod mask;
mod on_demand;
mod order;
pub mod photo;
mod point_coverage;
mod projection;
mod radiance_scale;
pub mod random;
mod real;
mod recolor;
mod remedy;
pub mod response;
mod saved_state;
mod scene;
pub mod sh;
mod similarity;
mod splats;
mod ssim;
pub mod synthetic;
pub mod text;
pub mod tone;
mod view_error;
mod vignetting;

pub use camera::{Camera, CameraError, Distortion, MAX_SIDE_PX};
pub use camera_motion::CameraMotion;
pub use capture::{NoiseModel, PixelValues};
pub use color::{
    Activation, ColorBasis, ColorModel, Component, DEAD_CHROMA_FLOOR, Light, MAX_EXP_ARGUMENT, MAX_LIGHTS, Mix, SH_OFFSET, softplus,
};
pub use colorspace::{Chromaticities, ColorSpace, Conversion};
pub use dataset::{BadPixels, Dataset, Observation, Point, View};
pub use edit::{Edit, EditError, Map, MapChain, Selection};
pub use engine::{Antialias, Cutoffs, Engine, EngineError, Layers, MAX_SAMPLES, Pass, PassTime, RasterConfig, RenderOptions, StepReport};
pub use exchange::{Exchange, ExchangeError, Messages, SingleProcess};
pub use image::{Image, ReducedBlock, luminance_rec709, luminance_sum};
pub use local_frame::SceneBounds;
pub use loss::{LossWeights, SQUARED_KNEE, Target};
pub use mask::Mask;
pub use on_demand::{Identity, Make, OnDemand, ReadError, Source, unreadable_image, unreadable_mask};
pub use order::spatial_order;
pub use point_coverage::PointCoverage;
pub use projection::{CameraProjection, Fisheye, MAX_FISHEYE_ANGLE_RAD, USUAL_FISHEYE_ANGLE_RAD};
pub use radiance_scale::{RadianceScale, RadianceScaleError};
pub use real::Real;
pub use remedy::Remedy;
pub use response::{Knots, RESPONSE_KNOTS, Response, ToneCurve};
pub use saved_state::{SavedGroup, SavedState, values_of};
pub use scene::{Scene, Snapshot};
pub use similarity::{BandRotation, Similarity};
pub use splats::{Moments, Splat, Splats, SplatsError, logit, sigmoid};
pub use ssim::{SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_SIGMA_PX, SSIM_TAPS, ssim_window};
pub use view_error::ViewError;
pub use vignetting::{VIGNETTING_TERMS, Vignetting};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
