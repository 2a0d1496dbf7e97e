"""Puts a chrome ball into a scene: lit by the scene's own light, behind and before its things.

    python chrome_ball.py SCENE DATASET OUTPUT --view NAME --at X,Y,Z --radius R

SCENE is a scene file or a run, X,Y,Z a point of the world where the ball lies. Needs `luxel` and
`bpy` (pip install bpy) in one Python. Writes OUTPUT/probe.exr, plate.exr, ball.exr, composite.exr and
composite.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import bpy
import luxel_blender
import numpy as np
from mathutils import Vector

import luxel

FAR = 1e9


def render_ball(folder: Path, camera: luxel.Camera, probe: luxel.Probe, at: list[float], radius: float) -> tuple[np.ndarray, ...]:
    """Renders the ball with Cycles; returns its radiance, coverage and depth."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    turn = luxel_blender.blender_from_world(probe.map_from_world.tolist())
    luxel_blender.set_world_light(folder / "probe.exr")
    luxel_blender.place_camera(camera.to_opengl().tolist(), camera.K.tolist(), camera.width, camera.height, turn)
    place = turn @ Vector(at)

    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=place + Vector((0, 0, radius)), segments=96, ring_count=48)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    chrome = bpy.data.materials.new("Chrome")
    chrome.use_nodes = True
    surface = chrome.node_tree.nodes["Principled BSDF"]
    surface.inputs["Metallic"].default_value = 1.0
    surface.inputs["Roughness"].default_value = 0.02
    ball.data.materials.append(chrome)
    bpy.ops.mesh.primitive_plane_add(size=12 * radius, location=place)
    bpy.context.object.is_shadow_catcher = True

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 128
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Standard"
    scene.view_layers[0].use_pass_z = True
    settings = scene.render.image_settings
    settings.file_format = "OPEN_EXR"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    path = folder / "ball.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    # What Blender writes has its rows from the bottom once they are pixels of it.
    image = bpy.data.images.load(str(path))
    pixels = np.array(image.pixels[:], np.float32).reshape(camera.height, camera.width, 4)[::-1]
    center = camera.project([list(world_center(at, radius, probe))])[1][0]
    return pixels[..., :3], pixels[..., 3], np.full(pixels.shape[:2], center, np.float32)


def world_center(at: list[float], radius: float, probe: luxel.Probe) -> np.ndarray:
    """Returns the middle of the ball in the world; up is the map's y."""
    return np.asarray(at) + radius * probe.map_from_world[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("dataset")
    parser.add_argument("output", type=Path)
    parser.add_argument("--view", help="name of the view whose camera looks on [default: the first test view]")
    parser.add_argument("--at", required=True, help="point that the ball lies on, world: X,Y,Z")
    parser.add_argument("--radius", type=float, required=True, help="radius of the ball, world units")
    arguments = parser.parse_args()
    at = [float(part) for part in arguments.at.split(",")]
    arguments.output.mkdir(parents=True, exist_ok=True)

    scene = luxel.Scene.open(arguments.scene)
    dataset = luxel.Dataset.open(arguments.dataset)
    views = {view.name: view for view in dataset.train + dataset.test}
    camera = (views[arguments.view] if arguments.view else dataset.test[0]).camera

    up = scene.probe(at, width=16, dataset=dataset).map_from_world[1]
    middle = [a + arguments.radius * u for a, u in zip(at, up)]
    probe = scene.probe(middle, width=1024, near=2 * arguments.radius, dataset=dataset)
    probe.save_exr(arguments.output / "probe.exr", exr_type="float")
    layers = scene.render_layers(camera)
    plate = layers["radiance"]
    luxel.write_exr(arguments.output / "plate.exr", plate, alpha=layers["alpha"], depth=np.minimum(layers["depth"], FAR), camera=camera)

    radiance, coverage, depth = render_ball(arguments.output, camera, probe, at, arguments.radius)
    # Blender multiplies colours by coverage. Things of the scene that are nearer hide the ball.
    hidden = (layers["depth"] < depth - arguments.radius)[..., None]
    composite = np.where(hidden, plate, radiance + plate * (1 - coverage[..., None]))
    luxel.write_exr(arguments.output / "composite.exr", composite, color_space=scene.color_space, camera=camera)
    luxel.write_preview(arguments.output / "composite.png", composite, white=scene.radiance_scale)


if __name__ == "__main__":
    main()
