//! Surface images: the distribution of depths of each pixel.

use luxel_core::{CameraProjection, ColorModel, Engine, EngineError, RasterConfig, RenderOptions, Splats};
use luxel_cpu::CpuEngine;

use crate::fixture;

/// Returns an opaque flat splat through (0, 0, 4) that is turned by 45 degrees about y.
fn slanted() -> Splats {
    let mut splats = fixture::splats(ColorModel::Sh { degree: 0 }, 1, &fixture::camera(32, 32), 5);
    splats.position[0] = [0.0, 0.0, 4.0];
    splats.log_scale[0] = [0.5f32.ln(), 0.5f32.ln(), 1e-3f32.ln()];
    let half = std::f32::consts::FRAC_PI_8;
    splats.rotation[0] = [half.cos(), 0.0, half.sin(), 0.0];
    splats.opacity_logit[0] = 6.0;
    splats
}

#[test]
fn a_flat_splat_is_where_the_ray_meets_its_plane() {
    let mut camera = fixture::camera(32, 32);
    camera.camera_from_world = glam::DAffine3::IDENTITY;
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&slanted(), None).unwrap();
    let options = RenderOptions::default();
    let found = engine.render_surface(&camera, &options).unwrap();
    let layers = engine.render_layers(&camera, &options).unwrap();
    assert!(found.pixels.iter().zip(&layers.alpha).all(|(pixel, alpha)| (pixel.alpha - alpha).abs() <= 1e-6));
    let mut seen = 0;
    for (n, pixel) in found.pixels.iter().enumerate().filter(|(_, pixel)| pixel.alpha > 0.1) {
        let slope = ((n % 32) as f64 + 0.5 - camera.center_px.x) / camera.focal_px.x;
        // The splat's x axis points to (1, 0, -1): its plane is x + z = 4.
        let expected = 4.0 / (1.0 + slope);
        assert!((f64::from(pixel.median_depth()) - expected).abs() < 2e-3, "{n}: {} {expected}", pixel.median_depth());
        assert_eq!((pixel.spread(), pixel.splat), (0.0, Some(0)));
        seen += 1;
    }
    assert!(seen > 20, "{seen}");
}

#[test]
fn quartiles_are_in_order_and_do_not_depend_on_threads() {
    let camera = fixture::camera(70, 50);
    let splats = fixture::splats(ColorModel::Sh { degree: 2 }, 200, &camera, 5);
    let with = |threads: usize| {
        let mut engine = CpuEngine::new(threads).unwrap();
        engine.load(&splats, None).unwrap();
        engine.render_surface(&camera, &RenderOptions::default()).unwrap()
    };
    let found = with(2);
    assert_eq!((found.width, found.height, found.pixels.len()), (70, 50, 3500));
    for pixel in &found.pixels {
        let [near, median, far] = pixel.depth_quartiles;
        assert!(near <= median && median <= far && near > 0.0, "{pixel:?}");
        assert_eq!(pixel.alpha == 0.0, median.is_infinite());
    }
    assert!(found.pixels.iter().any(|pixel| pixel.spread() > 0.0 && pixel.spread().is_finite()));
    assert_eq!(found, with(1));
}

#[test]
fn other_lenses_and_several_samples_are_refused() {
    let camera = fixture::camera(32, 24);
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&fixture::splats(ColorModel::Sh { degree: 0 }, 20, &camera, 5), None).unwrap();
    let message = |error: EngineError| error.to_string();
    let four = RenderOptions { raster: RasterConfig { samples: 2, ..RasterConfig::default() }, ..RenderOptions::default() };
    assert!(message(engine.render_surface(&camera, &four).unwrap_err()).contains("1 sample along a pixel's side, found 2"));
    let panorama = fixture::wide_camera(CameraProjection::Equirectangular, 64, 32);
    assert!(message(engine.render_surface(&panorama, &RenderOptions::default()).unwrap_err()).contains("of pinholes"));
    // Of a mix, the first light's: all lights have the same geometry.
    let lights = fixture::three_lights(&camera, 20);
    let mix = fixture::mix(&lights.iter().map(|(splats, gain)| (splats, *gain)).collect::<Vec<_>>());
    engine.load(&mix, None).unwrap();
    assert!(engine.render_surface(&camera, &RenderOptions::default()).is_ok());
}
