// Pass `project_backward`: computes the gradient by position, rotation, scale and opacity, with
// `color_backward` for the other parameters and `adam` for all. Twin:
// cpu/passes/project_backward.rs. What depends on the projection is in point_backward.wgsl or
// point_backward_rays.wgsl.
//
// One thread per splat of the shard. In: the sums over each entry's pixels: g, g u, g v, g u^2 · g
// u v, g v^2, red, green · blue, |g u|, |g (root_xy u + root_y v)|, with g the gradient by
// ln(alpha). A splat's entries are summed in the order of its tiles. In, out: parameters, moments,
// densification statistics. With M^T M the inverse covariance and S the second moments of the
// offsets whitened by M, dE/dcovariance = M^T S M / 2.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> shard: Shard;
@group(0) @binding(2) var<uniform> optimizer: Optimizer;
@group(0) @binding(3) var<storage, read> state: State;
@group(0) @binding(4) var<storage, read> places: array<vec2u>;
@group(0) @binding(5) var<storage, read> entry_gradients: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(7) var<storage, read_write> first: array<f32>;
@group(0) @binding(8) var<storage, read_write> second: array<f32>;
// Rows: gradient, absolute gradient, number of views, exact to 2^24.
@group(0) @binding(9) var<storage, read_write> stats: array<f32>;

struct Sums {
    log_alpha: f32,
    first: vec2f,
    second: vec3f,
    radiance: vec3f,
    absolute: vec2f,
}

fn gather_sums(splat: u32) -> Sums {
    let place = places[splat];
    var a = vec4f(0.0);
    var b = vec4f(0.0);
    var c = vec4f(0.0);
    // For many entries, `gather` has stored their sum in the first.
    let len = select(place.y, 1u, place.y > GATHER_ALONE);
    for (var n = 0u; n < len; n++) {
        let entry = 3u * (place.x + n);
        a += entry_gradients[entry];
        b += entry_gradients[entry + 1u];
        c += entry_gradients[entry + 2u];
    }
    return Sums(a.x, a.yz, vec3f(a.w, b.xy), vec3f(b.zw, c.x), c.yz);
}

// Replaces numbers that are not finite by zero: a splat that is culled for overflow has zero
// incoming gradients, but zero times infinity is NaN.
fn finite(value: f32) -> f32 {
    return select(0.0, value, is_finite(value));
}

// Gradient by the raw quaternion; d_0 to d_2 are the gradients by the rows of the rotation matrix.
fn rotation_backward(p: Projection, d_0: vec3f, d_1: vec3f, d_2: vec3f) -> vec4f {
    let w = p.quaternion.x;
    let x = p.quaternion.y;
    let y = p.quaternion.z;
    let z = p.quaternion.w;
    let d = vec4f(
        2.0 * (x * (d_2.y - d_1.z) + y * (d_0.z - d_2.x) + z * (d_1.x - d_0.y)),
        2.0 * (y * (d_0.y + d_1.x) + z * (d_0.z + d_2.x) + w * (d_2.y - d_1.z) - 2.0 * x * (d_1.y + d_2.z)),
        2.0 * (x * (d_0.y + d_1.x) + z * (d_1.z + d_2.y) + w * (d_0.z - d_2.x) - 2.0 * y * (d_0.x + d_2.z)),
        2.0 * (x * (d_0.z + d_2.x) + y * (d_1.z + d_2.y) + w * (d_1.x - d_0.y) - 2.0 * z * (d_0.x + d_1.y)),
    );
    // Normalisation: only the part orthogonal to the quaternion has an effect.
    return (d - dot(d, p.quaternion) * p.quaternion) * p.inverse_length;
}

struct Geometry {
    position: vec3f,
    rotation: vec4f,
    log_scale: vec3f,
    opacity_logit: f32,
    // Norms of the gradient by the centre, NDC units: of its sum, and of the sums of its absolute
    // parts.
    norms: vec2f,
    // Gradient by the focal lengths, for `camera_backward`.
    focal_px: vec2f,
}

// What `point_backward` of point_backward.wgsl or point_backward_rays.wgsl returns.
struct PointGradient {
    // Gradient by the point in camera space, and by the focal lengths.
    point: vec3f,
    focal_px: vec2f,
}

fn geometry_backward(i: u32, sums: Sums) -> Geometry {
    let p = project_splat(i);
    let root = inverse_root(p);
    let unit = 1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E);
    let by_offset = sums.first * (1.0 / SQRT_HALF_LOG2_E);
    let d_mean = vec2f(root.x * by_offset.x, root.y * by_offset.x + root.z * by_offset.y);
    let s = sums.second * unit;
    let by_root = vec3f(s.x * root.x, s.x * root.y + s.y * root.z, s.y * root.y + s.z * root.z);
    var d_xx = 0.5 * by_root.x * root.x;
    // The off-diagonal number stands for both entries.
    var d_xy = root.x * by_root.y;
    var d_yy = 0.5 * (root.y * by_root.y + root.z * by_root.z);
    var d_dilation = d_xx + d_yy;
    if ((camera.flags & FLAG_COMPENSATION) != 0u) {
        // compensation = sqrt(before / after): d ln(compensation) = (d ln before - d ln after) / 2.
        let ratio = p.determinant_before / p.determinant;
        let d_ratio = select(0.0, 0.5 * sums.log_alpha, ratio > MIN_AREA_RATIO);
        let by_before = d_ratio / max(p.determinant_before, 1e-30);
        let by_after = d_ratio / p.determinant;
        d_xx += by_before * (p.covariance.z - p.at.dilation) - by_after * p.covariance.z;
        d_yy += by_before * (p.covariance.x - p.at.dilation) - by_after * p.covariance.x;
        d_dilation -= by_after * (p.covariance.x + p.covariance.z);
        d_xy -= (by_before - by_after) * 2.0 * p.covariance.y;
    }
    // covariance = root root^T, root = screen_axes diag(sigma).
    let d_root_x = 2.0 * d_xx * p.root_x + d_xy * p.root_y;
    let d_root_y = 2.0 * d_yy * p.root_y + d_xy * p.root_x;
    let d_sigma = d_root_x * p.screen_x + d_root_y * p.screen_y;
    let ratio = p.raw_sigma / p.sigma;
    let share = ratio * ratio;
    var out: Geometry;
    let d_log_scale = d_sigma * p.sigma * share + sums.log_alpha * (vec3f(1.0) - share);
    out.log_scale = vec3f(finite(d_log_scale.x), finite(d_log_scale.y), finite(d_log_scale.z)) + p.raw_sigma * optimizer.scale_weight;
    out.opacity_logit = (1.0 - p.opacity) * (sums.log_alpha + p.opacity * optimizer.opacity_weight);
    // screen_axes = jacobian axes.
    let d_screen_x = d_root_x * p.sigma;
    let d_screen_y = d_root_y * p.sigma;
    let d_rotation = rotation_backward(
        p,
        p.at.jacobian_x.x * d_screen_x + p.at.jacobian_y.x * d_screen_y,
        p.at.jacobian_x.y * d_screen_x + p.at.jacobian_y.y * d_screen_y,
        p.at.jacobian_x.z * d_screen_x + p.at.jacobian_y.z * d_screen_y,
    );
    out.rotation = vec4f(finite(d_rotation.x), finite(d_rotation.y), finite(d_rotation.z), finite(d_rotation.w));
    let d_jacobian_x = vec3f(dot(d_screen_x, p.axes_0), dot(d_screen_x, p.axes_1), dot(d_screen_x, p.axes_2));
    let d_jacobian_y = vec3f(dot(d_screen_y, p.axes_0), dot(d_screen_y, p.axes_1), dot(d_screen_y, p.axes_2));
    let by = point_backward(p, d_jacobian_x, d_jacobian_y, d_mean, d_dilation);
    let d = by.point.x * camera.row_x.xyz + by.point.y * camera.row_y.xyz + by.point.z * camera.row_z.xyz;
    out.position = vec3f(finite(d.x), finite(d.y), finite(d.z));
    let ndc = ndc_of(p);
    // Sums of absolute gradients by the centre. They carry the rasteriser's constant twice: in u
    // and v, and in its root.
    let absolute = vec2f(root.x * sums.absolute.x / SQRT_HALF_LOG2_E, sums.absolute.y * unit);
    out.norms = vec2f(length(d_mean * ndc), length(absolute * ndc));
    out.focal_px = vec2f(finite(by.focal_px.x), finite(by.focal_px.y));
    return out;
}

@compute @workgroup_size(128)
fn project_backward(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(workgroup) * 128u + local;
    if (i >= shard.len || state.halted != HALT_NONE) {
        return;
    }
    let splat = shard.base + i;
    let is_visible = places[splat].y > 0u;
    var sums: Sums;
    if (is_visible) {
        sums = gather_sums(splat);
    }
    var geometry: Geometry;
    if (is_visible || optimizer.opacity_weight != 0.0 || optimizer.scale_weight != 0.0) {
        geometry = geometry_backward(i, sums);
        if (is_visible && optimizer.stats != 0u) {
            stats[i] += geometry.norms.x;
            stats[shard.stride + i] += geometry.norms.y;
            stats[2u * shard.stride + i] += 1.0;
        }
    }
    // The position is updated last, because colours depend on the old one.
    let d_position = geometry.position + color_backward(i, is_visible, sums.radiance);
    for (var k = 0u; k < 3u; k++) {
        update_parameter(ROW_POSITION + k, i, finite(d_position[k]), optimizer.position);
        update_parameter(ROW_LOG_SCALE + k, i, geometry.log_scale[k], optimizer.log_scale);
    }
    for (var k = 0u; k < 4u; k++) {
        update_parameter(ROW_ROTATION + k, i, geometry.rotation[k], optimizer.rotation);
    }
    update_parameter(ROW_OPACITY, i, geometry.opacity_logit, optimizer.opacity_logit);
    if (optimizer.noise_scale != 0.0 && !ONLY_GRADIENTS) {
        let moved = position_noise(i, splat);
        for (var k = 0u; k < 3u; k++) {
            parameters[(ROW_POSITION + k) * shard.stride + i] += moved[k];
        }
    }
}
