// The way back through the projection where pixels are rays: see `project_backward`. Twin:
// cpu/passes/project_backward_rays.rs.

// Gradient by the point in camera space, through the plane, the centre on it and the pixel's size.
fn point_backward(p: Projection, d_jacobian_x: vec3f, d_jacobian_y: vec3f, d_mean: vec2f, d_dilation: f32) -> vec3f {
    let by_x = vec3f(dot(d_jacobian_x, camera.row_x.xyz), dot(d_jacobian_x, camera.row_y.xyz), dot(d_jacobian_x, camera.row_z.xyz));
    let by_y = vec3f(dot(d_jacobian_y, camera.row_x.xyz), dot(d_jacobian_y, camera.row_y.xyz), dot(d_jacobian_y, camera.row_z.xyz));
    let by_inverse_distance = dot(by_x, p.basis.x) + dot(by_y, p.basis.y);
    // A plane that follows the direction tilts and does not turn.
    let tilt = d_mean - p.inverse_distance * vec2f(dot(by_x, p.unit), dot(by_y, p.unit));
    let by_cosine = d_dilation * p.pixel_angle.y * camera.dilation_px2;
    let across = tilt.x * p.basis.x + tilt.y * p.basis.y + by_cosine * (vec3f(0.0, 0.0, 1.0) - p.unit.z * p.unit);
    return p.inverse_distance * (across - (p.inverse_distance * by_inverse_distance) * p.unit);
}

// Variance that the pixel added.
fn dilation_of(p: Projection) -> f32 {
    return p.dilation;
}

// Factors from gradients by the centre to those in NDC: the plane is measured in radians, in no
// direction of the image.
fn ndc_of(p: Projection) -> vec2f {
    return vec2f(sqrt(p.pixel_angle.x) * 0.5 * sqrt(f32(camera.size_px.x) * f32(camera.size_px.y)));
}

// Sums of absolute gradients by the centre, as on the image plane.
fn absolute_by_center(root: vec3f, sums: vec2f) -> vec2f {
    let unit = 1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E);
    return vec2f(root.x * sums.x / SQRT_HALF_LOG2_E, sums.y * unit);
}

// Gradient by the focal lengths, which the host does not ask for where pixels are rays.
fn focal_backward(p: Projection, d_mean: vec2f, by_root: vec2f) -> vec2f {
    return vec2f(0.0);
}
