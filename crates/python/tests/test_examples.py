"""The example scripts and notebooks, run on a small data set in files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import luxel

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(script: str, *arguments: object) -> str:
    """Runs a script as a user does, and returns what it prints."""
    command = [sys.executable, EXAMPLES / f"{script}.py", *map(str, arguments)]
    found = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ, OMP_WAIT_POLICY="passive"))
    assert found.returncode == 0, found.stderr
    return found.stdout


@pytest.fixture(scope="module")
def folder(dataset: luxel.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of all tests, as files."""
    folder: Path = tmp_path_factory.mktemp("examples") / "data"
    (folder / "images").mkdir(parents=True)
    frames = []
    for n, view in enumerate([*dataset.train, *dataset.test]):
        luxel.write_exr(folder / "images" / f"{n}.exr", view.image)
        frames.append(view.camera.to_nerfstudio(f"images/{n}.exr"))
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder


@pytest.fixture(scope="module")
def trained(folder: Path) -> Path:
    """The output of the first example."""
    output = folder.parent / "trained"
    assert "dB (scene)" in run("train_and_look", folder, output, 60)
    return output


def test_a_scene_is_trained_and_its_renders_are_written(trained: Path) -> None:
    assert len(luxel.Scene.open(trained / "scene.ply")) > 0
    assert list(trained.glob("*.exr")) and list((trained / "previews").glob("*.png"))


def test_metrics_of_a_folder_are_a_table(folder: Path, trained: Path) -> None:
    renders = folder.parent / "renders"
    renders.mkdir()
    for path in trained.glob("*.exr"):
        path.rename(renders / path.name.replace(".exr.exr", ".exr"))
    lines = run("metrics_of_a_folder", folder / "images", renders).splitlines()
    assert lines[0].startswith("name,psnr_scene") and lines[-1].startswith("mean,")


def test_poses_find_back(folder: Path, trained: Path) -> None:
    pytest.importorskip("torch")
    lines = run("optimise_poses", folder, trained / "scene.ply", 20).splitlines()
    assert lines and all("degrees" in line for line in lines)


def test_a_loss_of_ones_own_improves_what_it_measures(folder: Path, trained: Path) -> None:
    pytest.importorskip("torch")
    output = folder.parent / "refined.ply"
    before, after = (float(line.split()[-1]) for line in run("custom_loss", folder, trained / "scene.ply", output, 40).splitlines())
    assert after < before and len(luxel.Scene.open(output)) > 0


def test_a_scene_is_trained_with_torch(folder: Path) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("gsplat")
    output = folder.parent / "torch.ply"
    assert "dB (scene)" in run("train_with_torch", folder, output, 40, 500)
    scene = luxel.Scene.open(output)
    assert len(scene) > 0 and np.isfinite(scene.positions).all()


NOTEBOOKS = EXAMPLES.parents[2] / "scripts" / "notebooks"


def test_notebooks_are_those_of_the_scripts() -> None:
    assert subprocess.run([sys.executable, NOTEBOOKS, "--check"]).returncode == 0


def run_notebook(name: str, folder: Path, **values: object) -> None:
    """Runs all cells of a notebook in a folder, with other parameters."""
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    folder.mkdir(exist_ok=True)
    command = [sys.executable, NOTEBOOKS, "--run", name, folder, *(f"{key}={value}" for key, value in values.items())]
    found = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ, OMP_WAIT_POLICY="passive"))
    assert found.returncode == 0, found.stderr


def test_notebook_train_and_look_runs(folder: Path) -> None:
    work = folder.parent / "notebook"
    run_notebook("train_and_look", work, dataset_path=folder, output="trained", steps=20)
    assert list((work / "trained").glob("*.exr"))


def test_notebook_metrics_of_a_folder_runs(folder: Path) -> None:
    images = folder / "images"
    run_notebook("metrics_of_a_folder", folder.parent / "notebook", references=images, images=images)


def test_notebook_optimise_poses_runs(folder: Path, trained: Path) -> None:
    pytest.importorskip("torch")
    run_notebook("optimise_poses", folder.parent / "notebook", dataset_path=folder, scene_path=trained / "scene.ply", steps=10)


def test_notebook_custom_loss_runs(folder: Path, trained: Path) -> None:
    pytest.importorskip("torch")
    work = folder.parent / "notebook"
    run_notebook("custom_loss", work, dataset_path=folder, scene_path=trained / "scene.ply", output="refined.ply", steps=10)
    assert (work / "refined.ply").exists()
