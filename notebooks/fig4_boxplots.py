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
# # Fig. 4: paired differences
#
# This notebook reads the study that `make sweep` left in `runs/`. The environment variable `ABLATE_STUDY` can name
# another study. Nothing is trained.

# %%
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image, display

from ablate.analysis import boxplot_panels, cautions, paired_table
from ablate.metrics import Group, Shown, metric_of, shown_in
from ablate.study.opened import found_study

study = found_study()
folder, paired = Path(mkdtemp()), paired_table(study.per_image, study.reference)
print("\n".join(cautions(study.per_image, study.reference)))


def boxes_of(metrics: list[str]) -> None:
    """Box plots side by side, or in words why there are none."""
    drawn = boxplot_panels(study.per_image, metrics, folder / metrics[0], study.reference, paired)
    display(Image(drawn[0], width=900)) if drawn else print(f"Nothing to compare with {study.reference}.")


# %% [markdown]
# Every variant renders every test frame. A box shows the differences between a variant and the reference on the same
# frames. The box shows quartiles, and the whiskers show the 5th and the 95th percentile. The bar below a box is the
# 95 % interval of the median shift over probe sites.
#
# The grey band is the re-simulation, which is the same frame with other scatterers. For patch chi-square it is the
# floor. For PSNR and MAE it is the level of a perfect stochastic renderer. A network that is better than this level
# knows the scatterers (`noise=body`), or has smoothed the speckle away.

# %%
boxes_of(shown_in(Shown.headline))

# %% [markdown]
# The last figure shows whether each component does what it is for. Shadow contrast belongs to the attenuation map.
# Smooth MAE (structure without speckle) belongs to the receptive field, the order of the labels and beam space. Thin
# contrast (how bright thin bones are) belongs to the maps at every level and to the interface map. Nyquist excess (the
# spectrum at the up-sampling frequency) belongs to the texture-friendly up-sampling. Shadow contrast and Nyquist excess
# are best at 0.

# %%
boxes_of([name for name in shown_in(Shown.screen) if metric_of(name).group is Group.mechanism])
