"""The native rasteriser under `luxel.torch`, with NumPy alone, against numbers in float64."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import luxel
from luxel._luxel import Rasterizer

GOLDEN = json.loads((Path(__file__).parent / "data" / "blending.json").read_text())


def array(numbers: dict[str, Any]) -> np.ndarray:
    return np.array(numbers["values"], np.float32).reshape(numbers["shape"])


INPUTS = {name: array(numbers) for name, numbers in GOLDEN["inputs"].items()}
WEIGHTS = {name: array(numbers) for name, numbers in GOLDEN["weights"].items()}
SPLATS = [INPUTS[name] for name in ("means", "quats", "scales", "opacities", "viewmats", "Ks")]


def assert_near(found: np.ndarray, expected: dict[str, Any], tolerance: float, mask: Any = 1.0) -> None:
    values = array(expected)
    assert found.shape == values.shape
    assert np.abs((found - values) * mask).max() <= tolerance * np.abs(values).max()


@pytest.mark.parametrize("packed", [False, True])
def test_images_and_gradients_equal_golden_numbers(packed: bool) -> None:
    projection, arrays = Rasterizer(2).project(*SPLATS, *GOLDEN["size"], antialiased=True, packed=packed)
    blending, image, alpha = projection.blend(INPUTS["colors"], INPUTS["backgrounds"])
    assert_near(image, GOLDEN["image"], 5e-6, WEIGHTS["safe"])
    assert_near(alpha, GOLDEN["alpha"], 5e-6, WEIGHTS["safe"])
    found = blending.backward(WEIGHTS["image"], WEIGHTS["alpha"])
    by_splats = projection.backward(found["means2d"], found["covars2d"], None, None, found["opacities"])
    gradients = dict(zip(("means", "quats", "scales", "covars", "opacities", "viewmats"), by_splats))
    assert gradients.pop("covars") is None
    # The last row of a view matrix is constant here, and is not used there.
    gradients |= {"colors": found["channels"], "backgrounds": found["background"]}
    for name, expected in GOLDEN["gradients"].items():
        assert_near(gradients[name], expected, 5e-5)
    if packed:
        depths = array(GOLDEN["depths"])[arrays["camera_ids"], arrays["gaussian_ids"]]
        np.testing.assert_allclose(arrays["depths"], depths, rtol=1e-5)
        assert (arrays["radii"] > 0).all() and arrays["radii"].dtype == np.int32


def test_absolute_gradients_are_at_least_the_others() -> None:
    projection, _ = Rasterizer(1).project(*SPLATS, *GOLDEN["size"])
    blending, image, _ = projection.blend(INPUTS["colors"])
    found = blending.backward(image, absolute=True)
    assert (found["absgrad"] >= np.abs(found["means2d"]) * (1 - 1e-4)).all() and found["absgrad"].max() > 0
    assert "absgrad" not in blending.backward(image)


def test_wrong_arrays_are_errors() -> None:
    rasterizer, size = Rasterizer(1), GOLDEN["size"]
    with pytest.raises(luxel.LuxelError, match="means: array of shape .9, 2., expected .*3"):
        rasterizer.project(np.zeros((9, 2), np.float32), *SPLATS[1:], *size)
    with pytest.raises(luxel.LuxelError, match="scales: array is not contiguous"):
        rasterizer.project(*SPLATS[:2], np.zeros((9, 6), np.float32)[:, ::2], *SPLATS[3:], *size)
    with pytest.raises(luxel.LuxelError, match="opacities: expected 9 numbers or rows, found 8"):
        rasterizer.project(*SPLATS[:3], SPLATS[3][:8], *SPLATS[4:], *size)
    projection, _ = rasterizer.project(*SPLATS, *size)
    with pytest.raises(luxel.LuxelError, match="channels: expected 36 numbers or rows, found 32"):
        projection.blend(INPUTS["colors"][:8])
