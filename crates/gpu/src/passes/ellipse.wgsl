// Ellipses on the image plane of a pinhole: evaluated at a pixel, and the tiles that they touch.

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

// The weight of a pixel's offset in the gradient by the splat's centre.
fn facing(seen: Seen) -> f32 {
    return 1.0;
}

// Returns the area of tiles in which `touched_columns` may find some: first column and row, one
// beyond the last column and row. The rows are those with pixel centres within the ellipse's
// extent.
fn touched_area(f: Footprint, tiles: vec2u) -> vec4u {
    let tile_px = f32(TILE_PX);
    let reach = f.extent_y_px + MARGIN_PX;
    let first = max(floor(f.mean_px.y - reach + 0.5), 0.0);
    let last = min(floor(f.mean_px.y + reach - 0.5), f32(tiles.y) * tile_px - 1.0);
    if (last < first) {
        return vec4u(0u);
    }
    return vec4u(0u, u32(first) / TILE_PX, tiles.x, u32(last) / TILE_PX + 1u);
}

// A span without a pixel.
const NO_SPAN = vec2f(0.0, -1.0);

// Returns the first and the last column of pixels that the ellipse touches in a band of so many
// rows of pixels: where it contains a pixel centre's column in the continuous band of the rows'
// pixel centres, with a margin for rounding. The last is before the first if there is none. Twin:
// cpu/passes/bin.rs.
fn touched_span(f: Footprint, first_row: f32, rows: f32) -> vec2f {
    let reach = f.extent_y_px + MARGIN_PX;
    let first_y = first_row + 0.5 - f.mean_px.y;
    let top = max(first_y - MARGIN_PX, -reach);
    let bottom = min(first_y + rows - 1.0 + MARGIN_PX, reach);
    if (top > bottom) {
        return NO_SPAN;
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
    return floor(vec2f(f.mean_px.x + left - MARGIN_PX + 0.5, f.mean_px.x + right + MARGIN_PX - 0.5));
}

// Returns the columns of tiles, first and one beyond the last, that the ellipse touches in a row of
// tiles.
fn touched_columns(f: Footprint, area: vec4u, tile_row: u32, tiles: vec2u) -> vec2u {
    let tile_px = f32(TILE_PX);
    let span = touched_span(f, f32(tile_row) * tile_px, tile_px);
    let first = max(span.x, 0.0);
    let last = min(span.y, f32(tiles.x) * tile_px - 1.0);
    if (last < first) {
        return vec2u(0u);
    }
    return vec2u(u32(first) / TILE_PX, u32(last) / TILE_PX + 1u);
}

// Returns a bit for each block of a tile, given by column and row, that the ellipse touches. With
// the margin, a splat's bit is missing only where none of the block's pixels sees it.
fn touched_blocks(f: Footprint, tile: vec2u) -> u32 {
    let corner = vec2f(tile * TILE_PX);
    var blocks = 0u;
    for (var block = 0u; block < BLOCKS; block += BLOCK_COLUMNS) {
        let row = f32(block / BLOCK_COLUMNS * BLOCK_HEIGHT);
        let span = touched_span(f, corner.y + row, f32(BLOCK_HEIGHT));
        for (var column = 0u; column < BLOCK_COLUMNS; column++) {
            let first = corner.x + f32(column * BLOCK_WIDTH);
            if (span.x <= min(span.y, first + f32(BLOCK_WIDTH) - 1.0) && span.y >= first) {
                blocks |= 1u << (block + column);
            }
        }
    }
    return blocks;
}
