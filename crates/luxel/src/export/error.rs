//! The error of a bake: its renders against the tone-mapped or converted renders of the scene.
//!
//! In: a scene and its bake, views. Out, over all pixels of the held-out views (of the training
//! views where none are held out):
//! - display bake: tone-mapped renders of the scene are the reference; PSNR of display values 0..1,
//!   and the mean absolute error in 8-bit steps;
//! - linear bake: renders of the scene in the bake's space are the reference; PSNR after the mu-law
//!   with the scene's scale as 1, and the sum of absolute errors over the sum of radiance.

use luxel_core::tone::{MU, exposed_rec709, mu_law};
use luxel_core::{Conversion, Dataset, Engine, Image, Scene};
use luxel_io::{Appearance, Baked};

use crate::Result;
use crate::error::Context;

/// Sums over pixels and channels.
#[derive(Default)]
struct Sums {
    squared: f64,
    absolute: f64,
    size: f64,
    count: f64,
}

/// The error of a bake over all pixels of the views measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeError {
    /// Number of views.
    pub views: usize,
    /// The values, by the kind of bake.
    pub values: BakeErrorValues,
}

/// The values of a [`BakeError`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BakeErrorValues {
    /// A display bake.
    Display {
        /// PSNR of display values 0..1, dB.
        psnr_db: f64,
        /// Mean absolute error in 8-bit steps.
        mean_absolute_error_of_255: f64,
    },
    /// A linear bake.
    Linear {
        /// PSNR after the mu-law with the scene's scale as 1, dB.
        psnr_mu_law_db: f64,
        /// Sum of absolute errors over the sum of radiance.
        relative_error_of_radiance: f64,
    },
}

/// Measures a bake on the held-out views, rendered on black.
pub(super) fn measure(scene: &Scene, baked: &Baked, dataset: &Dataset, engine: &mut dyn Engine) -> Result<BakeError> {
    let views = if dataset.test.is_empty() { &dataset.train } else { &dataset.test };
    let mut references = Vec::with_capacity(views.len());
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    for view in views {
        let options = scene.render_options();
        references.push(reference(scene, baked, engine.render(&view.camera, &options).context("cannot render a view")?));
    }
    engine.load(&baked.scene.splats, None).context("cannot load the bake")?;
    let mut sums = Sums::default();
    // A scale of 1 in the file's units: what the bake's exposure made of the scene's own.
    let unit = baked.exposure;
    for (view, reference) in views.iter().zip(&references) {
        let options = baked.scene.render_options();
        let found = engine.render(&view.camera, &options).context("cannot render a view of the bake")?;
        for (found, right) in found.pixels.as_flattened().iter().zip(reference.pixels.as_flattened()) {
            let (found, right) = match baked.appearance {
                Appearance::Display { .. } => (found.clamp(0.0, 1.0), *right),
                Appearance::Linear { .. } => (*found, right.max(0.0)),
            };
            let difference = match baked.appearance {
                Appearance::Display { .. } => found - right,
                Appearance::Linear { .. } => mu_law(found / unit, MU) - mu_law(right / unit, MU),
            };
            sums.squared += f64::from(difference).powi(2);
            sums.absolute += f64::from(found - right).abs();
            sums.size += f64::from(right);
            sums.count += 1.0;
        }
    }
    let psnr_db = luxel_metrics::psnr_of_mse(sums.squared / sums.count.max(1.0));
    let values = match baked.appearance {
        Appearance::Display { .. } => {
            BakeErrorValues::Display { psnr_db, mean_absolute_error_of_255: 255.0 * sums.absolute / sums.count.max(1.0) }
        }
        Appearance::Linear { .. } => BakeErrorValues::Linear {
            psnr_mu_law_db: psnr_db,
            relative_error_of_radiance: sums.absolute / sums.size.max(f64::MIN_POSITIVE),
        },
    };
    Ok(BakeError { views: views.len(), values })
}

/// Returns the reference for a bake's render, from a render of the scene in normalised units.
pub(super) fn reference(scene: &Scene, baked: &Baked, mut image: Image) -> Image {
    match baked.appearance {
        Appearance::Display { tonemap, .. } => {
            for pixel in &mut image.pixels {
                *pixel = tonemap.encode(exposed_rec709(scene.color_space, *pixel, baked.exposure));
            }
        }
        Appearance::Linear { color_space, .. } => {
            let conversion = Conversion::between(scene.color_space, color_space);
            for pixel in &mut image.pixels {
                *pixel = conversion.apply(scene.color_space.light(*pixel).map(|c| c * baked.exposure));
            }
        }
    }
    image
}
