#!/usr/bin/env python3
"""Measures scenes at the edges of blocks and away from them.

block_seams.py BLOCKS DATASET DEPTH SCENE... [--width FRACTION]
block_seams.py BLOCKS DATASET DEPTH SCENE... --metres WIDTH

BLOCKS is a folder of luxel split, DATASET its data set with transforms_test.json and pinhole cameras, DEPTH
renders of its test views with channel Z (luxel render --split test --depth), and each SCENE a folder of
luxel eval -o with renders and gt. Prints PSNR under the mu-law for pixels whose surface is nearer to an
edge between blocks than a fraction of the border, and for the others; the pixels are the same for all
scenes. With --metres, prints it for each edge of the blocks' first direction, over pixels no further from it than so many
units of the world, so that a scene with edges elsewhere tells what is the edge's and what is the place's. Needs numpy and OpenEXR.
"""

import argparse
import json
import math
import pathlib

import numpy as np
import OpenEXR

MU = 5000.0


def channels(path, names):
    """The channels of an image by name, [H, W, len(names)]."""
    found = OpenEXR.File(str(path), separate_channels=True).channels()
    return np.stack([found[name].pixels.astype(np.float64) for name in names], -1)


def places(frame, shared, depth):
    """World positions of an image's surfaces, [H, W, 3]."""
    get = lambda key: frame.get(key, shared.get(key))
    height, width = depth.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    # OpenGL axes: right, up, back.
    rays = np.stack([(x - get("cx")) / get("fl_x"), -(y - get("cy")) / get("fl_y"), -np.ones_like(x)], -1)
    pose = np.array(frame["transform_matrix"])
    return (rays * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]


def near_edges(blocks, world, width):
    """Pixels nearer to an edge of their block than the fraction `width` of the border there."""
    near = np.zeros(world.shape[:2], bool)
    for block in blocks:
        at = [world @ np.array(axis) for axis in block["axes"]]
        inside, close = np.ones_like(near), np.zeros_like(near)
        for along, core, reach in zip(at, block["core"], block["reach"]):
            low, high = [-math.inf if core[0] is None else core[0], math.inf if core[1] is None else core[1]]
            inside &= (along >= low) & (along < high)
            for edge, end in zip(core, reach):
                if edge is not None:
                    close |= np.abs(along - edge) < width * abs(end - edge)
        near |= inside & close
    return near


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("blocks", type=pathlib.Path)
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("depth", type=pathlib.Path)
    parser.add_argument("scenes", type=pathlib.Path, nargs="+")
    parser.add_argument("--width", type=float, default=0.5)
    parser.add_argument("--metres", type=float)
    args = parser.parse_args()
    listed = json.loads((args.blocks / "blocks.json").read_text())
    blocks = [json.loads((args.blocks / name / "block.json").read_text()) for name in listed["blocks"]]
    cameras = json.loads((args.dataset / "transforms_test.json").read_text())
    tone = lambda image: np.log1p(MU * np.clip(image / listed["radiance_scale"], 0, 1)) / math.log1p(MU)
    axis = np.array(blocks[0]["axes"][0])
    edges_m = sorted({edge for block in blocks for edge in block["core"][0] if edge is not None})
    by_edge = {scene: np.zeros((len(edges_m), 2)) for scene in args.scenes}
    sums = {scene: np.zeros((2, 2)) for scene in args.scenes}
    for frame in cameras["frames"]:
        name = pathlib.Path(frame["file_path"]).stem + ".exr"
        depth = channels(args.depth / name, ["Z"])[..., 0]
        world = places(frame, cameras, np.where(depth < 1e9, depth, 1e9))
        near = near_edges(blocks, world, args.width)
        for scene in args.scenes:
            truth, render = (tone(channels(scene / part / name, "RGB")) for part in ("gt", "renders"))
            error = ((truth - render) ** 2).mean(-1)
            for i, mask in enumerate((near, ~near)):
                sums[scene][i] += error[mask].sum(), mask.sum()
            for i, edge in enumerate(edges_m if args.metres else []):
                mask = np.abs(world @ axis - edge) < args.metres
                by_edge[scene][i] += error[mask].sum(), mask.sum()
    psnr = lambda total, count: -10 * math.log10(max(total, 1e-12) / max(count, 1))
    if args.metres:
        for scene in args.scenes:
            whole = psnr(*sums[scene].sum(0))
            print(f"{scene}: {whole:.2f} dB, at edges " + ", ".join(f"{edge:.1f}: {psnr(*of):.2f}" for edge, of in zip(edges_m, by_edge[scene])))
        return
    for scene, ((edge, edges), (other, others)) in sums.items():
        share = 100 * edges / (edges + others)
        print(f"{scene}: {psnr(edge, edges):.2f} dB at edges ({share:.0f} % of the pixels), {psnr(other, others):.2f} dB elsewhere")


if __name__ == "__main__":
    main()
