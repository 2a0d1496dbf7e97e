#!/usr/bin/env python3
"""Path-traces a desk under one light at a time, and under several at once: data sets for mixing light (docs/src/notebook/mixing-light.md).

    scripts/lights_path_traced.py out/desk        # out/desk/room, lamp, key, and all, each a data set of the same 24 + 6 cameras

`room` is a window and a ceiling, `lamp` the desk lamp alone, `key` a coloured key light alone, `all` the three together, rendered on its own. Images are
half-float EXR of 200x200, denoised. Needs what path_traced_scenes.py needs.
"""

import argparse
import json
import pathlib
import tempfile

import numpy as np
from path_traced_scenes import Scene, denoised, planks, points_of, poster, value_noise, world_from_camera

SIZE_PX = 200
FOV_DEG = 50
TRAIN, TEST = 24, 6
SAMPLES = 96
MAX_BOUNCES = 8
POINTS = 9_000
LIGHTS = ("room", "lamp", "key")


def desk(scene, lit):
    """A desk before two walls; `lit` names the lights that are on."""
    rng, at = np.random.default_rng(7), scene.at

    def radiance(light, *values):
        return scene.rgb(*(values if light in lit else (0, 0, 0)))

    plaster = 0.45 + 0.35 * value_noise(512, rng, 8, 0.75)[..., None] * np.array([1, 0.95, 0.85])
    scene.rectangle("floor", at().scale([3, 3, 1]), scene.diffuse(scene.texture(planks(512, rng, 12, (0.3, 0.22, 0.15)))))
    scene.rectangle("back", at().translate([0, 1.2, 1.5]).rotate([1, 0, 0], 90).scale([3, 1.5, 1]), scene.diffuse(scene.texture(plaster)))
    left = at().translate([-1.6, 0, 1.5]).rotate([0, 1, 0], 90).scale([1.5, 3, 1])
    scene.rectangle("left", left, scene.diffuse(scene.texture(plaster[::-1] * np.array([0.75, 0.85, 1]), 2)))
    wood = {"type": "principled", "base_color": scene.texture(planks(512, rng, 6, (0.5, 0.3, 0.12))), "roughness": 0.3, "specular": 0.5}
    scene.box("desk", (0, 0.3, 0.72), (0.9, 0.5, 0.03), wood)
    for i, (x, y) in enumerate([(-0.8, -0.1), (0.8, -0.1), (-0.8, 0.7), (0.8, 0.7)]):
        scene.box(f"leg{i}", (x, y, 0.345), (0.03, 0.03, 0.345), scene.matt(0.06, 0.06, 0.06))
    for i in range(7):
        cover = scene.diffuse(scene.texture(poster(96, rng)))
        scene.box(f"book{i}", (-0.5 + 0.02 * i, 0.45, 0.765 + 0.03 * i), (0.16, 0.11, 0.014), cover, rng.random() * 40)
    scene.box("sheet", (0.1, 0.05, 0.752), (0.15, 0.2, 0.001), scene.diffuse(scene.texture(poster(128, rng))), 12)
    scene.ball("gold", (0.05, 0.45, 0.85), 0.1, {"type": "roughconductor", "material": "Au", "alpha": 0.2})
    scene.ball("red", (-0.15, 0.1, 0.82), 0.07, {"type": "plastic", "diffuse_reflectance": scene.rgb(0.6, 0.05, 0.04)})
    scene.rod("mug", (0.4, 0.05, 0.75), (0.4, 0.05, 0.87), 0.05, scene.matt(0.15, 0.35, 0.3))
    for i, x in enumerate([-0.7, 0.3, 1.1]):
        place = at().translate([x, 1.19, 1.55]).rotate([1, 0, 0], 90).scale([0.3, 0.4, 1])
        scene.rectangle(f"poster{i}", place, scene.diffuse(scene.texture(poster(192, rng))))

    # The lamp: a foot, an arm, a shade that is open below, and a bulb in it.
    metal = scene.matt(0.1, 0.12, 0.15)
    scene.rod("foot", (0.6, 0.5, 0.75), (0.6, 0.5, 0.78), 0.1, metal)
    scene.rod("arm", (0.6, 0.5, 0.75), (0.6, 0.5, 1.25), 0.012, metal)
    scene.rod("reach", (0.6, 0.5, 1.25), (0.35, 0.4, 1.3), 0.01, metal)
    scene.rod("shade", (0.35, 0.4, 1.16), (0.35, 0.4, 1.3), 0.1, scene.matt(0.5, 0.45, 0.35))
    bulb = {"type": "area", "radiance": radiance("lamp", 150, 95, 45)}
    scene.items["bulb"] = {"type": "sphere", "center": [0.35, 0.4, 1.19], "radius": 0.035, "bsdf": scene.matt(0.6, 0.6, 0.6), "emitter": bulb}

    window = at().translate([-1.55, 0.2, 1.7]).rotate([0, 1, 0], 90).scale([0.45, 0.5, 1])
    scene.items["window"] = {"type": "rectangle", "to_world": window, "emitter": {"type": "area", "radiance": radiance("room", 1.6, 2.1, 2.8)}}
    ceiling = at().translate([0.3, -0.3, 3]).rotate([1, 0, 0], 180).scale([1.5, 1.2, 1])
    panel = {"type": "area", "radiance": radiance("room", 0.35, 0.33, 0.3)}
    scene.items["ceiling"] = {"type": "rectangle", "to_world": ceiling, "emitter": panel}
    # Behind the cameras, from the right: magenta.
    key = at().look_at(origin=[3.2, -2.2, 2.6], target=[0, 0.3, 0.8], up=[0, 0, 1]).scale([0.3, 0.3, 1])
    scene.items["key"] = {"type": "rectangle", "to_world": key, "emitter": {"type": "area", "radiance": radiance("key", 22, 4, 26)}}


def camera(rng):
    """From before the desk, somewhat above it."""
    angle, radius = rng.uniform(-2.45, -0.75), rng.uniform(1.7, 2.3)
    eye = (radius * np.cos(angle), 0.3 + radius * np.sin(angle), rng.uniform(1.0, 1.9))
    return eye, (rng.uniform(-0.25, 0.25), 0.4 + rng.uniform(-0.1, 0.2), rng.uniform(0.8, 1.05))


def make(name, lit, out, first_seed):
    import mitsuba as mi

    (out / "images").mkdir(parents=True, exist_ok=True)
    rng, point_rng = np.random.default_rng(3), np.random.default_rng(5)
    focal_px = 0.5 * SIZE_PX / np.tan(np.radians(FOV_DEG) / 2)
    frames, points = [], []
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(mi)
        desk(scene, lit)
        world = mi.load_dict(scene.items)
        film = {"type": "hdrfilm", "width": SIZE_PX, "height": SIZE_PX, "rfilter": {"type": "box"}}
        path = mi.load_dict({"type": "aov", "aovs": "al:albedo,nn:sh_normal", "img": {"type": "path", "max_depth": MAX_BOUNCES}})
        place = mi.load_dict({"type": "aov", "aovs": "p:position", "img": {"type": "direct"}})
        for i in range(TRAIN + TEST):
            matrix = world_from_camera(*camera(rng))
            # Mitsuba looks along +z, x to the left.
            to_world = mi.ScalarTransform4f(matrix @ np.diag([-1, 1, -1, 1.0]))
            lens = {"fov": float(FOV_DEG), "fov_axis": "x", "near_clip": 0.01, "far_clip": 1000.0}
            sensor = mi.load_dict({"type": "perspective", **lens, "to_world": to_world, "film": film})
            channels = np.array(mi.render(world, sensor=sensor, spp=SAMPLES, seed=first_seed + i, integrator=path))
            radiance = denoised(channels, folder).astype(np.float16)
            mi.Bitmap(radiance).write(str(out / f"images/{i:03d}.exr"))
            frames.append({"file_path": f"./images/{i:03d}.exr", "transform_matrix": matrix.tolist()})
            if i < TRAIN:
                position = np.array(mi.render(world, sensor=sensor, spp=1, seed=i, integrator=place))[..., -3:]
                points.append(points_of(position, radiance.astype(np.float32), POINTS // TRAIN, point_rng))
            print(f"{name} {i + 1}/{TRAIN + TEST}", flush=True)
    center = SIZE_PX / 2
    head = {"w": SIZE_PX, "h": SIZE_PX, "fl_x": focal_px, "fl_y": focal_px, "cx": center, "cy": center, "ply_file_path": "points.ply"}
    for split, part in (("train", frames[:TRAIN]), ("test", frames[TRAIN:])):
        (out / f"transforms_{split}.json").write_text(json.dumps({**head, "frames": part}))
    rows = np.concatenate(points)
    properties = "".join(f"property float {c}\n" for c in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    lines = "".join("%.5f %.5f %.5f %d %d %d\n" % tuple(row) for row in rows)
    (out / "points.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{properties}end_header\n{lines}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba")
    given = parser.parse_args()
    import mitsuba as mi

    mi.set_variant(given.variant)
    for i, (name, lit) in enumerate([*((light, (light,)) for light in LIGHTS), ("all", LIGHTS)]):
        make(name, lit, given.out / name, 1000 * i)


if __name__ == "__main__":
    main()
