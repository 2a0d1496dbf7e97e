#!/usr/bin/env python3
"""Path-traces HDR data sets of our own, on which docs/src/notebook tries recipes that other scenes have decided: loft-and-yard.md, detail-everywhere.md.

    scripts/path_traced_scenes.py loft out/loft             # a room with a window, bulbs, a mirror, glass: 120 + 20 views from within, minutes
    scripts/path_traced_scenes.py yard out/yard             # a yard under sun and sky: 60 + 12 views from around
    scripts/path_traced_scenes.py study out/study           # a desk and a wall with print and fine grain everywhere: 18 + 8 views from a cap
    scripts/path_traced_scenes.py neon out/neon             # the study with a bent tube for a lamp, at 200x200
    scripts/path_traced_scenes.py subset out/loft out/loft-18 --train 18

Images are half-float EXR of 300x300, of the study 400x400, denoised with albedo and normals; points.ply holds points of textured surfaces, off by 2 mm, as structure from motion would
find them. Needs numpy, mitsuba and pyoidn, and LLVM for Mitsuba (DRJIT_LIBLLVM_PATH, if it is not found; 15 fails, 19 works).
"""

import argparse
import itertools
import json
import os
import pathlib
import subprocess
import tempfile

import numpy as np

MAX_BOUNCES = 8
POINTS = 15_000
POINT_NOISE = 0.002
NEON_RADIUS = 0.02


# Textures: [n, n, 3] of reflectance, or [n, n] of noise.


def value_noise(n, rng, octaves=6, persistence=0.55):
    """Tileable, 0 to 1."""
    total, amplitude, weight = np.zeros((n, n)), 1.0, 0.0
    for octave in range(octaves):
        cells = min(n, 4 * 2**octave)
        grid = rng.random((cells, cells))
        x = np.arange(n) * cells / n
        i = x.astype(int)
        f = x - i
        f = f * f * (3 - 2 * f)
        j = (i + 1) % cells
        a, b = (1 - f)[:, None], f[:, None]
        c, d = (1 - f)[None], f[None]
        total += amplitude * (grid[i][:, i] * a * c + grid[j][:, i] * b * c + grid[i][:, j] * a * d + grid[j][:, j] * b * d)
        weight += amplitude
        amplitude *= persistence
    return total / weight


def bricks(n, rng, rows=16, columns=8, color=(0.45, 0.17, 0.1)):
    y, x = np.mgrid[0:n, 0:n] / n
    row = (y * rows).astype(int)
    along = (x * columns + 0.5 * (row % 2)) % columns
    column = along.astype(int)
    mortar = (y * rows - row < 0.1) | (along - column < 0.05)
    shade = rng.random((rows, columns + 1))[row, column]
    noise = value_noise(n, rng, 7)
    out = np.array(color)[None, None] * (0.5 + 0.9 * shade)[..., None] * (0.6 + 0.8 * noise)[..., None]
    out[mortar] = (np.array([0.55, 0.53, 0.5]) * (0.7 + 0.5 * noise[..., None]))[mortar]
    return out


def planks(n, rng, rows=10, color=(0.36, 0.2, 0.09)):
    y, x = np.mgrid[0:n, 0:n] / n
    row = (y * rows).astype(int)
    along = (x + rng.random(rows)[row]) * 3
    shade = rng.random((rows, 3))[row, along.astype(int) % 3]
    grain = value_noise(n, rng, 7, 0.7)
    grain = grain[np.arange(n)[:, None], (np.arange(n) // 8)[None]]
    out = np.array(color)[None, None] * (0.5 + 0.8 * shade)[..., None] * (0.45 + 1.1 * grain)[..., None]
    out[(y * rows - row < 0.03) | (along % 1 < 0.008)] *= 0.15
    return out


def tiles(n, rng, count):
    y, x = np.mgrid[0:n, 0:n] / n * count
    i, j = x.astype(int), y.astype(int)
    shade = rng.random((count, count))[j, i]
    light, dark = np.array([0.7, 0.68, 0.62]), np.array([0.1, 0.13, 0.16])
    out = np.where(((i + j) % 2)[..., None] == 0, light, dark) * (0.7 + 0.5 * shade)[..., None]
    out[(x - i < 0.05) | (y - j < 0.05)] = 0.3
    return out * (0.8 + 0.4 * value_noise(n, rng, 6))[..., None]


def poster(n, rng):
    """Coloured rectangles and lines of text that can't be read."""
    out = np.ones((n, n, 3)) * rng.random(3) * 0.8
    for _ in range(30):
        x, y, width, height = rng.random(4) * [1, 1, 0.3, 0.2]
        out[int(y * n) : int((y + height) * n), int(x * n) : int((x + width) * n)] = rng.random(3) ** 1.5
    for line in range(12):
        y, x = int((0.5 + 0.035 * line) * n), int(0.1 * n)
        while x < 0.9 * n:
            width = int(rng.integers(2, 8) * n / 128)
            out[y : y + int(0.015 * n), x : x + width] = 0.03
            x += width + int(n / 64)
    return out


def page(n, rng, color=(0.75, 0.73, 0.68), lines=40):
    """Lines of letters, each of a few strokes at random, that can't be read; two pictures in between."""
    out = np.ones((n, n, 3)) * np.array(color) * (0.85 + 0.3 * value_noise(n, rng, 8, 0.9))[..., None]
    height = n // lines
    for line in range(1, lines - 1):
        x, y = height, line * height
        while x < n - 2 * height:
            if rng.random() < 0.85:
                letter = np.kron(rng.random((3, 2)) < 0.55, np.ones((max(height // 5, 1), max(height // 5, 1))))
                part = out[y : y + letter.shape[0], x : x + letter.shape[1]]
                part[letter[: part.shape[0], : part.shape[1]] > 0] *= 0.25 + 0.4 * rng.random()
            x += height // 2
    for _ in range(2):
        x, y = (rng.random(2) * 0.6 * n).astype(int)
        side = int((0.2 + 0.2 * rng.random()) * n)
        picture = value_noise(side, rng, 8, 0.8)[..., None] * rng.random(3) + rng.random(3) * 0.2
        out[y : y + side, x : x + side] = picture[: n - y, : n - x]
    return out


def grain(n, rng, color, contrast):
    """A colour with noise down to the pixel that repeats nowhere."""
    noise = value_noise(n, rng, 10, 0.9) - 0.5
    return np.array(color) * np.exp(contrast * noise / noise.std())[..., None]


class Scene:
    """What Mitsuba's load_dict takes, put together."""

    def __init__(self, mi):
        self.mi, self.at, self.items = mi, mi.ScalarTransform4f, {"type": "scene"}

    def rgb(self, *values):
        return {"type": "rgb", "value": list(values)}

    def texture(self, values, repeat=1.0):
        bitmap = self.mi.Bitmap(np.clip(values, 0, 1).astype(np.float32))
        to_uv = self.at().scale([repeat, repeat, 1])
        return {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear", "to_uv": to_uv}

    def diffuse(self, reflectance):
        return {"type": "diffuse", "reflectance": reflectance}

    def matt(self, *values):
        return self.diffuse(self.rgb(*values))

    def two_sided(self, bsdf):
        return {"type": "twosided", "x": bsdf}

    def rectangle(self, name, to_world, bsdf):
        self.items[name] = {"type": "rectangle", "to_world": to_world, "bsdf": self.two_sided(bsdf)}

    def box(self, name, center, half, bsdf, turn=0):
        to_world = self.at().translate(list(center)).rotate([0, 0, 1], turn).scale(list(half))
        self.items[name] = {"type": "cube", "to_world": to_world, "bsdf": bsdf}

    def ball(self, name, center, radius, bsdf):
        self.items[name] = {"type": "sphere", "center": list(center), "radius": radius, "bsdf": bsdf}

    def lamp(self, name, center, radius, radiance):
        emitter = {"type": "area", "radiance": self.rgb(*radiance)}
        self.items[name] = {"type": "sphere", "center": list(center), "radius": radius, "emitter": emitter}

    def rod(self, name, start, end, radius, bsdf):
        self.items[name] = {"type": "cylinder", "p0": list(start), "p1": list(end), "radius": radius, "bsdf": self.two_sided(bsdf)}

    def leaves(self, name, vertices, faces, bsdf, folder):
        mesh = self.mi.Mesh(name, len(vertices), len(faces))
        parameters = self.mi.traverse(mesh)
        parameters["vertex_positions"] = np.ravel(np.array(vertices, np.float32))
        parameters["faces"] = np.ravel(np.array(faces, np.uint32))
        parameters.update()
        path = os.path.join(folder, name + ".ply")
        mesh.write_ply(path)
        self.items[name] = {"type": "ply", "filename": path, "face_normals": True, "bsdf": self.two_sided(bsdf)}


def loft(scene, _folder):
    """A room of 6 x 5 x 2.8 m; bulbs of some 300, a window of 10, a table's underside of 0.01."""
    rng, n, at = np.random.default_rng(11), 1024, scene.at
    floor = {"type": "principled", "base_color": scene.texture(planks(n, rng), 2), "roughness": 0.35, "specular": 0.5}
    scene.rectangle("floor", at().scale([3, 2.5, 1]), floor)
    scene.rectangle("ceiling", at().translate([0, 0, 2.8]).rotate([1, 0, 0], 180).scale([3, 2.5, 1]), scene.matt(0.7, 0.7, 0.68))
    north = scene.diffuse(scene.texture(bricks(n, rng), 2))
    scene.rectangle("north", at().translate([0, 2.5, 1.4]).rotate([1, 0, 0], 90).scale([3, 1.4, 1]), north)
    south = scene.diffuse(scene.texture(0.55 + 0.3 * value_noise(n, rng, 8, 0.75)[..., None] * np.array([1, 0.9, 0.7])))
    scene.rectangle("south", at().translate([0, -2.5, 1.4]).rotate([1, 0, 0], -90).scale([3, 1.4, 1]), south)
    east = scene.diffuse(scene.texture(tiles(n, rng, 16)))
    scene.rectangle("east", at().translate([3, 0, 1.4]).rotate([0, 1, 0], -90).scale([1.4, 2.5, 1]), east)
    for i, (y0, y1, z0, z1) in enumerate([(-2.5, -1, 0, 2.8), (1, 2.5, 0, 2.8), (-1, 1, 0, 0.9), (-1, 1, 2.2, 2.8)]):
        part = at().translate([-3, (y0 + y1) / 2, (z0 + z1) / 2]).rotate([0, 1, 0], 90).scale([(z1 - z0) / 2, (y1 - y0) / 2, 1])
        scene.rectangle(f"west{i}", part, scene.matt(0.25, 0.33, 0.42))
    window = at().translate([-3.3, 0, 1.55]).rotate([0, 1, 0], 90).scale([0.8, 1.3, 1])
    scene.items["window"] = {"type": "rectangle", "to_world": window, "emitter": {"type": "area", "radiance": scene.rgb(7, 9, 12)}}
    for i, y in enumerate([-1, -0.34, 0.34, 1]):
        scene.box(f"muntin{i}", (-3.02, y, 1.55), (0.04, 0.025, 0.65), scene.matt(0.6, 0.6, 0.6))
    scene.box("muntin", (-3.02, 0, 1.6), (0.04, 1, 0.02), scene.matt(0.6, 0.6, 0.6))

    wood = {"type": "principled", "base_color": scene.texture(planks(512, rng, 5, (0.5, 0.3, 0.12))), "roughness": 0.2, "specular": 0.5}
    scene.box("table", (0.2, 0.1, 0.75), (0.9, 0.5, 0.03), wood)
    for i, (x, y) in enumerate([(-0.6, -0.3), (1, -0.3), (-0.6, 0.5), (1, 0.5)]):
        scene.box(f"leg{i}", (x, y, 0.36), (0.03, 0.03, 0.36), scene.matt(0.05, 0.05, 0.05))
    scene.ball("glass", (0.5, 0.25, 0.92), 0.14, {"type": "dielectric"})
    scene.ball("chrome", (-0.2, 0.2, 0.9), 0.12, {"type": "conductor", "material": "Cr"})
    scene.ball("gold", (0.1, -0.2, 0.86), 0.08, {"type": "roughconductor", "material": "Au", "alpha": 0.15})
    scene.ball("red", (0.75, -0.15, 0.88), 0.1, {"type": "plastic", "diffuse_reflectance": scene.rgb(0.6, 0.04, 0.03)})
    for i in range(14):
        center = (-0.55 + 0.03 * i, -0.25 + 0.1 * rng.random(), 0.792 + 0.024 * (i % 5))
        cover = scene.diffuse(scene.texture(poster(128, rng)))
        scene.box(f"magazine{i}", center, (0.1, 0.07, 0.012), cover, rng.random() * 60)

    for shelf in range(4):
        scene.box(f"shelf{shelf}", (1.7, 2.3, 0.3 + 0.5 * shelf), (0.9, 0.18, 0.015), scene.matt(0.3, 0.2, 0.12))
    for shelf in range(4):
        x, i = 0.85, 0
        while x < 2.5:
            width, height = 0.015 + 0.03 * rng.random(), 0.1 + 0.08 * rng.random()
            if rng.random() < 0.85:
                center = (x + width, 2.25 + 0.05 * rng.random(), 0.315 + 0.5 * shelf + height)
                printed = rng.random() < 0.5
                back = scene.diffuse(scene.texture(poster(64, rng))) if printed else scene.matt(*(rng.random(3) ** 2 * 0.8))
                scene.box(f"book{shelf}_{i}", center, (width * 0.95, 0.1, height), back)
            x += 2 * width
            i += 1
    for i, (x, z) in enumerate([(-2, 1.5), (-0.9, 1.7), (0, 1.4)]):
        place = at().translate([x, 2.49, z]).rotate([1, 0, 0], 90).scale([0.35, 0.5, 1])
        scene.rectangle(f"poster{i}", place, scene.diffuse(scene.texture(poster(256, rng))))
    mirror = at().translate([0.5, -2.48, 1.4]).rotate([1, 0, 0], -90).scale([0.6, 0.8, 1])
    scene.items["mirror"] = {"type": "rectangle", "to_world": mirror, "bsdf": {"type": "conductor", "material": "Ag"}}
    for name, center, half in [("sofa", (-1.6, -1.7, 0.25), (0.9, 0.4, 0.25)), ("back", (-1.6, -2.1, 0.6), (0.9, 0.12, 0.35))]:
        cloth = 0.1 + 0.35 * value_noise(256, rng, 8, 0.8)[..., None] * np.array([0.5, 0.8, 0.4])
        scene.box(name, center, half, scene.diffuse(scene.texture(cloth, 3)))
    for i in range(120):
        angle, radius, z = rng.random() * 2 * np.pi, 0.25 * rng.random() ** 0.5, 0.5 + 0.9 * rng.random()
        axis = [rng.normal(), rng.normal(), rng.normal()]
        place = at().translate([2.3 + radius * np.cos(angle), -1.8 + radius * np.sin(angle), z]).rotate(axis, float(rng.random() * 360))
        green = (0.05 + 0.1 * rng.random(), 0.25 + 0.2 * rng.random(), 0.05)
        scene.rectangle(f"leaf{i}", place.scale([0.02, 0.09, 1]), scene.matt(*green))
    scene.rod("pot", (2.3, -1.8, 0), (2.3, -1.8, 0.45), 0.2, scene.matt(0.5, 0.25, 0.12))
    bulbs = [((0.9, 0.1, 1.9), 0.035, (260, 190, 110)), ((2.6, 1.9, 1.95), 0.025, (400, 300, 180)), ((-0.4, 0.45, 1.0), 0.02, (500, 260, 90))]
    for i, ((x, y, z), radius, radiance) in enumerate(bulbs):
        scene.lamp(f"bulb{i}", (x, y, z), radius, radiance)
        scene.rod(f"cord{i}", (x, y, z + radius), (x, y, 2.8 if i < 2 else z + radius + 0.001), 0.006, scene.matt(0.02, 0.02, 0.02))


def loft_camera(rng):
    """From anywhere that is not within the furniture, at the table or at a long wall."""
    while True:
        x, y, z = rng.uniform(-2.6, 2.6), rng.uniform(-2.1, 2.1), rng.uniform(1.0, 2.2)
        at_table = np.hypot((x - 0.2) / 1.3, (y - 0.1) / 0.9) < 1
        at_sofa = not at_table and abs(x + 1.6) < 1.1 and y < -1.1 and z < 1.3
        at_plant_or_shelf = np.hypot(x - 2.3, y + 1.8) < 0.6 or (x > 0.6 and y > 1.8)
        if not (at_table or at_sofa or at_plant_or_shelf):
            break
    if rng.random() < 0.6:
        return (x, y, z), (rng.uniform(-0.9, 1.3), rng.uniform(-0.6, 0.8), rng.uniform(0.5, 1.2))
    return (x, y, z), (rng.uniform(-3, 3), rng.choice([-2.5, 2.5]), rng.uniform(0.3, 2.2))


def study(scene, _folder):
    """A desk before a wall of 3 x 2 m, lit by a panel behind the cameras and a bulb of 250: no two places look alike."""
    rng, at = np.random.default_rng(31), scene.at
    printed = lambda n, *more: scene.diffuse(scene.texture(page(n, rng, *more)))  # noqa: E731
    wall = scene.diffuse(scene.texture(grain(1024, rng, (0.4, 0.36, 0.28), 0.25)))
    scene.rectangle("wall", at().translate([0, 0.9, 0.6]).rotate([1, 0, 0], 90).scale([2, 1.6, 1]), wall)
    desk = scene.diffuse(scene.texture(planks(1024, rng, 9, (0.4, 0.25, 0.12)) * grain(1024, rng, (1, 1, 1), 0.2)))
    scene.rectangle("desk", at().scale([1.8, 1.2, 1]), desk)
    for i in range(14):
        x, z = -1.35 + 0.45 * (i % 7) + rng.normal() * 0.05, 0.75 + 0.45 * (i // 7) + rng.normal() * 0.04
        place = at().translate([x, 0.885 - 0.001 * i, z]).rotate([1, 0, 0], 90).rotate([0, 0, 1], float(rng.normal() * 6))
        scene.rectangle(f"note{i}", place.scale([0.17, 0.2, 1]), printed(512, tuple(0.4 + 0.4 * rng.random(3)), 26))
    for i in range(16):
        x, y = rng.uniform(-1.2, 1.2), rng.uniform(-1.0, 0.2)
        place = at().translate([x, y, 0.004 + 0.002 * i]).rotate([0, 0, 1], float(rng.random() * 360))
        scene.rectangle(f"sheet{i}", place.scale([0.15, 0.21, 1]), printed(512, (0.75, 0.73, 0.68), 34))
    x, i = -1.3, 0
    while x < 1.2:
        half, height = 0.012 + 0.02 * rng.random(), 0.12 + 0.08 * rng.random()
        back = printed(256, tuple(rng.random(3) ** 1.5 * 0.8 + 0.05), 18)
        scene.box(f"book{i}", (x + half, 0.7 + 0.03 * rng.random(), height), (half * 0.95, 0.1, height), back, float(rng.normal() * 2))
        x, i = x + 2 * half + (0.15 if rng.random() < 0.06 else 0), i + 1
    for i in range(260):
        x, y, radius = rng.uniform(-1.3, 1.3), rng.uniform(-1.0, 0.5), 0.01 + 0.02 * rng.random() ** 2
        stone = scene.diffuse(scene.texture(grain(64, rng, tuple(rng.random(3) ** 1.5 * 0.7 + 0.03), 0.4)))
        if i % 3 == 0:
            scene.box(f"stone{i}", (x, y, radius + 0.03), (radius * 1.3, radius, radius), stone, float(rng.random() * 90))
        else:
            scene.ball(f"stone{i}", (x, y, radius + 0.03), radius, stone)
    for i in range(40):
        x, y, angle = rng.uniform(-1.2, 1.2), rng.uniform(-0.9, 0.4), rng.random() * 2 * np.pi
        end = (x + 0.16 * np.cos(angle), y + 0.16 * np.sin(angle), 0.06 + 0.1 * rng.random())
        scene.rod(f"pencil{i}", (x, y, 0.045), end, 0.005, scene.matt(*(rng.random(3) ** 1.5 * 0.8)))
    scene.rod("foot", (0.55, 0.3, 0), (0.55, 0.3, 0.5), 0.012, scene.matt(0.03, 0.03, 0.03))
    scene.lamp("bulb", (0.55, 0.3, 0.54), 0.035, (250, 180, 100))
    panel = at().look_at(origin=[-1.5, -2.5, 3], target=[0, 0.3, 0.3], up=[0, 0, 1]).scale([0.8, 0.8, 1])
    scene.items["panel"] = {"type": "rectangle", "to_world": panel, "emitter": {"type": "area", "radiance": scene.rgb(5, 5.4, 6)}}


def neon(scene, folder):
    """The study with a bent tube of 120 in place of the bulb, as wide as 4 pixels."""
    study(scene, folder)
    del scene.items["bulb"], scene.items["foot"]
    corners = [(-0.4, 0.3, 0.55), (0.1, 0.35, 0.62), (0.45, 0.2, 0.5), (0.5, -0.1, 0.42)]
    radiance = scene.rgb(120, 80, 45)
    for i, (start, end) in enumerate(itertools.pairwise(corners)):
        emitter = {"type": "area", "radiance": radiance}
        scene.items[f"tube{i}"] = {"type": "cylinder", "p0": list(start), "p1": list(end), "radius": NEON_RADIUS, "emitter": emitter}
    for i, corner in enumerate(corners):
        scene.lamp(f"joint{i}", corner, NEON_RADIUS, (120, 80, 45))


def study_camera():
    """From a cap of 1 x 0.7 m, spread evenly over it (the R2 sequence)."""
    places = itertools.count(1)

    def camera(rng):
        u, v = (0.5 + next(places) * np.array([0.7548776662466927, 0.5698402909980532])) % 1
        eye = (u - 0.5, -1.9 + 0.1 * rng.random(), 0.75 + 0.7 * v)
        return eye, (0.35 * (u - 0.5) + 0.05 * rng.normal(), 0.4, 0.35)

    return camera


def yard(scene, folder):
    """A paved yard within a lawn; a median of 0.01, a lit lamp of 50, the sun in a mirror ball of 100."""
    rng, at = np.random.default_rng(21), scene.at
    scene.items["sky"] = {"type": "sunsky", "sun_direction": [0.5, -0.45, 0.6], "turbidity": 3.5, "sky_scale": 0.06, "sun_scale": 0.06}
    noise = value_noise(1024, rng, 8, 0.7)
    grass = np.stack([0.10 + 0.12 * noise, 0.16 + 0.2 * noise, 0.05 + 0.05 * noise], 2)
    scene.items["lawn"] = {"type": "rectangle", "to_world": at().scale([2000, 2000, 1]), "bsdf": scene.diffuse(scene.texture(grass, 600))}
    paving = scene.diffuse(scene.texture(bricks(1024, rng, 24, 12, (0.5, 0.42, 0.36))))
    scene.items["paving"] = {"type": "rectangle", "to_world": at().translate([0, 0, 0.01]).scale([3, 3, 1]), "bsdf": paving}
    water = scene.two_sided({"type": "plastic", "diffuse_reflectance": scene.rgb(0.01, 0.03, 0.04), "nonlinear": True})
    scene.items["pond"] = {"type": "disk", "to_world": at().translate([1.2, 1.3, 0.03]).scale([0.8, 0.8, 1]), "bsdf": water}
    scene.box("shed", (-4.5, 4, 1.3), (1.4, 1.1, 1.3), scene.diffuse(scene.texture(planks(512, rng, 14, (0.4, 0.1, 0.07)))), 25)
    scene.box("wall", (4.6, 2, 0.7), (0.12, 4.5, 0.7), scene.diffuse(scene.texture(bricks(1024, rng, 12, 40, (0.5, 0.3, 0.2)))), 8)
    scene.box("bench", (-0.9, -0.6, 0.42), (0.7, 0.18, 0.03), scene.diffuse(scene.texture(planks(256, rng, 4))), 30)
    for i, (x, y) in enumerate([(-1.4, -0.9), (-0.4, -0.32)]):
        scene.box(f"foot{i}", (x, y, 0.2), (0.05, 0.15, 0.2), scene.matt(0.1, 0.1, 0.1), 30)
    scene.ball("mirror", (-0.5, 0.9, 0.65), 0.3, {"type": "conductor", "material": "Ag"})
    scene.rod("stand", (-0.5, 0.9, 0), (-0.5, 0.9, 0.36), 0.1, scene.matt(0.4, 0.4, 0.4))
    scene.ball("copper", (0.9, -0.8, 0.35), 0.35, {"type": "roughconductor", "material": "Cu", "alpha": 0.2})
    for i in range(8):
        x, y = rng.uniform(-2.6, 2.6, 2)
        if np.hypot(x - 1.2, y - 1.3) >= 1:
            half = 0.1 + 0.15 * rng.random()
            paint = scene.diffuse(scene.texture(poster(256, rng)))
            scene.box(f"crate{i}", (x, y, half), (half, half, half), paint, rng.random() * 90)
    scene.rod("post", (2.2, -1.8, 0), (2.2, -1.8, 2.1), 0.03, scene.matt(0.03, 0.03, 0.03))
    scene.lamp("lamp", (2.2, -1.8, 2.2), 0.1, (60, 45, 25))
    trees = [
        ((-2.2, 2.1), 1.9, 0.9, 2500),
        ((5.8, -3.5), 2.6, 1.3, 3000),
        ((-2.4, -2.2), 0.25, 0.5, 1500),
        ((-7, -3), 3, 1.6, 3000),
        ((2, 7.5), 2.8, 1.5, 3000),
    ]
    for i, tree in enumerate(trees):
        plant(scene, f"tree{i}", tree, rng, folder)


def plant(scene, name, tree, rng, folder):
    """A trunk and a crown of leaves, each two triangles."""
    (x, y), height, crown, count = tree
    scene.rod(name + "trunk", (x, y, 0), (x, y, height), 0.035 * height, scene.matt(0.12, 0.08, 0.05))
    vertices, faces = [], []
    for _ in range(count):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        radius = crown * rng.random() ** (1 / 3)
        center = np.array([x, y, height + 0.3 * crown]) + direction * radius * np.array([1, 1, 0.8])
        along, across = rng.normal(size=(2, 3))
        along /= np.linalg.norm(along)
        across -= along * (along @ across)
        across /= np.linalg.norm(across)
        length, first = 0.11 * (0.6 + 0.8 * rng.random()), len(vertices)
        vertices += [center - along * length, center + across * length * 0.4, center + along * length, center - across * length * 0.4]
        faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    scene.leaves(name, vertices, faces, scene.matt(0.08 + 0.1 * rng.random(), 0.2 + 0.1 * rng.random(), 0.04), folder)


def yard_camera(rng):
    """From around, farther out where the first tree stands, before the wall."""
    angle, radius, z = rng.uniform(0, 2 * np.pi), rng.uniform(3.1, 4.2), rng.uniform(0.7, 2.4)
    eye = np.array([radius * np.cos(angle), radius * np.sin(angle), z])
    if np.hypot(eye[0] + 2.2, eye[1] - 2.1) < 1.4:
        eye = eye * 1.5
    eye[0] = min(eye[0], 3.9)
    return eye, (rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(0.2, 1))


# scene: (what is in it, camera, seed of the cameras, field of view in degrees, side in pixels, views to train on, to test, samples a pixel)
SCENES = {
    "loft": (loft, loft_camera, 3, 65, 300, 120, 20, 24),
    "yard": (yard, yard_camera, 4, 60, 300, 60, 12, 20),
    "study": (study, study_camera(), 6, 50, 400, 18, 8, 32),
    "neon": (neon, study_camera(), 6, 50, 200, 18, 8, 64),
}


def world_from_camera(eye, target):
    """[4, 4], OpenGL's axes."""
    eye, target = np.array(eye, float), np.array(target, float)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, :4] = np.stack([right, np.cross(right, forward), -forward, eye], axis=1)
    return out


def write_pfm(path, pixels):
    path.write_bytes(f"PF\n{pixels.shape[1]} {pixels.shape[0]}\n-1.0\n".encode() + pixels[::-1].astype("<f4").tobytes())


def read_pfm(path):
    _, size, _, pixels = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    return np.frombuffer(pixels, "<f4").reshape(height, width, 3)[::-1]


def denoised(channels, folder):
    """Radiance [H, W, 3] of `channels` [H, W, 9]: radiance, albedo, normals."""
    import pyoidn

    root = pathlib.Path(pyoidn.__file__).parent / "oidn"
    program = root / "bin/oidnDenoise"
    program.chmod(0o755)
    command = [program]
    for i, option in enumerate(["hdr", "alb", "nrm"]):
        path = pathlib.Path(folder) / f"{option}.pfm"
        write_pfm(path, np.nan_to_num(channels[..., 3 * i : 3 * i + 3]))
        command += [f"--{option}", path]
    out = pathlib.Path(folder) / "out.pfm"
    environment = dict(os.environ, LD_LIBRARY_PATH=str(root / "lib"))
    subprocess.run(command + ["-o", out], check=True, capture_output=True, env=environment)
    return np.maximum(read_pfm(out), 0)


def points_of(position, radiance, count, rng):
    """Points [count, 3] and their display colours: where the image has texture, mostly."""
    log = np.log(radiance.mean(2) + 1e-3)
    dy, dx = np.gradient(log)
    is_hit = np.isfinite(position).all(2) & (np.abs(position).sum(2) > 1e-6)
    weight = np.where(is_hit, np.minimum(np.hypot(dx, dy), 0.5) + 0.003, 0).ravel()
    chosen = rng.choice(weight.size, count, replace=False, p=weight / weight.sum())
    found = position.reshape(-1, 3)[chosen] + rng.normal(0, POINT_NOISE, (count, 3))
    color = radiance.reshape(-1, 3)[chosen]
    return np.hstack([found, np.clip(255 * (color / (1 + color)) ** (1 / 2.2), 0, 255)])


def make(name, out, variant):
    import mitsuba as mi

    mi.set_variant(variant)
    fill, camera, seed, fov_deg, side_px, train, test, samples = SCENES[name]
    (out / "images").mkdir(parents=True, exist_ok=True)
    rng, point_rng = np.random.default_rng(seed), np.random.default_rng(5)
    focal_px = 0.5 * side_px / np.tan(np.radians(fov_deg) / 2)
    frames, points = [], []
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(mi)
        fill(scene, folder)
        world = mi.load_dict(scene.items)
        film = {"type": "hdrfilm", "width": side_px, "height": side_px, "rfilter": {"type": "box"}}
        path = mi.load_dict({"type": "aov", "aovs": "al:albedo,nn:sh_normal", "img": {"type": "path", "max_depth": MAX_BOUNCES}})
        place = mi.load_dict({"type": "aov", "aovs": "p:position", "img": {"type": "direct"}})
        for i in range(train + test):
            matrix = world_from_camera(*camera(rng))
            # Mitsuba looks along +z, x to the left.
            to_world = mi.ScalarTransform4f(matrix @ np.diag([-1, 1, -1, 1.0]))
            lens = {"fov": float(fov_deg), "fov_axis": "x", "near_clip": 0.01, "far_clip": 10_000.0}
            sensor = mi.load_dict({"type": "perspective", **lens, "to_world": to_world, "film": film})
            radiance = denoised(np.array(mi.render(world, sensor=sensor, spp=samples, seed=i, integrator=path)), folder).astype(np.float16)
            mi.Bitmap(radiance).write(str(out / f"images/{i:03d}.exr"))
            frames.append({"file_path": f"./images/{i:03d}.exr", "transform_matrix": matrix.tolist()})
            if i < train:
                position = np.array(mi.render(world, sensor=sensor, spp=1, seed=i, integrator=place))[..., -3:]
                points.append(points_of(position, radiance.astype(np.float32), POINTS // train, point_rng))
            print(f"{name} {i + 1}/{train + test}", flush=True)
    center = side_px / 2
    head = {"w": side_px, "h": side_px, "fl_x": focal_px, "fl_y": focal_px, "cx": center, "cy": center, "ply_file_path": "points.ply"}
    for split, part in (("train", frames[:train]), ("test", frames[train:])):
        (out / f"transforms_{split}.json").write_text(json.dumps({**head, "frames": part}))
    rows = np.concatenate(points)
    properties = "".join(f"property float {c}\n" for c in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    lines = "".join("%.5f %.5f %.5f %d %d %d\n" % tuple(row) for row in rows)
    (out / "points.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{properties}end_header\n{lines}")


def subset(source, out, train):
    """The first `train` views of `source` to train on, the same to test."""
    out.mkdir(parents=True, exist_ok=True)
    for name in ("images", "points.ply"):
        (out / name).symlink_to((source / name).resolve())
    for split, count in (("train", train), ("test", None)):
        data = json.loads((source / f"transforms_{split}.json").read_text())
        data["frames"] = data["frames"][:count]
        (out / f"transforms_{split}.json").write_text(json.dumps(data))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="what", required=True)
    for name in SCENES:
        command = commands.add_parser(name)
        command.add_argument("out", type=pathlib.Path)
        command.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba")
    command = commands.add_parser("subset")
    command.add_argument("source", type=pathlib.Path)
    command.add_argument("out", type=pathlib.Path)
    command.add_argument("--train", type=int, required=True)
    given = parser.parse_args()
    if given.what == "subset":
        subset(given.source, given.out, given.train)
    else:
        make(given.what, given.out, given.variant)


if __name__ == "__main__":
    main()
