"""Scenes: rendering to the bit, arrays in and out, edits, exports, probes."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import luxel


def test_renders_are_those_of_the_program_to_the_bit(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path: Path) -> None:
    path = tmp_path / "scene.ply"
    scene.save(path)
    camera = dataset.test[1].camera
    cameras = tmp_path / "camera.json"
    cameras.write_text(json.dumps({"frames": [camera.to_nerfstudio("frame")]}))
    arguments = ["render", path, "--cameras", cameras, "-o", tmp_path / "out", "--exr-type", "float", "--device", "cpu", "--quiet"]
    assert luxel.run_command(arguments) == 0
    written, space = luxel.read_image(next((tmp_path / "out").glob("*.exr")))
    opened = luxel.Camera.from_nerfstudio(camera.to_nerfstudio())
    np.testing.assert_array_equal(luxel.Scene.open(path).render(opened, device="cpu"), written)
    assert space == "linear-rec709"


def test_photographs_are_those_of_the_program_to_the_bit(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path: Path) -> None:
    path = tmp_path / "scene.ply"
    scene.save(path)
    near, far = (dataset.test[i].camera for i in (0, 1))
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps({"frames": [{**near.to_nerfstudio("a"), "focus_distance": 1.5}, {**far.to_nerfstudio("b"), "focus_distance": 2.0}]}))
    lens = ["--aperture", "0.1", "--blades", "6", "--shutter", "90", "--lens-samples", "9", "--frames", "0-0"]
    common = ["-o", tmp_path / "out", "--exr-type", "float", "--device", "cpu", "--quiet"]
    assert luxel.run_command(["render", path, "--cameras", cameras, *lens, *common]) == 0
    written, _ = luxel.read_image(tmp_path / "out" / "a.exr")
    opened = luxel.read_cameras(cameras)
    lens_of = {"aperture": 0.1, "focus": 1.5, "blades": 6, "shutter": 90.0, "lens_samples": 9}
    found = luxel.Scene.open(path).photograph(opened["a"], after=opened["b"], device="cpu", **lens_of)
    np.testing.assert_array_equal(found, written)
    with pytest.raises(luxel.LuxelError, match="focus: None"):
        scene.photograph(near, aperture=0.1)


def test_threads_render_one_scene_side_by_side(dataset: luxel.Dataset, scene: luxel.Scene) -> None:
    expected = [scene.render(view.camera, device="cpu") for view in dataset.train]
    found: dict[int, np.ndarray] = {}

    def render(i: int) -> None:
        found[i] = scene.render(dataset.train[i].camera, device="cpu")

    threads = [threading.Thread(target=render, args=(i,)) for i in range(len(expected))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, image in enumerate(expected):
        np.testing.assert_array_equal(found[i], image)


def test_arrays_come_back_and_change_the_scene(dataset: luxel.Dataset, scene: luxel.Scene) -> None:
    camera, count = dataset.test[0].camera, len(scene)
    copy = scene.copy()
    names = ["positions", "rotations", "log_scales", "opacity_logits", "sh", "raw_luminance"]
    rebuilt = luxel.Scene.from_arrays(
        *[getattr(scene, name) for name in names], color_model=scene.color_model, radiance_scale=scene.radiance_scale
    )
    assert rebuilt.sh.shape == (count, 16, 3) and rebuilt.raw_luminance.shape == (count, 1)
    copy.opacity_logits = np.full(count, -30.0)
    assert copy.render(camera, device="cpu").max() < 1e-6 < scene.render(camera, device="cpu").max()
    half = {name: getattr(scene, name)[: count // 2] for name in names}
    copy.set(**half)
    assert len(copy) == count // 2
    with pytest.raises(luxel.LuxelError, match="rotations: "):
        copy.positions = np.zeros((3, 3))
    assert len(copy) == count // 2, "a change that fails changes nothing"
    with pytest.raises(luxel.LuxelError, match="positions: a number of splat 1 is NaN"):
        positions = copy.positions
        positions[1] = np.nan
        copy.positions = positions


def test_background_and_layers(dataset: luxel.Dataset, scene: luxel.Scene) -> None:
    camera = dataset.test[0].camera
    layers = scene.render_layers(camera)
    np.testing.assert_array_equal(layers["radiance"], scene.render(camera, device="cpu"))
    before = scene.render(camera, background=[8, 8, 8], device="cpu")
    behind = layers["radiance"] + 8 * (1 - layers["alpha"][..., None])
    np.testing.assert_allclose(before, behind, rtol=1e-4, atol=1e-4)
    assert layers["depth"].shape == (24, 32)
    normals = scene.render_normals(camera)
    lengths = np.linalg.norm(normals, axis=-1)
    np.testing.assert_allclose(lengths, np.where(layers["alpha"] > 0, 1, 0), atol=1e-5)


def test_edits_change_light_alone_and_are_recorded(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path: Path) -> None:
    camera, edited = dataset.test[0].camera, scene.copy()
    assert edited.edit("gain 2") == len(edited)
    brighter, before = edited.render(camera, device="cpu"), scene.render(camera, device="cpu")
    np.testing.assert_allclose(brighter, 2 * before, rtol=1e-6)
    assert (edited.edits, scene.edits) == (["where all; gain 2"], [])
    np.testing.assert_array_equal(edited.gain, np.full(len(scene), 2.0))
    np.testing.assert_array_equal(edited.raw_luminance, scene.raw_luminance)
    assert len(scene.gain) == 0
    edited.save(tmp_path / "edited.ply")
    np.testing.assert_array_equal(luxel.Scene.open(tmp_path / "edited.ply").render(camera, device="cpu"), brighter)
    scaled = scene.copy()
    scaled.gain = edited.gain
    np.testing.assert_array_equal(scaled.render(camera, device="cpu"), brighter)
    edited.fold_gains()
    assert len(edited.gain) == 0 and edited.render(camera, device="cpu").mean() == pytest.approx(brighter.mean(), rel=0.02)
    with pytest.raises(luxel.LuxelError, match="gain"):
        edited.gain = [-1.0] * len(edited)
    with pytest.raises(luxel.LuxelError, match="column 1"):
        edited.edit("brighter")


def test_exports_and_probes(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path: Path) -> None:
    found = scene.export(tmp_path / "scene.usda", color_space="acescg", device="cpu")
    assert found["splats"] == len(scene) and found["color_space"] == "acescg" and found["metres_per_unit"] is None
    binary = scene.export(tmp_path / "scene.usdc", color_space="acescg", device="cpu", rotation=np.diag([-1.0, 1, -1]))
    assert binary["file_bytes"] < found["file_bytes"] and len(luxel.Scene.open(tmp_path / "scene.usdc")) == len(scene)
    with pytest.raises(luxel.LuxelError, match="expected a rotation"):
        scene.export(tmp_path / "x.ply", rotation=np.eye(3) * 2)
    probe = scene.probe([0, 0, -2], width=32, dataset=dataset, device="cpu")
    assert probe.image.shape == (16, 32, 3) and probe.alpha is None
    probe.save_exr(tmp_path / "probe.exr")
    image, _ = luxel.read_image(tmp_path / "probe.exr")
    np.testing.assert_allclose(image, probe.image, rtol=1e-3, atol=1e-6)
    with pytest.raises(luxel.LuxelError, match="bake: found 'x'|bake: found \"x\""):
        scene.export(tmp_path / "x.ply", bake="x")


DEADLOCK = """
import threading, time
import numpy as np
import luxel

scene = luxel.Scene.from_arrays(np.zeros((2, 3)), np.ones((2, 4)), np.zeros((2, 3)), np.zeros(2), np.zeros((2, 16, 3)))

class Slow:
    def __array__(self, *args, **kwargs):
        started.set()
        time.sleep(0.2)  # lets other threads run
        return np.ones((2, 3))

started = threading.Event()
thread = threading.Thread(target=lambda: setattr(scene, "positions", Slow()))
thread.start()
started.wait()
assert (scene.positions == 0).all() and len(scene) == 2
thread.join()
assert (scene.positions == 1).all()
"""


def test_an_array_that_takes_its_time_blocks_no_other_thread() -> None:
    subprocess.run([sys.executable, "-c", DEADLOCK], check=True, timeout=30)


def test_lamps_of_a_scene(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path: Path) -> None:
    lights = scene.lights(dataset, medians=20, width=64, device="cpu")
    assert len(lights) == len(lights.lamps) == 1 and lights.color_space == "linear-rec709"
    lamp = lights.lamps[0]
    np.testing.assert_allclose(lamp["middle"], [0, 0, 0], atol=0.5)
    assert lamp["radiance"][0] > lamp["radiance"][2] > 0
    assert lights.map is not None and lights.map.image.shape == (32, 64, 3) and 0 <= lights.unseen_share < 1
    lights.save(tmp_path / "lights.usda")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lights.usda", "lights_dome.exr"]
    assert scene.lights(dataset, medians=20, map=False).map is None
    with pytest.raises(luxel.LuxelError, match="medians: found 1"):
        scene.lights(dataset, medians=1)


def test_mesh_of_a_scene(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path: Path) -> None:
    mesh = scene.mesh(dataset, voxel=0.1, min_island=0.2)
    count = len(mesh.positions)
    assert mesh.normals.shape == mesh.radiance.shape == (count, 3) and mesh.triangles.max() < count
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)
    assert mesh.voxel == pytest.approx(0.1) and mesh.color_space == scene.color_space
    by_cameras = scene.mesh(cameras=[view.camera for view in dataset.train], voxel=0.1, min_island=0.2)
    np.testing.assert_array_equal(by_cameras.positions, mesh.positions)
    mesh.save(tmp_path / "proxy.ply")
    assert (tmp_path / "proxy.ply").read_bytes().startswith(b"ply")
    with pytest.raises(luxel.LuxelError, match="both are None"):
        scene.mesh()
