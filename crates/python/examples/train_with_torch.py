"""Trains a scene with PyTorch: own loss, own optimiser, Luxel's rasteriser and colour model.

    python train_with_torch.py DATASET OUT.ply [STEPS]

Splats grow by gsplat's DefaultStrategy where gsplat is installed (it needs no CUDA for that), else by
cloning those whose means have the largest gradients. Everything is linear radiance; only the loss looks
through a tone curve.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import torch

import luxel
from luxel.torch import lcd_radiance, rasterization

try:
    from gsplat import DefaultStrategy
except ImportError:
    DefaultStrategy = None

MU, MOST_SPLATS = 5000.0, 60_000
RATES = {"means": 3e-4, "quats": 1e-3, "scales": 5e-3, "opacities": 5e-2, "chroma": 5e-3, "luminance": 2e-2}


def tone(radiance: torch.Tensor) -> torch.Tensor:
    """The mu-law, which weighs shadows and lamps alike."""
    return torch.log1p(MU * radiance.clamp_min(0.0)) / np.log1p(MU)


def initial(dataset: luxel.Dataset, count: int, extent: float) -> dict[str, torch.nn.Parameter]:
    """Splats at the points of the data set, or around the origin where there are none."""
    g = torch.Generator().manual_seed(1)
    points = torch.from_numpy(np.asarray(dataset.points, np.float32))
    if len(points) == 0:
        points = extent * torch.randn(count, 3, generator=g)
    means = points[torch.randint(len(points), (count,), generator=g)] + 0.01 * extent * torch.randn(count, 3, generator=g)
    n = len(means)
    chroma = torch.zeros(n, 9, 3)
    chroma[:, 0] = 1 / (3 * 0.282095)
    values = {
        "means": means,
        "quats": torch.randn(n, 4, generator=g),
        "scales": torch.full((n, 3), float(np.log(0.03 * extent))),
        "opacities": torch.full((n,), -2.0),
        "chroma": chroma,
        "luminance": torch.full((n, 1), 0.5),
    }
    return {name: torch.nn.Parameter(value) for name, value in values.items()}


class CloneLargest:
    """Clones the splats that the loss pulls most, and removes those that became transparent."""

    def initialize_state(self, scene_scale: float) -> dict[str, Any]:
        return {"norms": torch.zeros(0)}

    def step_pre_backward(self, params: Any, optimizers: Any, state: Any, step: int, info: Any) -> None:
        info["means2d"].retain_grad()

    def step_post_backward(self, params: Any, optimizers: Any, state: Any, step: int, info: Any, packed: bool) -> None:
        n = len(params["means"])
        if len(state["norms"]) != n:
            state["norms"] = torch.zeros(n)
        state["norms"].index_add_(0, info["gaussian_ids"], info["means2d"].grad.norm(dim=-1))
        if step == 0 or step % 100 or n >= MOST_SPLATS:
            return
        kept = torch.nonzero(torch.sigmoid(params["opacities"].detach()) > 0.005)[:, 0]
        largest = torch.topk(state["norms"], min(n // 5, MOST_SPLATS - n)).indices
        rows = torch.cat([kept, largest])
        offset = torch.exp(params["scales"].detach()[largest]) * torch.randn(len(largest), 3)
        for name, optimizer in optimizers.items():
            old = params[name]
            new = torch.nn.Parameter(old.detach()[rows].clone())
            if name == "means":
                new.data[len(kept) :] += offset
            moments = optimizer.state.pop(old, {})
            optimizer.state[new] = {key: value[rows].clone() if value.dim() else value for key, value in moments.items()}
            optimizer.param_groups[0]["params"] = [new]
            params[name] = new


def main(path: str, output: str, steps: int) -> None:
    torch.manual_seed(0)
    dataset = luxel.Dataset.open(path)
    views = [(view.image, *view.camera.to_opencv()) for view in dataset.train]
    unit = float(np.mean([image.mean() for image, *_ in views]))
    eyes = np.stack([np.linalg.inv(pose)[:3, 3] for _, pose, _ in views])
    extent = float(np.linalg.norm(eyes - eyes.mean(0), axis=1).max())
    params = initial(dataset, 10_000, extent)
    optimizers = {name: torch.optim.Adam([value], lr=RATES[name] * (extent if name == "means" else 1.0)) for name, value in params.items()}
    strategy = DefaultStrategy(refine_start_iter=200, refine_stop_iter=steps // 2) if DefaultStrategy else CloneLargest()
    state = strategy.initialize_state(scene_scale=extent)
    for step in range(steps):
        image, pose, K = views[np.random.default_rng(step).integers(len(views))]
        viewmats, Ks = (torch.from_numpy(np.asarray(m, np.float32))[None] for m in (pose, K))
        target = torch.from_numpy(np.array(image)) / unit
        height, width = target.shape[:2]
        colors = lcd_radiance(params["means"], viewmats, params["chroma"], params["luminance"])
        found, _, info = rasterization(
            params["means"], params["quats"], torch.exp(params["scales"]), torch.sigmoid(params["opacities"]),
            colors, viewmats, Ks, width, height,
        )
        loss = (tone(found[0]) - tone(target)).abs().mean()
        strategy.step_pre_backward(params, optimizers, state, step, info)
        loss.backward()
        strategy.step_post_backward(params, optimizers, state, step, info, packed=True)
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        if step % 100 == 0 or step + 1 == steps:
            print(f"step {step}: loss {loss.item():.4f}, {len(params['means'])} splats", flush=True)
    arrays = {name: value.detach().numpy() for name, value in params.items()}
    scene = luxel.Scene.from_arrays(
        arrays["means"], arrays["quats"], arrays["scales"], arrays["opacities"], arrays["chroma"], arrays["luminance"],
        color_model="lcd-c2-l0-softplus", radiance_scale=unit,
    )
    scene.save(output)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) == 4 else 1000)
