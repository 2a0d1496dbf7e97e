//! The error of a view that cannot be used for training or metrics.

use crate::{CameraError, EngineError};

/// Explains why a view is invalid: its camera must be undistorted, and its image and mask must have
/// the camera's size.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ViewError {
    /// The camera cannot be used.
    #[error("view {view}: camera: {source}")]
    Camera {
        /// Name of the view.
        view: String,
        /// Cause.
        source: CameraError,
    },
    /// The camera has lens distortion.
    #[error("view {view}: camera: has lens distortion; undistort its image first")]
    Distorted {
        /// Name of the view.
        view: String,
    },
    /// The image is not of the camera's size.
    #[error("view {view}: image is {} x {}, the camera expects {} x {}", image[0], image[1], camera[0], camera[1])]
    ImageSize {
        /// Name of the view.
        view: String,
        /// Width and height of the image, pixels.
        image: [usize; 2],
        /// Width and height that the camera expects, pixels.
        camera: [usize; 2],
    },
    /// The image holds more or fewer pixels than its size says.
    #[error("view {view}: image holds {found} pixels, its size says {expected}")]
    PixelCount {
        /// Name of the view.
        view: String,
        /// Number of pixels found.
        found: usize,
        /// Number of pixels that its size implies.
        expected: usize,
    },
    /// A captured image beside the view's radiance is not of its size.
    #[error("view {view}: its captured image {recording} is {} x {}, expected {} x {}", recording_px[0], recording_px[1], view_px[0], view_px[1])]
    RecordingSize {
        /// Name of the view.
        view: String,
        /// Name of the captured image.
        recording: String,
        /// Width and height of the captured image, pixels.
        recording_px: [u32; 2],
        /// Width and height of the view, pixels.
        view_px: [u32; 2],
    },
    /// An image beside the view's radiance is not one of captured values of a known exposure.
    #[error("view {view}: its captured image {recording} has no exposure, expected seconds above 0")]
    RecordingExposure {
        /// Name of the view.
        view: String,
        /// Name of the image.
        recording: String,
    },
    /// The mask is not of the image's size.
    #[error("view {view}: mask holds {found} pixels, the image {expected}")]
    MaskSize {
        /// Name of the view.
        view: String,
        /// Number of weights of the mask.
        found: usize,
        /// Number of pixels of the image.
        expected: usize,
    },
    /// The mask holds a weight that is out of range.
    #[error("view {view}: mask: a weight is not a number from 0 to 1")]
    MaskWeight {
        /// Name of the view.
        view: String,
    },
}

impl From<ViewError> for EngineError {
    fn from(error: ViewError) -> Self {
        match error {
            ViewError::Camera { source, .. } => Self::Camera(source),
            other => Self::invalid(other.to_string()),
        }
    }
}
