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
# # Error against run time
#
# Reads the study that `make sweep` left in `runs/`, or the one that the environment variable `ABLATE_STUDY` names;
# trains nothing.

# %%
from pathlib import Path
from tempfile import mkdtemp

import pandas as pd
from IPython.display import Image, display

from ablate.analysis import error_vs_runtime, pareto_front
from ablate.studies.reading import open_study
from ablate.studies.results import provenance, runtime_points

study = open_study()
folder = Path(mkdtemp())
hardware = provenance(study.runs).get("hardware", "unknown hardware")
points, level = runtime_points(study.table)

# %% [markdown]
# ## The networks of the study
#
# Error on the test frames against the median time of a frame, network alone, on the machine that trained it. Nothing
# below and left of a point on the grey line is both faster and better. The paper gives 75 ms for its simulator and 40
# ms for its networks, on a GPU that it does not name.

# %%
png, pdf = error_vs_runtime(points, folder / "error_vs_runtime", level, hardware)
Image(png, width=1000)

# %%
wide = points.pivot(index=["series", "ms"], columns="metric", values="error").reset_index().sort_values("ms")
front = pareto_front(wide["ms"].to_numpy(), wide["pchi2"].to_numpy())
print("on the front of time and patch chi-square:", ", ".join(wide["series"].iloc[front]))
wide.round(3)

# %% [markdown]
# ## Beside the simulator
#
# `python -m ablate task=precision` measures the simulator with more and fewer rays, and every trained run in each
# precision and engine, against a converged reference. If that was done, here is what it drew, and the fastest of each
# series.

# %%
measured = study.folder.parent / "precision"
if (measured / "precision.png").exists():
    display(Image(measured / "precision.png", width=1000))
    errors = pd.read_csv(measured / "precision.csv", keep_default_na=False, na_values=["nan"])
    fastest = errors.loc[errors.groupby(["series", "metric"])["ms"].idxmin()]
    display(fastest.pivot(index=["series", "ms"], columns="metric", values="error").sort_values("ms").round(4))
else:
    print(f"There is no precision.png in {measured}. Run: python -m ablate task=precision")
