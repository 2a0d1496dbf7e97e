//! The GPU engine against the CPU's, pass by pass and end to end, on whatever adapter there is; software renderers too.
//!
//! Without an adapter the tests are reported as ignored; where `LUXEL_REQUIRE_GPU=1` that is a failure. `LUXEL_TEST_GPU` names another adapter
//! than the best. They run one after the other: they share a device. `LUXEL_PARITY=1` prints the worst differences that they found.

// A test binary has no outside to be reached from.
#![allow(unreachable_pub)]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod compare;
mod contract;
#[path = "../../../cpu/tests/engine/fixture.rs"]
#[allow(dead_code, reason = "the CPU's tests use all of it")]
mod fixture;
mod parity;
mod passes;

use std::sync::Arc;

use libtest_mimic::{Arguments, Failed, Trial};
use luxel_gpu::{DeviceChoice, Gpu};

/// A test.
type Body = fn(&Arc<Gpu>);

fn trial(gpu: Option<&Arc<Gpu>>, (name, body): (&'static str, Body)) -> Trial {
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
    let mut trials: Vec<Trial> =
        [passes::ALL, parity::ALL, contract::ALL].concat().into_iter().map(|test| trial(gpu.as_ref().ok(), test)).collect();
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
