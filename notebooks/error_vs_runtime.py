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
# # Error against run time
#
# This notebook reads the study that `make sweep` left in `runs/`. The environment variable `ABLATE_STUDY` can name
# another study. Nothing is trained.

# %%
from pathlib import Path
from tempfile import mkdtemp

import pandas as pd
from IPython.display import Image, display

from ablate.analysis import error_vs_runtime, pareto_front, runtime_points
from ablate.metrics import metric_of
from ablate.storage import read_json
from ablate.study.frame_times import timed_on
from ablate.study.opened import found_study

study = found_study()
folder = Path(mkdtemp())
points, level = runtime_points(study.table)

# %% [markdown]
# ## The networks of the study
#
# The figure shows the error on the test frames against the median time per frame, with the maps that the network reads.
# All networks were timed together, in turns, and the bars are quartiles. No other network is both better and as fast as
# a network on the grey line, where a difference in time within the bars is none. The paper reports 75 ms for its
# simulator and 40 ms for its networks, on a GPU that it does not name.

# %%
png, pdf = error_vs_runtime(points, folder / "error_vs_runtime", level, timed_on(study.usable.all))
Image(png, width=1000)

# %%
times = ["ms", "lower", "upper"]
wide = points.pivot(index=["series", *times], columns="metric", values="error").reset_index().sort_values("ms")
judged = "pchi2" if "pchi2" in wide else points["metric"].iloc[0]
error = wide[judged].map(metric_of(judged).badness)  # of the PSNR, whose larger values are better, its negative
front = pareto_front(wide["ms"].to_numpy(), error.to_numpy(), wide["lower"].to_numpy(), wide["upper"].to_numpy())
print(f"on the front of time and {metric_of(judged).label}:", ", ".join(wide["series"].iloc[front]))
wide.round(3)

# %% [markdown]
# ## Comparison with the simulator
#
# `python -m ablate task=precision` measures the simulator with different numbers of rays, and every trained run with
# different number formats and engines. All errors are relative to a converged reference. If this task was run, its
# figure and the fastest setting of each series are shown here.

# %%
measured = study.folder.parent / "precision"
if (measured / "precision.png").exists():
    print("measured with the networks of", read_json(measured / "run.json")["study"])
    display(Image(measured / "precision.png", width=1000))
    errors = pd.read_csv(measured / "precision.csv", keep_default_na=False, na_values=["nan"])
    fastest = errors.loc[errors.groupby(["series", "metric"])["ms"].idxmin()]
    display(fastest.pivot(index=["series", "ms"], columns="metric", values="error").sort_values("ms").round(4))
else:
    print(f"There is no precision.png in {measured.parent.name}/{measured.name}. Run: python -m ablate task=precision")
