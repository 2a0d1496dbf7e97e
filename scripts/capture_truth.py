#!/usr/bin/env python3
"""Hold what luxel prepare made of a synthetic capture (synthesise_capture.py) against the scene it was made of.

needs: pip install numpy OpenEXR

usage: capture_truth.py merge SCENE CAPTURE DATASET
         Error of luminance by decade of true luminance. DATASET: of `luxel prepare --sfm off`, whose radiance has the photographs' pixels.
       capture_truth.py poses SCENE CAPTURE DATASET OUT
         Aligns true camera centres with those that were found by a similarity, prints what is left, and writes OUT: the scene's own images and cameras in
         the world of the data set, to be passed to `luxel eval RUN --data OUT`; and split.json of the scene into DATASET.
"""
import json
import pathlib
import sys

import numpy as np
import OpenEXR

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


def read_exr(path):
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        if "RGB" in channels:
            return channels["RGB"].pixels.astype(np.float64)
        return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float64)


def write_exr(path, pixels):
    channels = {c: np.ascontiguousarray(pixels[..., i].astype(np.float32)) for i, c in enumerate("RGB")}
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))


def view_names(capture, folder, truth):
    """Scene's view by the prepared one's: views are named by their first frame."""
    files = sorted(p.stem for p in capture.iterdir() if p.suffix.lower() in (".jpg", ".dng"))
    per_view = len(files) // len(truth["views"])
    return {files[i * per_view]: name for i, name in enumerate(truth["views"])}


def merge(scene, capture, dataset):
    truth = json.loads((capture / "truth.json").read_text())
    true, found = [], []
    for name, view in view_names(capture, dataset, truth).items():
        true.append((read_exr(scene / "images" / f"{view}.exr") @ LUMINANCE).ravel() * truth["radiance_factor"])
        found.append((read_exr(dataset / "work" / "radiance" / f"{name}.exr") @ LUMINANCE).ravel())
    true, found = np.concatenate(true), np.concatenate(found)
    lit = (true > 0) & (found > 0)
    scale = np.exp(np.median(np.log(found[lit] / true[lit])))
    print(f"{len(true)} pixels; found / true luminance, median: {scale:.4f}, which is taken out below")
    print("decade of true luminance, cd/m2 | pixels | median error | mean error | rms error | 95th percentile")
    for decade in range(-6, 8):
        here = (true >= 10.0**decade) & (true < 10.0 ** (decade + 1))
        if here.sum() < 100:
            continue
        error = found[here] / scale / true[here] - 1
        rows = [np.median(error), error.mean(), np.sqrt((error**2).mean()), np.percentile(abs(error), 95)]
        print(f"1e{decade:+d} | {here.sum()} | " + " | ".join(f"{100 * v:+.2f} %" for v in rows))


def rotation(w, x, y, z):
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def similarity(source, target):
    """s, R, t with s R source + t nearest to target (Umeyama 1991)."""
    a, b = source.mean(0), target.mean(0)
    u, d, vt = np.linalg.svd((target - b).T @ (source - a) / len(source))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    r = u @ sign @ vt
    s = (d * np.diag(sign)).sum() / ((source - a) ** 2).sum() * len(source)
    return s, r, b - s * r @ a


def poses(scene, capture, dataset, out):
    truth = json.loads((capture / "truth.json").read_text())
    names = view_names(capture, dataset, truth)
    own = json.loads((scene / "transforms.json").read_text())
    true = {pathlib.Path(f["file_path"]).stem: np.array(f["transform_matrix"]) for f in own["frames"]}
    found = {}
    lines = [l for l in (dataset / "sparse/0/images.txt").read_text().splitlines() if not l.startswith("#")]
    for line in lines[::2]:
        word = line.split()
        r, t = rotation(*map(float, word[1:5])), np.array(list(map(float, word[5:8])))
        found[names[pathlib.Path(word[9]).stem]] = (r, -r.T @ t)
    common = sorted(found)
    source, target = (np.array([true[n][:3, 3] for n in common]), np.array([found[n][1] for n in common]))
    s, r, t = similarity(source, target)
    left = np.linalg.norm((s * source @ r.T + t) - target, axis=1)
    size = np.linalg.norm(target - target.mean(0), axis=1).mean()
    flip = np.diag([1.0, -1.0, -1.0])
    angles = [np.degrees(np.arccos(np.clip((np.trace(found[n][0] @ r @ true[n][:3, :3] @ flip) - 1) / 2, -1, 1))) for n in common]
    print(f"{len(common)} of {len(true)} views; centres off by {100 * left.mean() / size:.3f} % of their mean distance to the middle "
          f"(largest {100 * left.max() / size:.3f} %), turned by {np.mean(angles):.3f} degrees (largest {np.max(angles):.3f})")
    # A recovered response curve leaves one factor open: that between the medians of all views.
    back = {view: name for name, view in names.items()}
    medians = [np.median(read_exr(dataset / "images" / f"{back[n]}.exr")) / np.median(read_exr(scene / "images" / f"{n}.exr")) for n in common]
    factor = float(np.median(medians))
    print(f"found / true radiance, median: {factor / truth['radiance_factor']:.4f}; taken into OUT")
    (out / "images").mkdir(parents=True, exist_ok=True)
    for frame in own["frames"]:
        matrix = np.array(frame["transform_matrix"])
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = r @ matrix[:3, :3], s * r @ matrix[:3, 3] + t
        frame["transform_matrix"] = moved.tolist()
        name = pathlib.Path(frame["file_path"]).stem
        write_exr(out / "images" / f"{name}.exr", read_exr(scene / "images" / f"{name}.exr") * factor)
    (out / "transforms.json").write_text(json.dumps(own))
    split = json.loads((scene / "split.json").read_text())
    (out / "split.json").write_text(json.dumps({k: split[k] for k in ("train", "test")}))
    stem = lambda name: pathlib.Path(name).stem
    own_split = {k: [f"images/{back[stem(n)]}" for n in split[k] if stem(n) in found] for k in ("train", "test")}
    (dataset / "split.json").write_text(json.dumps(own_split))


command, *folders = sys.argv[1:]
{"merge": merge, "poses": poses}[command](*map(pathlib.Path, folders))
