//! The program as a user runs it: one test program for all of its tests, since each that is linked
//! takes as long as many tests.
#![allow(missing_docs, clippy::unwrap_used, reason = "helpers of tests fail the test")]

#[path = "../common/mod.rs"]
mod common;

mod bad_input;
mod bench;
mod blocks;
mod cameras;
mod captures;
mod channels;
mod cli;
mod compare;
mod completions;
mod coordinates;
mod deep;
mod edit;
mod export;
mod fields_of_captures;
mod hostile;
mod image_memory;
mod implicit;
mod interruption;
mod json;
mod limits;
mod mesh;
mod mix;
mod outputs;
mod poses;
mod prepare;
mod reproduce;
mod terminal;
mod view;
mod wide;
