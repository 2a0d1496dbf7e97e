//! Luxel.
