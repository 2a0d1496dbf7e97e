//! The transform of a prim: operations in an order, each over time.
//!
//! With points as columns, the matrix of `[a, b, c]` is A B C: the last operation is applied first.
//! Matrices in files have points as rows.

use std::collections::HashMap;

use glam::{DMat4, DQuat, DVec3};

use super::timed::Timed;

/// Operation that leaves the prims around out.
const RESET: &str = "!resetXformStack!";
/// Mark of an operation's inverse.
const INVERT: &str = "!invert!";

/// Operations of a prim.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::usd) struct Transform {
    order: Vec<String>,
    ops: HashMap<String, Timed>,
}

impl Transform {
    pub(in crate::usd) fn set_order(&mut self, order: Vec<String>) {
        self.order = order;
    }

    /// Returns the values of an operation, `xformOp:translate:pivot`, to be filled.
    pub(in crate::usd) fn op(&mut self, name: &str) -> &mut Timed {
        self.ops.entry(name.to_owned()).or_default()
    }

    /// Returns the values of the operations that the order names.
    pub(super) fn values(&self) -> impl Iterator<Item = &Timed> {
        self.order.iter().filter_map(|name| self.ops.get(name.trim_start_matches(INVERT)))
    }

    /// Returns whether the prims around are left out.
    pub(in crate::usd) fn is_reset(&self) -> bool {
        self.order.iter().any(|name| name == RESET)
    }

    /// Returns the matrix at a time, of points as columns.
    pub(in crate::usd) fn matrix(&self, time: Option<f64>) -> Result<DMat4, String> {
        let mut out = DMat4::IDENTITY;
        for name in self.order.iter().filter(|name| *name != RESET) {
            let (op, is_inverse) = name.strip_prefix(INVERT).map_or((name.as_str(), false), |op| (op, true));
            let values = self.ops.get(op).and_then(|value| value.at(time));
            let values = values.ok_or_else(|| format!("\"{op}\" is in xformOpOrder and has no value"))?;
            let matrix = matrix(op, &values)?;
            if is_inverse && matrix.determinant().abs() < f64::MIN_POSITIVE {
                return Err(format!("\"{op}\" has no inverse"));
            }
            out *= if is_inverse { matrix.inverse() } else { matrix };
        }
        Ok(out)
    }
}

/// Returns the matrix of an operation.
fn matrix(op: &str, values: &[f64]) -> Result<DMat4, String> {
    let kind = op.split(':').nth(1).unwrap_or_default();
    let wrong = |count: usize| format!("\"{op}\" has {} numbers, expected {count}", values.len());
    let triple = || <[f64; 3]>::try_from(values).map_err(|_| wrong(3));
    let about = |axis: char, degrees: f64| match axis {
        'X' => DMat4::from_rotation_x(degrees.to_radians()),
        'Y' => DMat4::from_rotation_y(degrees.to_radians()),
        _ => DMat4::from_rotation_z(degrees.to_radians()),
    };
    match kind {
        "translate" => triple().map(|v| DMat4::from_translation(DVec3::from(v))),
        "scale" => triple().map(|v| DMat4::from_scale(DVec3::from(v))),
        "orient" => {
            let [w, x, y, z] = <[f64; 4]>::try_from(values).map_err(|_| wrong(4))?;
            let q = DQuat::from_xyzw(x, y, z, w);
            if !(0.5..=2.0).contains(&q.length()) {
                return Err(format!("\"{op}\" is a quaternion of length {}, expected 1", q.length()));
            }
            Ok(DMat4::from_quat(q.normalize()))
        }
        "transform" => {
            let numbers = <[f64; 16]>::try_from(values).map_err(|_| wrong(16))?;
            // Rows of points as rows are columns of points as columns.
            let matrix = DMat4::from_cols_array(&numbers);
            let is_affine = matrix.row(3).abs_diff_eq(glam::DVec4::W, 1e-9);
            if is_affine { Ok(matrix) } else { Err(format!("\"{op}\" is a projective matrix, expected one that ends in 0 0 0 1")) }
        }
        "rotateX" | "rotateY" | "rotateZ" => match values {
            [degrees] => Ok(about(kind.chars().last().unwrap_or('Z'), *degrees)),
            _ => Err(wrong(1)),
        },
        "rotateXYZ" | "rotateXZY" | "rotateYXZ" | "rotateYZX" | "rotateZXY" | "rotateZYX" => {
            let [x, y, z] = triple()?;
            let angle = |axis: char| match axis {
                'X' => x,
                'Y' => y,
                _ => z,
            };
            // The first axis named is applied first.
            Ok(kind.trim_start_matches("rotate").chars().fold(DMat4::IDENTITY, |out, axis| about(axis, angle(axis)) * out))
        }
        _ => Err(format!("\"{op}\" is not a known transform, expected translate, scale, rotate..., orient or transform")),
    }
}
