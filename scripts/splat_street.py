#!/usr/bin/env python3
"""Makes a long street of splats, and a data set of its renders: a scene larger than memory should hold, to divide into blocks.

    scripts/splat_street.py out/street --luxel target/release/luxel
    scripts/splat_street.py out/street --houses 8 --splats-per-house 100000 --views-per-house 20 --size 640x480

The street runs along x, the ground is z = 0, houses stand at y = 6 to 9 with bays, columns and lamps; cameras walk along y = 0 at 1.6 m and look
at the houses, so that each sees two or three of them. Every eighth view is a test view. points.ply holds a part of the splats' places, off by 2 mm, as
structure from motion would find them. Renders are exact images of splats, so a perfect reconstruction exists. Needs numpy.
"""

import argparse
import json
import math
import pathlib
import subprocess

import numpy as np

HOUSE_M = 6.0
SH0 = 0.28209479177387814


def noise(at, rng, octaves=5, cells_per_m=0.7):
    """Value noise of points on a surface [N, 2] in metres, 0 to 1."""
    total, amplitude, weight = np.zeros(len(at)), 1.0, 0.0
    for octave in range(octaves):
        grid = rng.random((256, 256))
        x = at * cells_per_m * 2.3**octave
        i, f = np.floor(x).astype(int), x - np.floor(x)
        f = f * f * (3 - 2 * f)
        corner = lambda a, b: grid[(i[:, 0] + a) % 256, (i[:, 1] + b) % 256]
        low = corner(0, 0) * (1 - f[:, 0]) + corner(1, 0) * f[:, 0]
        high = corner(0, 1) * (1 - f[:, 0]) + corner(1, 1) * f[:, 0]
        total += amplitude * (low * (1 - f[:, 1]) + high * f[:, 1])
        amplitude, weight = amplitude * 0.6, weight + amplitude
    return total / weight


def rectangle(corner, edge_a, edge_b, color, glow=1.0):
    return np.array(corner, float), np.array(edge_a, float), np.array(edge_b, float), np.array(color, float), glow


def box(low, high, color, glow=1.0):
    """The faces of a box that the street sees: front, left, right, top."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return [
        rectangle((x0, y0, z0), (x1 - x0, 0, 0), (0, 0, z1 - z0), color, glow),
        rectangle((x0, y0, z0), (0, y1 - y0, 0), (0, 0, z1 - z0), color, glow),
        rectangle((x1, y0, z0), (0, y1 - y0, 0), (0, 0, z1 - z0), color, glow),
        rectangle((x0, y0, z1), (x1 - x0, 0, 0), (0, y1 - y0, 0), color, glow),
    ]


def house(start, rng):
    """Surfaces of the house that begins at x = start, with its piece of the street."""
    color = 0.25 + 0.5 * rng.random(3)
    faces = [
        rectangle((start, -2, 0), (HOUSE_M, 0, 0), (0, 11, 0), (0.3, 0.29, 0.27)),
        rectangle((start, 9, 0), (HOUSE_M, 0, 0), (0, 0, 6), color),
    ]
    for _ in range(3):
        x, width, depth = start + rng.uniform(0.2, 4.4), rng.uniform(0.5, 1.4), rng.uniform(0.5, 2.5)
        faces += box((x, 9 - depth, 0), (x + width, 9, rng.uniform(0.8, 4.5)), 0.2 + 0.6 * rng.random(3))
    x = start + rng.uniform(0.5, 5.3)
    faces += box((x, 6.0, 0), (x + 0.18, 6.18, 2.6), (0.1, 0.1, 0.1))
    faces += box((x - 0.12, 5.88, 2.6), (x + 0.3, 6.3, 3.0), (1.0, 0.8, 0.5), glow=60.0)
    return faces


def splats_of(faces, count, rng):
    """Discs on surfaces: places, radiance, log scales, quaternions w x y z."""
    area = np.array([np.linalg.norm(np.cross(a, b)) for _, a, b, _, _ in faces])
    which = rng.choice(len(faces), size=count, p=area / area.sum())
    place, radiance, quaternion = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 4))
    for n, (corner, a, b, color, glow) in enumerate(faces):
        own = np.flatnonzero(which == n)
        uv = rng.random((len(own), 2))
        place[own] = corner + uv[:, :1] * a + uv[:, 1:] * b
        metres = uv * [np.linalg.norm(a), np.linalg.norm(b)]
        shade = 0.15 + 1.7 * noise(metres, rng) ** 2 if glow == 1.0 else np.ones(len(own))
        stripes = 0.75 + 0.25 * np.sign(np.sin(9 * metres[:, 0]) * np.sin(7 * metres[:, 1]))
        radiance[own] = glow * color * (shade * stripes)[:, None]
        # The disc's short axis is the normal: turn z to it.
        normal = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
        if normal[2] < 0:
            normal = -normal
        half = np.array([1 + normal[2], -normal[1], normal[0], 0.0])
        quaternion[own] = half / np.linalg.norm(half)
    base = math.log(0.75 * math.sqrt(area.sum() / count))
    scale = base + rng.normal(0, 0.25, (count, 3))
    scale[:, 2] = base - 2.5
    return place, radiance, scale, quaternion


def write_scene(path, place, radiance, scale, quaternion, opacity_logit=2.5):
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    opacity = np.full((len(place), 1), opacity_logit)
    table = np.concatenate([place, (radiance - 0.5) / SH0, opacity, scale, quaternion], 1).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(place)}\n" + "".join(f"property float {n}\n" for n in names)
    path.write_bytes(head.encode() + b"end_header\n" + table.tobytes())


def write_points(path, place, radiance):
    color = (255 * np.clip(radiance, 0, 1) ** (1 / 2.2)).astype(int)
    lines = [f"{x:.4f} {y:.4f} {z:.4f} {r} {g} {b}" for (x, y, z), (r, g, b) in zip(place, color)]
    properties = "".join(f"property float {c}\n" for c in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(lines)}\n{properties}end_header\n" + "\n".join(lines) + "\n")


def camera(x, y, yaw, pitch):
    """Camera to world, OpenGL axes: right, up, back. Yaw 0 looks along y."""
    ahead = np.array([math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)])
    right = np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(right, ahead), -ahead, (x, y, 1.6)
    return pose.tolist()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--luxel", default="luxel")
    parser.add_argument("--houses", type=int, default=8)
    parser.add_argument("--splats-per-house", type=int, default=100_000)
    parser.add_argument("--views-per-house", type=int, default=20)
    parser.add_argument("--points-per-house", type=int, default=10_000)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    width, height = map(int, args.size.split("x"))
    args.out.mkdir(parents=True, exist_ok=True)
    parts = [splats_of(house(HOUSE_M * n, rng), args.splats_per_house, rng) for n in range(args.houses)]
    place, radiance, scale, quaternion = (np.concatenate(column) for column in zip(*parts))
    write_scene(args.out / "street.ply", place, radiance, scale, quaternion)
    chosen = rng.choice(len(place), min(len(place), args.points_per_house * args.houses), replace=False)
    write_points(args.out / "points.ply", place[chosen] + rng.normal(0, 0.002, (len(chosen), 3)), radiance[chosen])
    focal = 0.5 * width / math.tan(math.radians(35))
    head = {"w": width, "h": height, "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2, "ply_file_path": "points.ply"}
    count = args.houses * args.views_per_house
    frames = []
    for n in range(count):
        x = (n + rng.uniform(0.2, 0.8)) / count * HOUSE_M * args.houses
        pose = camera(x, rng.uniform(-1.5, 2.5), rng.uniform(-0.6, 0.6), rng.uniform(-0.1, 0.2))
        frames.append({"file_path": f"./images/{n:04}.exr", "transform_matrix": pose})
    (args.out / "all.json").write_text(json.dumps({**head, "frames": frames}))
    for split, own in (("test", frames[4::8]), ("train", [f for n, f in enumerate(frames) if n % 8 != 4])):
        (args.out / f"transforms_{split}.json").write_text(json.dumps({**head, "frames": own}))
    render = [args.luxel, "render", args.out / "street.ply", "--cameras", args.out / "all.json", "-o", args.out / "images", "--quiet", "--overwrite"]
    subprocess.run(render, check=True)
    rendered = sorted((args.out / "images").glob("*.exr"))
    for n, path in enumerate(rendered):
        path.rename(path.with_name(f"{n:04}.exr"))
    print(f"{len(place)} splats, {count} views")


if __name__ == "__main__":
    main()
