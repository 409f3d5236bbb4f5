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
# # Fig. 4: paired differences
#
# Reads the study that `make sweep` left in `runs/`, or the one that the environment variable `ABLATE_STUDY` names;
# trains nothing.

# %%
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image, display

from ablate.analysis import boxplot_panels, cautions, paired_table
from ablate.studies.reading import open_study

study = open_study()
folder, paired = Path(mkdtemp()), paired_table(study.per_image, study.reference)
print("\n".join(cautions(study.per_image, study.reference)))


def boxes_of(*metrics: str) -> None:
    """Box plots side by side, or in words why there are none."""
    drawn = boxplot_panels(study.per_image, metrics, folder / metrics[0], study.reference, paired)
    display(Image(drawn[0], width=900)) if drawn else print(f"Nothing to compare with {study.reference}.")


# %% [markdown]
# Every test frame is rendered by every variant and scored; a box holds the differences to the reference on the same
# frames. Boxes are quartiles, whiskers the 5th and 95th percentile, the bar below a box is the 95 % interval of the
# median shift over probe sites. The grey band is the re-simulation, the same frame with other scatterers: for PSNR
# and MAE the level of a perfect stochastic renderer, and a network beyond it has smoothed the speckle away; for patch
# chi-square the floor.

# %%
boxes_of("psnr", "mae", "pchi2")

# %% [markdown]
# Does each component do what it is for? Shadow contrast is for the attenuation map, smooth MAE (structure without
# speckle) for maps at every level, Nyquist excess (the spectrum at the up-sampling frequency) for texture layers. The
# first and the last are best at 0.

# %%
boxes_of("shadow_contrast", "mae_smooth", "nyquist_excess")
