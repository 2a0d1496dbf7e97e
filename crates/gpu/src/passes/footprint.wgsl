// A splat on the screen, as `project` computes it. Twin in Rust: layout.rs.

struct Footprint {
    // Centre x, y; rows of the triangular root of the inverse covariance times sqrt(log2(e) / 2):
    // alpha = 2^(log2_opacity - u^2 - v^2) at u = root_x dx + root_xy dy and v = root_y dy.
    mean_px: vec2f,
    root_x: f32,
    root_xy: f32,
    root_y: f32,
    log2_opacity: f32,
    // log2 of the alpha below which the splat is skipped.
    log2_threshold: f32,
    red: f32,
    green: f32,
    blue: f32,
    // Half the ellipse's extent along y at the threshold, and dy at its rightmost point.
    extent_y_px: f32,
    right_dy_px: f32,
}

// Returns the pixel of a tile for a thread: a run of 32 threads covers 8x4 pixels, so that
// neighbours in a subgroup are neighbours on the screen.
fn tile_pixel(local: u32) -> vec2u {
    let block = local >> 5u;
    let lane = local & 31u;
    return vec2u((block & 1u) * 8u + (lane & 7u), (block >> 1u) * 4u + (lane >> 3u));
}
