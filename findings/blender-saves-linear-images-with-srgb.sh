#!/usr/bin/env bash
# Blender 5.3.0 as a Python module: Image.save writes sRGB-encoded numbers into OpenEXR.
#
# Guess: a new image with float pixels, whose colour space says "Linear Rec.709", is saved to OpenEXR as it
# is, since the file format is linear, too.
# Seen: the pixels go through sRGB's curve on their way into the file: 4 becomes 1.82, .25 becomes .537.
# Reading the file back decodes nothing, as OpenEXR counts as linear. The same image named "Non-Color" or
# "sRGB" is written unchanged, and so is the linear one by Image.save_render. Nothing warns.
#
#     findings/blender-saves-linear-images-with-srgb.sh
#
# Needs Python 3.13 (PYTHON=...) and the Python package index. Exits 1 if the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.13}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'bpy==5.3.0' 'OpenEXR==3.5.0' 'numpy==2.5.5'
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import bpy
import numpy as np
import OpenEXR

folder = sys.argv[1]
bpy.ops.wm.read_factory_settings(use_empty=True)
pixels = np.tile(np.array([4.0, 0.25, 0.0, 1.0], np.float32), 8)


def saved(space: str, by_render: bool = False) -> np.ndarray:
    """Returns red and green of the file that an image of this colour space is saved to."""
    image = bpy.data.images.new("plate", 4, 2, alpha=True, float_buffer=True)
    if space:
        image.colorspace_settings.name = space
    image.pixels.foreach_set(pixels)
    path = f"{folder}/plate.exr"
    if by_render:
        settings = bpy.context.scene.render.image_settings
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
        image.save_render(path)
    else:
        image.filepath_raw, image.file_format = path, "OPEN_EXR"
        image.save()
    return OpenEXR.File(path).channels()["RGBA"].pixels[0, 0, :2]


print("bpy", bpy.app.version_string)
found = {
    "new image, its space left alone": saved(""),
    "Linear Rec.709": saved("Linear Rec.709"),
    "Linear Rec.709, save_render": saved("Linear Rec.709", by_render=True),
    "Non-Color": saved("Non-Color"),
    "sRGB": saved("sRGB"),
}
for name, values in found.items():
    print(f"{name:35} 4 -> {values[0]:.4f}  .25 -> {values[1]:.4f}")
curve = 1.055 * np.array([4.0, 0.25]) ** (1 / 2.4) - 0.055
expected = {name: np.array([4.0, 0.25]) for name in found}
expected["new image, its space left alone"] = expected["Linear Rec.709"] = curve
same = all(np.allclose(found[name], expected[name], atol=2e-3) for name in found)
print("as described" if same else "CHANGED")
sys.exit(0 if same else 1)
PYTHON
