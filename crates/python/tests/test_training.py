"""Training: steps, callbacks, checkpoints, interruption."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import luxel


def test_equal_seeds_make_equal_scenes_and_a_checkpoint_continues(dataset: luxel.Dataset, tmp_path: Path) -> None:
    options = {"steps": 12, "device": "cpu", "init_points": 100, "seed": 7}
    whole = luxel.train(dataset, **options)
    training = luxel.Training(dataset, **options)
    for step in training:
        if step.number == 5:
            break
    training.checkpoint(tmp_path / "paused.safetensors")
    resumed = luxel.Training(dataset, resume=tmp_path / "paused.safetensors", device="cpu")
    assert [step.number for step in resumed] == list(range(6, 13)) and resumed.is_finished
    np.testing.assert_array_equal(resumed.scene().positions, whole.positions)


def test_training_learns_and_measures(dataset: luxel.Dataset) -> None:
    training = luxel.Training(dataset, steps=60, device="cpu", init_points=200)
    before = training.evaluate()["mean"]["psnr_scene"]
    losses = [step.loss for step in training]
    after = training.evaluate("test")["mean"]["psnr_scene"]
    assert after > before + 5 and np.isfinite(losses).all()
    assert len(training.evaluate(dataset.test)["views"]) == 2
    image = training.render(dataset.test[0].camera)
    np.testing.assert_array_equal(image, training.scene().render(dataset.test[0].camera, device="cpu"))
    found = luxel.metrics.compare(dataset.test[0].image, image, scale=training.scene().radiance_scale)
    assert found["psnr_scene"] > before


def test_a_callback_sees_every_step_and_may_stop(dataset: luxel.Dataset) -> None:
    seen: list[int] = []

    def stop_at_three(step: luxel.Progress) -> None:
        seen.append(step.number)
        if step.number == 3:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        luxel.train(dataset, steps=9, device="cpu", init_points=50, on_step=stop_at_three)
    assert seen == [1, 2, 3]


@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
def test_ctrl_c_interrupts_training(dataset: luxel.Dataset) -> None:
    def interrupt() -> None:
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)

    # A job in the background of a shell ignores the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    thread = threading.Thread(target=interrupt)
    thread.start()
    start = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            luxel.train(dataset, steps=1_000_000, device="cpu", init_points=200)
    finally:
        thread.join()
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - start < 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"setps": 3}, "unknown field `setps`"),
        ({"preset": "quick"}, "expected one of `fast`, `full`, `paper`"),
        ({"steps": 0}, "iterations"),
        ({"mcmc_noise": 1.0}, "mcmc_noise: has an effect with strategy mcmc only"),
        ({"device": "cuda"}, "expected auto, cpu, gpu"),
        ({"resume": "a.safetensors", "seed": 3}, "leave preset and options out"),
        ({"resume": "/none.safetensors"}, "/none.safetensors"),
    ],
)
def test_options_that_cannot_be_are_refused(dataset: luxel.Dataset, options: dict[str, object], message: str) -> None:
    with pytest.raises(luxel.LuxelError) as caught:
        luxel.Training(dataset, **options)  # type: ignore[arg-type]
    assert message in str(caught.value)


def test_options_are_listed_with_their_values() -> None:
    assert luxel.training_options("paper")["iterations"] == 30_000
    assert luxel.training_options()["preset"] == "fast"
