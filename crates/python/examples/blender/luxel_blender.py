"""Blender add-on for Luxel: camera paths out; plates, depth, lamps, probes and proxy meshes in.

Install it in Blender (Edit, Preferences, Add-ons, Install from Disk), or import it in a script that
has `bpy`. Its panel is in the 3D view's sidebar, tab Luxel. Without a window:

    blender scene.blend --background --python luxel_blender.py -- camera_path.json

Coordinates: Blender's are those of Luxel's world, turned so that up is +Z. The turn is that of the
light probe's map, which `luxel.Probe.map_from_world` has; without a probe, nothing is turned.
Lamps and proxy meshes come as OpenUSD, with the axes that Blender gives its imports: they belong to
splats, cameras and maps from OpenUSD, and not to a world with that turn.
"""

from __future__ import annotations

import json
import struct
import sys
import zlib
from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatVectorProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper
from mathutils import Matrix, Vector

bl_info = {
    "name": "Luxel",
    "author": "The Luxel authors",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "3D View, sidebar, Luxel",
    "description": "Camera paths out; plates, depth, lamps, probes and proxy meshes in",
    "category": "Import-Export",
}

# From the axes of a latitude-longitude map (y up, its middle along z) to Blender's: z up, and the
# middle of an environment texture along x.
BLENDER_FROM_MAP = Matrix(((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))


def blender_from_world(map_from_world: list[list[float]] | None) -> Matrix:
    """Returns the turn [3,3] from Luxel's world to Blender's; None for a world with +Z up."""
    return Matrix.Identity(3) if map_from_world is None else BLENDER_FROM_MAP @ Matrix(map_from_world)


def set_world_light(path: str | Path, strength: float = 1.0) -> bpy.types.World:
    """Lights the scene with a probe, an OpenEXR file in latitude and longitude."""
    check_linear_rec709(path)
    world = bpy.data.worlds.new("Luxel probe")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(path), check_existing=True)
    texture.image.colorspace_settings.name = "Linear Rec.709"
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = strength
    output = nodes.new("ShaderNodeOutputWorld")
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    bpy.context.scene.world = world
    return world


def place_camera(world_from_camera_opengl: list[list[float]], k: list[list[float]], width: int, height: int, turn: Matrix) -> bpy.types.Object:
    """Makes a camera of Luxel's numbers, and sets the size of renders to its image.

    `world_from_camera_opengl` is `luxel.Camera.to_opengl()`, `k` its `K` with one focal length.
    """
    data = bpy.data.cameras.new("Luxel")
    camera = bpy.data.objects.new("Luxel", data)
    bpy.context.scene.collection.objects.link(camera)
    camera.matrix_world = turn.to_4x4() @ Matrix(world_from_camera_opengl)
    data.sensor_fit = "HORIZONTAL"
    data.lens = k[0][0] / width * data.sensor_width
    data.shift_x = (0.5 * width - k[0][2]) / width
    data.shift_y = (k[1][2] - 0.5 * height) / width
    scene = bpy.context.scene
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    return camera


def lens_px(camera: bpy.types.Object, width: int, height: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Returns the focal lengths and the principal point of a perspective camera, pixels from the top left."""
    lens, render = camera.data, bpy.context.scene.render
    pixel_aspect = render.pixel_aspect_y / render.pixel_aspect_x
    is_wide = lens.sensor_fit == "HORIZONTAL" or (lens.sensor_fit == "AUTO" and width >= pixel_aspect * height)
    sensor = lens.sensor_height if lens.sensor_fit == "VERTICAL" else lens.sensor_width
    span = width if is_wide else pixel_aspect * height
    focal = lens.lens / sensor * span
    center = 0.5 * width - lens.shift_x * span, 0.5 * height + lens.shift_y * span / pixel_aspect
    return (focal, focal / pixel_aspect), center


def camera_path(turn: Matrix) -> dict[str, object]:
    """Returns the active camera of every frame as a `transforms.json`, for `luxel render --cameras`.

    Camera shift, the size of renders and the aspect of pixels are honoured; depth of field and motion
    blur are not.
    """
    scene = bpy.context.scene
    render = scene.render
    width, height = (side * render.resolution_percentage // 100 for side in (render.resolution_x, render.resolution_y))
    world_from_blender = turn.inverted().to_4x4()
    frames = []
    kept = scene.frame_current
    for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
        scene.frame_set(number)
        camera = scene.camera
        if camera is None or camera.data.type != "PERSP":
            raise ValueError(f"frame {number}: expected an active perspective camera")
        (focal, focal_y), (cx, cy) = lens_px(camera, width, height)
        # A scaled camera sees the same; its axes are of unit length here.
        location, rotation, _ = camera.matrix_world.decompose()
        pose = world_from_blender @ Matrix.LocRotScale(location, rotation, None)
        frames.append(
            {
                "file_path": f"frame_{number:05}",
                "fl_x": focal,
                "fl_y": focal_y,
                "cx": cx,
                "cy": cy,
                "w": width,
                "h": height,
                "transform_matrix": [list(row) for row in pose],
            }
        )
    scene.frame_set(kept)
    return {"fps": render.fps / render.fps_base, "frames": frames}


def show_plate(path: str | Path) -> None:
    """Shows an OpenEXR file, or the sequence that it begins, behind the active camera's view."""
    image = bpy.data.images.load(str(path), check_existing=True)
    digits = Path(path).stem[-5:]
    if digits.isdigit() and len(list(Path(path).parent.glob("*.exr"))) > 1:
        image.source = "SEQUENCE"
    camera = bpy.context.scene.camera.data
    camera.show_background_images = True
    background = camera.background_images.new()
    background.image = image
    background.alpha = 1.0
    bpy.context.scene.render.film_transparent = True


def exr_header(data: bytes) -> tuple[dict[str, bytes], int] | None:
    """Returns the attributes of an OpenEXR file of scan lines, and where its header ends; None for another file."""
    if data[:8] != struct.pack("<II", 20000630, 2) and data[:8] != struct.pack("<II", 20000630, 0x402):
        return None
    attributes, at = {}, 8
    while data[at]:
        name = data[at : data.index(0, at)]
        at += len(name) + 1
        kind = data[at : data.index(0, at)]
        at += len(kind) + 1
        (size,) = struct.unpack_from("<I", data, at)
        attributes[name.decode()] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def check_linear_rec709(path: str | Path) -> None:
    """Refuses an OpenEXR file that states another colour space than Blender's own, which Blender would not heed."""
    header = exr_header(Path(path).read_bytes())
    space = header[0].get("colorInteropID", b"").decode() if header else ""
    if space not in {"", "lin_rec709_scene"}:
        raise ValueError(f"{path}: colours are {space}, expected lin_rec709_scene; write it with --output-color-space linear-rec709")


def read_depth(path: str | Path) -> np.ndarray:
    """Returns channel Z [height, width] of an OpenEXR file as `luxel render --depth` writes it.

    Blender gives scripts the colours of an image and its alpha, but not its depth.
    """
    data = Path(path).read_bytes()
    wrong = ValueError(f"{path}: expected an OpenEXR file of scan lines with ZIP compression, and Z in 32 bits")
    header = exr_header(data)
    if header is None:
        raise wrong
    attributes, at = header
    channels, place = [], 0
    while attributes["channels"][place]:
        end = attributes["channels"].index(0, place)
        (kind,) = struct.unpack_from("<I", attributes["channels"], end + 1)
        channels.append((attributes["channels"][place:end].decode(), 2 if kind == 1 else 4))
        place = end + 17
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    lines = {0: 1, 2: 1, 3: 16}.get(attributes["compression"][0])
    if lines is None or ("Z", 4) not in channels:
        raise wrong
    row = width * sum(size for _, size in channels)
    before = width * sum(size for name, size in channels if name < "Z")
    depth = np.zeros((height, width), np.float32)
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        y, size = struct.unpack_from("<iI", data, offset)
        count = min(lines, bottom - y + 1)
        block = np.frombuffer(data, np.uint8, size, offset + 8)
        if size < row * count:
            # Differences of bytes, of which the even ones come first.
            block = np.frombuffer(zlib.decompress(block.tobytes()), np.uint8).copy()
            block[1:] -= 128
            block = np.cumsum(block, dtype=np.uint8)
            halves = np.empty_like(block)
            halves[0::2], halves[1::2] = block[: -(-len(block) // 2)], block[-(-len(block) // 2) :]
            block = halves
        rows = block.reshape(count, row)[:, before : before + 4 * width]
        depth[y - top : y - top + count] = np.ascontiguousarray(rows).view("<f4")
    return depth


def add_depth(path: str | Path, step: int = 2) -> bpy.types.Object:
    """Adds what an image's depth shows as a mesh before the active camera, a vertex for every `step` pixels.

    The mesh is a holdout: renders are transparent where it is nearer, and the plate is seen there.
    """
    scene = bpy.context.scene
    camera = scene.camera
    if camera is None or camera.data.type != "PERSP":
        raise ValueError("expected an active perspective camera, from which the image was rendered")
    depth = read_depth(path)
    height, width = depth.shape
    (fx, fy), (cx, cy) = lens_px(camera, width, height)
    y, x = np.mgrid[0:height:step, 0:width:step]
    z = depth[y, x]
    local = np.stack([(x + 0.5 - cx) / fx * z, -(y + 0.5 - cy) / fy * z, -z], -1)
    corners = np.stack([z[:-1, :-1], z[1:, :-1], z[1:, 1:], z[:-1, 1:]])
    # No surface over a step in depth, nor where there is nothing.
    connected = (corners.min(0) > 0) & (corners.max(0) < 1e9) & (corners.max(0) < 1.1 * corners.min(0))
    number = np.arange(z.size).reshape(z.shape)
    faces = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], -1)[connected]
    used, faces = np.unique(faces, return_inverse=True)
    mesh = bpy.data.meshes.new("Luxel depth")
    mesh.from_pydata(local.reshape(-1, 3)[used].tolist(), [], faces.reshape(-1, 4).tolist())
    surface = bpy.data.objects.new("Luxel depth", mesh)
    location, rotation, _ = camera.matrix_world.decompose()
    surface.matrix_world = Matrix.LocRotScale(location, rotation, None)
    surface.is_holdout = True
    scene.collection.objects.link(surface)
    return surface


def add_points(positions: object, size: float, turn: Matrix, name: str = "Luxel points") -> bpy.types.Object:
    """Adds points of the world [count,3] as a mesh of vertices, to place things by."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([turn @ Vector(position) for position in positions], [], [])
    points = bpy.data.objects.new(name, mesh)
    points.display_type = "WIRE"
    points["luxel_point_size"] = size
    bpy.context.scene.collection.objects.link(points)
    return points


def import_usd(path: str | Path) -> list[bpy.types.Object]:
    """Imports an OpenUSD file and returns its objects; Blender turns +Y up into +Z up."""
    if not Path(path).is_file():
        raise ValueError(f"{path}: no such file")
    before = set(bpy.data.objects)
    if "FINISHED" not in bpy.ops.wm.usd_import(filepath=str(path)):
        raise ValueError(f"{path}: Blender could not read it as OpenUSD")
    return [item for item in bpy.data.objects if item not in before]


def add_lights(path: str | Path) -> list[bpy.types.Object]:
    """Adds the lamps of a file of `luxel lights`, and its map as the world."""
    # Blender drops a DomeLight where there is no world.
    if bpy.context.scene.world is None:
        bpy.context.scene.world = bpy.data.worlds.new("Luxel")
    # Lamps of no simple shape are meshes that shine.
    lights = [item for item in import_usd(path) if item.type == "LIGHT" or item.name.startswith("Lamp_")]
    # Blender makes lamps of portals.
    kept = [item for item in lights if not item.name.startswith("Portal_")]
    for stray in [item for item in lights if item.name.startswith("Portal_")]:
        bpy.data.objects.remove(stray)
    return kept


ROLES = (
    ("CATCHER", "Shadow catcher", "Shows the shadows of objects on the plate"),
    ("HOLDOUT", "Holdout", "Hides objects that are behind it"),
    ("COLLIDER", "Collider", "Stops rigid bodies, and is not rendered"),
)


def add_proxy(path: str | Path, role: str = "CATCHER") -> bpy.types.Object:
    """Adds a mesh of `luxel mesh` in one of the `ROLES`."""
    meshes = [item for item in import_usd(path) if item.type == "MESH"]
    if len(meshes) != 1 or "displayColor" not in meshes[0].data.attributes:
        raise ValueError(f"{path}: expected one mesh with displayColor, as luxel mesh writes it")
    (proxy,) = meshes
    proxy.name = "Luxel proxy"
    if role == "CATCHER":
        proxy.is_shadow_catcher = True
    elif role == "HOLDOUT":
        hide_from_light(proxy)
    else:
        proxy.hide_render = True
        collide(proxy)
    return proxy


def hide_from_light(mesh: bpy.types.Object) -> None:
    """Lets a mesh hide what is behind it, and do nothing else: its light is in the map already."""
    mesh.is_holdout = True
    for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(mesh, f"visible_{ray}", False)


def collide(mesh: bpy.types.Object) -> None:
    """Makes a mesh a body that does not move and that others fall on."""
    bpy.ops.object.select_all(action="DESELECT")
    mesh.select_set(True)
    bpy.context.view_layer.objects.active = mesh
    bpy.ops.rigidbody.object_add(type="PASSIVE")
    mesh.rigid_body.collision_shape = "MESH"


class LuxelSettings(bpy.types.PropertyGroup):
    """Settings of the add-on."""

    map_from_world: FloatVectorProperty(  # type: ignore[valid-type]
        name="Map from world", description="Turn of the light probe's map, row by row", size=9, default=(0, 1, 0, 0, 0, 1, 1, 0, 0)
    )


def turn_of(context: bpy.types.Context) -> Matrix:
    """Returns the turn from Luxel's world to Blender's that is set in the panel."""
    m = list(context.scene.luxel.map_from_world)
    return blender_from_world([m[0:3], m[3:6], m[6:9]])


class LUXEL_OT_world_light(bpy.types.Operator, ImportHelper):  # noqa: N801
    """Light the scene with a probe of Luxel"""

    bl_idname = "luxel.world_light"
    bl_label = "Probe as world light"
    filter_glob: StringProperty(default="*.exr", options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            set_world_light(self.filepath)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LUXEL_OT_camera_path(bpy.types.Operator, ExportHelper):  # noqa: N801
    """Write the active camera of all frames for luxel render --cameras"""

    bl_idname = "luxel.camera_path"
    bl_label = "Camera path"
    filename_ext = ".json"

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            path = camera_path(turn_of(context))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        Path(self.filepath).write_text(json.dumps(path, indent=1))
        return {"FINISHED"}


class LUXEL_OT_plate(bpy.types.Operator, ImportHelper):  # noqa: N801
    """Show a render of Luxel, or a sequence of them, behind the camera's view"""

    bl_idname = "luxel.plate"
    bl_label = "Plate"
    filter_glob: StringProperty(default="*.exr", options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        if context.scene.camera is None:
            self.report({"ERROR"}, "The scene has no active camera")
            return {"CANCELLED"}
        show_plate(self.filepath)
        return {"FINISHED"}


class LUXEL_OT_depth(bpy.types.Operator, ImportHelper):  # noqa: N801
    """Add the depth of a render of Luxel as a surface that hides what is behind it"""

    bl_idname = "luxel.depth"
    bl_label = "Depth"
    filter_glob: StringProperty(default="*.exr", options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            add_depth(self.filepath)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LUXEL_OT_lights(bpy.types.Operator, ImportHelper):  # noqa: N801
    """Add the lamps of luxel lights, and its map as the world"""

    bl_idname = "luxel.lights"
    bl_label = "Lamps"
    filter_glob: StringProperty(default="*.usda", options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            add_lights(self.filepath)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LUXEL_OT_proxy(bpy.types.Operator, ImportHelper):  # noqa: N801
    """Add a mesh of luxel mesh that catches shadows, hides objects or stops bodies"""

    bl_idname = "luxel.proxy"
    bl_label = "Proxy mesh"
    filter_glob: StringProperty(default="*.usdc;*.usda;*.usdz", options={"HIDDEN"})  # type: ignore[valid-type]
    role: EnumProperty(name="Role", items=ROLES, default="CATCHER")  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            add_proxy(self.filepath, self.role)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LUXEL_PT_panel(bpy.types.Panel):  # noqa: N801
    """The panel in the sidebar."""

    bl_label = "Luxel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Luxel"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column()
        column.operator(LUXEL_OT_world_light.bl_idname)
        column.operator(LUXEL_OT_plate.bl_idname)
        column.operator(LUXEL_OT_depth.bl_idname)
        column.operator(LUXEL_OT_lights.bl_idname)
        column.operator(LUXEL_OT_proxy.bl_idname)
        column.operator(LUXEL_OT_camera_path.bl_idname)
        column.prop(context.scene.luxel, "map_from_world")


CLASSES = (
    LuxelSettings,
    LUXEL_OT_world_light,
    LUXEL_OT_camera_path,
    LUXEL_OT_plate,
    LUXEL_OT_depth,
    LUXEL_OT_lights,
    LUXEL_OT_proxy,
    LUXEL_PT_panel,
)


def register() -> None:
    """Registers the add-on."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.luxel = bpy.props.PointerProperty(type=LuxelSettings)


def unregister() -> None:
    """Removes the add-on."""
    del bpy.types.Scene.luxel
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)


if __name__ == "__main__":
    register()
    if "--" in sys.argv:
        target = Path(sys.argv[sys.argv.index("--") + 1])
        target.write_text(json.dumps(camera_path(turn_of(bpy.context)), indent=1))
