#!/usr/bin/env python3
"""Expected values of Luxel's metrics, by independent implementations.

Writes crates/metrics/tests/oracles/metrics.json, which the test metric_oracles holds the library against. Images are made here and in the
test by the same arithmetic, so that none is stored. Needed, for instance in a virtual environment:

    pip install numpy scikit-image flip-evaluator && pip install --no-deps cvvdp

FLIP is the authors' program (flip-evaluator), SSIM is scikit-image's, the PU21 encoding is ColorVideoVDP's (cvvdp; only the class PU is taken
from it, which needs no PyTorch). Errors of logarithms and by decade are their definitions in NumPy.
"""

import ast
import functools
import importlib.metadata
import importlib.util
import json
import math
import pathlib

import flip_evaluator
import numpy as np
from skimage.metrics import structural_similarity

OUTPUT = pathlib.Path(__file__).parent.parent / "crates/metrics/tests/oracles/metrics.json"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LOG_FLOOR = 1e-5
RADIUS = 5
# Every so many pixels of an error map are stored.
MAP_STRIDE = 13


class Random:
    """Numerical Recipes' linear congruential generator; the upper 24 bits of 32 as a fraction."""

    def __init__(self, seed):
        self.state = seed

    def next(self):
        self.state = (self.state * 1664525 + 1013904223) % 2**32
        return (self.state >> 8) / 2**24


def noise(x, y, c, random):
    """Radiance over 18 stops, up to a quarter off."""
    mantissa, exponent, gain = 1 + random.next(), math.floor(random.next() * 18) - 12, 0.75 + 0.5 * random.next()
    return mantissa * 2.0**exponent, mantissa * 2.0**exponent * gain


def lamp_reference(x, y, c):
    if (x - 20) ** 2 + (y - 16) ** 2 < 36:
        return 48.0 if c == 0 else 40.0 if c == 1 else 28.0
    return (0.02 + 0.3 * ((x + 1) / 64) * ((c + 1) / 3)) * (1.5 if (x // 4 + y // 4) % 2 else 1.0)


def lamp(x, y, c, _):
    """A lamp over a dim chequered wall; the test is brighter and a pixel aside."""
    return lamp_reference(x, y, c), lamp_reference(max(x - 1, 0), y, c) * 1.05


def tint(x, y, c, _):
    """Coloured stripes whose hue changes on the right and whose brightness on the left."""
    value = lambda c: ((x * 7 + y * 3) % 16 + 1) / 16 * 0.5**c
    return value(c), value(2 - c) if x > 20 else value(c) * 0.9


def dim(x, y, c, _):
    """Near-black texture with a cast."""
    reference = ((x ^ y) % 8 + 1) * 2.0**-9
    return reference, reference + c * 2.0**-11


def edge(x, y, _c, _):
    """A flat image, and an edge and a point in the test."""
    return 0.25, 0.5 if x >= 16 or (x, y) == (6, 9) else 0.25


def dark_room(x, y, c, random):
    """Black but for a window: the median is 0."""
    light = (1 + random.next()) * (c + 1) if x < 8 and y < 12 else 0.0
    return light, light * 1.25 + (0.001 if y > 20 else 0.0)


IMAGES = {"noise": (noise, 37, 29), "lamp": (lamp, 64, 48), "tint": (tint, 40, 33), "dim": (dim, 24, 20), "edge": (edge, 32, 21), "dark_room": (dark_room, 30, 26)}


def make(name):
    """Reference and test, float32 [H,W,3]."""
    value, width, height = IMAGES[name]
    random = Random(1)
    pairs = [[[value(x, y, c, random) for c in range(3)] for x in range(width)] for y in range(height)]
    both = np.array(pairs, dtype=np.float64).astype(np.float32)
    return np.ascontiguousarray(both[..., 0]), np.ascontiguousarray(both[..., 1])


def pu21_encoder():
    """The encoding of cvvdp's class PU, without importing the package, which would import PyTorch."""
    utils = pathlib.Path(importlib.util.find_spec("pycvvdp").submodule_search_locations[0]) / "utils.py"
    tree = ast.parse(utils.read_text())
    tree.body = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "PU"]
    names = {"cache": functools.cache, "math": math, "np": np}
    exec(compile(tree, str(utils), "exec"), names)
    return names["PU"](type="banding_glare").encode


def similarity(a, b, peak):
    """scikit-image's SSIM with the window of Wang et al.: 11 pixels, sigma 1.5, borders of 5 pixels left out."""
    return float(structural_similarity(a, b, data_range=peak, gaussian_weights=True, sigma=1.5, use_sample_covariance=False))


def ssim_figures(reference, test):
    a, b = (np.clip(image.astype(np.float64), 0, 1) for image in (reference, test))
    over_channels = lambda pad: float(np.mean([similarity(pad(a[..., c]), pad(b[..., c]), 1.0) for c in range(3)]))
    return {
        "interior": over_channels(lambda plane: plane),
        "zeros": over_channels(lambda plane: np.pad(plane, RADIUS)),
        "replicated": over_channels(lambda plane: np.pad(plane, RADIUS, mode="edge")),
    }


def pu21_figures(encode, reference, test, peak):
    a, b = (image.astype(np.float64) * peak for image in (reference, test))
    psnr = 10 * math.log10(256**2 / np.mean((encode(a) - encode(b)) ** 2))
    pad = lambda image: np.pad(encode(image @ LUMINANCE), RADIUS, mode="edge")
    return {"peak_luminance": peak, "psnr": psnr, "ssim": similarity(pad(a), pad(b), 256.0)}


def flip_figures(reference, test, kind):
    clip = (lambda image: np.clip(image, 0, 1)) if kind == "LDR" else (lambda image: image)
    error, mean, parameters = flip_evaluator.evaluate(clip(reference), clip(test), kind, applyMagma=False)
    # Of LDR-FLIP they are infinite.
    exposures = {key: parameters[key] for key in ("startExposure", "stopExposure", "numExposures") if kind == "HDR"}
    return {"mean": float(mean), "every_13th": [float(v) for v in error.ravel()[::MAP_STRIDE]], **exposures}


def log_rmse(reference, test):
    log = lambda image: np.log10(np.maximum(image.astype(np.float64), LOG_FLOOR))
    return float(np.sqrt(np.mean((log(test) - log(reference)) ** 2)))


def decades(reference, test):
    a, b = (image.astype(np.float64) for image in (reference, test))
    luminance = a @ LUMINANCE
    divisor = np.maximum(luminance, LOG_FLOOR)
    error = np.abs(a - b).mean(axis=2) / divisor
    bias = (b @ LUMINANCE - luminance) / divisor
    place = np.clip(np.floor(np.log10(np.maximum(luminance, 1e-30))), -5, 4).astype(int)
    rows = [(decade, place == decade) for decade in range(-5, 5)]
    return [
        {"decade": decade, "count": int(at.sum()), "relative_error": float(error[at].mean()), "bias": float(bias[at].mean())}
        for decade, at in rows
        if at.any()
    ]


def main():
    encode = pu21_encoder()
    figures = {}
    for name in IMAGES:
        reference, test = make(name)
        figures[name] = {
            "sums": [float(image.astype(np.float64).sum()) for image in (reference, test)],
            "ssim": ssim_figures(reference, test),
            "pu21": [pu21_figures(encode, reference, test, peak) for peak in (100.0, 1000.0)],
            "ldr_flip": flip_figures(reference, test, "LDR"),
            "hdr_flip": flip_figures(reference, test, "HDR"),
            "log_rmse": log_rmse(reference, test),
            "relative_error_by_decade": decades(reference, test),
        }
    versions = {name: importlib.metadata.version(name) for name in ("flip-evaluator", "cvvdp", "scikit-image", "numpy")}
    OUTPUT.write_text(json.dumps({"made_by": versions, "images": figures}, indent=1, allow_nan=False) + "\n")
    print(f"wrote {OUTPUT}")


if __name__ == "__main__":
    main()
