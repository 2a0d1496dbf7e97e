//! From pixels to splats: which of them make up the painted part of an image.

/// Splats of which less than this is seen count as hidden. What lies behind 95 % of a pixel's opacity makes up at most 5 % of the pixel.
const LEAST_SEEN: f32 = 0.05;

/// What each splat gives to an image, sums over its pixels, `[N]` each. A splat's blending weight at a pixel is its alpha times the
/// transmittance in front of it: the derivative of the pixel by the splat's radiance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contributions {
    /// Blending weight times the pixel's mask.
    pub masked: Vec<f32>,
    /// Blending weight.
    pub blended: Vec<f32>,
    /// Alpha: what [`Self::blended`] would be with nothing in front.
    pub unoccluded: Vec<f32>,
    /// Masked blending weight times the brightest channel of the splat's radiance towards the camera, in the scene's units: the light that it brings.
    pub light: Vec<f32>,
}

impl Contributions {
    /// The part of each splat's blending weight that lies in the mask, 0 to 1; 0 for those that are hidden or not in the image.
    pub fn shares(&self) -> Vec<f32> {
        let share = |((masked, blended), unoccluded): ((&f32, &f32), &f32)| {
            let is_seen = *blended > 0.0 && *blended >= LEAST_SEEN * unoccluded;
            if is_seen { (masked / blended).clamp(0.0, 1.0) } else { 0.0 }
        };
        self.masked.iter().zip(&self.blended).zip(&self.unoccluded).map(share).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_and_unseen_splats_have_no_share() {
        let contributions = Contributions {
            masked: vec![2.0, 1.0, 0.1, 0.0],
            blended: vec![2.0, 4.0, 0.1, 0.0],
            unoccluded: vec![2.5, 5.0, 10.0, 0.0],
            light: vec![0.0; 4],
        };
        assert_eq!(contributions.shares(), [1.0, 0.25, 0.0, 0.0]);
    }
}
