#!/usr/bin/env python3
"""Compares lamps and maps of `luxel lights` with the light of a path-traced scene: docs/src/notebook/lights-truth.md.

    scripts/lights_truth.py truth neon truth.npz --at 0.1,0.1,0.3 --at 0.3,-0.3,0.15     # light at points of a scene of path_traced_scenes.py
    scripts/lights_truth.py measure truth.npz --towards 0.1,0.3,0.58 lights.json lights_dome.exr
    scripts/lights_truth.py measure truth.npz --towards 0.1,0.3,0.58 probe_1.exr probe_2.exr   # one map for each point

`truth` stores the radiance that comes from each direction; `measure` integrates it, and that of lamps and map, to irradiance by normal and prints
luminance against the truth: of all normals n, of those towards the lamp (n.l > .7), about the rim (|n.l| < .3), of the upper half, and the rms error
over the mean. Needs numpy, mitsuba (see path_traced_scenes.py) and OpenEXR.
"""

import argparse
import json
import pathlib
import tempfile

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
DIRECTIONS = (128, 256)
NORMALS = (16, 32)
MAX_BOUNCES = 8


def sphere(rows, columns):
    """Unit directions [rows * columns, 3], +z up, and their solid angles."""
    latitude = np.pi / 2 - np.pi * (np.arange(rows) + 0.5) / rows
    longitude = 2 * np.pi * (np.arange(columns) + 0.5) / columns
    up, around = np.meshgrid(latitude, longitude, indexing="ij")
    directions = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1).reshape(-1, 3)
    return directions, (np.cos(up) * np.pi / rows * 2 * np.pi / columns).ravel()


def irradiance(radiance):
    """Irradiance [normals, 3] of radiance by direction."""
    directions, solid_angles = sphere(*DIRECTIONS)
    return np.maximum(sphere(*NORMALS)[0] @ directions.T, 0) @ (radiance * solid_angles[:, None])


def traced(mi, scene, point, samples):
    """Radiance [directions, 3] that comes to a point."""
    import drjit as dr

    directions, _ = sphere(*DIRECTIONS)
    integrator = mi.load_dict({"type": "path", "max_depth": MAX_BOUNCES})
    total = np.zeros_like(directions)
    for seed in range(samples):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(directions))
        jitter = np.random.default_rng(seed).normal(0, 0.5 * np.pi / DIRECTIONS[0], directions.shape)
        rays = directions + jitter
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        ray = mi.RayDifferential3f(mi.Point3f(*map(float, point)), mi.Vector3f(rays.T.astype(np.float32)))
        found, _, _ = integrator.sample(scene, sampler, ray)
        total += np.array(found).reshape(3, -1).T
        if seed % 64 == 63:
            dr.flush_malloc_cache()
    return total / samples


def truth(arguments):
    import mitsuba as mi
    import path_traced_scenes as scenes

    mi.set_variant("llvm_ad_rgb")
    with tempfile.TemporaryDirectory() as folder:
        made = scenes.Scene(mi)
        scenes.SCENES[arguments.scene][0](made, folder)
        world = mi.load_dict(made.items)
    points = np.array([[float(v) for v in point.split(",")] for point in arguments.at])
    np.savez(arguments.out, points=points, radiance=np.stack([traced(mi, world, point, arguments.samples) for point in points]))


def map_radiance(path):
    """Radiance [directions, 3] of a map whose top is +z of the world."""
    import OpenEXR

    channels = OpenEXR.File(str(path)).channels()
    pixels = (channels.get("RGB") or channels["RGBA"]).pixels[..., :3].astype(float)
    height, width = pixels.shape[:2]
    directions, _ = sphere(*DIRECTIONS)
    x, y, z = directions[:, 0], directions[:, 2], -directions[:, 1]
    column = ((0.5 - np.arctan2(x, z) / (2 * np.pi)) * width).astype(int) % width
    row = np.clip(((0.5 - np.arcsin(np.clip(y, -1, 1)) / np.pi) * height).astype(int), 0, height - 1)
    return pixels[row, column]


def lamp_irradiance(lamp, point):
    """Irradiance [normals, 3] of a lamp: of a mesh by its outline, of other shapes as a point."""
    normals, _ = sphere(*NORMALS)
    if lamp["shape"] != "mesh":
        way = np.array(lamp["middle"]) - point
        distance = np.linalg.norm(way)
        towards = way / distance
        out = max(0, -towards @ np.array(lamp["normal"])) if "normal" in lamp else 1
        return np.maximum(normals @ towards, 0)[:, None] * np.array(lamp["intensity"]) * out / distance**2
    corners = np.array(lamp["points"])[np.array(lamp["triangles"])] - point
    directions, _ = sphere(512, 1024)
    is_hit = np.zeros(len(directions), bool)
    for a, b, c in corners:
        sides = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)])
        near = directions @ (a + b + c) > 0
        inside = directions[near] @ sides.T
        is_hit[near] |= (inside >= 0).all(1) | (inside <= 0).all(1)
    _, solid_angles = sphere(512, 1024)
    return (np.maximum(normals @ directions[is_hit].T, 0) @ solid_angles[is_hit])[:, None] * np.array(lamp["radiance"])


def measure(arguments):
    stored = np.load(arguments.truth)
    towards = np.array([float(v) for v in arguments.towards.split(",")])
    normals, weights = sphere(*NORMALS)
    maps = [path for path in arguments.files if path.suffix == ".exr"]
    lamps = [lamp for path in arguments.files if path.suffix == ".json" for lamp in json.loads(path.read_text())]
    for i, (point, radiance) in enumerate(zip(stored["points"], stored["radiance"])):
        expected = irradiance(radiance) @ LUMINANCE
        light = irradiance(map_radiance(maps[i % len(maps)])) + sum(lamp_irradiance(lamp, point) for lamp in lamps)
        found = light @ LUMINANCE
        to_lamp = normals @ ((towards - point) / np.linalg.norm(towards - point))
        parts = {"whole": to_lamp > -2, "lamp side": to_lamp > 0.7, "rim": abs(to_lamp) < 0.3, "upper half": normals[:, 2] > 0}
        text = ", ".join(f"{name} {(found * weights)[part].sum() / (expected * weights)[part].sum() - 1:+.1%}" for name, part in parts.items())
        rms = np.sqrt(np.average((found - expected) ** 2, weights=weights)) / np.average(expected, weights=weights)
        print(f"{point}: {text}, rms over mean {rms:.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("truth")
    command.add_argument("scene")
    command.add_argument("out", type=pathlib.Path)
    command.add_argument("--at", action="append", required=True)
    command.add_argument("--samples", type=int, default=256)
    command.set_defaults(run=truth)
    command = commands.add_parser("measure")
    command.add_argument("truth", type=pathlib.Path)
    command.add_argument("files", nargs="+", type=pathlib.Path)
    command.add_argument("--towards", required=True)
    command.set_defaults(run=measure)
    arguments = parser.parse_args()
    arguments.run(arguments)


if __name__ == "__main__":
    main()
