// Noise on positions after the update (Kheradmand et al. 2024, eq. 9), from the same hash of seed
// and splat as core/noise.rs, in 32-bit halves (x low, y high).

fn add64(a: vec2u, b: vec2u) -> vec2u {
    let low = a.x + b.x;
    return vec2u(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn shift_right64(a: vec2u, bits: u32) -> vec2u {
    return vec2u((a.x >> bits) | (a.y << (32u - bits)), a.y >> bits);
}

fn multiply64(a: vec2u, b: vec2u) -> vec2u {
    // 32 x 32 to 64 bits by halves of 16.
    let a0 = a.x & 0xffffu;
    let a1 = a.x >> 16u;
    let b0 = b.x & 0xffffu;
    let b1 = b.x >> 16u;
    let middle = a1 * b0 + ((a0 * b0) >> 16u);
    let middle_2 = a0 * b1 + (middle & 0xffffu);
    let high = a1 * b1 + (middle >> 16u) + (middle_2 >> 16u);
    return vec2u(a.x * b.x, high + a.x * b.y + a.y * b.x);
}

// Finaliser of SplitMix64 (Steele et al. 2014).
fn mix64(value: vec2u) -> vec2u {
    var z = add64(value, vec2u(0x7f4a7c15u, 0x9e3779b9u));
    z = multiply64(z ^ shift_right64(z, 30u), vec2u(0x1ce4e5b9u, 0xbf58476du));
    z = multiply64(z ^ shift_right64(z, 27u), vec2u(0x133111ebu, 0x94d049bbu));
    return z ^ shift_right64(z, 31u);
}

// Uniform in (0, 1] of 24 bits.
fn unit_of(bits: u32) -> f32 {
    return (f32(bits & 0xffffffu) + 1.0) / 16777216.0;
}

fn standard_normal(seed: vec2u, index: u32) -> vec3f {
    let h = mix64(seed ^ mix64(vec2u(index, 0u)));
    let g = mix64(h);
    // WGSL allows an error of 2^-21 in the logarithm of a number near 1, so the result may be above
    // 0.
    let radius = sqrt(max(-2.0 * log(vec2f(unit_of(h.x), unit_of(g.x))), vec2f(0.0)));
    let angle = TAU * vec2f(unit_of(shift_right64(h, 24u).x), unit_of(shift_right64(g, 24u).x));
    return vec3f(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y));
}

// Sigma n sigmoid(100 (0.005 - opacity)) scale, of the parameters after the update.
fn position_noise(i: u32, splat: u32) -> vec3f {
    let n = standard_normal(vec2u(optimizer.seed_low, optimizer.seed_high), splat);
    let raw = vec4f(
        parameter(ROW_ROTATION, i),
        parameter(ROW_ROTATION + 1u, i),
        parameter(ROW_ROTATION + 2u, i),
        parameter(ROW_ROTATION + 3u, i),
    );
    let axes = rotation_rows(raw / sqrt(max(dot(raw, raw), 1e-30)));
    let variance = exp(2.0 * parameter3(ROW_LOG_SCALE, i));
    let opacity = 1.0 / (1.0 + exp(-parameter(ROW_OPACITY, i)));
    let gate = optimizer.noise_scale / (1.0 + exp((opacity - 0.005) * 100.0));
    // R diag(variance) R^T n.
    let local = (axes[0] * n.x + axes[1] * n.y + axes[2] * n.z) * variance;
    return vec3f(dot(axes[0], local), dot(axes[1], local), dot(axes[2], local)) * gate;
}
