"""Colours that depend on the direction from which a splat is seen, with gradients."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from .._luxel import LuxelError
from ._arrays import array, check, rasterizer
from ._autograd import once_differentiable

_MAX_DEGREE = 5


class _Colors(torch.autograd.Function):
    """Radiance [C, N, 3] of means [N, 3], eyes [C, 3], sh and raw luminance."""

    @staticmethod
    def forward(ctx: Any, means: Tensor, eyes: Tensor, sh: Tensor, raw: Tensor, visible: Any, model: Any, degree: int) -> Tensor:
        ctx.save_for_backward(means, eyes, sh, raw)
        ctx.rest = (visible, model, degree)
        colors = rasterizer().colors(array(means), array(eyes), array(sh), array(raw), visible, model, degree)
        return torch.from_numpy(colors)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        means, eyes, sh, raw = (array(tensor) for tensor in ctx.saved_tensors)
        visible, model, degree = ctx.rest
        found = rasterizer().colors_backward(means, eyes, sh, raw, visible, model, degree, array(gradient))
        return (*(torch.from_numpy(numbers) for numbers in found), None, None, None)


def eyes_of(viewmats: Tensor) -> Tensor:
    """Returns the centres [C, 3] of cameras [C, 4, 4] in the world."""
    return torch.inverse(viewmats)[:, :3, 3].contiguous()


def colors_towards(means: Tensor, eyes: Tensor, sh: Tensor, raw: Tensor | None, visible: Any, model: Any, degree: int) -> Tensor:
    """Evaluates a colour model for checked arguments."""
    raw = means.new_zeros(0) if raw is None else raw
    result: Tensor = _Colors.apply(means, eyes, sh, raw, visible, model, degree)
    return result


def _check_degree(name: str, degree: int, coefficients: int) -> None:
    if not isinstance(degree, int) or not 0 <= degree <= _MAX_DEGREE:
        raise LuxelError(f"{name}: expected a degree of 0 to {_MAX_DEGREE}, found {degree!r}")
    if (degree + 1) ** 2 > coefficients:
        raise LuxelError(f"{name}: degree {degree} needs {(degree + 1) ** 2} coefficients, found {coefficients}")


def sh_model(degree: int, coefficients: int) -> tuple[int, None, None]:
    """Returns the model of harmonics, after checking its degree."""
    _check_degree("sh_degree", degree, coefficients)
    return (degree, None, None)


def sh_radiance(means: Tensor, viewmats: Tensor, sh: Tensor, degree: int) -> Tensor:
    """Evaluates spherical harmonics towards cameras, as 3D Gaussian splatting does.

    The radiance is max(sum of harmonics + 0.5, 0), with that method's order and signs.

    Args:
        means: centres of the splats, world units [N, 3].
        viewmats: maps from world to camera [C, 4, 4].
        sh: coefficients [N, K, 3] or [C, N, K, 3], (degree + 1)^2 <= K.
        degree: highest degree evaluated, 0 to 5.

    Returns:
        Linear radiance [C, N, 3], with gradients by all tensors.

    Raises:
        LuxelError: a tensor of another type or shape.
    """
    n, c = check("means", means, (None, 3)).shape[0], check("viewmats", viewmats, (None, 4, 4)).shape[0]
    check("sh", sh, (n, None, 3), (c, n, None, 3))
    return colors_towards(means, eyes_of(viewmats), sh, None, None, sh_model(degree, sh.shape[-2]), degree)


def log_sh_radiance(means: Tensor, viewmats: Tensor, sh: Tensor, degree: int) -> Tensor:
    """Evaluates spherical harmonics of log radiance towards cameras, as methods have it that learn the
    exposure of captured images.

    The radiance is exp(sum of harmonics + 0.5): positive, and without an upper bound. Arguments, result
    and exceptions are those of `sh_radiance`.
    """
    n = check("means", means, (None, 3)).shape[0]
    c = check("viewmats", viewmats, (None, 4, 4)).shape[0]
    check("sh", sh, (n, None, 3), (c, n, None, 3))
    _check_degree("degree", degree, sh.shape[-2])
    return colors_towards(means, eyes_of(viewmats), sh, None, None, (degree, None, "exp"), degree)


def lcd_radiance(
    means: Tensor,
    viewmats: Tensor,
    chroma: Tensor,
    raw_luminance: Tensor,
    *,
    activation: str = "softplus",
    active_degree: int | None = None,
) -> Tensor:
    """Evaluates the colour model of method `lcd` towards cameras: luminance times chromaticity.

    The chromaticity is rectified harmonics, divided by their sum; the luminance is an activation of
    harmonics. Pass the result to `rasterization` as `colors`.

    Args:
        means: centres of the splats, world units [N, 3].
        viewmats: maps from world to camera [C, 4, 4].
        chroma: harmonics of the chromaticity [N, K, 3], K a square of degree + 1.
        raw_luminance: harmonics of the luminance before activation [N, M], M in the same way.
        activation: "softplus", "exp" or "relu".
        active_degree: highest degree evaluated; None for all.

    Returns:
        Linear radiance [C, N, 3], at least 0 and without an upper bound, with gradients by all
        tensors.

    Raises:
        LuxelError: a tensor of another type or shape, an unknown activation.
    """
    n = check("means", means, (None, 3)).shape[0]
    check("viewmats", viewmats, (None, 4, 4))
    check("chroma", chroma, (n, None, 3))
    check("raw_luminance", raw_luminance, (n, None))
    degrees = []
    for name, count in (("chroma", chroma.shape[1]), ("raw_luminance", raw_luminance.shape[1])):
        degree = math.isqrt(count) - 1
        if (degree + 1) ** 2 != count or not 0 <= degree <= _MAX_DEGREE:
            raise LuxelError(f"{name}: expected 1, 4, 9, 16, 25 or 36 coefficients, found {count}")
        degrees.append(degree)
    active = max(degrees) if active_degree is None else active_degree
    if not isinstance(active, int) or active < 0:
        raise LuxelError(f"active_degree: expected a whole number from 0, found {active_degree!r}")
    model = (degrees[0], degrees[1], activation)
    return colors_towards(means, eyes_of(viewmats), chroma, raw_luminance, None, model, active)
