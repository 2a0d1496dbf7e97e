"""Tensors and the arrays of the native module, which share memory."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .._luxel import LuxelError, Rasterizer


@functools.lru_cache(maxsize=2)
def _rasterizer(threads: int) -> Rasterizer:
    return Rasterizer(threads)


def rasterizer() -> Rasterizer:
    """Returns the rasteriser on as many threads as torch uses."""
    return _rasterizer(torch.get_num_threads())


def array(tensor: Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Returns a contiguous array over the tensor's memory, or over a copy if it is strided."""
    values: np.ndarray[Any, np.dtype[np.float32]] = tensor.detach().contiguous().numpy()
    return values


def array_or_none(tensor: Tensor | None) -> np.ndarray[Any, np.dtype[np.float32]] | None:
    """Returns `array` of a tensor, or None."""
    return None if tensor is None else array(tensor)


def check(name: str, tensor: Any, *shapes: tuple[int | None, ...]) -> Tensor:
    """Checks type, device and shape of a tensor; None in a shape is any size.

    Raises:
        LuxelError: with what was expected and found.
    """
    if not isinstance(tensor, Tensor):
        raise LuxelError(f"{name}: expected a torch.Tensor, found {type(tensor).__name__}")
    if tensor.device.type != "cpu":
        raise LuxelError(f"{name}: expected a tensor on the CPU, found one on {tensor.device}; call .cpu()")
    if tensor.dtype != torch.float32:
        raise LuxelError(f"{name}: expected float32, found {tensor.dtype}; call .float()")
    found = tuple(tensor.shape)
    for shape in shapes:
        if len(shape) == len(found) and all(s is None or s == f for s, f in zip(shape, found)):
            return tensor
    expected = " or ".join(str(list("any" if s is None else s for s in shape)).replace("'", "") for shape in shapes)
    raise LuxelError(f"{name}: tensor of shape {list(found)}, expected {expected}")
