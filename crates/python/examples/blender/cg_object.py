"""Puts an object into a scene of Luxel: lit by its lamps, with its shadow and its bounce on the plate.

    luxel lights run --at=X,Y,Z -o lights.usda
    luxel mesh run -o proxy.usdc
    luxel render run --cameras path.json -o plates --write-cameras cameras.usda
    python cg_object.py lights.usda proxy.usdc cameras.usda plates OUTPUT \\
        --object grey-ball --size 0.12 --pixel 120,150

Needs `bpy` (pip install bpy), or runs in Blender: blender --background --python cg_object.py -- ARGUMENTS.
Writes a composite for each plate, NAME.exr and NAME.png, what it is made of, NAME_object.exr
(premultiplied) and NAME_shadow.exr (a factor on the plate), and scene.blend to go on from.

How: the part of the proxy mesh near the object is the local scene. It gets the albedo with which it has
the radiance of its vertices under the lamps and the map. It is then rendered with the object and
without, and the plate is multiplied by the quotient.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
import luxel_blender  # noqa: E402

BALLS = {"grey-ball": (0.5, 0.0, 1.0), "chrome-ball": (1.0, 1.0, 0.02)}
ALBEDO_ROUNDS, BAKE_SAMPLES = 4, 64
DARKEST, BRIGHTEST = 0.01, 0.95


def open_scene(lights: Path, proxy: Path, cameras: Path) -> tuple[list[bpy.types.Object], bpy.types.Object, dict[str, bpy.types.Object]]:
    """Opens what Luxel wrote into an empty Blender; returns the lamps, the proxy mesh and the cameras by name."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    lamps, mesh = luxel_blender.add_lights(lights), luxel_blender.add_proxy(proxy)
    mesh.is_shadow_catcher = False
    eyes = {item.name: item for item in luxel_blender.import_usd(cameras) if item.type == "CAMERA"}
    if not eyes:
        raise ValueError(f"{cameras}: expected cameras, as luxel render --write-cameras writes them")
    return lamps, mesh, eyes


def look_through(cameras: dict[str, bpy.types.Object], plates: list[Path], number: int) -> bpy.types.Object:
    """Makes the camera of a plate the active one: by its name, or the frame of the only one, which moves."""
    scene, plate = bpy.context.scene, plates[number]
    named = [eye for name, eye in cameras.items() if name == plate.stem or name.endswith(f"_{plate.stem}")]
    if len(named) == 1:
        scene.camera = named[0]
    elif len(cameras) == 1:
        (scene.camera,) = cameras.values()
        scene.frame_set(scene.frame_start + number)
    else:
        raise ValueError(f"{plate}: no camera of that name among {', '.join(sorted(cameras))}")
    return scene.camera


def read_image(path: Path) -> np.ndarray:
    """Returns the linear RGBA [height, width, 4] of an OpenEXR file, rows from the top."""
    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.name = "Linear Rec.709"
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1].copy()


def write_image(path: Path, rgba: np.ndarray) -> None:
    """Writes linear RGBA [height, width, 4], rows from the top, as OpenEXR in 32 bits."""
    height, width, _ = rgba.shape
    image = bpy.data.images.new(path.stem, width, height, alpha=True, float_buffer=True)
    # Blender 5.3 gives linear images sRGB's curve as it saves them, and leaves these as they are.
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "PREMUL"
    image.pixels.foreach_set(np.ascontiguousarray(rgba[::-1], np.float32).ravel())
    image.filepath_raw, image.file_format = str(path), "OPEN_EXR"
    image.save()
    bpy.data.images.remove(image)


def write_preview(path: Path, rgb: np.ndarray, stops: float) -> None:
    """Writes radiance [height, width, 3] as a PNG: exposed, rolled off above 1, with sRGB's curve."""
    shown = rgb * 2.0**stops
    shown = np.clip(1 - np.exp(-np.clip(shown, 0, None)), 0, 1)
    curve = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * np.maximum(shown, 1e-9) ** (1 / 2.4) - 0.055)
    height, width, _ = rgb.shape
    rgba = np.concatenate([curve, np.ones((height, width, 1))], -1)
    image = bpy.data.images.new(path.stem, width, height, alpha=False)
    image.colorspace_settings.name = "sRGB"
    image.pixels.foreach_set(np.ascontiguousarray(rgba[::-1], np.float32).ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def place_at_pixel(camera: bpy.types.Object, proxy: bpy.types.Object, pixel: tuple[float, float], size: tuple[int, int]) -> Vector:
    """Returns the point of the proxy that a pixel of the plate shows; pixels count from the top left."""
    bpy.context.view_layer.update()
    top_right, bottom_right, _, top_left = (Vector(corner) for corner in camera.data.view_frame(scene=bpy.context.scene))
    u, v = (pixel[0] + 0.5) / size[0], (pixel[1] + 0.5) / size[1]
    direction = top_left + u * (top_right - top_left) + v * (bottom_right - top_right)
    to_mesh = proxy.matrix_world.inverted()
    eye = camera.matrix_world.translation
    hit, point, _, _ = proxy.ray_cast(to_mesh @ eye, (to_mesh.to_3x3() @ camera.matrix_world.to_3x3() @ direction).normalized())
    if not hit:
        raise ValueError(f"pixel {pixel[0]:g},{pixel[1]:g} shows nothing of the proxy mesh; choose one on a surface")
    return proxy.matrix_world @ point


def add_object(kind: str, size: float, at: Vector) -> list[bpy.types.Object]:
    """Adds a ball, a card or the objects of a file, `size` across and with its lowest point at `at`."""
    if kind in BALLS:
        bpy.ops.mesh.primitive_uv_sphere_add(radius=size / 2, location=at + Vector((0, 0, size / 2)), segments=96, ring_count=48)
        bpy.ops.object.shade_smooth()
        color, metallic, roughness = BALLS[kind]
        return [with_material(bpy.context.object, color, metallic, roughness)]
    if kind == "card":
        bpy.ops.mesh.primitive_cube_add(size=size, location=at + Vector((0, 0, size / 2)))
        bpy.context.object.scale = (1.0, 0.02, 1.0)
        return [with_material(bpy.context.object, 0.5, 0.0, 1.0)]
    path = Path(kind)
    before = set(bpy.data.objects)
    readers = {".glb": bpy.ops.import_scene.gltf, ".gltf": bpy.ops.import_scene.gltf, ".obj": bpy.ops.wm.obj_import}
    reader = readers.get(path.suffix.lower())
    if reader is not None:
        reader(filepath=str(path))
    elif path.suffix.lower() in {".usd", ".usda", ".usdc", ".usdz"}:
        luxel_blender.import_usd(path)
    else:
        raise ValueError(f"{kind}: expected {', '.join(BALLS)}, card, or a file of glTF, OBJ or OpenUSD")
    added = [item for item in bpy.data.objects if item not in before]
    stand_on(added, size, at)
    return [item for item in added if item.type == "MESH"]


def with_material(item: bpy.types.Object, color: float, metallic: float, roughness: float) -> bpy.types.Object:
    """Gives an object a plain material and returns it; a rough one has no highlight."""
    material = bpy.data.materials.new(item.name)
    material.use_nodes = True
    surface = material.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (color, color, color, 1.0)
    surface.inputs["Metallic"].default_value = metallic
    surface.inputs["Roughness"].default_value = roughness
    if roughness == 1.0:
        surface.inputs["Specular IOR Level"].default_value = 0.0
    item.data.materials.append(material)
    return item


def stand_on(items: list[bpy.types.Object], size: float, at: Vector) -> None:
    """Scales objects to `size` along their longest side, and stands them on a point."""
    bpy.context.view_layer.update()
    corners = np.array([item.matrix_world @ Vector(corner) for item in items if item.type == "MESH" for corner in item.bound_box])
    if not len(corners):
        raise ValueError("the object's file holds no mesh")
    low, high = corners.min(0), corners.max(0)
    root = bpy.data.objects.new("Object", None)
    bpy.context.scene.collection.objects.link(root)
    for item in items:
        if item.parent is None:
            item.parent = root
    scale = size / max((high - low).max(), 1e-12)
    root.scale = (scale, scale, scale)
    middle = Vector(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]))
    root.location = at - scale * middle
    bpy.context.view_layer.update()


def split_proxy(proxy: bpy.types.Object, lamps: list[bpy.types.Object], middle: Vector, near: float) -> tuple[bpy.types.Object, bpy.types.Object]:
    """Cuts the proxy into the local scene, within `near` of a point, and the rest; returns both.

    The light of the rest is in the map already, so it only hides objects. Faces in front of a lamp go: the
    mesh closes what cameras see as a bright surface.
    """
    mesh = proxy.data
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    positions = positions.reshape(-1, 3)
    world = positions @ np.array(proxy.matrix_world.to_3x3()).T + np.array(proxy.matrix_world.translation)
    faces = np.empty(3 * len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("vertices", faces)
    faces = faces.reshape(-1, 3)
    colors = np.empty(4 * len(mesh.vertices), np.float32)
    mesh.attributes["displayColor"].data.foreach_get("color", colors)
    colors = colors.reshape(-1, 4)[:, :3]
    is_lamp = np.zeros(len(world), bool)
    for lamp in lamps:
        away = np.linalg.norm(world - np.array(lamp.matrix_world.translation), axis=1)
        is_lamp |= away < 1.5 * lamp_radius(lamp)
    distance = np.linalg.norm(world - np.array(middle), axis=1)
    is_near = (distance < near)[faces].all(1) & ~is_lamp[faces].any(1)
    parts = [part_of(name, world, colors, faces[kept]) for name, kept in (("Local scene", is_near), ("Rest of the scene", ~is_near))]
    bpy.data.objects.remove(proxy)
    if not len(parts[0].data.polygons):
        raise ValueError(f"no part of the proxy mesh is within {near:g} of the object; --near takes more of it")
    return parts[0], parts[1]


def lamp_radius(lamp: bpy.types.Object) -> float:
    """Returns the radius that holds a lamp's surface."""
    if lamp.data.type == "POINT":
        return lamp.data.shadow_soft_size
    return 0.5 * (lamp.data.size if lamp.data.shape == "DISK" else float(np.hypot(lamp.data.size, lamp.data.size_y)))


def part_of(name: str, positions: np.ndarray, colors: np.ndarray, faces: np.ndarray) -> bpy.types.Object:
    """Makes an object of some faces [count,3], with the radiance of its vertices as `radiance`."""
    used, corners = np.unique(faces, return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions[used].tolist(), [], corners.reshape(-1, 3).tolist())
    for layer in ("radiance", "albedo", "bake"):
        attribute = mesh.color_attributes.new(layer, "FLOAT_COLOR", "POINT")
        rgba = np.concatenate([colors[used], np.ones((len(used), 1), np.float32)], 1)
        attribute.data.foreach_set("color", np.ascontiguousarray(rgba, np.float32).ravel())
    mesh.shade_smooth()
    part = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(part)
    return part


def vertex_colors(item: bpy.types.Object, layer: str) -> np.ndarray:
    """Returns the colours [vertices,3] of a layer."""
    values = np.empty(4 * len(item.data.vertices), np.float32)
    item.data.attributes[layer].data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]


def set_vertex_colors(item: bpy.types.Object, layer: str, colors: np.ndarray) -> None:
    """Sets the colours [vertices,3] of a layer."""
    rgba = np.concatenate([colors, np.ones((len(colors), 1), np.float32)], 1)
    item.data.attributes[layer].data.foreach_set("color", np.ascontiguousarray(rgba, np.float32).ravel())
    item.data.update()


def diffuse_of_vertices(local: bpy.types.Object) -> None:
    """Gives the local scene a matt material with the albedo of its vertices."""
    material = bpy.data.materials.new("Albedo of the vertices")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    color = nodes.new("ShaderNodeVertexColor")
    color.layer_name = "albedo"
    surface, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    links.new(color.outputs["Color"], surface.inputs["Color"])
    links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    local.data.materials.append(material)


def fit_albedo(local: bpy.types.Object) -> float:
    """Finds the albedo with which the local scene has its vertices' radiance; returns the median relative error left."""
    diffuse_of_vertices(local)
    radiance = vertex_colors(local, "radiance")
    albedo = np.full_like(radiance, 0.5)
    scene = bpy.context.scene
    scene.cycles.samples = BAKE_SAMPLES
    bpy.ops.object.select_all(action="DESELECT")
    local.select_set(True)
    bpy.context.view_layer.objects.active = local
    error = np.inf
    for _ in range(ALBEDO_ROUNDS):
        set_vertex_colors(local, "albedo", albedo)
        local.data.color_attributes.active_color = local.data.color_attributes["bake"]
        bpy.ops.object.bake(type="COMBINED", target="VERTEX_COLORS", use_clear=True)
        lit = np.maximum(vertex_colors(local, "bake"), 1e-9)
        error = float(np.median(np.abs(lit - radiance) / np.maximum(radiance, 1e-9)))
        albedo = np.clip(albedo * np.clip(radiance / lit, 0.2, 5.0), DARKEST, BRIGHTEST)
    set_vertex_colors(local, "albedo", albedo)
    return error


def render(path: Path, samples: int) -> np.ndarray:
    """Renders the scene as it is to a file and returns its RGBA, premultiplied."""
    scene = bpy.context.scene
    scene.cycles.samples = samples
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return read_image(path)


def set_up_cycles(size: tuple[int, int]) -> None:
    """Chooses Cycles, the size of the plates, and no display transform."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *size, 100
    scene.render.film_transparent = True
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.use_denoising = True
    scene.view_settings.view_transform = "Standard"


def composite(objects: list[bpy.types.Object], local: bpy.types.Object, plate: np.ndarray, path: Path, samples: int) -> np.ndarray:
    """Renders the object alone, and the local scene with it and without; returns the composite's radiance.

    Writes PATH_object.exr and PATH_shadow.exr.
    """
    local.is_holdout = True
    alone = render(path.with_name(f"{path.name}_object.exr"), samples)
    local.is_holdout = False
    for item in objects:
        item.visible_camera = False
    passes = [path.with_name(f"{path.name}_{name}.exr") for name in ("with", "without")]
    lit_with = render(passes[0], samples)
    for item in objects:
        item.hide_render = True
    lit_without = render(passes[1], samples)
    for item in objects:
        item.hide_render, item.visible_camera = False, True
    covered = np.minimum(lit_with[..., 3:], lit_without[..., 3:])
    factor = np.where(covered > 0.5, lit_with[..., :3] / np.maximum(lit_without[..., :3], 1e-6), 1.0)
    factor = 1 + covered * (factor - 1)
    write_image(path.with_name(f"{path.name}_shadow.exr"), np.concatenate([factor, np.ones_like(covered)], -1))
    for written in passes:
        written.unlink()
    return alone[..., :3] + (1 - alone[..., 3:]) * factor * plate[..., :3]


def arguments_of(given: list[str]) -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lights", type=Path, help="from luxel lights, .usda")
    parser.add_argument("proxy", type=Path, help="from luxel mesh, .usdc or .usda")
    parser.add_argument("cameras", type=Path, help="from luxel render --write-cameras, .usda")
    parser.add_argument("plates", type=Path, help="from luxel render, .exr in linear Rec.709, or their folder")
    parser.add_argument("output", type=Path, help="folder that the images are written to")
    parser.add_argument("--object", default="grey-ball", help="grey-ball, chrome-ball, card, or a file: glTF, OBJ, OpenUSD [default: grey-ball]")
    parser.add_argument("--size", type=float, required=True, help="longest side of the object, world units")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--pixel", help="pixel of the first plate that shows where it stands: X,Y from the top left")
    where.add_argument("--at", help="point that it stands on, in Blender's axes (+Z up): X,Y,Z")
    parser.add_argument("--near", type=float, help="radius of the local scene, world units [default: 3 times the size]")
    parser.add_argument("--samples", type=int, default=256, help="of each pixel [default: 256]")
    parser.add_argument("--exposure", type=float, default=0.0, help="stops of the preview [default: 0]")
    return parser.parse_args(given)


def numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    """Returns the numbers of an option such as 1,2,3."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ValueError(f"{option} {text}: expected {count} numbers with commas between them")
    return values


def check_usd_space(path: Path) -> None:
    """Refuses lamps and meshes of another colour space than Blender's own, as far as their file states it as text or bytes."""
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    content = path.read_bytes()
    others = [space for space in (b"lin_ap1_scene", b"lin_ap0_scene", b"lin_rec2020_scene", b"lin_p3d65_scene") if space in content]
    if others:
        raise ValueError(f"{path}: colours are {others[0].decode()}, expected lin_rec709_scene; write it with --output-color-space linear-rec709")


def plates_of(path: Path) -> list[Path]:
    """Returns the plates of a folder in the order of their names, or the one that a path names."""
    plates = sorted(path.glob("*.exr")) if path.is_dir() else [path]
    if not plates or not plates[0].is_file():
        raise ValueError(f"{path}: expected an OpenEXR file, or a folder with some")
    return plates


def run(given: argparse.Namespace) -> None:
    """Does everything, from the files to the composites."""
    plates = plates_of(given.plates)
    for path in plates:
        luxel_blender.check_linear_rec709(path)
    for path in (given.lights, given.proxy):
        check_usd_space(path)
    if given.size <= 0 or (given.near is not None and given.near <= 0) or given.samples < 1:
        raise ValueError("--size and --near: expected lengths above 0; --samples: expected 1 or more")
    lamps, proxy, cameras = open_scene(given.lights, given.proxy, given.cameras)
    first = read_image(plates[0])
    size = (first.shape[1], first.shape[0])
    set_up_cycles(size)
    camera = look_through(cameras, plates, 0)
    if given.pixel:
        point = place_at_pixel(camera, proxy, numbers(given.pixel, 2, "--pixel"), size)
    else:
        point = Vector(numbers(given.at, 3, "--at"))
    near = given.near or 3 * given.size
    local, rest = split_proxy(proxy, lamps, point, near)
    luxel_blender.hide_from_light(rest)
    error = fit_albedo(local)
    print(f"stands on      {point.x:.4f} {point.y:.4f} {point.z:.4f}")
    print(f"local scene    {len(local.data.polygons):,} triangles within {near:g}")
    print(f"its radiance   met within {100 * error:.1f} % (median of its vertices)")
    objects = add_object(given.object, given.size, point)
    given.output.mkdir(parents=True, exist_ok=True)
    for number, path in enumerate(plates):
        look_through(cameras, plates, number)
        plate = read_image(path)
        if plate.shape != first.shape:
            raise ValueError(f"{path}: {plate.shape[1]} x {plate.shape[0]} pixels, expected {size[0]} x {size[1]} as in {plates[0]}")
        target = given.output / path.stem
        radiance = composite(objects, local, plate, target, given.samples)
        write_image(given.output / path.name, np.concatenate([radiance, np.ones_like(radiance[..., :1])], -1))
        write_preview(target.with_suffix(".png"), radiance, given.exposure)
        print(f"composite      {given.output / path.name}", flush=True)
    bpy.ops.wm.save_as_mainfile(filepath=str((given.output / "scene.blend").resolve()))


def main() -> int:
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    try:
        run(arguments_of(given))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
