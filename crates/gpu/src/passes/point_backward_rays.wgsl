// The way back through the projection where pixels are rays: see `project_backward`. Twin:
// cpu/passes/project_backward_rays.rs.

// Gradient by the point in camera space, through the plane, the centre on it and the pixel's size.
// There is none by the focal lengths.
fn point_backward(p: Projection, d_jacobian_x: vec3f, d_jacobian_y: vec3f, d_mean: vec2f, d_dilation: f32) -> PointGradient {
    let by_x = vec3f(dot(d_jacobian_x, camera.row_x.xyz), dot(d_jacobian_x, camera.row_y.xyz), dot(d_jacobian_x, camera.row_z.xyz));
    let by_y = vec3f(dot(d_jacobian_y, camera.row_x.xyz), dot(d_jacobian_y, camera.row_y.xyz), dot(d_jacobian_y, camera.row_z.xyz));
    let by_inverse_distance = dot(by_x, p.at.basis.x) + dot(by_y, p.at.basis.y);
    // A plane that follows the direction tilts and does not turn.
    let tilt = d_mean - p.at.inverse_distance * vec2f(dot(by_x, p.at.unit), dot(by_y, p.at.unit));
    let by_cosine = d_dilation * p.at.pixel_angle.y * camera.dilation_px2;
    let across = tilt.x * p.at.basis.x + tilt.y * p.at.basis.y + by_cosine * (vec3f(0.0, 0.0, 1.0) - p.at.unit.z * p.at.unit);
    let d_point = p.at.inverse_distance * (across - (p.at.inverse_distance * by_inverse_distance) * p.at.unit);
    return PointGradient(d_point, vec2f(0.0));
}

// Factors from gradients by the centre to those in NDC: the plane is measured in radians, in no
// direction of the image.
fn ndc_of(p: Projection) -> vec2f {
    return vec2f(sqrt(p.at.pixel_angle.x) * 0.5 * sqrt(f32(camera.size_px.x) * f32(camera.size_px.y)));
}
