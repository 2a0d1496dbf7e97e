"""Trains a scene with PyTorch: own loss, own optimiser, Luxel's rasteriser and colour model.

    python train_with_torch.py DATASET OUT.ply [STEPS] [MAX_SPLATS]

Needs gsplat for its DefaultStrategy, which runs without CUDA. Loss, learning rates and the mean of the last steps are as in
`luxel train`. Everything is linear radiance; only the loss looks through a tone curve.
"""

import sys

import numpy as np
import torch
from gsplat import DefaultStrategy
from torch.nn.functional import conv2d

import luxel
from luxel.torch import lcd_radiance, rasterization

MU, KNEE, AVERAGED = 5000.0, 0.03, 0.15
RATES = {"means": 4e-4, "quats": 1e-3, "scales": 5e-3, "opacities": 5e-2, "dc": 2.5e-3, "rest": 1.25e-4, "luminance": 5e-2}


def tone(radiance: torch.Tensor) -> torch.Tensor:
    """The mu-law, which weighs shadows and lamps alike."""
    return torch.log1p(MU * radiance.clamp_min(0.0)) / np.log1p(MU)


def ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """The mean SSIM of images [H, W, 3], in Gaussian windows of 11 pixels."""
    maps = torch.stack([a, b, a * a, b * b, a * b]).permute(0, 3, 1, 2).reshape(15, 1, *a.shape[:2])
    window = torch.exp(-((torch.arange(11.0) - 5) ** 2) / (2 * 1.5**2))
    window = (window / window.sum()).reshape(1, 1, -1, 1)
    maps = conv2d(conv2d(maps, window, padding=(5, 0)), window.transpose(2, 3), padding=(0, 5))
    ma, mb, aa, bb, ab = maps.reshape(5, 3, *a.shape[:2])
    top = (2 * ma * mb + 0.01**2) * (2 * (ab - ma * mb) + 0.03**2)
    return (top / ((ma * ma + mb * mb + 0.01**2) * (aa - ma * ma + bb - mb * mb + 0.03**2))).mean()


def main(path: str, output: str, steps: int, most: int) -> None:
    torch.manual_seed(0)
    dataset = luxel.Dataset.open(path)
    # Luxel's start: splats at the points, or in the volume that the cameras see, with the colours of the images. The
    # scene is to be rendered as `rasterization` renders it: cut-offs "parity" are gsplat's.
    scene = luxel.Training(dataset, steps=steps, max_splats=most, device="cpu", cutoffs="parity").scene()
    sh, degree = torch.from_numpy(scene.sh), int(np.sqrt(scene.sh.shape[1])) - 1
    arrays = [scene.positions, scene.rotations, scene.log_scales, scene.opacity_logits, scene.raw_luminance]
    values = dict(zip(["means", "quats", "scales", "opacities", "luminance"], map(torch.from_numpy, arrays)))
    values |= {"dc": sh[:, :1].clone(), "rest": sh[:, 1:].clone()}
    params = {name: torch.nn.Parameter(value) for name, value in values.items()}
    cameras = [view.camera.to_opencv() for view in dataset.train]
    viewmats = [torch.from_numpy(np.float32(pose @ scene.world_from_local))[None] for pose, _ in cameras]
    Ks = [torch.from_numpy(np.float32(K))[None] for _, K in cameras]
    targets = [tone(torch.from_numpy(view.image / np.float32(scene.radiance_scale))) for view in dataset.train]
    eyes = torch.inverse(torch.cat(viewmats))[:, :3, 3]
    extent = max(1.1 * (eyes - eyes.mean(0)).norm(dim=1).max().item(), (values["means"] - eyes.mean(0)).norm(dim=1).median().item())
    optimizers = {name: torch.optim.Adam([value], lr=RATES[name], eps=1e-15) for name, value in params.items()}
    strategy = DefaultStrategy(refine_start_iter=min(500, steps // 20), refine_stop_iter=steps // 2, reset_every=steps + 1)
    state = strategy.initialize_state(scene_scale=extent)
    order, averaged = np.random.default_rng(0), max(1, int(AVERAGED * steps))
    sums: dict[str, torch.Tensor] = {}
    for step in range(steps):
        if step % len(targets) == 0:
            shuffled = order.permutation(len(targets))
        n, active = shuffled[step % len(targets)], min(degree, step // max(1, min(1000, steps // 10)))
        optimizers["means"].param_groups[0]["lr"] = RATES["means"] * extent * 0.01 ** (step / steps)
        sh = torch.cat([params["dc"], params["rest"]], 1)
        colors = lcd_radiance(params["means"], viewmats[n], sh, params["luminance"], active_degree=active)
        height, width = targets[n].shape[:2]
        splats = params["quats"], torch.exp(params["scales"]), torch.sigmoid(params["opacities"])
        images, _, info = rasterization(
            params["means"], *splats, colors, viewmats[n], Ks[n], width, height, eps2d=0.1, rasterize_mode="antialiased"
        )
        found = tone(images[0])
        d = (found - targets[n]).abs()
        loss = 0.4 * (d + d * d / (2 * KNEE)).mean() + 0.2 * (1 - ssim(found, targets[n]))
        strategy.step_pre_backward(params, optimizers, state, step, info)
        loss.backward()
        strategy.step_post_backward(params, optimizers, state, step, info, packed=True)
        if len(params["means"]) > most:
            strategy.refine_stop_iter = step
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        if step >= steps - averaged:
            sums = {name: sums.get(name, 0) + value.detach() for name, value in params.items()}
        if step % 100 == 0 or step + 1 == steps:
            print(f"step {step}: loss {loss.item():.4f}, {len(params['means'])} splats", flush=True)
    mean = {name: (value / averaged).numpy() for name, value in sums.items()}
    shapes = {"positions": mean["means"], "rotations": mean["quats"], "log_scales": mean["scales"]}
    scene.set(**shapes, opacity_logits=mean["opacities"], sh=np.hstack([mean["dc"], mean["rest"]]), raw_luminance=mean["luminance"])
    scene.save(output)
    found = [luxel.metrics.compare(v.image, scene.render(v.camera), scale=scene.radiance_scale, hdr_flip=False) for v in dataset.test]
    print(f"{len(scene)} splats, {np.mean([metrics['psnr_scene'] for metrics in found]):.2f} dB (scene) on the test views")


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4, 5):
        sys.exit(__doc__)
    steps, most = [int(argument) for argument in sys.argv[3:]] + [3000, 40_000][len(sys.argv) - 3 :]
    main(sys.argv[1], sys.argv[2], steps, most)
