#!/usr/bin/env python3
"""Expected LPIPS distances of networks with made-up weights, by the reference package.

Writes crates/metrics/tests/oracles/lpips.json, which the test lpips_oracle holds the library against. Weights and images are made here and there by the
same arithmetic, so that none is stored or loaded. Needed: torch, torchvision, numpy and `pip install --no-deps lpips`.

With --export DIR it writes the networks as safetensors files too (needs safetensors), to try `luxel compare --lpips-weights`.
"""

import argparse
import json
import math
import pathlib
import warnings

import numpy as np

OUTPUT = pathlib.Path(__file__).parent.parent / "crates/metrics/tests/oracles/lpips.json"
SIZES = {"alex": (61, 48), "vgg": (37, 33)}


def fractions(count, seed):
    """A hash of index and seed as fractions of 24 bits."""
    x = np.arange(count, dtype=np.uint32) * np.uint32(0x9E3779B1) + np.uint32(seed * 0x01000193 % 2**32)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x85EBCA77)
    x ^= x >> np.uint32(13)
    x *= np.uint32(0xC2B2AE3D)
    x ^= x >> np.uint32(16)
    return (x >> np.uint32(8)).astype(np.float64) / 2**24


def values(name, shape, seed):
    """Weights that keep the size of what they are applied to, small biases, channel weights above 0."""
    u = fractions(math.prod(shape), seed)
    if name.startswith("lin"):
        made = u
    elif name.endswith(".bias"):
        made = (2 * u - 1) * 0.05
    else:
        made = (2 * u - 1) * math.sqrt(6 / math.prod(shape[1:]))
    return made.reshape(shape).astype(np.float32)


def images(width, height):
    """A noise over a gradient, and the same darker with other noise; [H,W,3] in 0 to 1."""
    u = fractions(2 * width * height * 3, 77).reshape(2, height, width, 3)
    gradient = np.arange(width, dtype=np.float64)[None, :, None] / width
    return [(0.5 * gradient + 0.5 * u[0]).astype(np.float32), (0.4 * gradient + 0.25 * u[0] + 0.25 * u[1]).astype(np.float32)]


def main():
    import lpips
    import torch

    parser = argparse.ArgumentParser()
    parser.add_argument("--export", type=pathlib.Path)
    export = parser.parse_args().export
    expected = {"made_by": {"lpips": "0.1.4", "torch": torch.__version__}}
    for network, (width, height) in SIZES.items():
        model = lpips.LPIPS(net=network, pnet_rand=True, pretrained=False, verbose=False)
        state = model.state_dict()
        names = sorted(name for name in state if name.startswith("net.") or name.startswith("lin") and not name.startswith("lins."))
        made = {name: torch.from_numpy(values(name, tuple(state[name].shape), seed)) for seed, name in enumerate(names)}
        model.load_state_dict(made, strict=False)
        tensors = [torch.from_numpy(image.transpose(2, 0, 1)[None]) for image in images(width, height)]
        with torch.no_grad():
            distance, layers = model(*tensors, normalize=True, retPerLayer=True)
        expected[network] = {
            "size": [width, height],
            "tensors": {name: list(tensor.shape) for name, tensor in made.items()},
            "distance": float(distance),
            "layers": [float(layer) for layer in layers],
        }
        if export:
            from safetensors.numpy import save_file

            save_file({name: tensor.numpy() for name, tensor in made.items()}, export / f"{network}.safetensors")
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text(json.dumps(expected, indent=1) + "\n")
    print(f"wrote {OUTPUT}")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
