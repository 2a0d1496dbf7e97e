//! The contract between training and an engine, and the helpers that authors of engines need.
//!
//! In: scenes, cameras, views and plans. Out: images, reports and scenes. [`Engine`] is coarse,
//! blocking and object-safe; an engine implements it with the eleven passes of [`Pass`]. Types that
//! programs use together with an engine are also at the root of the crate.

mod adam;
mod camera_gradient;
mod channels;
mod contract;
mod deep;
mod densify;
mod differentiable;
mod dropout;
mod moment_format;
mod parameter_rows;
mod pass;
mod pixel_angle;
mod raster;
mod render_only;
mod saved;
mod sparse_gradients;
mod step;
mod surface;

pub use adam::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, AdamBetas, AdamMove, NumberAdam};
pub use camera_gradient::{CAMERA_SUMS, CameraGradient, CameraGradientChoice, CameraSums};
pub use channels::{ChannelLoss, ChannelRoles, ChannelSource, ChannelStep, LEAST_CHANNELS, MeasuredChannels, SeenSplats, check_channels};
pub use contract::{Engine, EngineError, tile_memory};
pub use deep::{DeepImage, DeepSample, merge_samples};
pub use densify::{DensifyPlan, DensifyStats, Geometry, PlanRow};
pub use differentiable::{
    AbsoluteMeans, ActivatedSplats, BlendGradient, BlendOptions, BlendedPixels, BlendedSplats, CameraMatrices, Channels, ColorGradient,
    Differentiable, DirectionalColors, EllipseGradient, MatrixCamera, PixelGradient, ProjectedSplats, ScreenEllipses, ShapeParameters,
    SplatGradient, check_len,
};
pub use dropout::Dropout;
pub use moment_format::MomentFormat;
pub use parameter_rows::ParameterRows;
pub use pass::{Pass, PassTime};
pub use pixel_angle::{PIXEL_ANGLE_TERMS, PixelAngle};
pub use raster::{Antialias, Cutoffs, Evaluations, JACOBIAN_MARGIN, Layers, MAX_SAMPLES, MIN_AREA_RATIO, RasterConfig, RenderOptions};
pub use render_only::RenderOnly;
pub use saved::{SavedPart, SplatArray, check_range};
pub use sparse_gradients::{SPLATS_PER_BLOCK, STATISTICS_ROWS, SparseGradients, SparsePart};
pub use step::{LearningRates, PositionNoise, StatsCollection, StepConfig, StepReport};
pub use surface::{SurfaceImage, SurfacePixel};
