"""The order of splats in memory."""

from __future__ import annotations

import torch
from torch import Tensor

from .._luxel import spatial_order as _spatial_order
from ._arrays import array, check


def spatial_order(means: Tensor) -> Tensor:
    """Returns the order along a space-filling curve in which neighbours in space are neighbours in memory.

    `rasterization` is faster on splats in this order, as Luxel's own training keeps them. Images are the
    same but for rounding where splats have equal depth.

    Args:
        means: centres of the splats, any units [N, 3].

    Returns:
        Places among the splats as they are, int64 [N]: `means[spatial_order(means)]` is in order, and every
        other tensor of the splats is put in order by the same places.

    Raises:
        LuxelError: a tensor of another type or shape.

        >>> means = torch.tensor([[9.0, 0, 0], [0.0, 0, 0], [8.0, 0, 0], [1.0, 0, 0]])
        >>> spatial_order(means).tolist()
        [1, 3, 2, 0]
    """
    return torch.from_numpy(_spatial_order(array(check("means", means, (None, 3)))))
