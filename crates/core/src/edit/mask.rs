//! From painted pixels to splats: each splat's share of the painted part of an image.

/// Visible part below which a splat counts as hidden. What lies behind 95 % of a pixel's opacity
/// adds at most 5 % to the pixel.
const LEAST_SEEN: f32 = 0.05;

/// The contributions of each splat to an image, as sums over its pixels, `[N]` each.
///
/// A splat's blending weight at a pixel is its alpha times the transmittance in front of it: the
/// derivative of the pixel by the splat's radiance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contributions {
    /// Sum of blending weight times the pixel's mask.
    pub masked: Vec<f32>,
    /// Sum of blending weights.
    pub blended: Vec<f32>,
    /// Sum of alphas: the value of [`Self::blended`] if nothing were in front.
    pub unoccluded: Vec<f32>,
    /// Sum of masked blending weights times the brightest channel of the splat's radiance towards
    /// the camera, in the scene's units: the light that the splat adds.
    pub light: Vec<f32>,
}

impl Contributions {
    /// Returns the contributions of the lights of a scene together: their light is added; the
    /// blending weights, which differ by cut-offs alone, are averaged.
    pub fn of_lights(lights: impl IntoIterator<Item = Self>) -> Self {
        let mut lights = lights.into_iter();
        let Some(mut sum) = lights.next() else { return Self::default() };
        let mut count = 1.0f32;
        for light in lights {
            count += 1.0;
            let rows = [
                (&mut sum.masked, light.masked),
                (&mut sum.blended, light.blended),
                (&mut sum.unoccluded, light.unoccluded),
                (&mut sum.light, light.light),
            ];
            rows.into_iter().for_each(|(sum, values)| sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value));
        }
        if count > 1.0 {
            let weights = [&mut sum.masked, &mut sum.blended, &mut sum.unoccluded];
            weights.into_iter().flatten().for_each(|value| *value /= count);
        }
        sum
    }

    /// Returns the part of each splat's blending weight that lies in the mask, 0 to 1; 0 for splats
    /// that are hidden or outside the image.
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
