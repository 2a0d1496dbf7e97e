"""Finds where photographs of a scene were taken: poses are optimised through the rasteriser.

    python optimise_poses.py DATASET SCENE [STEPS]

SCENE is a scene of DATASET of method `lcd`. Each test view is turned and moved away from its pose, and has to find back
by its image alone.
"""

# %% parameters dataset_path = "my-images", scene_path = "trained/scene.ply", steps = 150
from __future__ import annotations

import math
import sys

import numpy as np
import torch

import luxel
from luxel.torch import lcd_radiance, rasterization

if len(sys.argv) not in (3, 4):
    sys.exit(__doc__)
dataset_path, scene_path, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) == 4 else 150

# %% text
# The splats are constants here; the view matrix is what has a gradient. A scene has its own coordinates, in which the
# data set's cameras are placed by `world_from_local`.

# %%
dataset, scene = luxel.Dataset.open(dataset_path), luxel.Scene.open(scene_path)
means, quats = torch.from_numpy(scene.positions), torch.from_numpy(scene.rotations)
scales, opacities = torch.from_numpy(np.exp(scene.log_scales)), torch.sigmoid(torch.from_numpy(scene.opacity_logits))
chroma, luminance = torch.from_numpy(scene.sh), torch.from_numpy(scene.raw_luminance)
# The name of the model ends with the activation, lcd-c2-l0-exp, unless everything is as usual: lcd.
activation = "softplus" if scene.color_model == "lcd" else scene.color_model.rsplit("-", 1)[1]


def render(viewmat: torch.Tensor, K: torch.Tensor, width: int, height: int) -> torch.Tensor:
    """Renders radiance in units of the scene's scale [height, width, 3]."""
    colors = lcd_radiance(means, viewmat[None], chroma, luminance, activation=activation)
    filters = {"eps2d": 0.1, "rasterize_mode": "antialiased"}
    return rasterization(means, quats, scales, opacities, colors, viewmat[None], K[None], width, height, **filters)[0][0]  # type: ignore[arg-type]


def motion(turn: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
    """Returns the rigid motion [4, 4] of a rotation vector (radians) and a shift."""
    x, y, z = turn
    o = torch.zeros(())
    rows = [torch.stack([o, -z, y, shift[0]]), torch.stack([z, o, -x, shift[1]]), torch.stack([-y, x, o, shift[2]]), torch.zeros(4)]
    result: torch.Tensor = torch.matrix_exp(torch.stack(rows))
    return result


def tone(radiance: torch.Tensor) -> torch.Tensor:
    """The mu-law, which weighs shadows and lamps alike."""
    return torch.log1p(5000.0 * radiance.clamp_min(0.0)) / math.log1p(5000.0)


# %% text
# Six numbers move a camera: a rotation vector and a shift, in camera axes.

# %%
generator = torch.Generator().manual_seed(0)
unit = float(np.linalg.norm(np.ptp(scene.positions, axis=0))) / 4
for view in dataset.test:
    pose, K = (torch.from_numpy(np.asarray(m, np.float32)) for m in view.camera.to_opencv())
    true = pose @ torch.from_numpy(np.float32(scene.world_from_local))
    start = motion(0.01 * torch.randn(3, generator=generator), 0.005 * unit * torch.randn(3, generator=generator)) @ true
    target = tone(torch.from_numpy(view.image / np.float32(scene.radiance_scale)))
    turn, shift = torch.zeros(3, requires_grad=True), torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([{"params": [turn], "lr": 1e-3}, {"params": [shift], "lr": 1e-3 * unit}])
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.01 ** (1 / steps))
    for _ in range(steps):
        optimizer.zero_grad()
        found = render(motion(turn, shift) @ start, K, view.camera.width, view.camera.height)
        (tone(found) - target).abs().mean().backward()
        optimizer.step()
        decay.step()
    errors = []
    for estimate in (start, (motion(turn, shift) @ start).detach()):
        rotation = estimate[:3, :3] @ true[:3, :3].T
        angle = math.degrees(math.acos(min(1.0, (float(torch.trace(rotation)) - 1) / 2)))
        eyes = [torch.inverse(matrix)[:3, 3] for matrix in (estimate, true)]
        errors.append((angle, float((eyes[0] - eyes[1]).norm()) / unit))
    print("{}: {:.2f} degrees and {:.2%} of the scene off, then {:.2f} and {:.2%}".format(view.name, *errors[0], *errors[1]))
