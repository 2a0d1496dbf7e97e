// The projection to the plane across a splat's direction, where pixels are rays: the variant of
// linearise.wgsl. Twin: cpu/passes/project_rays.rs.

struct Linearised {
    // Direction in camera space, 1 where its z is not negative or else -1, and the distance.
    unit: vec3f,
    sign: f32,
    depth: f32,
    inverse_distance: f32,
    basis: PlaneBasis,
    // Squared side of a pixel in radians, and its derivative by the cosine to the axis.
    pixel_angle: vec2f,
    // J R_camera, [2,3].
    jacobian_x: vec3f,
    jacobian_y: vec3f,
    // Variance that the pixel adds.
    dilation: f32,
}

// Returns a direction of camera space in the world.
fn in_world(v: vec3f) -> vec3f {
    return v.x * camera.row_x.xyz + v.y * camera.row_y.xyz + v.z * camera.row_z.xyz;
}

fn linearise(position: vec3f) -> Linearised {
    var at: Linearised;
    let point = vec3f(
        dot(camera.row_x.xyz, position) + camera.row_x.w,
        dot(camera.row_y.xyz, position) + camera.row_y.w,
        dot(camera.row_z.xyz, position) + camera.row_z.w,
    );
    at.depth = sqrt(max(dot(point, point), 1e-30));
    at.inverse_distance = 1.0 / at.depth;
    at.unit = point * at.inverse_distance;
    at.sign = select(-1.0, 1.0, at.unit.z >= 0.0);
    at.basis = plane_basis(at.unit, at.sign);
    at.pixel_angle = pixel_angle(at.unit.z);
    at.jacobian_x = in_world(at.basis.x) * at.inverse_distance;
    at.jacobian_y = in_world(at.basis.y) * at.inverse_distance;
    at.dilation = at.pixel_angle.x * camera.dilation_px2;
    return at;
}
