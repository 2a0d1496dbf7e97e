//! Deep images: what each pixel is blended from.

use luxel_core::{CameraProjection, ColorModel, Engine, EngineError, RasterConfig, RenderOptions};
use luxel_cpu::CpuEngine;

use crate::fixture;

#[test]
fn composited_samples_are_the_render_for_any_number_of_them() {
    let (pinhole, panorama) = (fixture::camera(70, 50), fixture::wide_camera(CameraProjection::Equirectangular, 64, 32));
    let options = RenderOptions::default();
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&fixture::splats(ColorModel::Sh { degree: 2 }, 200, &pinhole, 5), None).unwrap();
    for camera in [&pinhole, &panorama] {
        let expected = engine.render_layers(camera, &options).unwrap();
        let all = engine.render_deep(camera, &options, usize::MAX).unwrap();
        assert!(all.most_samples() > 8, "{}", all.most_samples());
        for most in [usize::MAX, 8, 1] {
            let deep = engine.render_deep(camera, &options, most).unwrap();
            assert!(deep.most_samples() <= most);
            for samples in &deep.pixels {
                assert!(samples.windows(2).all(|pair| pair[0].depth[1] <= pair[1].depth[0]));
            }
            let flat = deep.flatten();
            let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * (1e-3 + b.abs());
            let (found, image) = (flat.image.pixels.as_flattened(), expected.image.pixels.as_flattened());
            assert!(found.iter().zip(image).all(|(a, b)| near(*a, *b)), "{most}");
            assert!(flat.alpha.iter().zip(&expected.alpha).all(|(a, b)| (a - b).abs() <= 1e-6), "{most}");
            if most == usize::MAX {
                let covered = expected.alpha.iter().zip(flat.depth.iter().zip(&expected.depth)).filter(|(alpha, _)| **alpha > 0.01);
                assert!(covered.map(|(_, depths)| depths).all(|(a, b)| (a - b).abs() <= 1e-4 * b.abs()));
            }
        }
    }
    let one_thread = CpuEngine::new(1).and_then(|mut one| {
        one.load(&engine.save()?.0, None)?;
        one.render_deep(&pinhole, &options, 8)
    });
    assert_eq!(one_thread.unwrap(), engine.render_deep(&pinhole, &options, 8).unwrap());
}

#[test]
fn several_samples_a_pixel_and_mixes_are_refused() {
    let camera = fixture::camera(32, 24);
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&fixture::splats(ColorModel::Sh { degree: 0 }, 20, &camera, 5), None).unwrap();
    let four = RenderOptions { raster: RasterConfig { samples: 2, ..RasterConfig::default() }, ..RenderOptions::default() };
    let message = |error: EngineError| error.to_string();
    assert!(message(engine.render_deep(&camera, &four, 8).unwrap_err()).contains("1 sample along a pixel's side, found 2"));
    let lights = fixture::three_lights(&camera, 20);
    let mix = fixture::mix(&lights.iter().map(|(splats, gain)| (splats, *gain)).collect::<Vec<_>>());
    engine.load(&mix, None).unwrap();
    assert!(message(engine.render_deep(&camera, &RenderOptions::default(), 8).unwrap_err()).contains("mix of lights"));
}
