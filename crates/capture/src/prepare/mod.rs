//! Decisions about a folder of photographs that is to become a data set, without its files.
//!
//! [`select`] drops duplicates, [`apply_exposure_list`] adds listed exposures, [`plan`] decides
//! cameras, exposures, brackets and white balance from headers, [`choose_response`] finds the
//! response curve of developed pictures, [`raw_frame`] and [`developed_frame`] make
//! [`CapturedFrame`]s of decoded samples, [`sequential_pairs`] and [`spatial_pairs`] choose the
//! pairs of views to match, [`sharpest_frames`] chooses the frames of a video, and [`advice`] lists
//! what to photograph again. The program that reads and writes files calls these in between.
//!
//! [`CapturedFrame`]: crate::CapturedFrame

mod advice;
mod cameras;
mod error;
mod exposures;
mod frames;
mod notes;
mod options;
mod pairs;
mod photograph;
mod plan;
mod primaries;
mod projection;
mod records;
mod response;
mod video;

pub use advice::{AdviceInput, advice};
pub use cameras::PlannedCamera;
pub use error::{PrepareError, PrepareNote};
pub use exposures::apply_exposure_list;
pub use frames::{CurveTables, developed_frame, raw_frame, thinned};
pub use options::{PlanOptions, WhiteBalance};
pub use pairs::{sequential_pairs, spatial_pairs};
pub use photograph::{LeftOut, Photograph, Selection, select};
pub use plan::{Plan, PlannedView, check_options, plan};
pub use primaries::conversion_from;
pub use projection::{ProjectionChoice, SetProjection};
pub use records::{RegisteredView, Registration, ViewRecord, range_stops};
pub use response::{CurveOrigin, ResponseChoice, SetCurve, choose_response, views_for_response};
pub use video::sharpest_frames;
