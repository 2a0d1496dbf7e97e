//! Linear least squares by normal equations.
//!
//! In: rows `[A^T A | A^T B]`, f64. Out: `X` that minimises `|A X - B|`. Gauss-Jordan elimination
//! without pivoting, for `A^T A` close to a multiple of the identity, as that of smooth bases over
//! even directions is. Degenerate: a singular `A^T A` gives infinite or NaN values.

/// Solves normal equations: `rows` are `[A^T A | A^T B]`, `[N, N + M]`; returns `X`, `[N, M]`.
///
/// ```
/// use luxel_core::least_squares;
///
/// // 2 x = 6, with y free of it: 4 y = 2.
/// let x = least_squares::solve(vec![vec![2.0, 0.0, 6.0], vec![0.0, 4.0, 2.0]]);
/// assert_eq!(x, [[3.0], [0.5]]);
/// ```
pub fn solve(mut rows: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let count = rows.len();
    for pivot in 0..count {
        let reciprocal = 1.0 / rows[pivot][pivot];
        rows[pivot].iter_mut().for_each(|v| *v *= reciprocal);
        let pivot_row = rows[pivot].clone();
        for row in rows.iter_mut().enumerate().filter_map(|(i, row)| (i != pivot).then_some(row)) {
            let factor = row[pivot];
            row.iter_mut().zip(&pivot_row).for_each(|(v, p)| *v -= factor * p);
        }
    }
    rows.into_iter().map(|row| row.into_iter().skip(count).collect()).collect()
}
