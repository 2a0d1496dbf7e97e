#!/usr/bin/env python3
"""Makes captures as a photographer would bring them from a data set of radiance, for docs/src/notebook/captured-images.md.

    scripts/make_captures.py brackets crates/cli/data/desk-lamp-200 brackets      # 5 exposures a view, for --supervision ldr
    scripts/make_captures.py pairs crates/cli/data/desk-lamp-200 pairs            # the same beside the radiance, in HDR-NeRF's layout
    scripts/make_captures.py drift crates/cli/data/desk-lamp-200 drift --ev 0.3 --balance-ev 0.15
    scripts/make_captures.py stranger crates/cli/data/desk-lamp-200 stranger      # an object before some of the views, with masks/
    scripts/make_captures.py noise crates/cli/data/desk-lamp-200 noise --white 2 --electrons 200
    scripts/make_captures.py radiance crates/cli/data/desk-lamp-200 radiance      # the images as they are, in the same layout

Faults go into the training images; the test images stay true. Every folder has a transforms.json, a split.json and the points as points.ply, so that
trainings differ in the images alone; pairs has transforms_train.json and transforms_test.json, and trains with --supervision hdr, ldr or both. Needs numpy, OpenEXR and Pillow.
"""

import argparse
import json
import pathlib
import shutil
import struct

import numpy as np
import OpenEXR
from PIL import Image

EXPOSURES_S = [0.125, 0.5, 2.0, 8.0, 32.0]


def read_exr(path):
    channels = OpenEXR.File(str(path)).channels()
    pixels = channels["RGB"].pixels if "RGB" in channels else np.stack([channels[c].pixels for c in "RGB"], axis=-1)
    return pixels.astype(np.float64)


def write_exr(path, pixels):
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels, dtype=np.float32)}).write(str(path))


def write_png(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)).save(path)


def response(x):
    """What HDR-NeRF's synthetic scenes are recorded with; 0.73 of the unit exposure."""
    return (x / (x + 1)) ** (1 / 2.2)


def write_points(scene, out):
    """Positions and colours of COLMAP's points3D.bin as a PLY."""
    data = (scene / "sparse/0/points3D.bin").read_bytes()
    (count,), at = struct.unpack_from("<Q", data), 8
    rows = []
    for _ in range(count):
        _, x, y, z, r, g, b, _, track = struct.unpack_from("<QdddBBBdQ", data, at)
        rows.append(struct.pack("<fffBBB", x, y, z, r, g, b))
        at += struct.calcsize("<QdddBBBdQ") + 8 * track
    properties = "".join(f"property float {c}\n" for c in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n"
    (out / "points.ply").write_bytes(head.encode() + b"".join(rows))


def noisy(x, electrons, rng):
    """Exposure x as a sensor counts it that has so many electrons at x = 1, with 3 of read noise."""
    return np.maximum(rng.poisson(np.maximum(x, 0) * electrons) + rng.normal(0, 3, x.shape), 0) / electrons


def write_pairs(scene, described, train, out, electrons, rng):
    """HDR-NeRF's layout: train/r_<pose>_<exposure>.png beside train_hdr/hdr_<pose>.exr, and so for test."""
    noise = {"train": rng, "test": np.random.default_rng(rng.bit_generator.seed_seq.spawn(1)[0])}
    head = {key: value for key, value in described.items() if key != "frames"}
    frames, exposures, poses = {"train": [], "test": []}, {"train": {}, "test": {}}, {"train": 0, "test": 0}
    for frame in described["frames"]:
        name = pathlib.PurePosixPath(frame["file_path"]).stem
        source = next(path for path in [scene / frame["file_path"], scene / "images" / f"{name}.exr"] if path.is_file())
        part = "train" if name in train else "test"
        pose, poses[part] = poses[part], poses[part] + 1
        target = out / f"{part}_hdr" / f"hdr_{pose:03}.exr"
        target.parent.mkdir(exist_ok=True)
        shutil.copy(source, target)
        radiance = read_exr(source)
        for k, seconds in enumerate(EXPOSURES_S):
            write_png(out / f"{part}/r_{pose}_{k}.png", response(noisy(radiance * seconds, electrons, noise[part])))
            frames[part].append({**frame, "file_path": f"{part}/r_{pose}_{k}"})
            exposures[part][f"r_{pose}_{k}.png"] = seconds
    for part in ["train", "test"]:
        described = {**head, "frames": frames[part], "ply_file_path": "points.ply"}
        (out / f"transforms_{part}.json").write_text(json.dumps(described, indent=1))
        (out / f"exposure_{part}.json").write_text(json.dumps(exposures[part], indent=1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["brackets", "pairs", "drift", "stranger", "noise", "radiance"])
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--ev", type=float, default=0.3, help="drift: largest exposure error, stops")
    parser.add_argument("--balance-ev", type=float, default=0.0, help="drift: largest error of red and blue against green, stops")
    parser.add_argument("--electrons", type=float, default=20_000, help="brackets, pairs, noise: of a pixel at x = 1, at white")
    parser.add_argument("--white", type=float, default=2.0, help="noise: radiance at white")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    described = json.loads((args.scene / "transforms.json").read_text())
    split = json.loads((args.scene / "split.json").read_text())
    args.out.mkdir(parents=True)
    write_points(args.scene, args.out)
    stem = lambda name: pathlib.PurePosixPath(name).stem
    train = {stem(name) for name in split["train"]}

    if args.kind == "pairs":
        return write_pairs(args.scene, described, train, args.out, args.electrons, rng)

    views = [frame for frame in described["frames"] if stem(frame["file_path"]) in train]
    drift = rng.uniform(-1, 1, (len(views), 3)) * [args.balance_ev, 0, args.balance_ev] + rng.uniform(-args.ev, args.ev, (len(views), 1))
    # What all images share could not be told from the scene; the truth has no such share.
    drift -= drift.mean(axis=0)

    frames, names = [], {"train": [], "test": []}
    for frame in described["frames"]:
        name = stem(frame["file_path"])
        source = next(path for path in [args.scene / frame["file_path"], args.scene / "images" / f"{name}.exr"] if path.is_file())
        if name not in train:
            target = args.out / "test" / f"{name}.exr"
            target.parent.mkdir(exist_ok=True)
            shutil.copy(source, target)
            frames.append({**frame, "file_path": f"test/{name}.exr"})
            names["test"].append(f"test/{name}")
            continue
        radiance = read_exr(source)
        if args.kind == "brackets":
            for k, seconds in enumerate(EXPOSURES_S):
                write_png(args.out / f"train/{name}_{k}.png", response(noisy(radiance * seconds, args.electrons, rng)))
                frames.append({**frame, "file_path": f"train/{name}_{k}.png", "exposure": seconds})
                names["train"].append(f"train/{name}_{k}")
            continue
        index = len(names["train"])
        more = {}
        if args.kind == "drift":
            radiance = radiance * 2.0 ** drift[index]
            more["drift_ev"] = drift[index].tolist()
        elif args.kind == "noise":
            radiance = noisy(radiance / args.white, args.electrons, rng) * args.white
            more["noise"] = [args.white * 3 / args.electrons, args.white / args.electrons]
        elif args.kind == "stranger" and index % 3 == 0:
            height, width, _ = radiance.shape
            y, x = np.mgrid[:height, :width]
            center = rng.uniform(0.3, 0.7) * width
            person = (abs(x - center) < 0.11 * width) & (y > 0.25 * height)
            head = (x - center) ** 2 + (y - 0.2 * height) ** 2 < (0.075 * width) ** 2
            is_person = person | head
            radiance[is_person] = np.median(radiance) * rng.uniform(2, 6) * np.array([0.9, 0.5, 0.35])
            write_png(args.out / f"masks/{name}.png", np.where(is_person, 0.0, 1.0))
        elif args.kind == "stranger":
            write_png(args.out / f"masks/{name}.png", np.ones(radiance.shape[:2]))
        write_exr(args.out / f"train/{name}.exr", radiance)
        frames.append({**frame, "file_path": f"train/{name}.exr", **more})
        names["train"].append(f"train/{name}")
    described = {**described, "frames": frames, "ply_file_path": "points.ply"}
    (args.out / "transforms.json").write_text(json.dumps(described, indent=1))
    (args.out / "split.json").write_text(json.dumps(names, indent=1))


if __name__ == "__main__":
    main()
