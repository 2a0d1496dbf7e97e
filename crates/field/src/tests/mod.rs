//! Gradients of every part, against central differences of an oracle in f64; and learning.

mod gradients;
mod learning;
mod oracle;
