"""Tensors and the arrays of the native module, which share memory."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .._luxel import LuxelError, Rasterizer


# By process and number of threads: threads do not come along when a process forks. Those of another
# process are kept, because to let go of them would be to speak to threads that are not there.
_rasterizers: dict[tuple[int, int], Rasterizer] = {}


def rasterizer() -> Rasterizer:
    """Returns this process's rasteriser on as many threads as torch uses."""
    key = (os.getpid(), torch.get_num_threads())
    found = _rasterizers.get(key)
    if found is None:
        found = _rasterizers[key] = Rasterizer(key[1])
    return found


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
