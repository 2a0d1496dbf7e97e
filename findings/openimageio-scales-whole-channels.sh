#!/usr/bin/env bash
# OpenImageIO 3.2: an OpenEXR channel of whole numbers, read as float, is divided by 4294967295.
#
# Guess: a channel of 32-bit unsigned integers, such as numbers of objects, reads as the same numbers in
# float: 49973 is 49973.0. OpenEXR's own library, asked for float, converts so.
# Seen: read_image("float") and ImageBuf.get_pixels() give 0.0000116: whole channels are taken for a fixed-point
# range from 0 to 1, in a file whose other channels are float and come unchanged. Only a read in the type "uint",
# which cuts the float channels of the same file, gives the numbers. So a tool on OpenImageIO that computes in
# float loses them, and numbers of objects are better written as float.
#
#     findings/openimageio-scales-whole-channels.sh
#
# Needs Python 3.11 or newer and the Python package index. Exits 1 if the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'OpenImageIO==3.2.2.0' 'OpenEXR==3.5.3' 'numpy>=2,<3'
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import numpy as np
import OpenEXR
import OpenImageIO as oiio

path = f"{sys.argv[1]}/ids.exr"
ids = np.array([[15, 49973], [0, 4294967295]], np.uint32)
depth = np.array([[2.5, 70.0], [1.0, 3.0]], np.float32)
OpenEXR.File({"type": OpenEXR.scanlineimage}, {"id": ids, "Z": depth}).write(path)

image = oiio.ImageInput.open(path)
spec = image.spec()
at = list(spec.channelnames).index("id")
as_float = image.read_image("float")[..., at]
as_whole = image.read_image("uint")
buffer = oiio.ImageBuf(path).get_pixels()[..., at]
by_openexr = OpenEXR.File(path).channels()["id"].pixels
print("OpenImageIO", oiio.__version__, dict(zip(spec.channelnames, map(str, spec.channelformats))))
print("float:        ", as_float.ravel())
print("ImageBuf:     ", buffer.ravel())
print("uint:         ", as_whole[..., at].ravel(), "and Z becomes", as_whole[..., 1 - at].ravel())
print("OpenEXR 3.5.3:", by_openexr.ravel())
same = (
    np.allclose(as_float, ids / 4294967295.0, rtol=1e-6)
    and np.allclose(buffer, as_float)
    and (as_whole[..., at] == ids).all()
    and (by_openexr == ids).all()
)
print("as described" if same else "CHANGED")
sys.exit(0 if same else 1)
PYTHON
