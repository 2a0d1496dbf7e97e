"""Times forward and backward of `luxel.torch.rasterization`, beside gsplat's PyTorch functions on the CPU.

    OMP_WAIT_POLICY=passive python rasterization.py SCENE.ply CAMERA.json [ROUNDS]

SCENE is a plain 3DGS file, CAMERA one of `luxel bench --camera`. gsplat's rasteriser needs CUDA, but its projection, its harmonics
and its lists of tiles have versions in PyTorch, which are used here; tiles are blended by PyTorch, all pixels of a tile at
once. Rounds alternate; medians are printed, and how far the images are apart. Splats are in the order of the file, and for
luxel.torch also in spatial order, as Luxel's own training keeps them.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import torch

import luxel
from luxel.torch import rasterization, spatial_order

TILE, REPETITIONS = 16, 12


def blended(means, conics, colors, opacities, lists, width, height):
    """Blends tiles with lists of splats, front to back: an image [height, width, 3]."""
    rows = []
    across = -(-width // TILE)
    for first in range(0, len(lists), across):
        row = []
        for tile in range(first, first + across):
            y, x = torch.meshgrid(torch.arange(TILE) + 0.5, torch.arange(TILE) + 0.5, indexing="ij")
            pixels = torch.stack([x + tile % across * TILE, y + tile // across * TILE], -1).reshape(-1, 1, 2)
            ids = lists[tile]
            d = pixels - means[ids]
            a, b, c = conics[ids].unbind(-1)
            sigma = 0.5 * (a * d[..., 0] ** 2 + c * d[..., 1] ** 2) + b * d[..., 0] * d[..., 1]
            alpha = (opacities[ids] * torch.exp(-sigma)).clamp(max=0.999)
            alpha = torch.where(alpha < 1 / 255, torch.zeros_like(alpha), alpha)
            behind = torch.cumprod(1 - alpha, 1)
            before = torch.cat([torch.ones(TILE * TILE, 1), behind[:, :-1]], 1)
            weight = torch.where(behind > 1e-4, alpha * before, torch.zeros_like(alpha))
            row.append((weight @ colors[ids]).reshape(TILE, TILE, 3))
        rows.append(torch.cat(row, 1))
    return torch.cat(rows)[:height, :width]


def of_gsplat(t, viewmat, K, width, height):
    """The image by gsplat's PyTorch functions."""
    from gsplat.cuda import _torch_impl as gsplat

    covars, _ = gsplat._quat_scale_to_covar_preci(t["quats"], t["scales"], True, False)
    radii, means2d, depths, conics, _ = gsplat._fully_fused_projection(t["means"], covars, viewmat, K, width, height)
    directions = t["means"] - torch.inverse(viewmat)[:, None, :3, 3]
    colors = (gsplat._spherical_harmonics(3, directions, t["colors"][None]) + 0.5).clamp_min(0.0)
    with torch.no_grad():
        across, down = -(-width // TILE), -(-height // TILE)
        # gsplat's own function walks over splats in Python; the same lists, by whole arrays.
        seen = torch.nonzero((radii[0] > 0).all(-1))[:, 0]
        seen = seen[torch.argsort(depths[0][seen])]
        low = ((means2d[0][seen] - radii[0][seen]) / TILE).floor().long().clamp_min(0)
        high = ((means2d[0][seen] + radii[0][seen]) / TILE).ceil().long().minimum(torch.tensor([across, down]))
        count = (high - low).clamp_min(0)
        number = count.prod(-1)
        splat = torch.repeat_interleave(torch.arange(len(seen)), number)
        place = torch.arange(len(splat)) - torch.repeat_interleave(torch.cumsum(number, 0) - number, number)
        tile = (low[splat, 1] + place // count[splat, 0]) * across + low[splat, 0] + place % count[splat, 0]
        order = torch.sort(tile, stable=True)[1]
        lists = torch.split(seen[splat[order]], torch.bincount(tile, minlength=across * down).tolist())
    return blended(means2d[0], conics[0], colors[0], t["opacities"], lists, width, height)


def of_luxel(t, viewmat, K, width, height):
    return rasterization(**t, viewmats=viewmat, Ks=K, width=width, height=height, sh_degree=3, packed=False)[0][0]


def main(scene_path: str, camera_path: str, rounds: int) -> None:
    torch.set_num_threads(2)
    scene, camera = luxel.Scene.open(scene_path), json.load(open(camera_path))
    values = {
        "means": scene.positions, "quats": scene.rotations, "scales": np.exp(scene.log_scales),
        "opacities": 1 / (1 + np.exp(-scene.opacity_logits)), "colors": scene.sh,
    }  # fmt: skip
    t = {name: torch.from_numpy(np.ascontiguousarray(value)).requires_grad_() for name, value in values.items()}
    order = spatial_order(t["means"])
    ordered = {name: value.detach()[order].requires_grad_() for name, value in t.items()}
    viewmat = torch.tensor(np.float32(camera["world_to_camera"]).reshape(1, 4, 4))
    K = torch.tensor([[[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]], dtype=torch.float32)
    width, height = camera["width"], camera["height"]
    weights = torch.randn(height, width, 3, generator=torch.Generator().manual_seed(0))
    images = {}
    for _ in range(rounds):
        contestants = (
            ("luxel.torch", of_luxel, t),
            ("luxel.torch, spatial order", of_luxel, ordered),
            ("PyTorch with gsplat's functions", of_gsplat, t),
        )
        for name, render, t in contestants:
            repetitions = REPETITIONS if render is of_luxel else 1
            wall, cpu = [], []
            for n in range(repetitions + (2 if render is of_luxel else 0)):
                for value in t.values():
                    value.grad = None
                start = time.perf_counter(), time.process_time()
                image = render(t, viewmat, K, width, height)
                image.backward(weights)
                if n >= 2 or repetitions == 1:
                    wall.append(time.perf_counter() - start[0])
                    cpu.append(time.process_time() - start[1])
            images[name] = image.detach()
            print(f"{name}: {1e3 * np.median(wall):.1f} ms, {1e3 * np.median(cpu):.1f} ms of processor time", flush=True)
    one, _, other = images.values()
    print(f"largest difference of the images: {(one - other).abs().max():.1e} of {one.max():.2f}; mean {(one - other).abs().mean():.1e}")


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) == 4 else 3)
