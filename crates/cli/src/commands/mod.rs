//! One file per command.

pub(crate) mod bench;
pub(crate) mod blocks;
pub(crate) mod compare;
pub(crate) mod completions;
pub(crate) mod demo;
pub(crate) mod devices;
pub(crate) mod doctor;
pub(crate) mod edit;
pub(crate) mod eval;
pub(crate) mod export;
pub(crate) mod info;
pub(crate) mod lights;
pub(crate) mod mesh;
pub(crate) mod mix;
pub(crate) mod pick;
pub(crate) mod prepare;
pub(crate) mod probe;
pub(crate) mod render;
pub(crate) mod reproduce;
pub(crate) mod train;
#[cfg(feature = "view")]
pub(crate) mod view;
