//! From captured samples to radiance: exposure, white balance, camera matrices, response curves,
//! brackets, merging, the decisions that prepare a capture ([`prepare`]), pictures for finding the
//! places of panoramas ([`panorama`]), and world coordinates for the cameras that are found for it
//! ([`world`]).
//!
//! In: [`CapturedFrame`]s, decoded samples with the facts from their headers. Out: radiance as
//! [`luxel_core::Image`]. This crate opens no file. Units: a signal of 1 is where a sensor
//! saturates; radiance is luminance in cd/m2 as far as the exposure is known ([`Exposure`]).

mod align;
mod bracket;
mod camera_color;
mod capture_metrics;
mod demosaic;
mod exposure;
mod exposure_list;
mod frame;
mod lens_correction;
mod merge;
pub mod panorama;
pub mod prepare;
mod proxy;
mod response;
#[cfg(test)]
mod testing;
pub mod world;

pub use align::{FrameOffset, frame_offset};
pub use bracket::{BracketError, BracketNote, BracketRule, Brackets, Shot, find_brackets};
pub use camera_color::{CalibratedMatrix, CameraColor, CameraColorError, median_neutral};
pub use capture_metrics::{CaptureMetrics, capture_metrics, sharpness};
pub use demosaic::demosaic;
pub use exposure::Exposure;
pub use exposure_list::{ExposureListError, parse_exposure_list};
pub use frame::{CapturedFrame, Cell, CodeTransfer, FrameError, SampleLayout, SignalNoise};
pub use luxel_core::photo::Codes;
pub use merge::{Developed, Merged, merge};
pub use proxy::{Proxy, ProxyOptions, proxy};
pub use response::{ResponseCurve, ResponseError, recover_response};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
