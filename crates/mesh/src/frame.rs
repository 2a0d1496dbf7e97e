//! Depth images, and the weights of their pixels.
//!
//! In: [`DepthFrame`]s. Out: [`WeightedFrame`]s. A pixel counts by how sure its depth is: cos / d^2
//! / (1 + (spread / s)^2), with the cosine between its ray and the normal of the depth image, the
//! depth d (far pixels are large), and the spread against the median s of all pixels. Degenerate:
//! pixels with little coverage, that look along a surface, whose depths are spread out or lie
//! beyond the depth limit weigh nothing.

use luxel_core::Camera;

use crate::MeshError;

/// Coverage from which on a pixel shows a surface.
pub const LEAST_ALPHA: f32 = 0.5;
/// Spread of depths, in medians of all pixels, from which on a pixel does not count.
const MOST_SPREAD: f32 = 4.0;
/// Cosine to the normal below which a pixel looks along the surface.
const LEAST_COSINE: f32 = 0.1;

/// An image of depths and radiance, as one camera sees them.
#[derive(Clone, Debug)]
pub struct DepthFrame {
    /// An undistorted pinhole.
    pub camera: Camera,
    /// Distance along the viewing axis, `[H*W]`; infinite where there is nothing.
    pub depth: Vec<f32>,
    /// Distance between the depths in front of which a quarter and three quarters of the pixel lie,
    /// `[H*W]`: 0 for a hard surface.
    pub spread: Vec<f32>,
    /// Coverage, 0 to 1, `[H*W]`; 0 for pixels that are not to be used.
    pub alpha: Vec<f32>,
    /// Linear radiance, `[H*W]`.
    pub radiance: Vec<[f32; 3]>,
}

impl DepthFrame {
    /// Checks that the parts go together.
    pub(crate) fn check(&self, index: usize) -> Result<(), MeshError> {
        let error = |reason: String| Err(MeshError::Frame { index, reason });
        if let Err(reason) = self.camera.validate() {
            return error(reason.to_string());
        }
        if !self.camera.projection.is_pinhole() || !self.camera.distortion.is_none() {
            return error("expected an undistorted pinhole".to_owned());
        }
        let pixels = self.camera.size_px.iter().map(|side| *side as usize).product::<usize>();
        let lengths = [self.depth.len(), self.spread.len(), self.alpha.len(), self.radiance.len()];
        if lengths.iter().any(|len| *len != pixels) {
            return error(format!("arrays of {lengths:?} pixels, expected {pixels} each"));
        }
        Ok(())
    }

    /// Returns whether a pixel shows a surface at a depth that can be used.
    pub(crate) fn shows_surface(&self, pixel: usize) -> bool {
        let depth = self.depth[pixel];
        self.alpha[pixel] >= LEAST_ALPHA && depth > 0.0 && depth.is_finite() && self.spread[pixel] >= 0.0
    }

    /// Returns the cosine between the ray of a pixel and the normal of the depth image there, by
    /// central differences.
    fn cosine(&self, pixel: usize) -> f32 {
        let [width, height] = self.camera.size_px.map(|side| side as usize);
        let (x, y) = (pixel % width, pixel / width);
        let slope = |before: usize, after: usize, pixels: usize| match pixels {
            0 => 0.0,
            _ => (self.depth[after] - self.depth[before]) / pixels as f32,
        };
        let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)];
        let [top, bottom] = [y.saturating_sub(1), (y + 1).min(height - 1)];
        let [focal_x, focal_y] = self.camera.focal_px.to_array().map(|f| f as f32);
        let depth = self.depth[pixel];
        let across = slope(y * width + left, y * width + right, right - left) * focal_x / depth;
        let down = slope(top * width + x, bottom * width + x, bottom - top) * focal_y / depth;
        // A neighbour without depth makes it 0, or NaN.
        let cosine = 1.0 / (1.0 + across * across + down * down).sqrt();
        if cosine.is_finite() { cosine } else { 0.0 }
    }
}

/// Lengths that weights depend on, in the unit of the cameras.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WeightLengths {
    /// Median depth.
    pub(crate) depth: f64,
    /// Median spread of depths.
    pub(crate) spread: f64,
    /// Depth limit.
    pub(crate) max_depth: f64,
}

/// A depth image ready to be fused.
#[derive(Clone, Debug)]
pub(crate) struct WeightedFrame {
    pub(crate) camera: Camera,
    pub(crate) depth: Vec<f32>,
    /// 0 for pixels that do not count.
    pub(crate) weight: Vec<f32>,
    pub(crate) radiance: Vec<[f32; 3]>,
}

impl WeightedFrame {
    pub(crate) fn new(frame: DepthFrame, lengths: WeightLengths) -> Self {
        // Hard surfaces have no spread, and f32 no division by it.
        let usual_spread = (lengths.spread as f32).max(1e-6 * lengths.depth as f32);
        let weigh = |pixel: usize| {
            let (depth, spread, cosine) = (frame.depth[pixel], frame.spread[pixel], frame.cosine(pixel));
            let counts = frame.shows_surface(pixel)
                && f64::from(depth) <= lengths.max_depth
                && spread <= MOST_SPREAD * usual_spread
                && cosine >= LEAST_COSINE;
            if !counts {
                return 0.0;
            }
            let nearer = lengths.depth as f32 / depth;
            cosine * nearer * nearer / (1.0 + (spread / usual_spread).powi(2))
        };
        let weight: Vec<f32> = (0..frame.depth.len()).map(weigh).collect();
        Self { camera: frame.camera, depth: frame.depth, weight, radiance: frame.radiance }
    }
}
