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

// A splat evaluated at a pixel: whitened offsets from the centre and log2(alpha) before the cap.
struct Seen {
    u: f32,
    v: f32,
    log2_alpha: f32,
}

fn see(mean_px: vec2f, root: vec3f, log2_opacity: f32, at_px: vec2f) -> Seen {
    let d = at_px - mean_px;
    let u = root.x * d.x + d.y * root.y;
    let v = d.y * root.z;
    return Seen(u, v, log2_opacity - u * u - v * v);
}

// Returns the pixel of a tile for a thread: a run of 32 threads covers 8x4 pixels, so that
// neighbours in a subgroup are neighbours on the screen.
fn tile_pixel(local: u32) -> vec2u {
    let block = local >> 5u;
    let lane = local & 31u;
    return vec2u((block & 1u) * 8u + (lane & 7u), (block >> 1u) * 4u + (lane >> 3u));
}

// Returns the columns of tiles, first and one beyond the last, that the ellipse touches in a row of
// tiles: where it contains a pixel centre's column in the continuous band of the row's pixel
// centres, with a margin for rounding. Twin: cpu/passes/bin.rs.
fn touched_columns(f: Footprint, tile_row: u32, tiles: vec2u) -> vec2u {
    let tile_px = f32(TILE_PX);
    let reach = f.extent_y_px + MARGIN_PX;
    let first_y = f32(tile_row) * tile_px + 0.5 - f.mean_px.y;
    let top = max(first_y - MARGIN_PX, -reach);
    let bottom = min(first_y + tile_px - 1.0 + MARGIN_PX, reach);
    if (top > bottom) {
        return vec2u(0u);
    }
    let inverse_root = 1.0 / f.root_x;
    let slope = -f.root_xy * inverse_root;
    let radius2 = f.log2_opacity - f.log2_threshold;
    // The ellipse is convex: its rightmost point within the band is its rightmost point, or on the
    // nearer edge of the band.
    let left_dy = clamp(-f.right_dy_px, top, bottom);
    let right_dy = clamp(f.right_dy_px, top, bottom);
    let left_v = f.root_y * left_dy;
    let right_v = f.root_y * right_dy;
    let left = slope * left_dy - sqrt(max(radius2 - left_v * left_v, 0.0)) * inverse_root;
    let right = slope * right_dy + sqrt(max(radius2 - right_v * right_v, 0.0)) * inverse_root;
    // Pixel centres from left to right: from floor(left + 1/2) to floor(right - 1/2); the margin
    // compensates for centres exactly on the edge.
    let first = max(floor(f.mean_px.x + left - MARGIN_PX + 0.5), 0.0);
    let last = min(floor(f.mean_px.x + right + MARGIN_PX - 0.5), f32(tiles.x) * tile_px - 1.0);
    if (last < first) {
        return vec2u(0u);
    }
    return vec2u(u32(first) / TILE_PX, u32(last) / TILE_PX + 1u);
}

// Returns the rows of tiles, first and one beyond the last, with pixel centres within the ellipse's
// extent.
fn touched_rows(f: Footprint, tiles: vec2u) -> vec2u {
    let tile_px = f32(TILE_PX);
    let reach = f.extent_y_px + MARGIN_PX;
    let first = max(floor(f.mean_px.y - reach + 0.5), 0.0);
    let last = min(floor(f.mean_px.y + reach - 0.5), f32(tiles.y) * tile_px - 1.0);
    if (last < first) {
        return vec2u(0u);
    }
    return vec2u(u32(first) / TILE_PX, u32(last) / TILE_PX + 1u);
}
