"""A small data set that all tests share: two boxes of light, seen from an arc."""

from __future__ import annotations

import numpy as np
import pytest

import luxel

SIZE = (32, 24)


def arc(count: int) -> list[luxel.Camera]:
    """Cameras on an arc around the origin."""
    cameras = []
    for angle in np.linspace(-0.6, 0.6, count):
        eye = [4 * np.sin(angle), 0.5, -4 * np.cos(angle)]
        cameras.append(luxel.Camera.look_at(eye, [0, 0, 0], [0, -1, 0], 45, *SIZE))
    return cameras


def picture(camera: luxel.Camera) -> np.ndarray:
    """A bright disc before a dark wall, which all cameras see."""
    image = np.full((SIZE[1], SIZE[0], 3), [0.02, 0.03, 0.05], np.float32)
    pixels, depth = camera.project([[0.0, 0.0, 0.0]])
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    image[np.hypot(x - pixels[0, 0], y - pixels[0, 1]) < 5] = [40.0, 36.0, 25.0]
    return image


@pytest.fixture(scope="session")
def dataset() -> luxel.Dataset:
    cameras = arc(9)
    points = np.random.default_rng(0).normal(0, 0.4, (200, 3))
    return luxel.Dataset.from_arrays([picture(camera) for camera in cameras], cameras, points=points)


@pytest.fixture(scope="session")
def scene(dataset: luxel.Dataset) -> luxel.Scene:
    return luxel.train(dataset, steps=40, device="cpu", init_points=200)
