"""The function `rasterization`, with the signature of gsplat 1.5.3."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from .._luxel import LuxelError
from ._arrays import array, array_or_none, check, rasterizer
from ._colors import colors_towards, eyes_of, sh_model

_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
_PARTS = ("means2d", "covars2d", "conics", "depths", "opacities")


class _Handles:
    """What the passes of one call hand to each other besides tensors."""

    projection: Any
    visible: Any


class _Project(torch.autograd.Function):
    """Ellipses on the screens; `handles` receives the projection."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        viewmats: Tensor,
        Ks: Tensor,
        options: dict[str, Any],
        handles: _Handles,
    ) -> tuple[Tensor, ...]:
        splats = array(means), array(quats), array(scales), array(opacities)
        projection, arrays = rasterizer().project(*splats, array(viewmats), array(Ks), **options)
        ctx.projection = handles.projection = projection
        handles.visible = arrays["visible"]
        ctx.set_materialize_grads(False)
        ellipses = [torch.from_numpy(arrays[name]) for name in _PARTS]
        rest = [torch.from_numpy(arrays[name]) for name in ("radii", "camera_ids", "gaussian_ids") if name in arrays]
        ctx.mark_non_differentiable(*rest)
        return (*ellipses, *rest)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        if all(gradient is None for gradient in gradients[: len(_PARTS)]):
            return (None,) * 8
        found = ctx.projection.backward(*(array_or_none(gradient) for gradient in gradients[: len(_PARTS)]))
        return (*(torch.from_numpy(numbers) for numbers in found), None, None, None)


class _Blend(torch.autograd.Function):
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
        handles: _Handles,
        absgrad: bool,
    ) -> tuple[Tensor, Tensor]:
        ctx.blending, images, alphas = handles.projection.blend(array(channels), array_or_none(backgrounds))
        ctx.absgrad, ctx.has_backgrounds = absgrad, backgrounds is not None
        ctx.save_for_backward(means2d)
        # Zeros for an unused alpha would cost a pass over the image, and wake torch's threads.
        ctx.set_materialize_grads(False)
        ctx.shape = images.shape
        return torch.from_numpy(images), torch.from_numpy(alphas)

    @staticmethod
    def backward(ctx: Any, images: Tensor | None, alphas: Tensor | None) -> tuple[Tensor | None, ...]:
        by_images = np.zeros(ctx.shape, np.float32) if images is None else array(images)
        found = ctx.blending.backward(by_images, array_or_none(alphas), absolute=ctx.absgrad)
        found = {name: torch.from_numpy(numbers) for name, numbers in found.items()}
        if ctx.absgrad:
            (means2d,) = ctx.saved_tensors
            means2d.absgrad = found["absgrad"]
        background = found["background"] if ctx.has_backgrounds else None
        return found["means2d"], found["covars2d"], found["opacities"], found["channels"], background, None, None


def _refuse(unsupported: dict[str, bool]) -> None:
    for name, is_used in unsupported.items():
        if is_used:
            raise LuxelError(f"rasterization: {name} is not supported on the CPU; leave it at its default")


def _check_colors(colors: Any, n: int, c: int, sh_degree: int | None) -> None:
    if sh_degree is None:
        check("colors", colors, (n, None), (c, n, None))
        if colors.shape[-1] == 0:
            raise LuxelError("colors: expected at least 1 channel, found 0")
    else:
        check("colors", colors, (n, None, 3), (c, n, None, 3))


def _check_number(name: str, value: Any, least: float) -> float:
    if not isinstance(value, (int, float)) or not value >= least:
        raise LuxelError(f"{name}: expected a number of at least {least}, found {value!r}")
    return float(value)


def _check_size(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise LuxelError(f"{name}: expected a whole number of at least 1, found {value!r}")
    return value


def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars: Tensor | None = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Tensor | None = None,
    tangential_coeffs: Tensor | None = None,
    thin_prism_coeffs: Tensor | None = None,
    ftheta_coeffs: Any = None,
    rolling_shutter: Any = None,
    viewmats_rs: Tensor | None = None,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Rasterises N splats to the images of C cameras, with gradients by every tensor but `Ks`.

    Args:
        means: centres, world units [N, 3].
        quats: rotations w, x, y, z of any length [N, 4].
        scales: standard deviations, world units [N, 3].
        opacities: 0 to 1 [N].
        colors: any numbers [N, D] or [C, N, D]; with `sh_degree` coefficients of harmonics
            [N, K, 3] or [C, N, K, 3].
        viewmats: maps from world to camera, OpenCV axes [C, 4, 4].
        Ks: intrinsics without skew, pixels [C, 3, 3]; pixel centres are at +0.5.
        width, height: size of the images, pixels.
        near_plane, far_plane: depths between which splats are seen, world units.
        radius_clip: splats whose radii are not larger are culled, pixels.
        eps2d: dilation of the covariance on the screen, px^2.
        sh_degree: degree of the harmonics, 0 to 5; None if `colors` are what is blended.
        packed: whether arrays of `meta` hold only the visible splats.
        backgrounds: what is behind the splats [C, D].
        render_mode: "RGB", "D" (accumulated depth), "ED" (mean depth), "RGB+D" or "RGB+ED".
        absgrad: whether `meta["means2d"].absgrad` receives sums of absolute gradients.
        rasterize_mode: "classic", or "antialiased" for opacities that shrink by as much as the
            dilation widens a splat.
        tile_size, channel_chunk, segmented: accepted for compatibility. They tune gsplat's kernels;
            no image depends on them.

    Other arguments of gsplat are refused unless they have their defaults.

    Returns:
        Images [C, height, width, X] with X = D, 1 for "D" and "ED", D + 1 with colour and depth;
        alpha [C, height, width, 1]; and a dictionary `meta`: `means2d` (whose `.grad` and `.absgrad`
        densification reads), `radii`, `depths`, `conics`, `opacities`, [C, N, ...] each, or packed
        [M, ...] with `camera_ids` and `gaussian_ids`; `width`, `height`, `n_cameras`, `n_batches`,
        `tile_size`. gsplat's lists of tiles are not there.

    Raises:
        LuxelError: an argument that is not supported, of another type, shape or range.
    """
    _refuse(
        {
            "sparse_grad": bool(sparse_grad),
            "distributed": bool(distributed),
            f"camera_model {camera_model!r}": camera_model != "pinhole",
            "covars": covars is not None,
            "with_ut": bool(with_ut),
            "with_eval3d": bool(with_eval3d),
            "radial_coeffs": radial_coeffs is not None,
            "tangential_coeffs": tangential_coeffs is not None,
            "thin_prism_coeffs": thin_prism_coeffs is not None,
            "ftheta_coeffs": ftheta_coeffs is not None,
            "rolling_shutter": rolling_shutter is not None and getattr(rolling_shutter, "name", "") != "GLOBAL",
            "viewmats_rs": viewmats_rs is not None,
        }
    )
    if render_mode not in _MODES:
        raise LuxelError(f"render_mode: expected one of {', '.join(_MODES)}, found {render_mode!r}")
    if rasterize_mode not in ("classic", "antialiased"):
        raise LuxelError(f'rasterize_mode: expected "classic" or "antialiased", found {rasterize_mode!r}')
    n = check("means", means, (None, 3)).shape[0]
    c = check("viewmats", viewmats, (None, 4, 4)).shape[0]
    check("quats", quats, (n, 4))
    check("scales", scales, (n, 3))
    check("opacities", opacities, (n,))
    check("Ks", Ks, (c, 3, 3))
    if Ks.requires_grad:
        raise LuxelError("Ks: there is no gradient by intrinsics; pass Ks.detach()")
    _check_colors(colors, n, c, sh_degree)
    options = {
        "width": _check_size("width", width),
        "height": _check_size("height", height),
        "near_plane": _check_number("near_plane", near_plane, 0.0),
        "far_plane": _check_number("far_plane", far_plane, 0.0),
        "radius_clip": _check_number("radius_clip", radius_clip, 0.0),
        "eps2d": _check_number("eps2d", eps2d, 0.0),
        "antialiased": rasterize_mode == "antialiased",
        "packed": bool(packed),
    }
    handles = _Handles()
    ellipses = _Project.apply(means, quats, scales, opacities, viewmats, Ks, options, handles)
    means2d, covars2d, conics, depths, blended, radii, *ids = ellipses
    camera_ids, gaussian_ids = ids if packed else (None, None)
    places = camera_ids * n + gaussian_ids if packed else None
    channels = _channels(means, viewmats, colors, sh_degree, render_mode, depths, handles.visible, places)
    if backgrounds is not None:
        backgrounds = _backgrounds(backgrounds, c, channels.shape[-1], render_mode)
    images, alphas = _Blend.apply(means2d, covars2d, blended, channels, backgrounds, handles, bool(absgrad))
    if render_mode.endswith("ED"):
        images = torch.cat([images[..., :-1], images[..., -1:] / alphas.clamp(min=1e-10)], dim=-1)
    meta = {
        "batch_ids": torch.zeros_like(camera_ids) if packed else None,
        "camera_ids": camera_ids,
        "gaussian_ids": gaussian_ids,
        "radii": radii,
        "means2d": means2d,
        "depths": depths,
        "conics": conics,
        "opacities": blended,
        "width": width,
        "height": height,
        "tile_size": tile_size,
        "n_batches": 1,
        "n_cameras": c,
    }
    return images, alphas, meta


def _channels(
    means: Tensor,
    viewmats: Tensor,
    colors: Tensor,
    sh_degree: int | None,
    render_mode: str,
    depths: Tensor,
    visible: Any,
    places: Tensor | None,
) -> Tensor:
    """Returns what is blended: [N, X] or [C, N, X]."""
    n, c = means.shape[0], viewmats.shape[0]
    parts = []
    if render_mode.startswith("RGB"):
        if sh_degree is not None:
            model = sh_model(sh_degree, colors.shape[-2])
            colors = colors_towards(means, eyes_of(viewmats), colors, None, visible, model, sh_degree)
        parts.append(colors)
    if render_mode != "RGB":
        if places is not None:
            depths = depths.new_zeros(c * n).index_copy(0, places, depths).reshape(c, n)
        parts.append(depths[..., None])
    if len(parts) == 2 and parts[0].dim() == 2:
        parts[0] = parts[0].expand(c, -1, -1)
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=-1)


def _backgrounds(backgrounds: Tensor, c: int, channels: int, render_mode: str) -> Tensor:
    """Returns the background of all channels: that of depth is zero."""
    if render_mode in ("D", "ED"):
        check("backgrounds", backgrounds, (c, None))
        return backgrounds.new_zeros(c, 1)
    if render_mode == "RGB":
        return check("backgrounds", backgrounds, (c, channels))
    check("backgrounds", backgrounds, (c, channels - 1))
    return torch.cat([backgrounds, backgrounds.new_zeros(c, 1)], dim=-1)
