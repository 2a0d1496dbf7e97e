"""Holds light probes against a data set's held-out images: a probe at a camera must see what the camera saw.

    python3 -m venv venv && venv/bin/pip install OpenEXR numpy
    venv/bin/python examples/check_probe.py RUN DATASET OUT --luxel target/release/luxel --views 5

RUN was trained on DATASET (OpenEXR images, a transforms.json without distortion). A view knows the light of its own field only, so that
is what is compared: irradiance of a surface that faces the camera's axis, from the field alone, luminance; the light of each cell of an 8 x 8 grid
over the field; the brightest pixel; the mean direction that light comes from. The run's own render of the view stands beside, as what the probe can be at best. The table goes to
OUT/probe.md.
"""

import argparse
import json
import subprocess
from pathlib import Path

import numpy as np
import OpenEXR

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
CELLS = 8


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--luxel", default="luxel")
    parser.add_argument("--views", type=int, default=5, help="how many of the held-out views, evenly")
    parser.add_argument("--size", type=int, default=2048)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    camera = json.loads((args.dataset / "transforms.json").read_text())
    step = max((args.run / "eval").glob("step_*"), key=lambda folder: int(folder.name.removeprefix("step_")))
    held_out = sorted((step / "renders").glob("*.exr"))
    chosen = [held_out[i] for i in np.linspace(0, len(held_out) - 1, args.views).round().astype(int)]
    head = ["view", "irradiance: truth", "render", "probe", "cells: render", "cells: probe", "peak: truth", "render", "probe", "directions apart, degrees"]
    rows = [head, ["---"] * len(head)] + [check(args, camera, render) for render in chosen]
    text = "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows) + "\n"
    (args.out / "probe.md").write_text(text)
    print(text)


def check(args, camera, render):
    frame = next(frame for frame in camera["frames"] if Path(frame["file_path"]).stem == render.stem)
    world_from_camera = np.array(frame["transform_matrix"], dtype=float)
    probe = args.out / f"{render.stem}.exr"
    at = ",".join(map(repr, world_from_camera[:3, 3].tolist()))
    words = [args.luxel, "probe", args.run, f"--at={at}", "-o", probe, "--overwrite", "--size", args.size, "--up", "as-is", "--exr-type", "float"]
    subprocess.run(list(map(str, words)), check=True, capture_output=True)
    truth = luminance(args.dataset / "images" / render.name)
    height, width = truth.shape
    # The field: solid angle, cosine to the axis and cell of each of the image's pixels.
    x = (np.arange(width) + 0.5 - camera["cx"]) / camera["fl_x"]
    y = (np.arange(height) + 0.5 - camera["cy"]) / camera["fl_y"]
    x, y = np.meshgrid(x, y)
    cosine = (1 + x * x + y * y) ** -0.5
    rays = np.stack([x, -y, -np.ones_like(x)], axis=-1) * cosine[..., None]
    field = Field(cosine**3 / (camera["fl_x"] * camera["fl_y"]), cosine, x, y, camera, rays @ world_from_camera[:3, :3].T)
    seen = environment_field(probe, world_from_camera, camera, (width, height))
    true, own, found = field.measure(truth), field.measure(luminance(render)), seen.measure(luminance(probe)[seen.inside])
    apart = np.degrees(np.arccos(np.clip(true["direction"] @ found["direction"], -1, 1)))
    relative = lambda other: f"{np.abs(other['cells'] - true['cells']).sum() / true['cells'].sum():.1%}"
    change = lambda name, other: f"{other[name] / true[name] - 1:+.1%}"
    return [render.stem, f"{true['irradiance']:.4g}", change("irradiance", own), change("irradiance", found), relative(own), relative(found),
            f"{true['peak']:.4g}", change("peak", own), change("peak", found), f"{apart:.2f}"]


class Field:
    """Directions within a view: solid angle, cosine to its axis, place on its image plane, direction in the world."""

    def __init__(self, solid_angle, cosine, x, y, camera, direction, inside=None):
        self.solid_angle, self.cosine, self.direction, self.inside = solid_angle, cosine, direction, inside
        cell = lambda tangent, focal, center, size: np.clip(((tangent * focal + center) / size * CELLS).astype(int), 0, CELLS - 1)
        self.cell = cell(y, camera["fl_y"], camera["cy"], camera["h"]) * CELLS + cell(x, camera["fl_x"], camera["cx"], camera["w"])

    def measure(self, light):
        return dict(irradiance=(light * self.solid_angle * self.cosine).sum(), peak=light.max(),
                    direction=unit((self.direction * (light * self.solid_angle)[..., None]).reshape(-1, 3).sum(axis=0)),
                    cells=np.bincount(self.cell.ravel(), (light * self.solid_angle).ravel(), CELLS**2))


def environment_field(path, world_from_camera, camera, size):
    height, width = luminance(path).shape
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    longitude = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    latitude, longitude = np.meshgrid(latitude, longitude, indexing="ij")
    direction = np.stack([np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], axis=-1)
    edge = np.pi * (0.5 - np.arange(height + 1) / height)
    solid_angle = np.broadcast_to((2 * np.pi / width * -np.diff(np.sin(edge)))[:, None], (height, width))
    seen = direction @ world_from_camera[:3, :3]
    ahead = np.maximum(-seen[..., 2], 1e-9)
    x, y = seen[..., 0] / ahead, -seen[..., 1] / ahead
    u, v = x * camera["fl_x"] + camera["cx"], y * camera["fl_y"] + camera["cy"]
    inside = (seen[..., 2] < 0) & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    return Field(solid_angle[inside], ahead[inside], x[inside], y[inside], camera, direction[inside], inside)


def unit(vector):
    return vector / np.linalg.norm(vector)


def luminance(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels for name in "RGB"], axis=-1).astype(np.float64) @ LUMINANCE


if __name__ == "__main__":
    main()
