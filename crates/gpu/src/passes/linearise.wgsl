// The projection of a pinhole, linearised at a splat. Twin: cpu/passes/project.rs.

struct Linearised {
    // Position in camera space; z is 1 for splats that are culled by depth.
    point: vec3f,
    depth: f32,
    slope: vec2f,
    // J R_camera, [2,3].
    jacobian_x: vec3f,
    jacobian_y: vec3f,
    // Variance that the pixel adds.
    dilation: f32,
}

fn linearise(position: vec3f) -> Linearised {
    var at: Linearised;
    at.depth = dot(camera.row_z.xyz, position) + camera.row_z.w;
    let z = select(1.0, at.depth, at.depth > camera.near * 0.5);
    at.point = vec3f(dot(camera.row_x.xyz, position) + camera.row_x.w, dot(camera.row_y.xyz, position) + camera.row_y.w, z);
    let inverse_z = 1.0 / z;
    at.slope = clamp(at.point.xy * inverse_z, camera.slope_min, camera.slope_max);
    let scale = inverse_z * camera.focal_px;
    at.jacobian_x = scale.x * camera.row_x.xyz - (scale.x * at.slope.x) * camera.row_z.xyz;
    at.jacobian_y = scale.y * camera.row_y.xyz - (scale.y * at.slope.y) * camera.row_z.xyz;
    at.dilation = camera.dilation_px2;
    return at;
}
