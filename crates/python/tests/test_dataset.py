"""Data sets, from arrays and from files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import arc, picture

import luxel


def test_arrays_make_the_views_that_they_describe(dataset: luxel.Dataset) -> None:
    assert (len(dataset.train), len(dataset.test)) == (7, 2)
    view = dataset.test[0]
    np.testing.assert_array_equal(view.image, picture(view.camera))
    assert view.image.dtype == np.float32 and view.mask is None and view.exposure is None
    assert dataset.points.shape == (200, 3) and dataset.color_space == "linear-rec709"


def test_images_are_shared_and_cannot_be_written(dataset: luxel.Dataset) -> None:
    view = dataset.train[0]
    first, second = view.image, view.image
    assert first.__array_interface__["data"] == second.__array_interface__["data"]
    with pytest.raises(ValueError):
        first[0, 0, 0] = 1


def test_images_outlive_their_data_set() -> None:
    camera = arc(2)[0]
    image = luxel.Dataset.from_arrays([picture(camera)], [camera]).train[0].image
    np.testing.assert_array_equal(image, picture(camera))


def test_bad_pixels_and_masks_add_up() -> None:
    camera = arc(2)[0]
    image, mask = picture(camera), np.ones((24, 32), bool)
    image[3, 4] = [np.nan, 0, 0]
    mask[:2] = False
    found = luxel.Dataset.from_arrays([image], [camera], masks=[mask]).train[0].mask
    assert found is not None
    expected = mask.astype(np.float32)
    expected[3, 4] = 0
    np.testing.assert_array_equal(found, expected)


def test_files_are_read_as_the_program_reads_them(tmp_path: Path) -> None:
    frames = []
    for i, camera in enumerate(arc(9)):
        luxel.write_exr(tmp_path / "images" / f"{i:03}.exr", picture(camera), exr_type="float")
        frames.append(camera.to_nerfstudio(f"images/{i:03}.exr"))
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    seen: list[tuple[int, int, str]] = []
    opened = luxel.Dataset.open(tmp_path, progress=lambda *what: seen.append(what))
    assert (len(opened.train), len(opened.test)) == (7, 2)
    np.testing.assert_allclose(opened.test[0].camera.camera_from_world, arc(9)[0].camera_from_world, atol=1e-12)
    np.testing.assert_array_equal(opened.test[0].image, picture(arc(9)[0]))
    halved = luxel.Dataset.open(tmp_path, downscale=2, image_memory="1GiB")
    assert halved.train[0].image.shape == (12, 16, 3)
    assert luxel.Dataset.open(tmp_path, downscale="auto").train[0].image.shape == (24, 32, 3)
    with pytest.raises(luxel.LuxelError, match="expected auto or a whole number from 1 to 16"):
        luxel.Dataset.open(tmp_path, downscale=17)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"images": []}, "cameras: 1, expected one for each of 0 images"),
        ({"images": [np.zeros((3, 4))]}, "images[0]: array of shape [3, 4], expected [height, width, 3]"),
        ({"images": [np.zeros((3, 4, 3))]}, "the image is 4 x 3, the camera expects 32 x 24"),
        ({"images": [np.zeros((24, 32, 3), np.uint8)]}, "images[0]: array of uint8, which are encoded values"),
        ({"images": ["text"]}, "images[0]: not an array of numbers"),
        ({"masks": [np.ones((2, 2))]}, "masks[0]: array of shape [2, 2], expected [24, 32]"),
        ({"test": [4]}, "test: index 4, expected below 1"),
        ({"test": [0]}, "no view to train on"),
        ({"color_space": "srgb"}, "expected linear-rec709"),
        ({"points": np.zeros((2, 3)), "point_colors": np.zeros((1, 3), np.uint8)}, "point_colors: 1, expected one for each of 2 points"),
    ],
)
def test_arrays_that_do_not_go_together_are_refused(change: dict[str, object], message: str) -> None:
    camera = arc(2)[0]
    arguments = {"images": [picture(camera)], "cameras": [camera], **change}
    with pytest.raises(luxel.LuxelError) as caught:
        luxel.Dataset.from_arrays(**arguments)  # type: ignore[arg-type]
    assert message in str(caught.value)


def test_a_missing_folder_and_an_unknown_option_are_named() -> None:
    with pytest.raises(luxel.LuxelError, match="/no/such/place"):
        luxel.Dataset.open("/no/such/place")
    with pytest.raises(luxel.LuxelError, match="unknown field `downscales`"):
        luxel.Dataset.open("/no/such/place", downscales=2)
