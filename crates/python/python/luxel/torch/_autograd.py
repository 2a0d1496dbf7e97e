"""What PyTorch's own typing leaves out of the functions with gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from torch.autograd import function

_Backward = TypeVar("_Backward", bound=Callable[..., Any])


def once_differentiable(backward: _Backward) -> _Backward:
    """Returns a backward pass whose own gradient is an error where it is asked for."""
    decorate: Any = function.once_differentiable
    return cast(_Backward, decorate(backward))
