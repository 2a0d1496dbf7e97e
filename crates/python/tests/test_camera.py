"""Cameras from and to other conventions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import luxel

K = np.array([[100.0, 0, 50], [0, 110, 40], [0, 0, 1]])


def pose(angle: float = 0.3) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]
    matrix[:3, 3] = [0.1, -0.2, 0.5]
    return matrix


def test_opencv_comes_back_as_it_went_in() -> None:
    camera = luxel.Camera.from_opencv(pose(), K, 100, 80)
    found, lens = camera.to_opencv()
    np.testing.assert_array_equal(found, pose())
    np.testing.assert_array_equal(lens, K)
    assert (camera.width, camera.height, camera.projection) == (100, 80, "pinhole")
    np.testing.assert_allclose(camera.world_from_camera @ found, np.eye(4), atol=1e-15)


def test_a_point_projects_as_the_matrices_say() -> None:
    camera = luxel.Camera(pose(), K, 100, 80)
    points = np.array([[0.2, 0.1, 3.0], [0.0, 0.0, -5.0]])
    pixels, depth = camera.project(points)
    local = pose()[:3, :3] @ points[0] + pose()[:3, 3]
    expected = K @ (local / local[2])
    np.testing.assert_allclose(pixels[0], expected[:2], rtol=1e-14)
    assert depth[0] == pytest.approx(local[2])
    assert np.isnan(pixels[1]).all() and np.isnan(depth[1])
    direction = camera.directions(pixels[:1])[0]
    away = points[0] - camera.position
    np.testing.assert_allclose(direction, away / np.linalg.norm(away), rtol=1e-12)


def test_opengl_has_y_up_and_z_backwards() -> None:
    camera = luxel.Camera.from_opengl(np.eye(4), K, 100, 80)
    np.testing.assert_array_equal(camera.forward, [0, 0, -1])
    pixels, _ = camera.project([[0.0, 1.0, -5.0]])
    assert pixels[0, 1] < 40, "up in the world is up in the image"
    np.testing.assert_allclose(camera.to_opengl(), np.eye(4), atol=1e-15)


def test_colmap_and_nerfstudio_come_back() -> None:
    camera = luxel.Camera(pose(), K, 100, 80)
    for other in [
        luxel.Camera.from_colmap(**camera.to_colmap()),
        luxel.Camera.from_nerfstudio(camera.to_nerfstudio()),
    ]:
        np.testing.assert_allclose(other.camera_from_world, pose(), atol=1e-12)
        np.testing.assert_allclose(other.K, K, atol=1e-12)
    fisheye = luxel.Camera(pose(), K, 100, 80, projection="fisheye", fisheye=[0.01, 0.002, 0, 0])
    numbers = fisheye.to_colmap()
    assert numbers["model"] == "OPENCV_FISHEYE" and numbers["params"][4:6] == [0.01, 0.002]
    assert luxel.Camera.from_colmap(**numbers).fisheye == pytest.approx([0.01, 0.002, 0, 0])
    simple = luxel.Camera.from_colmap("SIMPLE_RADIAL", [90, 50, 40, 0.1], 100, 80, [1, 0, 0, 0], [0, 0, 0])
    assert simple.distortion == [0.1, 0, 0, 0] and simple.K[0, 0] == simple.K[1, 1] == 90


def test_a_camera_survives_pickling_and_compares() -> None:
    camera = luxel.Camera.panorama(pose(), 64)
    assert pickle.loads(pickle.dumps(camera)) == camera
    assert camera != camera.moved_to(np.eye(4))
    assert (camera.downscaled(2).width, camera.downscaled(2).height) == (32, 16)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: luxel.Camera(2 * np.eye(4), K, 4, 3), "last row"),
        (lambda: luxel.Camera(np.diag([2.0, 2, 2, 1]), K, 4, 3), "not a rotation"),
        (lambda: luxel.Camera(np.eye(3), K, 4, 3), "expected [4, 4] or [3, 4]"),
        (lambda: luxel.Camera(np.eye(4), np.eye(4), 4, 3), "K: array of shape [4, 4]"),
        (lambda: luxel.Camera(np.eye(4), K, 0, 3), "image size 0 x 3"),
        (lambda: luxel.Camera(np.eye(4), K, 4, 3, projection="orthographic"), '"fisheye" or "equirectangular"'),
        (lambda: luxel.Camera.from_colmap("FOV", [1], 4, 3, [1, 0, 0, 0], [0, 0, 0]), "expected one of SIMPLE_PINHOLE"),
        (lambda: luxel.Camera.look_at([0, 0, 0], [0, 1, 0], [0, 1, 0], 45, 4, 3), "up is the viewing direction"),
    ],
)
def test_what_is_no_camera_is_refused(make: object, message: str) -> None:
    with pytest.raises(luxel.LuxelError) as caught:
        make()  # type: ignore[operator]
    assert message in str(caught.value)
