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
# # The paper's Table II, to scale
#
# The seven networks of the paper's Table II, trained as printed, beside the paper's numbers. The question, the design
# and the rule were written down before the test frames were scored: `docs/table2.md`. This notebook reads the study
# that `python -m ablate +study=table2` leaves in `runs/table2`, or the copy that is kept in `docs/results/table2`.
# Nothing is trained.

# %%
import sys
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp

import pandas as pd
from IPython.display import Image

from ablate.study.opened import found_study

sys.path.insert(0, "../scripts")  # the analysis of docs/table2.md
table2, table2_figures = import_module("table2"), import_module("table2_figures")

study = found_study(("runs/table2", "docs/results/table2"), "python -m ablate +study=table2")
everything = table2.read_runs(study.folder)
runs = everything[everything["labels"] == "arbitrary"]
print(f"{len(everything)} trainings, {len(runs)} of them with an order of labels drawn by their seed")

# %% [markdown]
# ## The paper beside ours
#
# Means over trainings. The paper's frames are of another simulator, and four times as high; FD speckle stands beside
# its FID. So columns are compared by the order of their networks, not by their size.

# %%
table2.beside_the_paper(runs).round(3)

# %% [markdown]
# ## Is SA2H better than each of the ablated networks?
#
# Ten one-sided t tests with a pooled error, and Holm's correction over them. `worse` is in units of the metric, `share`
# is its share of SA2H's value, and `paper` is that share in the paper.

# %%
tests = table2.tests(runs)
tests.set_index(["network", "metric"]).round(4)

# %%
picture = Path(mkdtemp()) / "effects.png"
table2_figures.effects_figure(tests).savefig(picture, dpi=150)
Image(picture, width=800)

# %%
print(table2.verdict(runs, tests))

# %% [markdown]
# ## SA2H between the formula and re-simulation
#
# The formula renders S and A in closed form, without weights. A place below 0 is worse than no network.

# %%
table2.on_the_scale(study.folder).round(3)

# %% [markdown]
# ## In the paper's order?
#
# Kendall's tau between the paper's seven values of a metric and ours, with its exact two-sided p.

# %%
table2.orders(runs).round(3)

# %% [markdown]
# ## Frames of sites that training has seen, and of others
#
# The paper splits by frame, so a test frame has neighbours in training.

# %%
seen, unseen = (
    table2.read_runs(study.folder, sites).query("labels == 'arbitrary'").groupby("network")[["psnr", "mae", "pchi2"]]
    for sites in ("seen", "unseen")
)
pd.concat({"seen": seen.mean(), "unseen": unseen.mean()}, axis=1).loc[table2.PAPER.index].round(3)

# %% [markdown]
# ## With the echogenic order of the labels

# %%
beside = everything[everything["labels"] != "arbitrary"]
beside.set_index(["network", "anatomy", "seed"])[["psnr", "mae", "pchi2", "fd_speckle", "octave_sd"]].round(3)
