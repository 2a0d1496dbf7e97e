//! Compares the GPU engine with the CPU engine, pass by pass and end to end, on whatever adapter
//! there is, software renderers included.
//!
//! Environment variables:
//!
//! - `LUXEL_REQUIRE_GPU=1` fails without an adapter; otherwise the tests are then reported as
//!   ignored.
//! - `LUXEL_TEST_GPU` names an adapter other than the best.
//! - `LUXEL_GPU_TESTS=threads` runs only the tests in [`THREAD_ORDER`], whose kernels exchange data
//!   between the threads of a workgroup. Only they can depend on the size of a subgroup, so where
//!   all tests have run at one size, these are enough at another. The default, `all`, runs every
//!   test.
//! - `LUXEL_PARITY=1` prints the worst differences that were found.
//!
//! The tests share a device, so they run one after the other.

// A test binary exports nothing.
#![allow(unreachable_pub, reason = "modules of a test share their items")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod batch;
mod camera;
mod compare;
mod contract;
#[path = "../../../cpu/tests/engine/fixture.rs"]
#[allow(dead_code, reason = "the CPU's tests use all of it")]
mod fixture;
mod gain;
mod mix;
mod parity;
mod passes;
mod read_back;
mod vignetting;
mod wide;
mod work;

use std::sync::Arc;

use libtest_mimic::{Arguments, Failed, Trial};
use luxel_gpu::{DeviceChoice, Gpu};

/// Tests of kernels that exchange data between threads: prefix sums, sorts, masks and the pipeline
/// of the backward pass. Shaders use no subgroup operations; a missing barrier shows only at some
/// sizes.
const THREAD_ORDER: &[&str] = &[
    "tiles_hold_every_splat_that_can_be_seen_in_them",
    "tiles_are_sorted_by_depth_then_index",
    "many_splats_are_sorted_over_several_blocks",
    "gpu_images_match_cpu",
    "gpu_losses_match_cpu",
    "gpu_gradients_match_cpu",
    "gpu_gradients_by_the_camera_match_cpu",
    "gpu_gradients_with_vignetting_match_cpu",
    "crowded_tiles_match_the_cpu",
    "splats_over_many_tiles_match_the_cpu",
    "equal_inputs_give_equal_bits",
    "optional_features_do_not_show",
    "contributions_match_the_cpu",
    "blocks_have_the_bits_of_every_splat_that_can_be_seen_in_them",
    "the_work_is_what_pairs_counted_one_by_one_make_it",
];

/// Returns the tests that `LUXEL_GPU_TESTS` selects.
fn selected() -> Vec<(&'static str, Body)> {
    let all = [
        passes::ALL,
        parity::ALL,
        batch::ALL,
        mix::ALL,
        gain::ALL,
        camera::ALL,
        vignetting::ALL,
        wide::ALL,
        read_back::ALL,
        work::ALL,
        contract::ALL,
    ]
    .concat();
    for name in THREAD_ORDER {
        assert!(all.iter().any(|(found, _)| found == name), "THREAD_ORDER: there is no test {name}");
    }
    match std::env::var("LUXEL_GPU_TESTS").as_deref() {
        Err(_) | Ok("all") => all,
        Ok("threads") => all.into_iter().filter(|(name, _)| THREAD_ORDER.contains(name)).collect(),
        Ok(other) => panic!("LUXEL_GPU_TESTS: found \"{other}\", expected \"all\" or \"threads\""),
    }
}

/// The function of a test.
type Body = fn(&Arc<Gpu>);

/// Makes a test, which is ignored without a GPU.
fn trial(gpu: Option<&Arc<Gpu>>, name: &'static str, body: Body) -> Trial {
    let Some(gpu) = gpu.map(Arc::clone) else {
        return Trial::test(name, || Ok(())).with_ignored_flag(true);
    };
    Trial::test(name, move || {
        body(&gpu);
        Ok(())
    })
}

fn main() {
    let mut arguments = Arguments::from_args();
    arguments.test_threads = Some(1);
    let name = std::env::var("LUXEL_TEST_GPU").unwrap_or_default();
    let gpu = Gpu::open(&DeviceChoice::Named(name));
    let is_required = std::env::var("LUXEL_REQUIRE_GPU").is_ok_and(|v| v == "1");
    let mut trials: Vec<Trial> = selected().into_iter().map(|(name, body)| trial(gpu.as_ref().ok(), name, body)).collect();
    match gpu {
        Ok(gpu) => {
            let facts = gpu.facts();
            let [from, to] = facts.subgroup_size;
            eprintln!("GPU: {} ({}, {}), subgroups of {from} to {to}", facts.name, facts.backend, facts.kind);
        }
        Err(error) if is_required => {
            trials.push(Trial::test("a_gpu_is_there", move || Err(Failed::from(format!("LUXEL_REQUIRE_GPU=1, but {error}")))));
        }
        Err(error) => eprintln!("tests are ignored: {error}"),
    }
    let conclusion = libtest_mimic::run(&arguments, trials);
    if std::env::var("LUXEL_PARITY").is_ok_and(|v| v == "1") {
        compare::print_table();
    }
    conclusion.exit();
}
