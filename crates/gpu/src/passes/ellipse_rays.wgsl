// Ellipses on the plane across their direction, where pixels are rays: the variant of ellipse.wgsl,
// with the same functions.
//
// `mean_px` of a footprint holds the direction in camera space, projected from the opposite pole of
// the hemisphere that it lies in: (x, y) / (1 + |z|). `root_x` is negative where z is. Its size,
// `root_xy` and `root_y` are the triangular root of the inverse covariance on the plane, in
// radians. `extent_y_px` and `right_dy_px` are unused.

struct Seen {
    u: f32,
    v: f32,
    log2_alpha: f32,
    // Cosine between the ray and the splat's direction.
    facing: f32,
}

// log2 of an alpha below every threshold.
const UNSEEN = -127.0;

fn encode_direction(unit: vec3f) -> vec2f {
    return unit.xy / (1.0 + abs(unit.z));
}

fn decode_direction(code: vec2f, sign: f32) -> vec3f {
    let s = dot(code, code);
    return vec3f(2.0 * code, sign * (1.0 - s)) / (1.0 + s);
}

fn see(code: vec2f, root: vec3f, log2_opacity: f32, at_px: vec2f) -> Seen {
    let sign = select(-1.0, 1.0, root.x >= 0.0);
    let unit = decode_direction(code, sign);
    let basis = plane_basis(unit, sign);
    let ray = ray_at(at_px);
    let d = vec2f(dot(basis.x, ray), dot(basis.y, ray));
    let u = abs(root.x) * d.x + root.y * d.y;
    let v = root.z * d.y;
    let facing = dot(unit, ray);
    return Seen(u, v, select(UNSEEN, log2_opacity - u * u - v * v, facing > 0.0), facing);
}

// An offset across the ray of the centre changes by this much when the centre moves.
fn facing(seen: Seen) -> f32 {
    return seen.facing;
}

// Angle of sine t, for 0 <= t <= 1.
fn angle_of_sine(t: f32) -> f32 {
    return atan2(t, sqrt(max(1.0 - t * t, 0.0)));
}

// Returns the tiles of the box around the cap of directions that the splat may reach: first column
// and row, one beyond the last column and row. Functions of shaders may be off by 1e-3.
fn touched_area(f: Footprint, tiles: vec2u) -> vec4u {
    let whole = vec4u(0u, 0u, tiles);
    // The smallest eigenvalue of root root^T is that of the largest axis.
    let a = f.root_x * f.root_x + f.root_xy * f.root_xy;
    let b = f.root_xy * f.root_y;
    let c = f.root_y * f.root_y;
    let half = 0.5 * (a - c);
    let largest = 0.5 * (a + c) + sqrt(half * half + b * b);
    let area = f.root_x * f.root_y;
    let reach2 = (f.log2_opacity - f.log2_threshold) * largest / max(area * area, 1e-37);
    if (!(reach2 < 0.7)) {
        return whole;
    }
    let angle = angle_of_sine(sqrt(reach2)) + 2e-3;
    let unit = decode_direction(f.mean_px, select(-1.0, 1.0, f.root_x >= 0.0));
    var low = vec2f(0.0);
    var high = vec2f(camera.size_px);
    if (lens.is_panorama != 0u) {
        let flat = length(unit.xz);
        let latitude = atan2(unit.y, flat);
        low.y = (latitude - angle) * camera.focal_px.y + camera.center_px.y;
        high.y = (latitude + angle) * camera.focal_px.y + camera.center_px.y;
        if (abs(latitude) + angle < HALF_PI) {
            let longitude = atan2(unit.x, unit.z);
            let width = angle_of_sine(min(sin_cos(angle).x / flat, 1.0)) + 2e-3;
            // One that crosses the seam touches the whole row.
            if (abs(longitude) + width < 2.0 * HALF_PI) {
                low.x = (longitude - width) * camera.focal_px.x + camera.center_px.x;
                high.x = (longitude + width) * camera.focal_px.x + camera.center_px.x;
            }
        }
    } else {
        let flat = length(unit.xy);
        let from_axis = atan2(flat, unit.z);
        if (from_axis - angle > lens.max_angle) {
            return vec4u(0u);
        }
        let inner = min(from_axis, lens.max_angle);
        let direction = select(vec2f(0.0), unit.xy / flat, flat > 0.0);
        let middle = direction * fisheye_radius(inner) * camera.focal_px + camera.center_px;
        let reach = (angle + from_axis - inner) * lens.stretch * camera.focal_px;
        low = middle - reach;
        high = middle + reach;
    }
    let size = vec2f(camera.size_px);
    let first = clamp(floor(low - 1.0), vec2f(0.0), size);
    let end = clamp(ceil(high + 1.0), vec2f(0.0), size);
    if (any(end <= first)) {
        return vec4u(0u);
    }
    return vec4u(vec2u(first) / TILE_PX, min((vec2u(end) + TILE_PX - 1u) / TILE_PX, tiles));
}

fn touched_columns(f: Footprint, area: vec4u, tile_row: u32, tiles: vec2u) -> vec2u {
    return area.xz;
}

// Returns all blocks of the tile.
fn touched_blocks(f: Footprint, tile: vec2u) -> u32 {
    return (1u << BLOCKS) - 1u;
}
