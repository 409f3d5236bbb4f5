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
# # Fig. 3: where the variants are wrong
#
# This notebook reads the study that `make sweep` left in `runs/`. The environment variable `ABLATE_STUDY` can name
# another study. Nothing is trained.

# %%
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image, display

from ablate.analysis import chi2_maps_figure
from ablate.study.opened import found_study

study = found_study()
folder = Path(mkdtemp())

# %% [markdown]
# Each map compares the grey-level histograms of patches of 20 x 20 pixels with those of the target. 0 (black) means
# equal histograms, and 1 (bright) means histograms without overlap. The image is below its map, and the target is at
# the right. The map of the re-simulation is the floor, because it differs from the target by its scatterers, ray paths
# and noise alone. The number is the root mean square over all patches that lie wholly in the fan.

# %%
for number, picture in enumerate(study.pictures):
    png, pdf = chi2_maps_figure(picture, folder / f"fig3_{number}")
    display(Image(png, width=1000))
