#!/usr/bin/env python3
"""Makes data sets of a scene for the wide projections: views of a fisheye and panoramas, rendered by
luxel, and pinhole cut-outs of the same images.

wide_views.py LUXEL SCENE OUT [--at X,Y,Z] [--spread S] [--views N] [--side PX]

OUT/fisheye, OUT/panorama: images and transforms.json with train and test lists; every fourth view is a
test view. OUT/fisheye-cutouts, OUT/panorama-cutouts: five or six views of 90 degrees of each training
image, resampled bilinearly in linear light. Needs numpy and OpenEXR.
"""

import argparse
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import OpenEXR

COEFFICIENTS = [-0.03, 0.012, -0.004, 0.0006]
FIELD_DEG = 190.0
# Yaw and pitch of cut-outs: all of the circle's.
SIDES = [(0, 0), (math.pi / 2, 0), (-math.pi / 2, 0), (0, math.pi / 2), (0, -math.pi / 2)]


def rotation(yaw, pitch):
    """Camera to world, OpenGL axes: right, up, back."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    turn = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    tilt = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    # The world of 3D Gaussian splatting has y down.
    return np.diag([1.0, -1.0, -1.0]) @ turn @ tilt


def poses(at, spread, count):
    rng = np.random.default_rng(1)
    for i in range(count):
        eye = np.array(at) + spread * rng.uniform(-1, 1, 3)
        yield eye, rotation(2 * math.pi * i / count, 0.3 * math.sin(2.4 * i))


def radius(angle):
    k1, k2, k3, k4 = COEFFICIENTS
    t2 = angle * angle
    return angle * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def matrix(eye, turn):
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = turn, eye
    return m.tolist()


def fisheye(side):
    focal = 0.5 * side / radius(math.radians(FIELD_DEG / 2))
    keys = dict(zip(("k1", "k2", "k3", "k4"), COEFFICIENTS))
    return {"camera_model": "OPENCV_FISHEYE", "fl_x": focal, "fl_y": focal, "cx": side / 2, "cy": side / 2, "w": side, "h": side,
            "fisheye_crop_radius": side / 2, **keys}


def panorama(side):
    return {"camera_model": "EQUIRECTANGULAR", "w": 2 * side, "h": side}


def fisheye_place(ray, side):
    """Pixels of rays (OpenCV axes), NaN outside of the circle."""
    flat = np.hypot(ray[..., 0], ray[..., 1])
    angle = np.arctan2(flat, ray[..., 2])
    focal = 0.5 * side / radius(math.radians(FIELD_DEG / 2))
    scale = np.where(flat > 0, focal * radius(angle) / np.maximum(flat, 1e-12), 0)
    place = ray[..., :2] * scale[..., None] + side / 2
    place[angle > math.radians(FIELD_DEG / 2) - 0.01] = np.nan
    return place


def panorama_place(ray, side):
    longitude = np.arctan2(ray[..., 0], ray[..., 2])
    latitude = np.arctan2(ray[..., 1], np.hypot(ray[..., 0], ray[..., 2]))
    return np.stack([(longitude / math.pi + 1) * side, (latitude / math.pi + 0.5) * side], -1)


def sample(image, place, wraps):
    height, width = image.shape[:2]
    at = np.nan_to_num(place - 0.5)
    low = np.floor(at).astype(int)
    fx, fy = (at - low)[..., 0:1], (at - low)[..., 1:2]

    def pixel(dx, dy):
        x = low[..., 0] + dx
        x = x % width if wraps else np.clip(x, 0, width - 1)
        return image[np.clip(low[..., 1] + dy, 0, height - 1), x]

    top = pixel(0, 0) * (1 - fx) + pixel(1, 0) * fx
    bottom = pixel(0, 1) * (1 - fx) + pixel(1, 1) * fx
    return top * (1 - fy) + bottom * fy


def read(path):
    channels = OpenEXR.File(str(path)).channels()
    return channels["RGB"].pixels.astype(np.float32) if "RGB" in channels else np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float32)


def write(path, image):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": image.astype(np.float16)}).write(str(path))


def make(args, name, lens):
    out = args.out / name
    (out / "images").mkdir(parents=True, exist_ok=True)
    frames = [{"file_path": f"images/{i:03}.exr", "transform_matrix": matrix(eye, turn)}
              for i, (eye, turn) in enumerate(poses(args.at, args.spread, args.views))]
    files = [frame["file_path"] for frame in frames]
    test = files[3::4]
    split = {"train_filenames": [f for f in files if f not in test], "val_filenames": test, "test_filenames": test}
    (out / "transforms.json").write_text(json.dumps({**lens, "frames": frames, **split}, indent=1))
    subprocess.run([args.luxel, "render", args.scene, "--cameras", out / "transforms.json", "-o", out / "images", "--samples", "3",
                    "--exr-type", "half", "--overwrite", "--quiet"], check=True)
    cut_out(args.out, name, args.side, frames, test)


def cut_out(folder, name, side, frames, test, points=None):
    """Cuts pinhole views of 90 degrees out of the training images of FOLDER/NAME; `points`: a file for ply_file_path."""
    place = fisheye_place if name == "fisheye" else panorama_place
    turns = SIDES if name == "fisheye" else [*SIDES, (math.pi, 0)]
    out = folder / name
    cut = folder / f"{name}-cutouts"
    (cut / "images").mkdir(parents=True, exist_ok=True)
    across = round(side * (90 / FIELD_DEG if name == "fisheye" else 0.5) * 4 / math.pi)
    focal = across / 2
    y, x = np.mgrid[0:across, 0:across] + 0.5
    base = np.stack([(x - focal) / focal, (y - focal) / focal, np.ones_like(x)], -1)
    cut_frames, masks = [], {}
    flip = np.diag([1.0, -1.0, -1.0])
    for i, frame in enumerate(frames):
        if frame["file_path"] in test:
            continue
        image = read(out / frame["file_path"])
        pose = np.array(frame["transform_matrix"])
        for n, (yaw, pitch) in enumerate(turns):
            cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
            # Cut-out to camera, OpenCV axes.
            turn = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
            at = place(base @ turn.T, side)
            seen = np.isfinite(at).all(-1)
            path = f"images/{i:03}_{n}.exr"
            write(cut / path, np.where(seen[..., None], sample(image, at, name == "panorama"), -1.0))
            m = np.eye(4)
            m[:3, :3], m[:3, 3] = pose[:3, :3] @ flip @ turn @ flip, pose[:3, 3]
            cut_frames.append({"file_path": path, "transform_matrix": m.tolist()})
    files = [frame["file_path"] for frame in cut_frames]
    lens = {"camera_model": "PINHOLE", "fl_x": focal, "fl_y": focal, "cx": focal, "cy": focal, "w": across, "h": across}
    split = {"train_filenames": files, "val_filenames": [], "test_filenames": []}
    head = {**lens, "ply_file_path": points} if points else lens
    (cut / "transforms.json").write_text(json.dumps({**head, "frames": cut_frames, **split}, indent=1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("luxel")
    parser.add_argument("scene")
    parser.add_argument("out", type=Path)
    parser.add_argument("--at", type=lambda t: [float(v) for v in t.split(",")], default=[0.0, 0.0, 2.5])
    parser.add_argument("--spread", type=float, default=0.6)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--side", type=int, default=256)
    args = parser.parse_args()
    make(args, "fisheye", fisheye(args.side))
    make(args, "panorama", panorama(args.side))


if __name__ == "__main__":
    main()
