"""Writes Blender's active camera, frame by frame, as a transforms.json for `luxel render --cameras`.

In Blender: open this file in the text editor and run it; or  blender scene.blend --background --python blender_camera_path.py -- path.json
The scene must be in the axes of the reconstruction: import the .ply or .usda as it is (luxel export --up as-is), or parent camera and splats
to one object and turn that. Camera shift and the render's resolution are honoured; depth of field and motion blur are not.
"""

import json
import sys

import bpy


def camera_path(scene):
    render = scene.render
    factor = render.resolution_percentage / 100
    width, height = int(render.resolution_x * factor), int(render.resolution_y * factor)
    pixel_aspect = render.pixel_aspect_y / render.pixel_aspect_x
    frames = []
    for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
        scene.frame_set(number)
        camera = scene.camera
        if camera is None or camera.data.type != "PERSP":
            raise SystemExit(f"frame {number}: expected an active perspective camera")
        lens = camera.data
        fit = lens.sensor_fit
        if fit == "AUTO":
            fit = "HORIZONTAL" if width >= pixel_aspect * height else "VERTICAL"
        sensor = lens.sensor_height if lens.sensor_fit == "VERTICAL" else lens.sensor_width
        span = width if fit == "HORIZONTAL" else pixel_aspect * height
        focal_x = lens.lens / sensor * span
        matrix = camera.matrix_world.normalized()
        frames.append({
            "file_path": f"frame_{number:05d}",
            "transform_matrix": [list(row) for row in matrix],
            "w": width,
            "h": height,
            "fl_x": focal_x,
            "fl_y": focal_x / pixel_aspect,
            "cx": width / 2 - lens.shift_x * span,
            "cy": height / 2 + lens.shift_y * span / pixel_aspect,
        })
    return {"fps": render.fps / render.fps_base, "frames": frames}


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []
    target = words[0] if words else bpy.path.abspath("//camera_path.json")
    with open(target, "w") as file:
        json.dump(camera_path(bpy.context.scene), file, indent=1)
    print(f"{target}: {bpy.context.scene.frame_end - bpy.context.scene.frame_start + 1} frames")
