"""Metrics of HDR images: every metric of `luxel compare`, on arrays and on files.

    >>> import numpy as np
    >>> from luxel import metrics
    >>> reference = np.full((16, 16, 3), 2.0, np.float32)
    >>> found = metrics.compare(reference, 0.75 * reference, scale=2.0, hdr_flip=False)
    >>> found["psnr_scene"] > 20
    True
"""

from ._luxel import compare, compare_files

__all__ = ["compare", "compare_files"]
