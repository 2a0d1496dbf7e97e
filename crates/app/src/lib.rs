//! Run folders, studies, preparation and reports: the parts that the program `luxel`, its viewer
//! and its Python package share beyond the library.
//!
//! The library [`luxel`] trains in memory, renders, edits and exports. This crate works in folders:
//!
//! - [`run`] trains in a folder, with checkpoints, metrics and a report, and continues where a run
//!   was interrupted. [`run::open_scene`] reads the newest scene of such a folder.
//! - [`prepare`] makes a data set of a folder of photographs or videos.
//! - [`study`] trains and measures a matrix of data sets, methods and seeds.
//! - [`blocks`] splits a large data set, whose blocks are trained as runs, and merges their scenes.
//! - [`compare`] and [`edit`] put two runs, or two scenes under the same edit, side by side.
//! - [`report`] makes pages of plots, pictures and tables.
//! - [`pick`] says what a pixel is made of, [`mod@bench`] how long renders and steps take,
//!   [`usd_space`] where cameras of OpenUSD are in a scene, [`machine`] what the machine is.
//! - [`output`], [`files`] and [`schema`] say how results are named, written and versioned.
//!
//! Like the library it prints nothing and parses no arguments, and its errors are the library's.
//! Its interface changes with the program: a program that embeds Luxel starts from [`luxel`].
//!
//! The feature `methods`, off by default, adds published methods to compare with.

pub mod bench;
pub mod blocks;
pub mod build_info;
pub mod compare;
pub mod edit;
pub mod files;
pub mod machine;
pub mod non_splat;
pub mod output;
pub mod pick;
pub mod prepare;
pub mod process;
pub mod report;
pub mod run;
pub mod schema;
pub mod study;
pub mod text;
pub mod usd_space;

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;
