//! Small dense networks over sixteen samples at a time, shared by radiance fields and by decoders
//! of anchors, and networks of one input as tables, shared by fields and by the second colours of
//! splats. Gradients are exact and written by hand; sums have one fixed order.

mod network;
pub(crate) mod relu_line;

pub(crate) use self::network::{Activations, Network};
