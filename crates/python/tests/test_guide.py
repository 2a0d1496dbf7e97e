"""The examples of the guide's page on Python, run as they stand but for the number of steps."""

from __future__ import annotations

import json
import re
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import luxel

PAGE = Path(__file__).parents[3] / "docs" / "src" / "guide" / "python.md"


class Run:
    """What wandb.init returns, as far as the guide uses it."""

    def __init__(self) -> None:
        self.logged: list[dict[str, Any]] = []

    def log(self, values: dict[str, Any], step: int) -> None:
        self.logged.append(values | {"step": step})


def test_examples_of_the_guide_run(dataset: luxel.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    frames = []
    for folder in ("my-images/images", "references", "images"):
        Path(folder).mkdir(parents=True)
    views = [*dataset.train, *dataset.test]
    for n, view in enumerate(views):
        for name in (f"my-images/images/{n}.exr", f"references/{n}.exr", f"images/{n}.exr"):
            luxel.write_exr(name, view.image)
        frames.append(view.camera.to_nerfstudio(f"images/{n}.exr"))
    Path("my-images/transforms.json").write_text(json.dumps({"frames": frames}))
    wandb, run = types.ModuleType("wandb"), Run()
    monkeypatch.setattr(wandb, "init", lambda project: run, raising=False)
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    names: dict[str, Any] = {
        # What the text around the examples speaks of.
        "camera_from_world": np.eye(4),
        "K": np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]]),
        "images": [np.ones((480, 640, 3), np.float32)] * 9,
        "cameras": [luxel.Camera(np.eye(4), [[700, 0, 320], [0, 700, 240], [0, 0, 1]], 640, 480)] * 9,
        "points": np.array([[0.0, 0, 3]]),
        "reference": np.ones((24, 32, 3), np.float32),
    }
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 6
    for block in blocks:
        few_steps = block.replace("steps=2000", "steps=20").replace("seed=42)", "seed=42, steps=20)").replace("1000 == 0", "10 == 0")
        few_steps = few_steps.replace("luxel.train(dataset, on_step", "luxel.train(my_dataset, steps=20, on_step")
        # What so few steps make has no large parts.
        few_steps = few_steps.replace("triangles=50_000", "voxel=0.1, min_island=0.01")
        if "my_dataset" in few_steps:
            names["my_dataset"] = dataset
        exec(compile(few_steps, str(PAGE), "exec"), names)  # noqa: S102
    assert Path("scene.ply").exists() and Path("render.exr").exists()
    assert len(run.logged) == 20 and run.logged[-1]["step"] == 20
    # The mean of a metric is the last thing that is printed.
    assert float(capsys.readouterr().out.split()[-1]) > 0
