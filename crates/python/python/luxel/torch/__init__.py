"""Differentiable rasterisation of Gaussian splats for PyTorch, on the processor.

`rasterization` has the signature, shapes and meaning of gsplat 1.5.3's function of that name, so
that programs written for gsplat run without CUDA. Results are the same bits for any number of
threads (those of `torch.get_num_threads()`). Tensors are float32 on the CPU.

    >>> import torch
    >>> from luxel.torch import rasterization
    >>> means = torch.tensor([[0.0, 0.0, 2.0]], requires_grad=True)
    >>> view, K = torch.eye(4)[None], torch.tensor([[[20.0, 0, 8], [0, 20, 8], [0, 0, 1]]])
    >>> image, alpha, meta = rasterization(
    ...     means, torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.1), torch.tensor([0.9]),
    ...     torch.tensor([[4.0, 2.0, 1.0]]), view, K, 16, 16)
    >>> image.shape, alpha.shape
    (torch.Size([1, 16, 16, 3]), torch.Size([1, 16, 16, 1]))
    >>> image.square().sum().backward()
    >>> means.grad.shape
    torch.Size([1, 3])
"""

try:
    import torch as _torch  # noqa: F401
except ImportError as error:
    raise ImportError("luxel.torch needs PyTorch: pip install torch") from error

from ._colors import lcd_radiance, log_sh_radiance, sh_radiance
from ._order import spatial_order
from ._rasterization import rasterization

__all__ = ["lcd_radiance", "log_sh_radiance", "rasterization", "sh_radiance", "spatial_order"]
