// Vignetting of the image: the gain of its pixels, for pass `loss`, and the gradient by the
// coefficients of ln gain. Twin: cpu/passes/vignetting.
//
// With p a pixel's radiance and g the gradient by it, the gradient by ln gain is g p, summed over
// channels; coefficient k has the factor r^(2k). Out: sums of a workgroup, which the host adds up.

fn radius_squared(at: vec2u) -> f32 {
    let from_axis = (vec2f(at) + 0.5 - config.axis_px) * config.inverse_unit;
    return min(dot(from_axis, from_axis), 1.0);
}

fn gain_at(at: vec2u) -> f32 {
    let r = radius_squared(at);
    let c = config.log_gain;
    return exp(c.x + r * (c.y + r * (c.z + r * c.w)));
}

@compute @workgroup_size(256)
fn vignetting_sums(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = workgroup.xy * SIDE + vec2u(local % SIDE, local / SIDE);
    let size = size_px();
    var sums = vec4f(0.0);
    if (all(at < size)) {
        // All samples of a pixel have the same gradient.
        let sample = at.y * camera.samples * camera.size_px.x + at.x * camera.samples;
        let gradient = pixel_gradients[sample].xyz * f32(camera.samples * camera.samples);
        // A pixel without a gradient adds nothing, even if it is NaN.
        let by_channel = select(vec3f(0.0), gradient * radiance_at(at), gradient != vec3f(0.0));
        let by_log_gain = by_channel.x + by_channel.y + by_channel.z;
        let r = radius_squared(at);
        sums = by_log_gain * vec4f(1.0, r, r * r, r * r * r);
    }
    add_over_workgroup(local, sums);
    if (local == 0u) {
        group_sums[workgroup.y * tile_counts(size).x + workgroup.x] = rows[0];
    }
}
