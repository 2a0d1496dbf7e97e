"""The Blender add-on, where `bpy` is installed (pip install bpy): cameras, light and plates to the pixel."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import luxel

bpy = pytest.importorskip("bpy", reason="bpy is not installed")
sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "blender"))
import luxel_blender  # noqa: E402

TURN = [[0.0, 0.6, 0.8], [0.0, 0.8, -0.6], [-1.0, 0.0, 0.0]]


@pytest.fixture(autouse=True)
def empty_scene() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)


def camera() -> luxel.Camera:
    looking = luxel.Camera.look_at([1.0, -2.0, 3.0], [0.0, 0.2, 0.1], [0.0, -0.8, 0.6], 50, 64, 48)
    k = looking.K
    k[0, 2] += 3.0
    k[1, 2] -= 2.0
    return luxel.Camera(looking.camera_from_world, k, 64, 48)


def test_a_camera_goes_to_blender_and_comes_back() -> None:
    turn = luxel_blender.blender_from_world(TURN)
    there = camera()
    luxel_blender.place_camera(there.to_opengl().tolist(), there.K.tolist(), there.width, there.height, turn)
    scene = bpy.context.scene
    scene.frame_start = scene.frame_end = 1
    path = luxel_blender.camera_path(turn)
    back = luxel.Camera.from_nerfstudio(path["frames"][0])
    np.testing.assert_allclose(back.camera_from_world, there.camera_from_world, atol=1e-5)
    np.testing.assert_allclose(back.K, there.K, rtol=1e-5)


def test_a_camera_that_blender_exports_as_usd_comes_back(tmp_path: Path) -> None:
    # Without a data set -Y is up in the world, which is +Y in the exported stage and +Z in Blender.
    turn = luxel_blender.Matrix(((1, 0, 0), (0, 0, 1), (0, -1, 0)))
    there = camera()
    luxel_blender.place_camera(there.to_opengl().tolist(), there.K.tolist(), there.width, there.height, turn)
    for frame, x in ((1, 0.0), (3, 2.0)):
        bpy.context.scene.camera.location.x += x
        bpy.context.scene.camera.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 3
    path = tmp_path / "shot.usdc"
    bpy.ops.wm.usd_export(filepath=str(path), export_animation=True)
    found = list(luxel.read_cameras(path, width=64, height=48).values())
    assert len(found) == 3
    np.testing.assert_allclose(found[0].camera_from_world, there.camera_from_world, atol=1e-5)
    np.testing.assert_allclose(found[0].K, there.K, rtol=1e-5)
    np.testing.assert_allclose(found[2].position, there.position + [2.0, 0, 0], atol=1e-5)


def test_blender_sees_a_thing_where_luxel_does(tmp_path: Path) -> None:
    turn, there = luxel_blender.blender_from_world(TURN), camera()
    luxel_blender.place_camera(there.to_opengl().tolist(), there.K.tolist(), there.width, there.height, turn)
    at = [0.3, 0.1, 0.2]
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.05, location=turn @ luxel_blender.Vector(at))
    pixels = render(tmp_path / "dot.exr")
    y, x = np.nonzero(pixels[..., 3] > 0.5)
    expected = there.project([at])[0][0]
    np.testing.assert_allclose([x.mean() + 0.5, y.mean() + 0.5], expected, atol=0.6)


def test_light_comes_from_where_the_probe_has_it(tmp_path: Path) -> None:
    """A map with one bright spot, seen by a camera that looks at it through Blender's world."""
    image = np.full((32, 64, 3), 0.01, np.float32)
    image[8:11, 20:23] = [50.0, 20.0, 5.0]
    luxel.write_exr(tmp_path / "probe.exr", image, exr_type="float")
    # Longitude falls from 180 degrees at the left; 0 is +z and 90 is +x.
    longitude, latitude = np.pi - 2 * np.pi * 21.5 / 64, np.pi / 2 - np.pi * 9.5 / 32
    direction = np.array([np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)])
    in_world = np.linalg.inv(TURN) @ direction
    looking = luxel.Camera.look_at([0, 0, 0], in_world, np.linalg.inv(TURN) @ [0, 1, 0], 60, 33, 33)
    turn = luxel_blender.blender_from_world(TURN)
    luxel_blender.place_camera(looking.to_opengl().tolist(), looking.K.tolist(), 33, 33, turn)
    luxel_blender.set_world_light(tmp_path / "probe.exr")
    bpy.context.scene.render.film_transparent = False
    pixels = render(tmp_path / "world.exr")
    y, x = np.unravel_index(pixels[..., 0].argmax(), pixels.shape[:2])
    assert abs(x - 16) <= 2 and abs(y - 16) <= 2, (x, y)
    assert pixels[y, x, 0] == pytest.approx(50.0, rel=0.1), "radiance is neither tone-mapped nor cut"


def render(path: Path) -> np.ndarray:
    """Renders with Cycles: RGBA [height, width, 4], linear."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.render.film_transparent = scene.render.film_transparent or scene.world is None
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    loaded = bpy.data.images.load(str(path))
    width, height = loaded.size
    return np.array(loaded.pixels[:], np.float32).reshape(height, width, 4)[::-1]


def test_depth_is_a_surface_that_hides_what_is_behind_it(tmp_path: Path) -> None:
    turn, there = luxel_blender.blender_from_world(TURN), camera()
    eye = luxel_blender.place_camera(there.to_opengl().tolist(), there.K.tolist(), there.width, there.height, turn)
    bpy.context.view_layer.update()
    # A wall at 3 on the left half, nothing on the right.
    depth = np.full((48, 64), 1e10, np.float32)
    depth[:, :32] = 3.0
    rng = np.random.default_rng(1)
    depth[:, :32] += 0.01 * rng.random((48, 32), np.float32)
    luxel.write_exr(tmp_path / "wall.exr", np.ones((48, 64, 3), np.float32), depth=depth, alpha=np.ones((48, 64), np.float32))
    assert np.array_equal(luxel_blender.read_depth(tmp_path / "wall.exr"), depth)
    wall = luxel_blender.add_depth(tmp_path / "wall.exr", step=1)
    back = np.array(turn.inverted())
    world = np.array([back @ np.array(wall.matrix_world @ vertex.co) for vertex in wall.data.vertices])
    pixels, distance = there.project(world)
    assert len(world) == 48 * 32 and len(wall.data.polygons) == 47 * 31
    y, x = (pixels[:, 1] - 0.5).round().astype(int), (pixels[:, 0] - 0.5).round().astype(int)
    np.testing.assert_allclose(pixels, np.stack([x, y], -1) + 0.5, atol=1e-3)
    np.testing.assert_allclose(distance, depth[y, x], rtol=1e-5)
    # A large ball behind the wall is seen on the right alone.
    bpy.ops.mesh.primitive_uv_sphere_add(radius=2.0, location=eye.matrix_world @ luxel_blender.Vector((0.0, 0.0, -6.0)))
    bpy.context.scene.render.film_transparent = True
    coverage = render(tmp_path / "ball.exr")[..., 3]
    assert coverage[10:38, :30].max() < 0.5 and coverage[20:28, 35:40].min() > 0.5


@pytest.fixture(scope="module")
def out(dataset: luxel.Dataset, scene: luxel.Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Lamps, mesh, cameras and plates of the scene of all tests, as files."""
    folder: Path = tmp_path_factory.mktemp("out")
    scene.lights(dataset, medians=20, width=64).save(folder / "lights.usda")
    scene.mesh(dataset, voxel=0.1, min_island=0.2).save(folder / "proxy.usdc")
    views = {f"images_{n}": view.camera for n, view in enumerate(dataset.train[:2])}
    luxel.write_cameras(folder / "cameras.usda", views, dataset=dataset)
    (folder / "plates").mkdir()
    for n, view in enumerate(views.values()):
        luxel.write_exr(folder / "plates" / f"{n}.exr", scene.render(view, device="cpu"), camera=view)
    return folder


def test_lamps_come_with_their_radiance_and_the_map(scene: luxel.Scene, dataset: luxel.Dataset, out: Path) -> None:
    lamp = scene.lights(dataset, medians=20, map=False).lamps[0]
    (item,) = luxel_blender.add_lights(out / "lights.usda")
    # Blender's energy of a lamp that is not normalised is pi times radiance.
    np.testing.assert_allclose(np.array(item.data.color) * item.data.energy / np.pi, lamp["radiance"], rtol=1e-3)
    assert any(node.type == "TEX_ENVIRONMENT" for node in bpy.context.scene.world.node_tree.nodes)
    with pytest.raises(ValueError, match="no such file"):
        luxel_blender.add_lights(out / "nowhere.usda")


MESH_LAMP = """#usda 1.0
(
    defaultPrim = "Lights"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "Lights" {
    def Mesh "Lamp_1" (
        prepend apiSchemas = ["MeshLightAPI", "MaterialBindingAPI"]
    )
    {
        int[] faceVertexCounts = [3, 3, 3, 3]
        int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
        uniform token subdivisionScheme = "none"
        rel material:binding = <Glow>
        def Material "Glow" {
            token outputs:surface.connect = <Surface.outputs:surface>
            def Shader "Surface" {
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:emissiveColor = (40, 20, 10)
                token outputs:surface
            }
        }
    }
}
"""


def test_a_lamp_that_is_a_mesh_shines(tmp_path: Path) -> None:
    path = tmp_path / "lights.usda"
    path.write_text(MESH_LAMP)
    (item,) = luxel_blender.add_lights(path)
    assert item.type == "MESH" and len(item.data.polygons) == 4
    shader = next(node for node in item.data.materials[0].node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    found = np.array(shader.inputs["Emission Color"].default_value[:3]) * shader.inputs["Emission Strength"].default_value
    np.testing.assert_allclose(found, [40.0, 20.0, 10.0], rtol=1e-6)


def test_a_proxy_mesh_catches_hides_and_stops(out: Path) -> None:
    catcher = luxel_blender.add_proxy(out / "proxy.usdc")
    assert catcher.is_shadow_catcher and len(catcher.data.polygons) > 10
    holdout = luxel_blender.add_proxy(out / "proxy.usdc", "HOLDOUT")
    assert holdout.is_holdout and not holdout.visible_shadow
    collider = luxel_blender.add_proxy(out / "proxy.usdc", "COLLIDER")
    assert collider.hide_render and collider.rigid_body.type == "PASSIVE"
    with pytest.raises(ValueError, match="one mesh"):
        luxel_blender.add_proxy(out / "cameras.usda")


def test_a_body_comes_to_rest_on_a_collider() -> None:
    bpy.ops.mesh.primitive_plane_add(size=4.0)
    luxel_blender.collide(bpy.context.object)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.2, location=(0.0, 0.0, 1.0))
    ball = bpy.context.object
    bpy.ops.rigidbody.object_add(type="ACTIVE")
    ball.rigid_body.collision_shape = "SPHERE"
    for frame in range(1, 101):
        bpy.context.scene.frame_set(frame)
    height = ball.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world.translation.z
    assert height == pytest.approx(0.2, abs=0.05)


def test_colours_that_blender_would_take_for_others_are_refused(scene: luxel.Scene, dataset: luxel.Dataset, out: Path, tmp_path: Path) -> None:
    cg_object = pytest.importorskip("cg_object")
    camera = dataset.train[0].camera
    (tmp_path / "plates").mkdir()
    plate = luxel.convert_color_space(scene.render(camera, device="cpu"), "linear-rec709", "acescg")
    luxel.write_exr(tmp_path / "plates" / "0.exr", plate, color_space="acescg")
    scene.lights(dataset, medians=20, map=False, color_space="acescg").save(tmp_path / "lights.usda")
    for lights, plates in ((out / "lights.usda", tmp_path / "plates"), (tmp_path / "lights.usda", out / "plates")):
        words = [lights, out / "proxy.usdc", out / "cameras.usda", plates, tmp_path / "shot", "--size", "0.3", "--pixel", "16,12"]
        with pytest.raises(ValueError, match="lin_ap1_scene, expected lin_rec709_scene"):
            cg_object.run(cg_object.arguments_of([str(word) for word in words]))
    with pytest.raises(ValueError, match="lin_ap1_scene"):
        luxel_blender.set_world_light(tmp_path / "plates" / "0.exr")


def test_an_object_is_composited_with_its_shadow(out: Path, tmp_path: Path) -> None:
    cg_object = pytest.importorskip("cg_object")
    words = [out / "lights.usda", out / "proxy.usdc", out / "cameras.usda", out / "plates", tmp_path / "shot"]
    options = ["--object", "grey-ball", "--size", "0.3", "--near", "2", "--pixel", "16,12", "--samples", "4"]
    cg_object.run(cg_object.arguments_of([*map(str, words), *options]))
    for n in (0, 1):
        plate, made = (luxel.read_image(path)[0] for path in (out / "plates" / f"{n}.exr", tmp_path / "shot" / f"{n}.exr"))
        # Blender reads half floats; far from the object nothing changes.
        difference = np.abs(made - plate).max(-1)
        assert difference[0, 0] == pytest.approx(0, abs=1e-3) and difference.max() > 1
        for part in ("object", "shadow"):
            assert (tmp_path / "shot" / f"{n}_{part}.exr").stat().st_size > 0
    assert (tmp_path / "shot" / "scene.blend").exists()
    with pytest.raises(ValueError, match="shows nothing of the proxy mesh"):
        cg_object.run(cg_object.arguments_of([*map(str, words), *options[:-3], "0,0"]))
