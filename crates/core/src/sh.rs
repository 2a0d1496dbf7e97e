//! Real spherical harmonics to degree 5, with the sign convention of 3D Gaussian splatting.
//!
//! In: a unit direction. Out: [`basis`] writes Y_m(direction) in the order (0,0), (1,-1), (1,0),
//! (1,1), (2,-2), ...; [`basis_gradient`] returns derivatives by x, y and z. These are derivatives
//! of the polynomials below as functions of an unconstrained direction: project the result onto the
//! tangent plane of the sphere (`I - v v^T`) to get the derivative by a unit vector.
//!
//! Source: Ramamoorthi and Hanrahan 2001 (degrees 0 to 2), Sloan 2008 "Stupid spherical harmonics
//! tricks" (appendix A2); the signs (-1)^m are those of Kerbl et al. 2023.

use crate::Real;

/// Highest supported degree.
pub const MAX_DEGREE: usize = 5;
/// Number of coefficients of one channel at the highest degree.
pub const MAX_COEFFICIENTS: usize = coefficients(MAX_DEGREE);
/// Y of degree 0: 1 / (2 sqrt(pi)).
pub const C0: f32 = 0.282_094_8;

/// Returns the number of coefficients of one channel at `degree`.
pub const fn coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// Returns `count` points spread evenly on the unit sphere: a Fibonacci lattice.
pub fn lattice(count: usize) -> Vec<[f32; 3]> {
    let point = |i: usize| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let phi = i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let r = (1.0 - z * z).sqrt();
        [r * phi.cos(), r * phi.sin(), z].map(|c| c as f32)
    };
    (0..count).map(point).collect()
}

// The factors K of the polynomials below: K = sqrt((2l+1)/(4 pi) (l-m)!/(l+m)!) times the leading
// Legendre factor.

/// Factor of degree 1.
pub const C1: f32 = 0.488_602_5;
/// Factors of degree 2.
pub const C2: [f32; 5] = [1.092_548_4, -1.092_548_4, 0.315_391_57, -1.092_548_4, 0.546_274_2];
/// Factors of degree 3.
pub const C3: [f32; 7] = [-0.590_043_6, 2.890_611_4, -0.457_045_8, 0.373_176_34, -0.457_045_8, 1.445_305_7, -0.590_043_6];
/// Factors of degree 4.
pub const C4: [f32; 9] =
    [2.503_343, -1.770_130_8, 0.946_174_7, -0.669_046_5, 0.105_785_55, -0.669_046_5, 0.473_087_34, -1.770_130_8, 0.625_835_7];
/// Factors of degree 5.
pub const C5: [f32; 11] = [
    -0.656_382_1,
    8.302_649,
    -0.489_238_3,
    4.793_536_7,
    -0.452_946_65,
    0.116_950_32,
    -0.452_946_65,
    2.396_768_4,
    -0.489_238_3,
    2.075_662_3,
    -0.656_382_1,
];

/// Evaluates the basis up to `degree` (at most 5) at the unit vector `[x, y, z]`; higher entries
/// stay untouched.
#[inline(always)]
pub fn basis<R: Real>(degree: usize, [x, y, z]: [R; 3], out: &mut [R; MAX_COEFFICIENTS]) {
    let k = |value: f32| x.lift(value);
    out[0] = k(C0);
    if degree < 1 {
        return;
    }
    out[1] = k(-C1) * y;
    out[2] = k(C1) * z;
    out[3] = k(-C1) * x;
    if degree < 2 {
        return;
    }
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    // cos(2 phi) and sin(2 phi) / 2, times sin^2(theta).
    let c2 = xx - yy;
    out[4] = k(C2[0]) * xy;
    out[5] = k(C2[1]) * yz;
    out[6] = k(C2[2]) * (zz + zz - xx - yy);
    out[7] = k(C2[3]) * xz;
    out[8] = k(C2[4]) * c2;
    if degree < 3 {
        return;
    }
    let three_xx_yy = k(3.0) * xx - yy;
    let xx_three_yy = xx - k(3.0) * yy;
    let four_zz = k(4.0) * zz - xx - yy;
    out[9] = k(C3[0]) * y * three_xx_yy;
    out[10] = k(C3[1]) * xy * z;
    out[11] = k(C3[2]) * y * four_zz;
    out[12] = k(C3[3]) * z * (zz + zz - k(3.0) * (xx + yy));
    out[13] = k(C3[4]) * x * four_zz;
    out[14] = k(C3[5]) * z * c2;
    out[15] = k(C3[6]) * x * xx_three_yy;
    if degree < 4 {
        return;
    }
    let seven_zz_1 = k(7.0) * zz - k(1.0);
    let seven_zz_3 = k(7.0) * zz - k(3.0);
    let c4 = xx * xx_three_yy - yy * three_xx_yy;
    out[16] = k(C4[0]) * xy * c2;
    out[17] = k(C4[1]) * yz * three_xx_yy;
    out[18] = k(C4[2]) * xy * seven_zz_1;
    out[19] = k(C4[3]) * yz * seven_zz_3;
    out[20] = k(C4[4]) * (zz * (k(35.0) * zz - k(30.0)) + k(3.0));
    out[21] = k(C4[5]) * xz * seven_zz_3;
    out[22] = k(C4[6]) * c2 * seven_zz_1;
    out[23] = k(C4[7]) * xz * xx_three_yy;
    out[24] = k(C4[8]) * c4;
    if degree < 5 {
        return;
    }
    let nine_zz_1 = k(9.0) * zz - k(1.0);
    let three_zz_1 = k(3.0) * zz - k(1.0);
    let five_4 = zz * (k(21.0) * zz - k(14.0)) + k(1.0);
    let s5 = k(5.0) * xx * xx - k(10.0) * xx * yy + yy * yy;
    let c5 = xx * xx - k(10.0) * xx * yy + k(5.0) * yy * yy;
    out[25] = k(C5[0]) * y * s5;
    out[26] = k(C5[1]) * xy * z * c2;
    out[27] = k(C5[2]) * y * three_xx_yy * nine_zz_1;
    out[28] = k(C5[3]) * xy * z * three_zz_1;
    out[29] = k(C5[4]) * y * five_4;
    out[30] = k(C5[5]) * z * (zz * (k(63.0) * zz - k(70.0)) + k(15.0));
    out[31] = k(C5[6]) * x * five_4;
    out[32] = k(C5[7]) * z * c2 * three_zz_1;
    out[33] = k(C5[8]) * x * xx_three_yy * nine_zz_1;
    out[34] = k(C5[9]) * z * c4;
    out[35] = k(C5[10]) * x * c5;
}

/// Adds a d to a sum.
///
/// A function and not a closure: a closure called so often is not inlined, and then not compiled
/// for the caller's instruction set.
#[inline(always)]
fn add<R: Real>(sum: &mut [R; 3], a: R, d: [R; 3]) {
    for (sum, d) in sum.iter_mut().zip(d) {
        *sum = a.mul_add(d, *sum);
    }
}

/// Returns the gradient by direction of a sum over the basis:
/// `sum_m weight[m] * grad Y_m([x, y, z])`, for the polynomials of [`basis`].
///
/// `weight` holds the gradients by the basis values; entries above `degree` are ignored.
#[inline(always)]
pub fn basis_gradient<R: Real>(degree: usize, [x, y, z]: [R; 3], weight: &[R; MAX_COEFFICIENTS]) -> [R; 3] {
    let k = |value: f32| x.lift(value);
    let zero = k(0.0);
    let w = weight;
    if degree < 1 {
        return [zero; 3];
    }
    let mut sum = [k(-C1) * w[3], k(-C1) * w[1], k(C1) * w[2]];
    if degree < 2 {
        return sum;
    }
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    let c2 = xx - yy;
    let two = k(2.0);
    add(&mut sum, k(C2[0]) * w[4], [y, x, zero]);
    add(&mut sum, k(C2[1]) * w[5], [zero, z, y]);
    add(&mut sum, k(C2[2]) * w[6], [-(x + x), -(y + y), k(4.0) * z]);
    add(&mut sum, k(C2[3]) * w[7], [z, zero, x]);
    add(&mut sum, k(C2[4]) * w[8], [x + x, -(y + y), zero]);
    if degree < 3 {
        return sum;
    }
    let three_xx_yy = k(3.0) * xx - yy;
    let xx_three_yy = xx - k(3.0) * yy;
    let three_c2 = k(3.0) * c2;
    let six_xy = k(6.0) * xy;
    add(&mut sum, k(C3[0]) * w[9], [six_xy, three_c2, zero]);
    add(&mut sum, k(C3[1]) * w[10], [yz, xz, xy]);
    add(&mut sum, k(C3[2]) * w[11], [-(two * xy), k(4.0) * zz - xx - k(3.0) * yy, k(8.0) * yz]);
    add(&mut sum, k(C3[3]) * w[12], [-(k(6.0) * xz), -(k(6.0) * yz), k(6.0) * zz - k(3.0) * (xx + yy)]);
    add(&mut sum, k(C3[4]) * w[13], [k(4.0) * zz - k(3.0) * xx - yy, -(two * xy), k(8.0) * xz]);
    add(&mut sum, k(C3[5]) * w[14], [two * xz, -(two * yz), c2]);
    add(&mut sum, k(C3[6]) * w[15], [three_c2, -six_xy, zero]);
    if degree < 4 {
        return sum;
    }
    let seven_zz_1 = k(7.0) * zz - k(1.0);
    let seven_zz_3 = k(7.0) * zz - k(3.0);
    let twenty_one_zz_3 = k(21.0) * zz - k(3.0);
    let fourteen_z = k(14.0) * z;
    add(&mut sum, k(C4[0]) * w[16], [y * three_xx_yy, x * xx_three_yy, zero]);
    add(&mut sum, k(C4[1]) * w[17], [six_xy * z, three_c2 * z, y * three_xx_yy]);
    add(&mut sum, k(C4[2]) * w[18], [y * seven_zz_1, x * seven_zz_1, fourteen_z * xy]);
    add(&mut sum, k(C4[3]) * w[19], [zero, z * seven_zz_3, y * twenty_one_zz_3]);
    add(&mut sum, k(C4[4]) * w[20], [zero, zero, z * (k(140.0) * zz - k(60.0))]);
    add(&mut sum, k(C4[5]) * w[21], [z * seven_zz_3, zero, x * twenty_one_zz_3]);
    add(&mut sum, k(C4[6]) * w[22], [two * x * seven_zz_1, -(two * y * seven_zz_1), fourteen_z * c2]);
    add(&mut sum, k(C4[7]) * w[23], [three_c2 * z, -(six_xy * z), x * xx_three_yy]);
    add(&mut sum, k(C4[8]) * w[24], [k(4.0) * x * xx_three_yy, -(k(4.0) * y * three_xx_yy), zero]);
    if degree < 5 {
        return sum;
    }
    let nine_zz_1 = k(9.0) * zz - k(1.0);
    let three_zz_1 = k(3.0) * zz - k(1.0);
    let five_4 = zz * (k(21.0) * zz - k(14.0)) + k(1.0);
    let d_five_4 = z * (k(84.0) * zz - k(28.0));
    let c4 = xx * xx_three_yy - yy * three_xx_yy;
    let s4 = k(4.0) * xy * c2;
    let eighteen_z = k(18.0) * z;
    add(&mut sum, k(5.0 * C5[0]) * w[25], [s4, c4, zero]);
    add(&mut sum, k(C5[1]) * w[26], [yz * three_xx_yy, xz * xx_three_yy, xy * c2]);
    add(&mut sum, k(C5[2]) * w[27], [six_xy * nine_zz_1, three_c2 * nine_zz_1, eighteen_z * y * three_xx_yy]);
    add(&mut sum, k(C5[3]) * w[28], [y * z * three_zz_1, x * z * three_zz_1, xy * nine_zz_1]);
    add(&mut sum, k(C5[4]) * w[29], [zero, five_4, y * d_five_4]);
    add(&mut sum, k(C5[5]) * w[30], [zero, zero, zz * (k(315.0) * zz - k(210.0)) + k(15.0)]);
    add(&mut sum, k(C5[6]) * w[31], [five_4, zero, x * d_five_4]);
    add(&mut sum, k(C5[7]) * w[32], [two * x * z * three_zz_1, -(two * y * z * three_zz_1), c2 * nine_zz_1]);
    add(&mut sum, k(C5[8]) * w[33], [three_c2 * nine_zz_1, -(six_xy * nine_zz_1), eighteen_z * x * xx_three_yy]);
    add(&mut sum, k(C5[9]) * w[34], [k(4.0) * x * xx_three_yy * z, -(k(4.0) * y * three_xx_yy * z), c4]);
    add(&mut sum, k(5.0 * C5[10]) * w[35], [c4, -s4, zero]);
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns points spread evenly on the unit sphere (Fibonacci lattice).
    fn directions(count: usize) -> impl Iterator<Item = [f64; 3]> {
        (0..count).map(move |i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let phi = i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
            let r = (1.0 - z * z).sqrt();
            [r * phi.cos(), r * phi.sin(), z]
        })
    }

    #[test]
    fn basis_is_orthonormal() {
        // A Fibonacci lattice of n points integrates polynomials of degree 10 to about 1/n.
        let count = 20_000;
        let mut gram = vec![[0f64; MAX_COEFFICIENTS]; MAX_COEFFICIENTS];
        for direction in directions(count) {
            let mut y = [0f64; MAX_COEFFICIENTS];
            basis(MAX_DEGREE, direction, &mut y);
            for i in 0..MAX_COEFFICIENTS {
                for j in 0..MAX_COEFFICIENTS {
                    gram[i][j] += y[i] * y[j] * 4.0 * std::f64::consts::PI / count as f64;
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                let expected = f64::from(u8::from(i == j));
                assert!((value - expected).abs() < 1e-4, "<Y{i}, Y{j}> = {value}");
            }
        }
    }

    #[test]
    fn gradient_is_tangentially_that_of_central_differences() {
        for v in directions(50) {
            for degree in 0..=MAX_DEGREE {
                for m in 0..coefficients(degree) {
                    let mut weight = [0f64; MAX_COEFFICIENTS];
                    weight[m] = 1.0;
                    let g = basis_gradient(degree, v, &weight);
                    let radial: f64 = (0..3).map(|i| g[i] * v[i]).sum();
                    for axis in 0..3 {
                        let h = 1e-5;
                        let value = |s: f64| {
                            let mut p = v;
                            p[axis] += s;
                            let n = p.iter().map(|c| c * c).sum::<f64>().sqrt();
                            let mut y = [0f64; MAX_COEFFICIENTS];
                            basis(degree, p.map(|c| c / n), &mut y);
                            y[m]
                        };
                        let numeric = (value(h) - value(-h)) / (2.0 * h);
                        let analytic = g[axis] - radial * v[axis];
                        assert!((numeric - analytic).abs() < 1e-7, "degree {degree} m {m} axis {axis}: {numeric} {analytic}");
                    }
                }
            }
        }
    }
}
