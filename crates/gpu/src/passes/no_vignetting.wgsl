// The gain of pixels of an image without vignetting. Counterpart: vignetting.wgsl.

fn gain_at(at: vec2u) -> f32 {
    return 1.0;
}
