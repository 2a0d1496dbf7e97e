"""Trains a scene of a data set, measures it, and writes renders to look at.

    python train_and_look.py DATASET OUTPUT [STEPS]
"""

# %% parameters dataset_path = "my-images", output = "trained", steps = 2000
from __future__ import annotations

import sys
from pathlib import Path

import luxel

if len(sys.argv) not in (3, 4):
    sys.exit(__doc__)
dataset_path, output, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) == 4 else 2000

# %% text
# A data set is a folder of posed HDR images. Some views are kept for measuring.

# %%
dataset = luxel.Dataset.open(dataset_path)
print(dataset)

# %% text
# `Training` is an iterator over steps: it can be looked at, paused and measured at any of them.

# %%
training = luxel.Training(dataset, preset="fast", steps=steps)
for step in training:
    if step.number % 200 == 0:
        print(step)
print("{psnr_scene:.2f} dB (scene), {psnr_gtmax:.2f} dB (gtmax)".format(**training.evaluate()["mean"]))

# %% text
# Renders are linear radiance. OpenEXR files keep it; previews are for looking at.

# %%
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

# %% notebook
# from IPython.display import Image
# Image(previews / f"{name}.png")
