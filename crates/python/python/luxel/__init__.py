"""Luxel: places in high dynamic range, as Gaussian splats of scene-linear radiance.

Images are float32 arrays [height, width, 3] of linear radiance in the units of the data set, never
8 bits and never clamped. World coordinates are those of the data set's files; camera axes are
OpenCV's. Errors are `LuxelError`. Notes and warnings go to the logger `luxel` of `logging`.

    >>> import numpy as np
    >>> import luxel
    >>> camera = luxel.Camera.look_at([0, 0, -3], [0, 0, 0], [0, -1, 0], fov=50, width=32, height=24)
    >>> image = np.full((24, 32, 3), 4.0, np.float32)
    >>> dataset = luxel.Dataset.from_arrays([image], [camera])
    >>> scene = luxel.train(dataset, steps=5, device="cpu")
    >>> scene.render(camera).shape
    (24, 32, 3)
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any, Callable

if sys.platform == "linux":
    # Without this, libraries of Vulkan print an error for every attempt to find a desktop.
    os.environ.setdefault("XDG_RUNTIME_DIR", os.devnull)

from . import metrics
from ._luxel import (
    Camera,
    Dataset,
    Lights,
    LuxelError,
    Mesh,
    Probe,
    Progress,
    Scene,
    Training,
    View,
    __version__,
    convert_color_space,
    read_cameras,
    read_image,
    run_command,
    training_options,
    write_cameras,
    write_exr,
    write_preview,
)

if TYPE_CHECKING:
    from os import PathLike

__all__ = [
    "Camera",
    "Dataset",
    "Lights",
    "LuxelError",
    "Mesh",
    "Probe",
    "Progress",
    "Scene",
    "Training",
    "View",
    "__version__",
    "convert_color_space",
    "metrics",
    "read_cameras",
    "read_image",
    "run_command",
    "train",
    "training_options",
    "write_cameras",
    "write_exr",
    "write_preview",
]


def train(
    dataset: Dataset | str | PathLike[str],
    *,
    preset: str | None = "fast",
    steps: int | None = None,
    device: str = "auto",
    threads: int | None = None,
    on_step: Callable[[Progress], Any] | None = None,
    progress: bool = False,
    **options: Any,
) -> Scene:
    """Trains a scene in memory and returns it.

    Args:
        dataset: a data set, or the path of one.
        preset: "fast", "full" or "paper".
        steps: number of steps; None for that of the preset.
        device: "auto", "cpu", "gpu" or "gpu:NAME".
        threads: threads of the processor; None for all cores.
        on_step: function that is called with the numbers of each step. An exception that it raises
            ends the training and comes out of this function.
        progress: whether a bar of tqdm shows the progress, if tqdm is installed.
        **options: further options by their names in the section `train` of `config.toml`, such as
            method="lcd", max_splats=40000, seed=42. `training_options()` lists them.

    Raises:
        LuxelError: an option that is unknown or out of range, a data set that cannot be read.
    """
    if not isinstance(dataset, Dataset):
        dataset = Dataset.open(dataset)
    training = Training(dataset, preset=preset, steps=steps, device=device, threads=threads, **options)
    made: Any = training
    if progress:
        try:
            from tqdm.auto import tqdm
        except ImportError as error:
            raise LuxelError("progress=True needs tqdm: pip install tqdm") from error
        made = tqdm(training, total=training.options["iterations"], unit="step")
    for step in made:
        if on_step is not None:
            on_step(step)
    return training.scene()
