"""Images and metrics on arrays and files."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import luxel

IMAGE = np.random.default_rng(3).gamma(0.5, 2.0, (20, 24, 3)).astype(np.float32)


def test_radiance_is_neither_cut_nor_rounded(tmp_path: Path) -> None:
    bright = 1e6 * IMAGE
    luxel.write_exr(tmp_path / "a.exr", bright, color_space="acescg", attributes={"shot": "010", "iso": 200.0})
    found, space = luxel.read_image(tmp_path / "a.exr")
    np.testing.assert_array_equal(found, bright)
    assert space == "acescg"
    converted, space = luxel.read_image(tmp_path / "a.exr", color_space="linear-rec709")
    np.testing.assert_allclose(converted, luxel.convert_color_space(bright, "acescg", "linear-rec709"), rtol=1e-6)
    assert space == "linear-rec709"
    luxel.write_preview(tmp_path / "a.png", bright, white=1e6)
    assert luxel.read_image(tmp_path / "a.png")[0].shape == IMAGE.shape


def test_metrics_of_arrays_are_those_of_files(tmp_path: Path) -> None:
    other = IMAGE * np.float32(1.1)
    luxel.write_exr(tmp_path / "reference.exr", IMAGE, exr_type="float")
    luxel.write_exr(tmp_path / "test.exr", other, exr_type="float")
    of_files = luxel.metrics.compare_files(tmp_path / "reference.exr", tmp_path / "test.exr")
    of_arrays = luxel.metrics.compare(IMAGE, other)
    assert of_files["scale"] == of_arrays["scale"]
    for name in ["psnr_scene", "psnr_gtmax", "ssim_scene", "pu21_psnr", "log_rmse", "hdr_flip"]:
        assert of_files["mean"][name] == of_arrays[name], name
    assert luxel.metrics.compare(IMAGE, IMAGE, hdr_flip=False)["psnr_scene"] == 100


def test_masked_pixels_do_not_count() -> None:
    other, mask = IMAGE.copy(), np.ones(IMAGE.shape[:2])
    other[:5] = 0
    mask[:5] = 0
    found = luxel.metrics.compare(IMAGE, other, mask=mask, hdr_flip=False)
    assert found["psnr_scene"] == 100 and found["masked_pixels"] == 5 * 24


def test_errors_have_remedies_and_messages(tmp_path: Path) -> None:
    with pytest.raises(luxel.LuxelError, match="expected equal sizes"):
        luxel.metrics.compare(IMAGE, IMAGE[:-1])
    with pytest.raises(luxel.LuxelError, match="expected .exr"):
        luxel.write_exr(tmp_path / "a.tif", IMAGE)
    with pytest.raises(luxel.LuxelError) as caught:
        luxel.write_preview(tmp_path / "a.png", IMAGE, tonemap="filmic")
    assert "none, mulaw, reinhard, aces or agx" in str(caught.value) and caught.value.remedy is None
    (tmp_path / "bad.exr").write_bytes(b"v/1\x01 and no more")
    with pytest.raises(luxel.LuxelError, match="bad.exr"):
        luxel.read_image(tmp_path / "bad.exr")


def test_notes_go_to_logging(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    luxel.write_exr(tmp_path / "images" / "a.exr", IMAGE)
    camera = luxel.Camera.look_at([0, 0, -3], [0, 0, 0], [0, -1, 0], 50, 24, 20)
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [camera.to_nerfstudio("images/a.exr")]}))
    with caplog.at_level(logging.INFO, logger="luxel"):
        luxel.Dataset.open(tmp_path)
    levels = {record.levelname for record in caplog.records if record.name == "luxel"}
    assert levels == {"INFO", "WARNING"}


def test_the_program_is_in_the_package() -> None:
    shown = subprocess.run([sys.executable, "-m", "luxel", "--version"], capture_output=True, text=True, check=True)
    assert luxel.__version__ in shown.stdout
    wrong = subprocess.run([sys.executable, "-m", "luxel", "trian"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2 and "train" in wrong.stderr
