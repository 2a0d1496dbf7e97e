// The geometry of a splat up to the screen, with the intermediate values that the backward pass
// needs: the part that is the same for every projection. Twin: cpu/passes/project.rs. It uses
// `camera`, `shard` and `parameters`, with rows in the order of layout.rs, and `linearise` of
// linearise.wgsl or linearise_rays.wgsl.

struct Projection {
    // The projection linearised at the splat.
    at: Linearised,
    // w x y z, unit, and the reciprocal of the raw one's length.
    quaternion: vec4f,
    inverse_length: f32,
    // Rows of the splat's rotation matrix.
    axes_0: vec3f,
    axes_1: vec3f,
    axes_2: vec3f,
    // Standard deviations of the parameters, and with the 3D filter.
    raw_sigma: vec3f,
    sigma: vec3f,
    // Jacobian times axes, and scaled by sigma.
    screen_x: vec3f,
    screen_y: vec3f,
    root_x: vec3f,
    root_y: vec3f,
    // Dilated covariance xx, xy, yy and its determinant; determinant before dilation.
    covariance: vec3f,
    determinant: f32,
    determinant_before: f32,
    opacity: f32,
    compensation: f32,
    filter_factor: f32,
}

fn project_splat(i: u32) -> Projection {
    var p: Projection;
    p.at = linearise(parameter3(ROW_POSITION, i));

    let raw = vec4f(
        parameter(ROW_ROTATION, i),
        parameter(ROW_ROTATION + 1u, i),
        parameter(ROW_ROTATION + 2u, i),
        parameter(ROW_ROTATION + 3u, i),
    );
    p.inverse_length = 1.0 / sqrt(max(dot(raw, raw), 1e-30));
    p.quaternion = raw * p.inverse_length;
    let axes = rotation_rows(p.quaternion);
    p.axes_0 = axes[0];
    p.axes_1 = axes[1];
    p.axes_2 = axes[2];

    p.raw_sigma = exp(parameter3(ROW_LOG_SCALE, i));
    p.sigma = p.raw_sigma;
    p.filter_factor = 1.0;
    if ((camera.flags & FLAG_SMOOTHING) != 0u) {
        let f = parameter(ROW_SMOOTHING, i);
        p.sigma = sqrt(p.raw_sigma * p.raw_sigma + f * f);
        let ratio = p.raw_sigma / p.sigma;
        p.filter_factor = ratio.x * ratio.y * ratio.z;
    }

    p.screen_x = p.at.jacobian_x.x * axes[0] + p.at.jacobian_x.y * axes[1] + p.at.jacobian_x.z * axes[2];
    p.screen_y = p.at.jacobian_y.x * axes[0] + p.at.jacobian_y.y * axes[1] + p.at.jacobian_y.z * axes[2];
    p.root_x = p.screen_x * p.sigma;
    p.root_y = p.screen_y * p.sigma;

    let dilation = p.at.dilation;
    let before = vec3f(dot(p.root_x, p.root_x), dot(p.root_x, p.root_y), dot(p.root_y, p.root_y));
    // |a|^2 |b|^2 - (a.b)^2 = |a x b|^2 (Lagrange): no cancellation for thin ellipses.
    let area = cross(p.root_x, p.root_y);
    p.determinant_before = dot(area, area);
    p.determinant = (before.x + before.z) * dilation + (p.determinant_before + dilation * dilation);
    p.covariance = vec3f(before.x + dilation, before.y, before.z + dilation);
    p.compensation = 1.0;
    if ((camera.flags & FLAG_COMPENSATION) != 0u) {
        p.compensation = sqrt(max(p.determinant_before / p.determinant, MIN_AREA_RATIO));
    }
    p.opacity = 1.0 / (1.0 + exp(-parameter(ROW_OPACITY, i)));
    return p;
}

// Triangular root M of the inverse covariance: M = [[m.x, m.y], [0, m.z]], M^T M = covariance^-1.
fn inverse_root(p: Projection) -> vec3f {
    let xy = p.covariance.y;
    let yy = p.covariance.z;
    let m = sqrt(yy / p.determinant);
    return vec3f(m, -(m * xy / yy), 1.0 / sqrt(yy));
}

// Unit vector from the camera to the splat, and the reciprocal of the distance.
fn view_direction(i: u32) -> vec4f {
    let offset = parameter3(ROW_POSITION, i) - camera.eye.xyz;
    let inverse_distance = 1.0 / sqrt(max(dot(offset, offset), 1e-30));
    return vec4f(offset * inverse_distance, inverse_distance);
}
