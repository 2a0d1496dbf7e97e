//! [`Differentiable`] for the CPU engine: checks arguments, and hands out [`Projected`] splats.
//!
//! In and out: see [`luxel_core::engine::Differentiable`]. Nothing here touches the scene that the
//! engine trains.

use luxel_core::EngineError;
use luxel_core::engine::{
    ActivatedSplats, BlendOptions, ColorGradient, Differentiable, DirectionalColors, MatrixCamera, ProjectedSplats, ScreenEllipses,
    check_len,
};

use super::CpuEngine;
use super::projected::Projected;
use super::screens::Shared;
use crate::passes::directional::{directional_backward, directional_colors};

/// Checks cameras.
fn check_cameras(cameras: &[MatrixCamera]) -> Result<(), EngineError> {
    for (n, MatrixCamera { camera_from_world, focal_px, center_px }) in cameras.iter().enumerate() {
        let [fx, fy] = focal_px;
        if !camera_from_world.as_flattened().iter().chain(focal_px).chain(center_px).all(|v| v.is_finite()) {
            return Err(EngineError::invalid(format!(
                "camera {n}: expected finite numbers, found {camera_from_world:?}, {focal_px:?}, {center_px:?}"
            )));
        }
        if *fx <= 0.0 || *fy <= 0.0 {
            return Err(EngineError::invalid(format!("camera {n}: expected focal lengths above 0, found {fx} and {fy}")));
        }
    }
    Ok(())
}

impl Differentiable for CpuEngine {
    fn project(
        &self,
        splats: &ActivatedSplats<'_>,
        cameras: &[MatrixCamera],
        options: &BlendOptions,
    ) -> Result<(ScreenEllipses, Box<dyn ProjectedSplats>), EngineError> {
        splats.validate()?;
        options.validate()?;
        check_cameras(cameras)?;
        let shared =
            Shared { pool: self.pool.clone(), level: self.state.level, record_bytes: self.record_bytes, spare: self.spare.clone() };
        let (ellipses, projected) = self.pool.install(|| Projected::new(shared, splats, cameras, options));
        Ok((ellipses, Box::new(projected)))
    }

    fn colors(&self, colors: &DirectionalColors<'_>) -> Result<Vec<[f32; 3]>, EngineError> {
        colors.validate()?;
        Ok(self
            .pool
            .install(|| directional_colors(self.state.level, colors, self.spare.numbers.take(colors.position.len() * colors.eye.len()))))
    }

    fn colors_backward(&self, colors: &DirectionalColors<'_>, gradient: &[[f32; 3]]) -> Result<ColorGradient, EngineError> {
        colors.validate()?;
        check_len("gradient by colours", gradient.len(), colors.position.len() * colors.eye.len())?;
        let numbers = &self.spare.numbers;
        let out = ColorGradient {
            position: numbers.take(colors.position.len()),
            eye: vec![[0.0; 3]; colors.eye.len()],
            sh: numbers.take(colors.sh.len()),
            raw_luminance: numbers.take(colors.raw_luminance.len()),
        };
        Ok(self.pool.install(|| directional_backward(self.state.level, colors, gradient, out)))
    }

    fn recycle(&self, numbers: Vec<f32>) {
        self.spare.numbers.give_back(numbers);
    }
}
