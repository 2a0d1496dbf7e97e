"""The passes of `rasterization` as functions of autograd: splats to ellipses, ellipses to images."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ._arrays import array, array_or_none, rasterizer
from ._autograd import once_differentiable

_PARTS = ("means2d", "covars2d", "conics", "depths", "opacities")


class Handles:
    """What the passes of one call hand to each other besides tensors."""

    projection: Any
    visible: Any
    # The tensor whose attribute `absgrad` is set, and the rows of it that belong to the call.
    means2d: Tensor
    rows: Any


def _of_covariances(covars: Any) -> tuple[Any, Any]:
    """Returns quaternions [N, 4] and standard deviations [N, 3] of covariances [N, 6]."""
    full = covars[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(np.float64)
    # A covariance that is not finite belongs to a splat that is culled.
    finite = np.isfinite(full).all(axis=(1, 2))
    full[~finite] = np.eye(3)
    variances, axes = np.linalg.eigh(full)
    axes[np.linalg.det(axes) < 0] *= -1.0
    # The quaternion of a rotation R is an eigenvector of this matrix, for its largest eigenvalue
    # (Bar-Itzhack 2000), which has no degenerate rotation.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = axes.transpose(1, 2, 0)
    k = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    quats = np.linalg.eigh(k.transpose(2, 0, 1))[1][:, :, 3]
    scales = np.sqrt(np.maximum(variances, 0.0))
    scales[~finite] = np.nan
    return np.ascontiguousarray(quats, np.float32), np.ascontiguousarray(scales, np.float32)


def _sparse(gradient: Tensor | None, ids: Tensor) -> Tensor | None:
    """Returns the rows `ids`, ascending, of a gradient whose other rows are zero."""
    if gradient is None:
        return None
    return torch.sparse_coo_tensor(ids[None], gradient[ids], gradient.shape)._coalesced_(True)


class Project(torch.autograd.Function):
    """Ellipses on the screens; `handles` receives the projection.

    Shapes are quaternions and scales, or covariances [N, 6].
    """

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor | None,
        scales: Tensor | None,
        covars: Tensor | None,
        opacities: Tensor,
        viewmats: Tensor,
        Ks: Tensor,
        options: dict[str, Any],
        sparse_grad: bool,
        handles: Handles,
    ) -> tuple[Tensor, ...]:
        of_quats, of_scales = (array(quats), array(scales)) if covars is None else _of_covariances(array(covars))
        projection, arrays = rasterizer().project(
            array(means), of_quats, of_scales, array(opacities), array(viewmats), array(Ks), **options
        )
        ctx.projection = handles.projection = projection
        ctx.by_covariance = covars is not None
        handles.visible = arrays["visible"]
        ctx.set_materialize_grads(False)
        ellipses = [torch.from_numpy(arrays[name]) for name in _PARTS]
        rest = [torch.from_numpy(arrays[name]) for name in ("radii", "camera_ids", "gaussian_ids") if name in arrays]
        ctx.seen = rest[2] if sparse_grad else None
        ctx.mark_non_differentiable(*rest)
        return (*ellipses, *rest)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        if all(gradient is None for gradient in gradients[: len(_PARTS)]):
            return (None,) * 10
        by_parts = (array_or_none(gradient) for gradient in gradients[: len(_PARTS)])
        # Inputs are means, quats, scales, covars, opacities and viewmats.
        found = ctx.projection.backward(*by_parts, by_covariance=ctx.by_covariance, by_viewmats=ctx.needs_input_grad[5])
        means, quats, scales, covars, *rest = (None if numbers is None else torch.from_numpy(numbers) for numbers in found)
        if ctx.seen is not None:
            ids = torch.unique(ctx.seen)
            means, quats, scales, covars = (_sparse(gradient, ids) for gradient in (means, quats, scales, covars))
        return (means, quats, scales, covars, *rest, None, None, None, None)


class Blend(torch.autograd.Function):
    """Images and alpha of a projection.

    Covariances are an input for their gradient alone: the projection keeps a root of them, which is
    more precise.
    """

    @staticmethod
    def forward(
        ctx: Any,
        means2d: Tensor,
        covars2d: Tensor,
        opacities: Tensor,
        channels: Tensor,
        backgrounds: Tensor | None,
        handles: Handles,
        absgrad: bool,
    ) -> tuple[Tensor, Tensor]:
        ctx.blending, images, alphas = handles.projection.blend(array(channels), array_or_none(backgrounds))
        ctx.absgrad = absgrad
        ctx.target, ctx.rows = handles.means2d, handles.rows
        # Zeros for an unused alpha would cost a pass over the image, and wake torch's threads.
        ctx.set_materialize_grads(False)
        ctx.shape = images.shape
        return torch.from_numpy(images), torch.from_numpy(alphas)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, images: Tensor | None, alphas: Tensor | None) -> tuple[Tensor | None, ...]:
        by_images = np.zeros(ctx.shape, np.float32) if images is None else array(images)
        found = ctx.blending.backward(by_images, array_or_none(alphas), absolute=ctx.absgrad)
        found = {name: torch.from_numpy(numbers) for name, numbers in found.items()}
        if ctx.absgrad and ctx.rows is None:
            ctx.target.absgrad = found["absgrad"]
        elif ctx.absgrad:
            if getattr(ctx.target, "absgrad", None) is None:
                ctx.target.absgrad = torch.zeros_like(ctx.target)
            ctx.target.absgrad[ctx.rows] = found["absgrad"]
        background = found.get("background")
        return found["means2d"], found["covars2d"], found["opacities"], found["channels"], background, None, None
