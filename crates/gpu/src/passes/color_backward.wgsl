// Pass `color_backward`: computes the gradient by the colour model's coefficients and by the
// viewing direction. Twins: core/color/light.rs and core/sh.rs (the formulas),
// cpu/passes/color_backward.rs. It runs within `project_backward`.

// Gradient by direction of a sum over the basis: sum over m of w[m] grad Y_m(v), of the polynomials
// of `sh_basis`.
fn sh_basis_gradient(degree: u32, v: vec3f, w: ptr<function, array<f32, 36>>) -> vec3f {
    if (degree < 1u) {
        return vec3f(0.0);
    }
    let x = v.x;
    let y = v.y;
    let z = v.z;
    var g = vec3f(-SH_C1 * (*w)[3], -SH_C1 * (*w)[1], SH_C1 * (*w)[2]);
    if (degree < 2u) {
        return g;
    }
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let xy = x * y;
    let yz = y * z;
    let xz = x * z;
    let c2 = xx - yy;
    g += SH_C2[0] * (*w)[4] * vec3f(y, x, 0.0);
    g += SH_C2[1] * (*w)[5] * vec3f(0.0, z, y);
    g += SH_C2[2] * (*w)[6] * vec3f(-2.0 * x, -2.0 * y, 4.0 * z);
    g += SH_C2[3] * (*w)[7] * vec3f(z, 0.0, x);
    g += SH_C2[4] * (*w)[8] * vec3f(2.0 * x, -2.0 * y, 0.0);
    if (degree < 3u) {
        return g;
    }
    let three_xx_yy = 3.0 * xx - yy;
    let xx_three_yy = xx - 3.0 * yy;
    let three_c2 = 3.0 * c2;
    let six_xy = 6.0 * xy;
    g += SH_C3[0] * (*w)[9] * vec3f(six_xy, three_c2, 0.0);
    g += SH_C3[1] * (*w)[10] * vec3f(yz, xz, xy);
    g += SH_C3[2] * (*w)[11] * vec3f(-2.0 * xy, 4.0 * zz - xx - 3.0 * yy, 8.0 * yz);
    g += SH_C3[3] * (*w)[12] * vec3f(-6.0 * xz, -6.0 * yz, 6.0 * zz - 3.0 * (xx + yy));
    g += SH_C3[4] * (*w)[13] * vec3f(4.0 * zz - 3.0 * xx - yy, -2.0 * xy, 8.0 * xz);
    g += SH_C3[5] * (*w)[14] * vec3f(2.0 * xz, -2.0 * yz, c2);
    g += SH_C3[6] * (*w)[15] * vec3f(three_c2, -six_xy, 0.0);
    if (degree < 4u) {
        return g;
    }
    let seven_zz_1 = 7.0 * zz - 1.0;
    let seven_zz_3 = 7.0 * zz - 3.0;
    let twenty_one_zz_3 = 21.0 * zz - 3.0;
    let fourteen_z = 14.0 * z;
    g += SH_C4[0] * (*w)[16] * vec3f(y * three_xx_yy, x * xx_three_yy, 0.0);
    g += SH_C4[1] * (*w)[17] * vec3f(six_xy * z, three_c2 * z, y * three_xx_yy);
    g += SH_C4[2] * (*w)[18] * vec3f(y * seven_zz_1, x * seven_zz_1, fourteen_z * xy);
    g += SH_C4[3] * (*w)[19] * vec3f(0.0, z * seven_zz_3, y * twenty_one_zz_3);
    g += SH_C4[4] * (*w)[20] * vec3f(0.0, 0.0, z * (140.0 * zz - 60.0));
    g += SH_C4[5] * (*w)[21] * vec3f(z * seven_zz_3, 0.0, x * twenty_one_zz_3);
    g += SH_C4[6] * (*w)[22] * vec3f(2.0 * x * seven_zz_1, -2.0 * y * seven_zz_1, fourteen_z * c2);
    g += SH_C4[7] * (*w)[23] * vec3f(three_c2 * z, -six_xy * z, x * xx_three_yy);
    g += SH_C4[8] * (*w)[24] * vec3f(4.0 * x * xx_three_yy, -4.0 * y * three_xx_yy, 0.0);
    if (degree < 5u) {
        return g;
    }
    let nine_zz_1 = 9.0 * zz - 1.0;
    let three_zz_1 = 3.0 * zz - 1.0;
    let five_4 = zz * (21.0 * zz - 14.0) + 1.0;
    let d_five_4 = z * (84.0 * zz - 28.0);
    let c4 = xx * xx_three_yy - yy * three_xx_yy;
    let s4 = 4.0 * xy * c2;
    let eighteen_z = 18.0 * z;
    g += 5.0 * SH_C5[0] * (*w)[25] * vec3f(s4, c4, 0.0);
    g += SH_C5[1] * (*w)[26] * vec3f(yz * three_xx_yy, xz * xx_three_yy, xy * c2);
    g += SH_C5[2] * (*w)[27] * vec3f(six_xy * nine_zz_1, three_c2 * nine_zz_1, eighteen_z * y * three_xx_yy);
    g += SH_C5[3] * (*w)[28] * vec3f(y * z * three_zz_1, x * z * three_zz_1, xy * nine_zz_1);
    g += SH_C5[4] * (*w)[29] * vec3f(0.0, five_4, y * d_five_4);
    g += SH_C5[5] * (*w)[30] * vec3f(0.0, 0.0, zz * (315.0 * zz - 210.0) + 15.0);
    g += SH_C5[6] * (*w)[31] * vec3f(five_4, 0.0, x * d_five_4);
    g += SH_C5[7] * (*w)[32] * vec3f(2.0 * x * z * three_zz_1, -2.0 * y * z * three_zz_1, c2 * nine_zz_1);
    g += SH_C5[8] * (*w)[33] * vec3f(three_c2 * nine_zz_1, -six_xy * nine_zz_1, eighteen_z * x * xx_three_yy);
    g += SH_C5[9] * (*w)[34] * vec3f(4.0 * x * xx_three_yy * z, -4.0 * y * three_xx_yy * z, c4);
    g += 5.0 * SH_C5[10] * (*w)[35] * vec3f(c4, -s4, 0.0);
    return g;
}

// Differentiates and updates the colour's coefficients; returns the gradient by the position: (I -
// v v^T) dE/dv / |position - eye|. A splat that is not visible has no gradient, but its moments
// decay.
fn color_backward(i: u32, is_visible: bool, d_radiance: vec3f) -> vec3f {
    let degree = min(camera.active_degree, MAX_LIGHT_DEGREE);
    var direction = vec4f(0.0);
    var basis: array<f32, 36>;
    var d_basis: array<f32, 36>;
    var d_response = vec3f(0.0);
    var d_raw = 0.0;
    if (is_visible) {
        direction = view_direction(i);
        basis = sh_basis(degree, direction.xyz);
        let r = response(&basis, i);
        if (IS_LCD) {
            let luminance = activate(r.w);
            let alive = max(r.xyz, vec3f(0.0)) + DEAD_CHROMA_FLOOR;
            let sum = alive.x + alive.y + alive.z;
            let along = dot(d_radiance, alive / sum);
            d_raw = along * activation_derivative(r.w);
            d_response = select(vec3f(0.0), (luminance / sum) * (d_radiance - along), r.xyz > vec3f(0.0));
        } else if (IS_LOG) {
            let logs = r.xyz + SH_OFFSET;
            d_response = select(vec3f(0.0), d_radiance * exp(min(logs, vec3f(MAX_EXP_ARGUMENT))), logs < vec3f(MAX_EXP_ARGUMENT));
        } else {
            d_response = select(vec3f(0.0), d_radiance, r.xyz + SH_OFFSET > vec3f(0.0));
        }
    }
    if (IS_LCD) {
        update_parameter(ROW_LUMINANCE, i, d_raw, optimizer.luminance_dc);
        let used = select(0u, coefficients(min(degree, LUMINANCE_DEGREE)), is_visible);
        for (var m = 1u; m < LUMINANCE_COEFFICIENTS; m++) {
            var gradient = 0.0;
            if (m < used) {
                gradient = d_raw * basis[m];
                d_basis[m] = d_raw * parameter(ROW_LUMINANCE + m, i);
            }
            update_parameter(ROW_LUMINANCE + m, i, gradient, optimizer.luminance_rest);
        }
    }
    let used = select(0u, coefficients(min(degree, SH_DEGREE)), is_visible);
    for (var m = 0u; m < SH_COEFFICIENTS; m++) {
        let row = ROW_SH + 3u * m;
        var gradient = vec3f(0.0);
        if (m < used) {
            gradient = d_response * basis[m];
            d_basis[m] += dot(d_response, parameter3(row, i));
        }
        let rate = select(optimizer.sh_rest, optimizer.sh_dc, m == 0u);
        update_parameter(row, i, gradient.x, rate);
        update_parameter(row + 1u, i, gradient.y, rate);
        update_parameter(row + 2u, i, gradient.z, rate);
    }
    if (!is_visible) {
        return vec3f(0.0);
    }
    let g = sh_basis_gradient(degree, direction.xyz, &d_basis);
    return (g - dot(g, direction.xyz) * direction.xyz) * direction.w;
}
