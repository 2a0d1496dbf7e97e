"""The function `rasterization`, with the signature of gsplat 1.5.3."""

from __future__ import annotations

import math
import numbers
import operator
from typing import Any

import torch
from torch import Tensor

from .._luxel import LuxelError
from ._arrays import check
from ._colors import colors_towards, eyes_of, sh_model
from ._passes import Blend, Handles, Project

_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")


def _refuse(unsupported: dict[str, bool]) -> None:
    for name, is_used in unsupported.items():
        if is_used:
            raise LuxelError(f"rasterization: {name} is not supported on the CPU; leave it at its default")


def _check_colors(colors: Any, batch: tuple[int, ...], n: int, c: int, sh_degree: int | None) -> None:
    if sh_degree is None:
        check("colors", colors, (*batch, n, None), (*batch, c, n, None))
        if colors.shape[-1] == 0:
            raise LuxelError("colors: expected at least 1 channel, found 0")
    else:
        check("colors", colors, (*batch, n, None, 3), (*batch, c, n, None, 3))


def _check_number(name: str, value: Any, least: float) -> float:
    if not isinstance(value, numbers.Real) or not float(value) >= least:
        raise LuxelError(f"{name}: expected a number of at least {least}, found {value!r}")
    return float(value)


def _check_size(name: str, value: Any) -> int:
    try:
        # NumPy's and torch's whole numbers too.
        size = operator.index(value)
    except TypeError:
        raise LuxelError(f"{name}: expected a whole number, found {value!r}") from None
    if size < 1:
        raise LuxelError(f"{name}: expected a whole number of at least 1, found {size}")
    return size


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

    All tensors may have batch dimensions before those given here, the same for all: each batch is a
    scene of its own.

    Args:
        means: centres, world units [N, 3].
        quats: rotations w, x, y, z of any length [N, 4]; ignored with `covars`.
        scales: standard deviations, world units [N, 3]; ignored with `covars`.
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
        covars: covariances, world units^2 [N, 3, 3], in place of quats and scales. The upper triangle
            is read, and receives the gradient.
        sparse_grad: whether the gradients of means, quats, scales and covars from the projection are
            sparse tensors of the splats that a camera sees; needs `packed`, and no batch dimensions.
            The part of harmonics by means is dense.
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
        [M, ...] with `batch_ids`, `camera_ids` and `gaussian_ids`; `width`, `height`, `n_cameras`, `n_batches`,
        `tile_size`. gsplat's lists of tiles are not there.

    Raises:
        LuxelError: an argument that is not supported, of another type, shape or range.
    """
    _refuse(
        {
            "distributed": bool(distributed),
            f"camera_model {camera_model!r}": camera_model != "pinhole",
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
    if sparse_grad and not packed:
        raise LuxelError("sparse_grad: needs packed=True")
    batch = tuple(means.shape[:-2]) if isinstance(means, Tensor) else ()
    if 0 in batch:
        raise LuxelError(f"means: expected batch dimensions of at least 1, found {list(batch)}")
    if sparse_grad and batch:
        raise LuxelError("sparse_grad: expected tensors without batch dimensions")
    n = check("means", means, (*batch, None, 3)).shape[-2]
    c = check("viewmats", viewmats, (*batch, None, 4, 4)).shape[-3]
    if covars is None:
        check("quats", quats, (*batch, n, 4))
        check("scales", scales, (*batch, n, 3))
    else:
        check("covars", covars, (*batch, n, 3, 3))
        covars = covars[..., (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
        quats = scales = None
    check("opacities", opacities, (*batch, n))
    check("Ks", Ks, (*batch, c, 3, 3))
    if Ks.requires_grad:
        raise LuxelError("Ks: there is no gradient by intrinsics; pass Ks.detach()")
    _check_colors(colors, batch, n, c, sh_degree)
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
    each = [0] if not batch else range(math.prod(batch))
    handles = [Handles() for _ in each]
    inputs = [means, quats, scales, covars, opacities, viewmats, Ks, colors, backgrounds]
    rows = [_rows(tensor, len(batch)) for tensor in inputs]
    projected = [Project.apply(*(part[i] for part in rows[:7]), options, bool(sparse_grad), handles[i]) for i in each]
    names = ("means2d", "covars2d", "conics", "depths", "opacities", "radii", "camera_ids", "gaussian_ids")
    parts = {name: [ellipses[i] for ellipses in projected] for i, name in enumerate(names[: len(projected[0])])}
    # Blending reads what `meta` has, whose gradients densification reads.
    meta = {name: _joined(tensors, batch, packed) for name, tensors in parts.items()} if batch else {k: v[0] for k, v in parts.items()}
    images, alphas = [], []
    first = 0
    for i in each:
        places: Any = None
        if batch:
            places = slice(first, first + len(parts["means2d"][i])) if packed else _place(i, batch)
            first += len(parts["means2d"][i])
        means2d, covars2d, depths, blended = (
            meta[name] if places is None else meta[name][places] for name in ("means2d", "covars2d", "depths", "opacities")
        )
        scattered = parts["camera_ids"][i] * n + parts["gaussian_ids"][i] if packed else None
        channels = _channels(rows[0][i], rows[5][i], rows[7][i], sh_degree, render_mode, depths, handles[i].visible, scattered)
        behind = None if backgrounds is None else _backgrounds(rows[8][i], c, channels.shape[-1], render_mode)
        handles[i].means2d, handles[i].rows = meta["means2d"], places
        image, alpha = Blend.apply(means2d, covars2d, blended, channels, behind, handles[i], bool(absgrad))
        if render_mode.endswith("ED"):
            image = torch.cat([image[..., :-1], image[..., -1:] / alpha.clamp(min=1e-10)], dim=-1)
        images.append(image)
        alphas.append(alpha)
    del meta["covars2d"]
    ids: dict[str, Tensor | None] = {"batch_ids": None, "camera_ids": None, "gaussian_ids": None}
    if packed:
        seen = torch.tensor([len(tensor) for tensor in parts["means2d"]])
        ids["batch_ids"] = torch.repeat_interleave(torch.arange(len(seen)), seen)
    return (
        _joined(images, batch, False) if batch else images[0],
        _joined(alphas, batch, False) if batch else alphas[0],
        {
            **ids,
            **meta,
            "width": width,
            "height": height,
            "tile_size": tile_size,
            "n_batches": len(images),
            "n_cameras": c,
        },
    )


def _rows(tensor: Tensor | None, batch_dims: int) -> Any:
    """Returns what each scene of a batch has of a tensor."""
    if batch_dims == 0 or tensor is None:
        return _Same(tensor)
    return tensor.flatten(0, batch_dims - 1)


class _Same:
    """A tensor that all scenes share, or None."""

    def __init__(self, tensor: Tensor | None) -> None:
        self.tensor = tensor

    def __getitem__(self, _: int) -> Tensor | None:
        return self.tensor


def _joined(tensors: list[Tensor], batch: tuple[int, ...], packed: bool) -> Tensor:
    """Joins the tensors of scenes: along the batch dimensions, or one after another if packed."""
    if packed:
        return torch.cat(tensors)
    return torch.stack(tensors).reshape(*batch, *tensors[0].shape)


def _place(index: int, batch: tuple[int, ...]) -> tuple[int, ...]:
    """Returns the place of a scene in the batch dimensions."""
    place = []
    for size in reversed(batch):
        index, n = divmod(index, size)
        place.append(n)
    return tuple(reversed(place))


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
