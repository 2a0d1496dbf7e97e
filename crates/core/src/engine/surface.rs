//! Surface images: how far each pixel sees, as a distribution and not as a mean.
//!
//! In: the splats that an engine blends into a pixel, front to back. Out: [`SurfaceImage`]. Behind
//! a translucent veil, or at a silhouette, the mean depth lies where there is nothing; the median
//! lies on one of the surfaces, and the distance between the quartiles tells how sure it is. The
//! depth of a splat at a pixel is where its density along the pixel's ray is greatest: for a flat
//! splat that is where the ray meets its plane. Degenerate: a pixel that no splat touches has
//! coverage 0 and infinite depths.

/// The distribution of depths of a pixel, by the weights with which radiance is blended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePixel {
    /// Coverage by splats, 0 to 1.
    pub alpha: f32,
    /// Distances along the viewing axis in front of which a quarter, a half and three quarters of
    /// the coverage lie.
    pub depth_quartiles: [f32; 3],
    /// Number of the splat with the greatest weight, the nearest of equals.
    pub splat: Option<u32>,
}

impl SurfacePixel {
    /// A pixel that no splat touches.
    pub const EMPTY: Self = Self { alpha: 0.0, depth_quartiles: [f32::INFINITY; 3], splat: None };

    /// Returns the pixel that is blended from parts: weight, and depth, in any order, which is
    /// sorted by depth. Its splat is not known.
    ///
    /// ```
    /// use luxel_core::engine::SurfacePixel;
    ///
    /// let pixel = SurfacePixel::from_parts(&mut [[0.6, 2.0], [0.2, 5.0], [0.1, 1.0]]);
    /// assert_eq!(pixel.depth_quartiles, [2.0, 2.0, 2.0]);
    /// assert!((pixel.alpha - 0.9).abs() < 1e-6);
    /// assert_eq!(SurfacePixel::from_parts(&mut []), SurfacePixel::EMPTY);
    /// ```
    pub fn from_parts(parts: &mut [[f32; 2]]) -> Self {
        parts.sort_by(|a, b| a[1].total_cmp(&b[1]));
        let alpha: f32 = parts.iter().map(|[weight, _]| weight).sum();
        if alpha <= 0.0 {
            return Self::EMPTY;
        }
        let depth_quartiles = [0.25, 0.5, 0.75].map(|share| {
            let mut left = share * alpha;
            let reached = parts.iter().find(|[weight, _]| {
                left -= weight;
                left <= 0.0
            });
            // Rounding may leave a remainder behind the last part.
            reached.or(parts.last()).map_or(f32::INFINITY, |[_, depth]| *depth)
        });
        Self { alpha, depth_quartiles, splat: None }
    }

    /// Returns the median depth.
    pub fn median_depth(&self) -> f32 {
        self.depth_quartiles[1]
    }

    /// Returns the distance between the first and the third quartile: small where the pixel shows
    /// one surface. Infinite for an empty pixel.
    pub fn spread(&self) -> f32 {
        if self.alpha > 0.0 { self.depth_quartiles[2] - self.depth_quartiles[0] } else { f32::INFINITY }
    }
}

/// An image of depths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// The pixels, `[H*W]`, row-major.
    pub pixels: Vec<SurfacePixel>,
}
