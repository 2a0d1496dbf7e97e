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

// A pair of a splat and a tile, with a bit for each of the tile's blocks that the splat touches.
// Twin in Rust: layout.rs.
struct Entry {
    splat: u32,
    blocks: u32,
}

// Blocks side by side in a tile.
const BLOCK_COLUMNS = TILE_PX / BLOCK_WIDTH;

// Returns the pixel of a tile for a thread: a run of threads covers a block, so that neighbours
// in a subgroup are neighbours on the screen.
fn tile_pixel(local: u32) -> vec2u {
    let block = local / BLOCK_PIXELS;
    let lane = local % BLOCK_PIXELS;
    let corner = vec2u((block % BLOCK_COLUMNS) * BLOCK_WIDTH, (block / BLOCK_COLUMNS) * BLOCK_HEIGHT);
    return corner + vec2u(lane % BLOCK_WIDTH, lane / BLOCK_WIDTH);
}
