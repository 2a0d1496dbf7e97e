"""Files of cameras: JSON and OpenUSD, there and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import luxel

K = np.array([[100.0, 0, 53], [0, 90, 38.5], [0, 0, 1]])


def cameras(count: int = 4) -> dict[str, luxel.Camera]:
    """Cameras on an arc around the origin, in a world with -Y up."""
    found = {}
    for i in range(count):
        eye = [3 * np.sin(0.3 * i), -0.4 * i - 0.5, -3 * np.cos(0.3 * i)]
        pose = luxel.Camera.look_at(eye, [0, 0, 0], [0, -1, 0], fov=50, width=100, height=80).camera_from_world
        found[f"view_{i}"] = luxel.Camera(pose, K, 100, 80)
    return found


def dataset() -> luxel.Dataset:
    image = np.ones((80, 100, 3), np.float32)
    return luxel.Dataset.from_arrays([image] * 4, list(cameras().values()))


def assert_equal(found: luxel.Camera, expected: luxel.Camera, tolerance: float) -> None:
    assert (found.width, found.height) == (expected.width, expected.height)
    np.testing.assert_allclose(found.camera_from_world, expected.camera_from_world, atol=1e-12)
    # OpenUSD has lenses in floats of 32 bits.
    np.testing.assert_allclose(found.K, expected.K, atol=tolerance)


@pytest.mark.parametrize("name, tolerance", [("c.json", 1e-12), ("c.usda", 2e-5)])
def test_cameras_come_back(tmp_path: Path, name: str, tolerance: float) -> None:
    luxel.write_cameras(tmp_path / name, cameras(), dataset=dataset())
    found = luxel.read_cameras(tmp_path / name, dataset=dataset())
    assert list(found) == list(cameras())
    for one, other in zip(found.values(), cameras().values()):
        assert_equal(one, other, tolerance)


def test_a_moving_camera_comes_back_frame_by_frame(tmp_path: Path) -> None:
    luxel.write_cameras(tmp_path / "shot.usda", cameras(), moving=True, fps=25, dataset=dataset())
    found = luxel.read_cameras(tmp_path / "shot.usda", dataset=dataset())
    assert list(found) == ["shot.0000", "shot.0001", "shot.0002", "shot.0003"]
    for one, other in zip(found.values(), cameras().values()):
        assert_equal(one, other, 2e-5)


def test_openusd_sees_what_luxel_sees(tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr", reason="OpenUSD's library is not installed: pip install usd-core")
    Usd, UsdGeom = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdGeom")
    assert pxr
    luxel.write_cameras(tmp_path / "shot.usda", cameras(), moving=True, dataset=dataset(), metres_per_unit=0.5)
    stage = Usd.Stage.Open(str(tmp_path / "shot.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 0.5
    prim = UsdGeom.Camera(stage.GetPrimAtPath("/Cameras/shot"))
    point = np.array([0.2, 0.1, 0.3])
    # The export turns -Y up to +Y by half a turn about x.
    in_stage = point * [1, -1, -1]
    for time, camera in enumerate(cameras().values()):
        frustum = prim.GetCamera(time).frustum
        # OpenUSD's frustum is that of the aperture: from -1 to 1 across it, +1 at the top.
        matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
        clip = np.array([*in_stage, 1]) @ matrix
        x, y = clip[:2] / clip[3]
        pixel, _ = camera.project(point[None])
        np.testing.assert_allclose([(x + 1) * 50, (1 - y) * 40], pixel[0], atol=1e-4)
    # As a program writes it again: with +Z up in centimetres, as a package, with the size left out.
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    for name in ("luxel:width", "luxel:height"):
        prim.GetPrim().RemoveProperty(name)
    for extension in ("usdc", "usda"):
        stage.GetRootLayer().Export(str(tmp_path / f"again.{extension}"))
        found = luxel.read_cameras(tmp_path / f"again.{extension}", width=100, height=80, dataset=dataset(), metres_per_unit=0.5)
        for one, other in zip(found.values(), cameras().values()):
            np.testing.assert_allclose(one.position, other.position * 0.02, atol=1e-12)
    with pytest.raises(luxel.LuxelError, match="size of images"):
        luxel.read_cameras(tmp_path / "again.usdc", dataset=dataset())


Z_UP = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
    startTimeCode = 1001
    endTimeCode = 1003
)
def Xform "Rig"
{
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]

    def Camera "hero"
    {
        float focalLength = 36
        float horizontalAperture = 36
        float verticalAperture = 18
        double3 xformOp:translate.timeSamples = { 1001: (0, 0, 0), 1003: (0, 0, 4) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Camera "witness"
    {
    }
}
"""


def test_a_layer_of_another_program_is_turned_upright(tmp_path: Path) -> None:
    path = tmp_path / "shot.usda"
    path.write_text(Z_UP)
    with pytest.raises(luxel.LuxelError, match="2 cameras, of which some move .*name the one to use"):
        luxel.read_cameras(path, width=64, height=36)
    with pytest.raises(luxel.LuxelError, match="no camera .other., expected one of /Rig/hero, /Rig/witness"):
        luxel.read_cameras(path, camera="other", width=64, height=36)
    found = luxel.read_cameras(path, camera="hero", width=64, height=36)
    assert list(found) == ["hero.1001", "hero.1002", "hero.1003"]
    middle = found["hero.1002"]
    # The size is of the aperture's shape. Luxel's world has -Y up: Z up is -Y, and Y ahead is Z.
    assert (middle.width, middle.height, middle.K[0, 0], middle.K[1, 1]) == (64, 32, 64, 64)
    np.testing.assert_allclose(middle.position, [1, -5, 2], atol=1e-12)
    np.testing.assert_allclose(middle.forward, [0, 1, 0], atol=1e-12)
    path.write_text(Z_UP.replace("float focalLength = 36", 'token projection = "orthographic"'))
    with pytest.raises(luxel.LuxelError, match="camera /Rig/hero at time 1001: an orthographic camera"):
        luxel.read_cameras(path, camera="hero", width=64, height=36)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    panorama = luxel.Camera.panorama(np.eye(4), 64)
    with pytest.raises(luxel.LuxelError, match="pinhole cameras without distortion only"):
        luxel.write_cameras(tmp_path / "c.usda", {"sphere": panorama})
    with pytest.raises(luxel.LuxelError, match="expected the extension"):
        luxel.write_cameras(tmp_path / "c.usdz", cameras())
    with pytest.raises(luxel.LuxelError, match="at least one"):
        luxel.write_cameras(tmp_path / "c.json", {})
