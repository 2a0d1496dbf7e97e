// Pass `color`: computes the radiance of a splat towards the camera, of one light. Twins:
// core/color/light.rs and core/sh.rs (the formulas), cpu/passes/color.rs. It runs within `project`
// for visible splats, and again within `project_backward`.

// Values of the harmonics up to `degree` at the unit vector v.
fn sh_basis(degree: u32, v: vec3f) -> array<f32, 36> {
    var out: array<f32, 36>;
    let x = v.x;
    let y = v.y;
    let z = v.z;
    out[0] = SH_C0;
    if (degree < 1u) {
        return out;
    }
    out[1] = -SH_C1 * y;
    out[2] = SH_C1 * z;
    out[3] = -SH_C1 * x;
    if (degree < 2u) {
        return out;
    }
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let xy = x * y;
    let yz = y * z;
    let xz = x * z;
    let c2 = xx - yy;
    out[4] = SH_C2[0] * xy;
    out[5] = SH_C2[1] * yz;
    out[6] = SH_C2[2] * (zz + zz - xx - yy);
    out[7] = SH_C2[3] * xz;
    out[8] = SH_C2[4] * c2;
    if (degree < 3u) {
        return out;
    }
    let three_xx_yy = 3.0 * xx - yy;
    let xx_three_yy = xx - 3.0 * yy;
    let four_zz = 4.0 * zz - xx - yy;
    out[9] = SH_C3[0] * y * three_xx_yy;
    out[10] = SH_C3[1] * xy * z;
    out[11] = SH_C3[2] * y * four_zz;
    out[12] = SH_C3[3] * z * (zz + zz - 3.0 * (xx + yy));
    out[13] = SH_C3[4] * x * four_zz;
    out[14] = SH_C3[5] * z * c2;
    out[15] = SH_C3[6] * x * xx_three_yy;
    if (degree < 4u) {
        return out;
    }
    let seven_zz_1 = 7.0 * zz - 1.0;
    let seven_zz_3 = 7.0 * zz - 3.0;
    let c4 = xx * xx_three_yy - yy * three_xx_yy;
    out[16] = SH_C4[0] * xy * c2;
    out[17] = SH_C4[1] * yz * three_xx_yy;
    out[18] = SH_C4[2] * xy * seven_zz_1;
    out[19] = SH_C4[3] * yz * seven_zz_3;
    out[20] = SH_C4[4] * (zz * (35.0 * zz - 30.0) + 3.0);
    out[21] = SH_C4[5] * xz * seven_zz_3;
    out[22] = SH_C4[6] * c2 * seven_zz_1;
    out[23] = SH_C4[7] * xz * xx_three_yy;
    out[24] = SH_C4[8] * c4;
    if (degree < 5u) {
        return out;
    }
    let nine_zz_1 = 9.0 * zz - 1.0;
    let three_zz_1 = 3.0 * zz - 1.0;
    let five_4 = zz * (21.0 * zz - 14.0) + 1.0;
    let s5 = 5.0 * xx * xx - 10.0 * xx * yy + yy * yy;
    let c5 = xx * xx - 10.0 * xx * yy + 5.0 * yy * yy;
    out[25] = SH_C5[0] * y * s5;
    out[26] = SH_C5[1] * xy * z * c2;
    out[27] = SH_C5[2] * y * three_xx_yy * nine_zz_1;
    out[28] = SH_C5[3] * xy * z * three_zz_1;
    out[29] = SH_C5[4] * y * five_4;
    out[30] = SH_C5[5] * z * (zz * (63.0 * zz - 70.0) + 15.0);
    out[31] = SH_C5[6] * x * five_4;
    out[32] = SH_C5[7] * z * c2 * three_zz_1;
    out[33] = SH_C5[8] * x * xx_three_yy * nine_zz_1;
    out[34] = SH_C5[9] * z * c4;
    out[35] = SH_C5[10] * x * c5;
    return out;
}

// Coefficients of one channel up to `degree`.
fn coefficients(degree: u32) -> u32 {
    return (degree + 1u) * (degree + 1u);
}

fn activate(raw: f32) -> f32 {
    if (ACTIVATION == ACTIVATION_SOFTPLUS) {
        let e = exp(-abs(raw));
        // ln(1 + e) loses the small digits of e by rounding 1 + e; its series keeps them.
        return max(raw, 0.0) + select(log(1.0 + e), e * (1.0 - e * (0.5 - e * (1.0 / 3.0 - e * 0.25))), e < 0.02);
    }
    if (ACTIVATION == ACTIVATION_EXP) {
        return exp(min(raw, MAX_EXP_ARGUMENT));
    }
    return max(raw, 0.0);
}

fn activation_derivative(raw: f32) -> f32 {
    if (ACTIVATION == ACTIVATION_SOFTPLUS) {
        let e = exp(-abs(raw));
        return select(e, 1.0, raw > 0.0) / (1.0 + e);
    }
    if (ACTIVATION == ACTIVATION_EXP) {
        return select(0.0, exp(min(raw, MAX_EXP_ARGUMENT)), raw < MAX_EXP_ARGUMENT);
    }
    return select(0.0, 1.0, raw > 0.0);
}

// Sums over the basis: of the colour's harmonics, and of the luminance's (w).
fn response(basis: ptr<function, array<f32, 36>>, i: u32) -> vec4f {
    var sum = vec3f(0.0);
    let used = coefficients(min(camera.active_degree, SH_DEGREE));
    for (var m = 0u; m < used; m++) {
        sum += parameter3(ROW_SH + 3u * m, i) * (*basis)[m];
    }
    var raw = 0.0;
    if (IS_LCD) {
        // The constant term is stored without its basis value.
        raw = parameter(ROW_LUMINANCE, i);
        let used_luminance = coefficients(min(camera.active_degree, LUMINANCE_DEGREE));
        for (var m = 1u; m < used_luminance; m++) {
            raw += parameter(ROW_LUMINANCE + m, i) * (*basis)[m];
        }
    }
    return vec4f(sum, raw);
}

// The splat's gain of the light, in a mix.
fn gain_of(i: u32) -> f32 {
    if (HAS_GAIN) {
        return parameter(ROW_GAIN, i);
    }
    return 1.0;
}

fn radiance_of(response: vec4f) -> vec3f {
    if (IS_LCD) {
        let r = max(response.xyz, vec3f(0.0)) + DEAD_CHROMA_FLOOR;
        return activate(response.w) * (r / (r.x + r.y + r.z));
    }
    if (IS_LOG) {
        return exp(min(response.xyz + SH_OFFSET, vec3f(MAX_EXP_ARGUMENT)));
    }
    return max(response.xyz + SH_OFFSET, vec3f(0.0));
}
