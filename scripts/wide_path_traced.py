#!/usr/bin/env python3
"""Path-traces the scenes of path_traced_scenes.py with a fisheye of 190 degrees and as panoramas, and
cuts pinhole views of 90 degrees out of the training images.

wide_path_traced.py loft|yard OUT [--views N] [--side PX] [--samples N]

OUT/fisheye, OUT/panorama: images, points.ply and transforms.json with train and test lists; every
fourth view is a test view. OUT/fisheye-cutouts, OUT/panorama-cutouts: five or six views of each training
image, resampled bilinearly in linear light, with the same points. Each pixel is the mean of rays
through its area, so that no other projection is resampled. Views that OUT/*/traced holds are not traced
again. Needs numpy, OpenEXR, mitsuba and pyoidn, and LLVM for Mitsuba (DRJIT_LIBLLVM_PATH).
"""

import argparse
import json
import math
import pathlib
import tempfile

import numpy as np
import path_traced_scenes as traced
import wide_views as wide

# Camera axes of OpenCV (right, down, forward) in those of OpenGL (right, up, back).
FLIP = np.diag([1.0, -1.0, -1.0])
# Samples of all pixels that are traced together.
CHUNK = 8


def poses(name, count):
    """World from camera, OpenGL axes: at the places of the scene's own cameras, turned by a golden angle and tilted by up to 17 degrees."""
    camera, rng = traced.SCENES[name][1], np.random.default_rng(7)
    for i in range(count):
        eye, _ = camera(rng)
        heading, pitch = 2.39996 * i, 0.3 * math.sin(2.4 * i)
        target = np.array(eye) + [math.cos(heading) * math.cos(pitch), math.sin(heading) * math.cos(pitch), math.sin(pitch)]
        yield traced.world_from_camera(eye, target)


def panorama_rays(side):
    def rays(x, y):
        longitude, latitude = (x / side - 1) * math.pi, (y / side - 0.5) * math.pi
        flat = np.cos(latitude)
        return np.stack([np.sin(longitude) * flat, np.sin(latitude), np.cos(longitude) * flat], -1)

    return rays


def fisheye_rays(side):
    limit = math.radians(wide.FIELD_DEG / 2)
    angles = np.linspace(0, limit + 0.2, 20_000)
    radii = wide.radius(angles) * 0.5 * side / wide.radius(limit)

    def rays(x, y):
        x, y = x - side / 2, y - side / 2
        from_axis = np.hypot(x, y)
        angle = np.interp(from_axis, radii, angles)
        scale = np.sin(angle) / np.maximum(from_axis, 1e-9)
        return np.stack([x * scale, y * scale, np.cos(angle)], -1)

    return rays


class Tracer:
    """Renders a scene of path_traced_scenes.py by rays of one's own."""

    def __init__(self, name, folder):
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        scene = traced.Scene(mi)
        traced.SCENES[name][0](scene, folder)
        self.mi, self.folder, self.world = mi, folder, mi.load_dict(scene.items)
        self.path = mi.load_dict({"type": "path", "max_depth": traced.MAX_BOUNCES})

    def view(self, matrix, rays, width, height, samples, seed):
        """Radiance [H, W, 3], and the places [H, W, 3] that the pixels show, 0 where none."""
        import drjit as dr

        mi, rng = self.mi, np.random.default_rng(seed)
        pixels = np.mgrid[0:height, 0:width].reshape(2, -1)
        channels, place = np.zeros((height * width, 9)), None
        for first in range(0, samples, CHUNK):
            # Tracing the scene's program takes longer than its rays: many samples at once.
            count = min(CHUNK, samples - first)
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(seed * samples + first, count * width * height)
            y, x = np.tile(pixels, count) + rng.random((2, count * width * height))
            direction = rays(x, y) @ (matrix[:3, :3] @ FLIP).T
            eye = np.broadcast_to(matrix[:3, 3], direction.shape)
            ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(eye.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32))))
            radiance, _, _ = self.path.sample(self.world, sampler, ray)
            hit = self.world.ray_intersect(ray)
            albedo = hit.bsdf(ray).eval_diffuse_reflectance(hit, hit.is_valid())
            found, valid = [radiance, albedo, hit.sh_frame.n, hit.p], hit.is_valid()
            dr.eval(found, valid)
            *parts, at = [np.array(part).T for part in found]
            channels += np.nan_to_num(np.concatenate(parts, 1)).reshape(count, -1, 9).sum(0)
            if place is None:
                place = np.where(np.array(valid)[:, None], at, 0)[: width * height]
        channels = (channels / samples).reshape(height, width, 9)
        return traced.denoised(channels, self.folder), place.reshape(height, width, 3)


def write_points(path, rows):
    properties = "".join(f"property float {c}\n" for c in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    lines = "".join("%.5f %.5f %.5f %d %d %d\n" % tuple(row) for row in rows)
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{properties}end_header\n{lines}")


def kept(path, trace):
    """What `trace` returned for this file of an earlier run, or returns now."""
    if not path.exists():
        radiance, place = trace()
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, radiance=radiance.astype(np.float32), place=place.astype(np.float32))
        partial.replace(path)
    with np.load(path) as found:
        return found["radiance"], found["place"]


def make(tracer, args, kind):
    out = args.out / kind
    for folder in ("images", "traced"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    is_fisheye = kind == "fisheye"
    side = args.side if is_fisheye else round(args.side * 0.8)
    lens = wide.fisheye(side) if is_fisheye else wide.panorama(side)
    rays = fisheye_rays(side) if is_fisheye else panorama_rays(side)
    frames, points, point_rng = [], [], np.random.default_rng(5)
    files = [f"images/{i:03}.exr" for i in range(args.views)]
    test = files[3::4]
    for i, matrix in enumerate(poses(args.scene, args.views)):
        radiance, place = kept(
            out / f"traced/{i:03}.npz", lambda m=matrix, seed=i: tracer.view(m, rays, lens["w"], lens["h"], args.samples, seed)
        )
        if is_fisheye:
            y, x = np.mgrid[0:side, 0:side] + 0.5
            outside = np.hypot(x - side / 2, y - side / 2) > side / 2
            radiance, place = np.where(outside[..., None], 0, radiance), np.where(outside[..., None], 0, place)
        wide.write(out / files[i], radiance)
        frames.append({"file_path": files[i], "transform_matrix": matrix.tolist()})
        if files[i] not in test:
            points.append(traced.points_of(place, radiance, traced.POINTS // (args.views - len(test)), point_rng))
        print(f"{kind} {i + 1}/{args.views}", flush=True)
    split = {"train_filenames": [f for f in files if f not in test], "val_filenames": test, "test_filenames": test}
    head = {**lens, "ply_file_path": "points.ply"}
    (out / "transforms.json").write_text(json.dumps({**head, "frames": frames, **split}, indent=1))
    write_points(out / "points.ply", np.concatenate(points))
    wide.cut_out(args.out, kind, side, frames, test, "points.ply")
    write_points(args.out / f"{kind}-cutouts/points.ply", np.concatenate(points))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=list(traced.SCENES))
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--side", type=int, default=320, help="of the fisheye; panoramas have 0.8 of it for their height")
    parser.add_argument("--samples", type=int, default=12)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tracer = Tracer(args.scene, folder)
        for kind in ("fisheye", "panorama"):
            make(tracer, args, kind)


if __name__ == "__main__":
    main()
