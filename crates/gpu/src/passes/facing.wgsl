// The weight of a pixel's offset in the gradient by the splat's centre: 1 on the image plane. Twin:
// `facing` in footprint_rays.wgsl.

fn facing(seen: Seen) -> f32 {
    return 1.0;
}
