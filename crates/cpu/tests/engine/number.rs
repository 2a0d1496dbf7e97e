//! Number types of the oracle: `f64`, and [`Var`], an `f64` that records its operations.
//!
//! `Var` writes every operation on a tape (one per thread); [`gradient`] walks it backwards.
//! Derivatives are those of the branch that was taken: at a threshold the oracle, like the engine,
//! differentiates the side it is on.

use std::cell::RefCell;
use std::ops::{Add, Div, Mul, Neg, Sub};

use luxel_core::Real;

/// A number type of the oracle.
pub trait Number: Real {
    /// Makes a constant.
    fn of(value: f64) -> Self;
    /// Returns the value, for decisions.
    fn value(self) -> f64;
}

impl Number for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
}

/// A node of the tape: up to two operands and the derivatives by them.
#[derive(Clone, Copy)]
struct Node {
    operand: [u32; 2],
    partial: [f64; 2],
}

/// No operand: a constant.
const NONE: u32 = u32::MAX;

thread_local! {
    static TAPE: RefCell<Vec<Node>> = const { RefCell::new(Vec::new()) };
}

/// A number on the tape.
#[derive(Clone, Copy, Debug)]
pub struct Var {
    value: f64,
    node: u32,
}

/// Starts a new tape with the given independent variables.
pub fn variables(values: &[f64]) -> Vec<Var> {
    TAPE.with_borrow_mut(|tape| {
        tape.clear();
        values
            .iter()
            .map(|&value| {
                tape.push(Node { operand: [NONE; 2], partial: [0.0; 2] });
                Var { value, node: tape.len() as u32 - 1 }
            })
            .collect()
    })
}

/// The derivatives of one number by every number of the tape.
pub struct Gradient(Vec<f64>);

/// Computes the derivatives of `of` by all its inputs.
pub fn gradient(of: Var) -> Gradient {
    TAPE.with_borrow(|tape| {
        let mut adjoint = vec![0.0; tape.len()];
        if of.node != NONE {
            adjoint[of.node as usize] = 1.0;
        }
        for i in (0..tape.len()).rev() {
            for (operand, partial) in tape[i].operand.into_iter().zip(tape[i].partial) {
                if operand != NONE && adjoint[i] != 0.0 {
                    adjoint[operand as usize] += partial * adjoint[i];
                }
            }
        }
        Gradient(adjoint)
    })
}

impl Gradient {
    /// Returns the derivative by `var`.
    pub fn by(&self, var: Var) -> f64 {
        if var.node == NONE { 0.0 } else { self.0[var.node as usize] }
    }
}

fn record(value: f64, operands: [(Var, f64); 2]) -> Var {
    if operands.iter().all(|(var, _)| var.node == NONE) {
        return Var::of(value);
    }
    TAPE.with_borrow_mut(|tape| {
        tape.push(Node { operand: operands.map(|(var, _)| var.node), partial: operands.map(|(_, partial)| partial) });
        Var { value, node: tape.len() as u32 - 1 }
    })
}

fn record_unary(value: f64, operand: Var, partial: f64) -> Var {
    record(value, [(operand, partial), (Var::of(0.0), 0.0)])
}

impl Number for Var {
    fn of(value: f64) -> Self {
        Self { value, node: NONE }
    }
    fn value(self) -> f64 {
        self.value
    }
}

impl Add for Var {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        record(self.value + o.value, [(self, 1.0), (o, 1.0)])
    }
}

impl Sub for Var {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        record(self.value - o.value, [(self, 1.0), (o, -1.0)])
    }
}

impl Mul for Var {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        record(self.value * o.value, [(self, o.value), (o, self.value)])
    }
}

impl Div for Var {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let value = self.value / o.value;
        record(value, [(self, 1.0 / o.value), (o, -value / o.value)])
    }
}

impl Neg for Var {
    type Output = Self;
    fn neg(self) -> Self {
        record_unary(-self.value, self, -1.0)
    }
}

impl Real for Var {
    fn lift(self, value: f32) -> Self {
        Self::of(value.into())
    }
    fn mul_add(self, factor: Self, term: Self) -> Self {
        self * factor + term
    }
    fn max(self, other: Self) -> Self {
        if self.value >= other.value { self } else { other }
    }
    fn min(self, other: Self) -> Self {
        if self.value <= other.value { self } else { other }
    }
    fn sqrt(self) -> Self {
        let value = self.value.sqrt();
        record_unary(value, self, 0.5 / value)
    }
    fn exp(self) -> Self {
        let value = self.value.exp();
        record_unary(value, self, value)
    }
    fn ln_1p(self) -> Self {
        record_unary(self.value.ln_1p(), self, 1.0 / (1.0 + self.value))
    }
    fn if_positive(self, then: Self, otherwise: Self) -> Self {
        if self.value > 0.0 { then } else { otherwise }
    }
}

#[test]
fn tape_differentiates_a_formula_with_every_operation() {
    fn formula<N: Number>(x: &[N]) -> N {
        let a = (x[0] * x[1] - x[2]) / (x[0] + N::of(3.0));
        (a * a).sqrt().max(N::of(0.1)).ln_1p() + (-x[2]).exp().min(x[1]) * x[0].if_positive(x[1], x[2])
    }
    let at = [0.7, -1.3, 0.4];
    let x = variables(&at);
    let exact = gradient(formula(&x));
    for i in 0..3 {
        let h = 1e-6;
        let moved = |s: f64| {
            let mut y = at;
            y[i] += s;
            formula(&y)
        };
        let numeric = (moved(h) - moved(-h)) / (2.0 * h);
        assert!((numeric - exact.by(x[i])).abs() < 1e-8, "{i}: {numeric} {}", exact.by(x[i]));
    }
}
