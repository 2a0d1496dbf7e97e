"""Trains a scene of a data set, measures it, and writes renders to look at.

    python train_and_look.py DATASET OUTPUT
"""

from __future__ import annotations

import sys
from pathlib import Path

import luxel


def main(dataset_path: str, output: str) -> None:
    dataset = luxel.Dataset.open(dataset_path)
    print(dataset)

    training = luxel.Training(dataset, preset="fast", steps=2000)
    for step in training:
        if step.number % 200 == 0:
            print(step)
    print("{psnr_scene:.2f} dB (scene), {psnr_gtmax:.2f} dB (gtmax)".format(**training.evaluate()["mean"]))

    scene = training.scene()
    folder = Path(output)
    previews = folder / "previews"
    previews.mkdir(parents=True, exist_ok=True)
    scene.save(folder / "scene.ply")
    for view in dataset.test:
        image = scene.render(view.camera)
        name = Path(view.name).name
        luxel.write_exr(folder / f"{name}.exr", image, color_space=scene.color_space, camera=view.camera)
        luxel.write_preview(previews / f"{name}.png", image, white=scene.radiance_scale)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2])
