# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     name: python3
#     display_name: Python 3
# ---

# %% [markdown]
# # Fig. 3: where the variants are wrong
#
# Reads the study that `make sweep` left in `runs/`, or the one that the environment variable `ABLATE_STUDY` names;
# trains nothing.

# %%
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image, display

from ablate.analysis import chi2_maps_figure
from ablate.studies.reading import open_study

study = open_study()
folder = Path(mkdtemp())

# %% [markdown]
# The grey-level histograms of patches of 20 x 20 pixels are compared with those of the target: 0 (black) is the same
# histogram, 1 (bright) nothing in common. Below each map is its image, at the right the target. The map of the
# re-simulation is the floor: what other scatterers alone make of it. The number is the root mean square over patches
# wholly inside the fan.

# %%
for number, picture in enumerate(study.pictures):
    png, pdf = chi2_maps_figure(picture, folder / f"fig3_{number}")
    display(Image(png, width=1000))
