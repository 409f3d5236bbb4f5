# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     name: python3
#     display_name: Python 3
# ---

# %% [markdown]
# # Fig. 2: images of the variants
#
# This notebook reads the study that `make sweep` left in `runs/`. The environment variable `ABLATE_STUDY` can name
# another study. Nothing is trained.

# %%
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
from IPython.display import Image

from ablate.analysis import qualitative_figure
from ablate.study.opened import found_study

study = found_study()
folder = Path(mkdtemp())
print("test frames shown:", ", ".join(picture.name for picture in study.pictures))

# %% [markdown]
# The figure shows test frames of unseen probe sites. The target has its segmentation S in the left corner and its
# attenuation map A in the right corner. The re-simulation is the same frame with other scatterers. Where it differs
# from the target, no network can know the target. If a variant has several seeds, the lowest seed is shown.

# %%
png, pdf = qualitative_figure(study.pictures, folder / "fig2")
Image(png, width=1000)

# %% [markdown]
# The next figure shows one frame in a larger size. The target comes first, and the other images follow.

# %%
picture = study.pictures[0]
images = {"target": picture.target, **picture.predictions}
columns = 3
rows = -(-len(images) // columns)
figure, axes = plt.subplots(rows, columns, figsize=(12, 3 * rows), squeeze=False, layout="constrained")
for each in axes.flat:
    each.set_axis_off()
for each, (name, image) in zip(axes.flat, images.items(), strict=False):
    each.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
    each.set_title(name)
plt.show()
