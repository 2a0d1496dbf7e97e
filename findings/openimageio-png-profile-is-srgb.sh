#!/usr/bin/env bash
# OpenImageIO 3.2.2 reading PNG: a picture with an ICC profile of its own counts as sRGB.
#
# Guess: a PNG whose only statement of colour is an iCCP chunk, of Display P3's primaries with a power of 2.6, has no
# oiio:ColorSpace, or one that says that it is not known.
# Seen: the attribute oiio:ColorSpace is srgb_rec709_scene, next to the profile that says otherwise; a host that
# trusts the attribute shows wrong colours. With cICP beside it (12, 13, 0, 1) the name is
# srgb_p3d65_scene. Nothing in the attributes tells a guess from a statement.
#
#     findings/openimageio-png-profile-is-srgb.sh
#
# Needs Python 3 (PYTHON=...) and the Python package index. Exits 1 if the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'OpenImageIO==3.2.2.0' 'pillow==13.0.0'
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import io
import struct
import sys
import zlib

import OpenImageIO as oiio
from PIL import Image, ImageCms

folder = sys.argv[1]


def number(value: float) -> bytes:
    """A number of 15.16 bits."""
    return struct.pack(">i", round(value * 65536))


def profile() -> bytes:
    """Returns a display profile: P3 with white D65 under D50, a power of 2.6."""
    xyz = lambda *v: b"XYZ \0\0\0\0" + b"".join(map(number, v))  # noqa: E731
    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(2.6 * 256)) + b"\0\0"
    name = b"P3, power 2.6\0"
    text = b"desc\0\0\0\0" + struct.pack(">I", len(name)) + name + bytes(78)
    tags = {
        b"desc": text + bytes(-len(text) % 4),
        b"cprt": b"text\0\0\0\0none\0\0\0\0",
        b"wtpt": xyz(0.9642, 1.0, 0.8249),
        b"rXYZ": xyz(0.5151, 0.2412, -0.0011),
        b"gXYZ": xyz(0.2920, 0.6922, 0.0419),
        b"bXYZ": xyz(0.1571, 0.0666, 0.7841),
        b"rTRC": curve,
        b"gTRC": curve,
        b"bTRC": curve,
    }
    table, content, at = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for key, value in tags.items():
        table += key + struct.pack(">II", at + len(content), len(value))
        content += value
    head = struct.pack(">I4sI4s4s4s", at + len(content), bytes(4), 0x02100000, b"mntr", b"RGB ", b"XYZ ")
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28) + number(0.9642) + number(1.0) + number(0.8249)
    return head + bytes(128 - len(head)) + table + content


def read(chunks: bytes) -> tuple[str, bool]:
    """Returns the name of the colour space, and whether there is a profile."""
    png = io.BytesIO()
    Image.new("RGB", (2, 2), (200, 100, 50)).save(png, "PNG", icc_profile=icc)
    data = png.getvalue()
    path = folder + "/picture.png"
    open(path, "wb").write(data[:33] + chunks + data[33:])
    spec = oiio.ImageInput.open(path).spec()
    return spec.get_string_attribute("oiio:ColorSpace"), spec.getattribute("ICCProfile") is not None


icc = profile()
print(ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(icc))).strip())
content = b"cICP" + bytes([12, 13, 0, 1])
cicp = struct.pack(">I", 4) + content + struct.pack(">I", zlib.crc32(content))
found = [read(b""), read(cicp)]
print(oiio.VERSION_STRING, found)
if found != [("srgb_rec709_scene", True), ("srgb_p3d65_scene", True)]:
    sys.exit("the behaviour has changed")
PYTHON
