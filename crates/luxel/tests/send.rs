//! Trainings, renderers and engines move to other threads, such as beside the loop of a window.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use luxel::{Dataset, Device, Error, Event, Renderer, Scene, SelectedEngine, StopFlag, Training, synthetic};

fn assert_send<T: Send>() {}

#[test]
fn what_works_for_long_moves_to_another_thread() {
    assert_send::<Training>();
    assert_send::<Renderer>();
    assert_send::<SelectedEngine>();
    assert_send::<Box<dyn luxel_core::Engine>>();
    assert_send::<Scene>();
    assert_send::<Event>();
    assert_send::<Error>();
    assert_send::<StopFlag>();
}

#[test]
fn a_training_goes_on_in_another_thread_with_the_same_result() {
    let folder = tempfile::tempdir().unwrap();
    synthetic::write_dataset(folder.path(), synthetic::BallsOptions { side_px: 12, views: 4 }).unwrap();
    let dataset = Dataset::open(folder.path()).unwrap();
    let start = || Training::builder(&dataset).steps(6).device(Device::Cpu.with_threads(2)).start().unwrap();
    let mut here = start();
    assert_eq!(here.by_ref().count(), 6);
    let mut moved = start();
    moved.next().unwrap().unwrap();
    let there = std::thread::spawn(move || {
        assert_eq!(moved.by_ref().map(Result::unwrap).map(|step| step.number).collect::<Vec<_>>(), [2, 3, 4, 5, 6]);
        moved.into_scene().unwrap()
    });
    assert_eq!(there.join().unwrap(), here.into_scene().unwrap());
}
