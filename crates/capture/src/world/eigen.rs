//! Eigenvectors of small symmetric matrices, by cyclic Jacobi rotations.
//!
//! In: a symmetric matrix, f64. Out: eigenvalues in descending order with unit eigenvectors, to
//! rounding. Degenerate: equal eigenvalues have any orthonormal vectors of their space.

use glam::{DMat3, DVec3};

/// Sweeps after which small matrices have converged to rounding.
const SWEEPS: usize = 32;

/// An eigenvalue with its unit eigenvector.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eigen<const N: usize> {
    pub(super) value: f64,
    pub(super) vector: [f64; N],
}

/// Returns the eigenvalues and eigenvectors of a symmetric matrix, largest first.
pub(super) fn eigen<const N: usize>(mut a: [[f64; N]; N]) -> [Eigen<N>; N] {
    let mut v = [[0.0; N]; N];
    (0..N).for_each(|i| v[i][i] = 1.0);
    for _ in 0..SWEEPS {
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for row in &mut a {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
                let (above, below) = a.split_at_mut(q);
                for (x, y) in above[p].iter_mut().zip(&mut below[0]) {
                    (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
                }
                for row in &mut v {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
            }
        }
    }
    let mut out: [Eigen<N>; N] = std::array::from_fn(|i| Eigen { value: a[i][i], vector: std::array::from_fn(|k| v[k][i]) });
    out.sort_by(|a, b| b.value.total_cmp(&a.value));
    out
}

/// Returns the eigenvalues and eigenvectors of a symmetric 3x3 matrix, largest first.
pub(super) fn eigen3(m: &DMat3) -> [(f64, DVec3); 3] {
    eigen(m.to_cols_array_2d()).map(|e| (e.value, DVec3::from_array(e.vector)))
}

/// Returns the matrix v v^T.
pub(super) fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Returns the middle value, the upper of two; 0 of none.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Returns the point whose coordinates are the middle values; the origin of none.
pub(super) fn median_point(points: &[DVec3]) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| median(points.iter().map(|p| p[axis]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_is_put_together_again_from_its_eigenvectors() {
        let m = [[4.0, 1.0, -2.0, 0.5], [1.0, 3.0, 0.0, 1.5], [-2.0, 0.0, -1.0, 0.25], [0.5, 1.5, 0.25, 2.0]];
        let parts = eigen(m);
        for (i, row) in m.iter().enumerate() {
            for (j, expected) in row.iter().enumerate() {
                let sum: f64 = parts.iter().map(|e| e.value * e.vector[i] * e.vector[j]).sum();
                let orthonormal: f64 = parts.iter().map(|e| e.vector[i] * e.vector[j]).sum();
                assert!((sum - expected).abs() < 1e-12 && (orthonormal - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        assert!(parts.windows(2).all(|pair| pair[0].value >= pair[1].value));
    }

    #[test]
    fn the_middle_of_nothing_is_zero() {
        assert_eq!((median([]), median([3.0, 1.0, 2.0])), (0.0, 2.0));
    }
}
