// The way back through the projection of a pinhole: see `project_backward`.

// Gradients by the point in camera space and by the focal lengths, through the centre and the
// Jacobian. The dilation is constant.
fn point_backward(p: Projection, d_jacobian_x: vec3f, d_jacobian_y: vec3f, d_mean: vec2f, d_dilation: f32) -> PointGradient {
    let inverse_z = 1.0 / p.at.point.z;
    let scale = inverse_z * camera.focal_px;
    // jacobian = scale (row - slope row_z); mean = scale point + centre.
    let by_direct = vec2f(dot(d_jacobian_x, camera.row_x.xyz), dot(d_jacobian_y, camera.row_y.xyz));
    let by_depth = vec2f(dot(d_jacobian_x, camera.row_z.xyz), dot(d_jacobian_y, camera.row_z.xyz));
    let true_slope = p.at.point.xy * inverse_z;
    // Where the slope is clamped it is constant.
    let clamped = true_slope != p.at.slope;
    let d_slope = select(-(scale * by_depth), vec2f(0.0), clamped);
    let d_xy = d_mean * scale + d_slope * inverse_z;
    let by_scale = by_direct - p.at.slope * by_depth + d_mean * p.at.point.xy;
    let d_z = -inverse_z * (by_scale * scale + d_slope * true_slope);
    // The limits of the slope are a length on the image over the focal length: scale times a
    // clamped slope does not depend on it.
    let d_focal = inverse_z * (by_scale + select(vec2f(0.0), p.at.slope * by_depth, clamped));
    return PointGradient(vec3f(d_xy, d_z.x + d_z.y), d_focal);
}

// Factors from gradients by the centre to those in NDC, which spans 2 over the image's side.
fn ndc_of(p: Projection) -> vec2f {
    return 0.5 * vec2f(camera.size_px);
}
