// The way back through the projection of a pinhole: see `project_backward`.

// Gradient by the point in camera space, through the centre and the Jacobian. The dilation is
// constant.
fn point_backward(p: Projection, d_jacobian_x: vec3f, d_jacobian_y: vec3f, d_mean: vec2f, d_dilation: f32) -> vec3f {
    let inverse_z = 1.0 / p.point.z;
    let scale = inverse_z * camera.focal_px;
    // jacobian = scale (row - slope row_z); mean = scale point + centre.
    let by_direct = vec2f(dot(d_jacobian_x, camera.row_x.xyz), dot(d_jacobian_y, camera.row_y.xyz));
    let by_depth = vec2f(dot(d_jacobian_x, camera.row_z.xyz), dot(d_jacobian_y, camera.row_z.xyz));
    let true_slope = p.point.xy * inverse_z;
    // Where the slope is clamped it is constant.
    let d_slope = select(-(scale * by_depth), vec2f(0.0), true_slope != p.slope);
    let d_xy = d_mean * scale + d_slope * inverse_z;
    let by_scale = by_direct - p.slope * by_depth + d_mean * p.point.xy;
    let d_z = -inverse_z * (by_scale * scale + d_slope * true_slope);
    return vec3f(d_xy, d_z.x + d_z.y);
}

// Variance that the pixel added.
fn dilation_of(p: Projection) -> f32 {
    return camera.dilation_px2;
}

// Factors from gradients by the centre to those in NDC, which spans 2 over the image's side.
fn ndc_of(p: Projection) -> vec2f {
    return 0.5 * vec2f(camera.size_px);
}

// Sums of absolute gradients by the centre. They carry the rasteriser's constant twice: in u and v,
// and in its root.
fn absolute_by_center(root: vec3f, sums: vec2f) -> vec2f {
    let unit = 1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E);
    return vec2f(root.x * sums.x / SQRT_HALF_LOG2_E, sums.y * unit);
}

// Gradient by the focal lengths: centre and Jacobian are proportional to them, and the root is to
// the Jacobian. by_root is the root times the gradient by it, row by row.
fn focal_backward(p: Projection, d_mean: vec2f, by_root: vec2f) -> vec2f {
    return d_mean * p.point.xy / p.point.z + by_root / camera.focal_px;
}
