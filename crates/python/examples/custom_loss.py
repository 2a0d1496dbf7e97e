"""Refines the light of a trained scene with a loss of your own.

    python custom_loss.py DATASET SCENE OUT.ply [STEPS]

SCENE is a scene of DATASET of method `lcd`. The loss here compares logarithms of radiance: an error of a tenth costs the same
in a lamp and in its shadow, which the mu-law of training does not promise. Shapes stay; only luminance and chromaticity learn.
"""

# %% parameters dataset_path = "my-images", scene_path = "trained/scene.ply", output = "refined.ply", steps = 300
from __future__ import annotations

import sys

import numpy as np
import torch

import luxel
from luxel.torch import lcd_radiance, rasterization

if len(sys.argv) not in (4, 5):
    sys.exit(__doc__)
dataset_path, scene_path, output = sys.argv[1:4]
steps = int(sys.argv[4]) if len(sys.argv) == 5 else 300

# %%
dataset, scene = luxel.Dataset.open(dataset_path), luxel.Scene.open(scene_path)
means, quats = torch.from_numpy(scene.positions), torch.from_numpy(scene.rotations)
scales, opacities = torch.from_numpy(np.exp(scene.log_scales)), torch.sigmoid(torch.from_numpy(scene.opacity_logits))
chroma = torch.nn.Parameter(torch.from_numpy(scene.sh))
luminance = torch.nn.Parameter(torch.from_numpy(scene.raw_luminance))
activation = "softplus" if scene.color_model == "lcd" else scene.color_model.rsplit("-", 1)[1]


# %% text
# Any function of the image that PyTorch differentiates is a loss. The floor keeps noise in black pixels from mattering.

# %%
def loss_of(found: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """The mean difference of the logarithms of radiance, in units of the scene's scale."""
    floor = 1e-3
    return (torch.log(found.clamp_min(0.0) + floor) - torch.log(target + floor)).abs().mean()


def log_rmse() -> float:
    """The mean error of the test views."""
    images = [(view.image, scene.render(view.camera)) for view in dataset.test]
    return float(np.mean([luxel.metrics.compare(*pair, scale=scene.radiance_scale, hdr_flip=False)["log_rmse"] for pair in images]))


# %%
print(f"before: log-RMSE {log_rmse():.4f}")
optimizer = torch.optim.Adam([{"params": [chroma], "lr": 5e-4}, {"params": [luminance], "lr": 5e-3}])
views = [(view.image / np.float32(scene.radiance_scale), *view.camera.to_opencv()) for view in dataset.train]
order = np.random.default_rng(0)
for step in range(steps):
    image, pose, K = views[order.integers(len(views))]
    viewmats, Ks = (torch.from_numpy(np.float32(matrix))[None] for matrix in (pose @ scene.world_from_local, K))
    height, width = image.shape[:2]
    colors = lcd_radiance(means, viewmats, chroma, luminance, activation=activation)
    found, _, _ = rasterization(
        means, quats, scales, opacities, colors, viewmats, Ks, width, height, eps2d=0.1, rasterize_mode="antialiased"
    )
    loss = loss_of(found[0], torch.from_numpy(image))
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()

# %%
scene.set(sh=chroma.detach().numpy(), raw_luminance=luminance.detach().numpy())
print(f"after: log-RMSE {log_rmse():.4f}")
scene.save(output)
