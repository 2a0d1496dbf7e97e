"""Writes `data/blending.json`: a small scene with its images and gradients in float64.

The numbers come from the dense compositor of `test_torch.py`, so that machines without torch can test
the native rasteriser against them. Run it in this folder when the compositor changes.
"""

from __future__ import annotations

import json
from pathlib import Path

import torch
from test_torch import composite, double, project, scene

SIZE = (12, 9)


def main() -> None:
    start = scene(5, n=9, d=4, size=SIZE)
    tensors = double(start)
    image, alpha, margin = composite(tensors, tensors["colors"].expand(2, -1, -1), *SIZE, antialiased=True)
    g = torch.Generator().manual_seed(1)
    safe = margin > 1e-3
    weights = (torch.randn(image.shape, generator=g) * safe).float()
    alpha_weights = (torch.randn(alpha.shape, generator=g) * safe).float()
    (image * weights).sum().add((alpha * alpha_weights).sum()).backward()
    depth = project(tensors, *SIZE, 0.3, True)[2]

    def numbers(tensor: torch.Tensor) -> dict[str, list[float]]:
        return {"shape": list(tensor.shape), "values": [float(f"{v:.9g}") for v in tensor.detach().flatten().tolist()]}

    golden = {
        "size": SIZE,
        "inputs": {name: numbers(tensor) for name, tensor in start.items()},
        "weights": {"image": numbers(weights), "alpha": numbers(alpha_weights), "safe": numbers(safe.float())},
        "image": numbers(image),
        "alpha": numbers(alpha),
        "depths": numbers(depth),
        "gradients": {name: numbers(t.grad) for name, t in tensors.items() if t.grad is not None},
    }
    path = Path(__file__).parent / "data" / "blending.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(golden, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
