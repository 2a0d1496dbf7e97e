use crate::Body;
pub const ALL: &[(&str, Body)] = &[];
