//! The layouts of data sets, a file each: how a folder of this layout is recognised, and what its
//! frames, split and points are.

pub(in crate::dataset) mod colmap;
pub(in crate::dataset) mod llff;
pub(in crate::dataset) mod metashape;
pub(in crate::dataset) mod phone;
pub(in crate::dataset) mod poses_bounds;
pub(in crate::dataset) mod realityscan;
pub(in crate::dataset) mod transforms;
pub(in crate::dataset) mod usd;
