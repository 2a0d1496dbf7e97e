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
        var gradient = pixel_gradients[sample_of(at, 0u)].xyz * f32(camera.samples * camera.samples);
        var by_log_gain = 0.0;
        for (var channel = 0u; channel < 3u; channel++) {
            // A pixel without a gradient adds nothing, even if it is NaN.
            if (gradient[channel] != 0.0) {
                by_log_gain += gradient[channel] * radiance_at(at, channel);
            }
        }
        let r = radius_squared(at);
        sums = by_log_gain * vec4f(1.0, r, r * r, r * r * r);
    }
    add_over_workgroup(local, sums);
    if (local == 0u) {
        group_sums[workgroup.y * ((size.x + SIDE - 1u) / SIDE) + workgroup.x] = totals[0];
    }
}
