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
# # Table II: the models compared
#
# Reads a finished study under `runs/`; trains nothing. Make one with `make sweep`, or name another by the
# environment variable `ABLATE_STUDY`. Open as a notebook with `pip install -e '.[notebook]'` and jupytext.

# %%
import os
from pathlib import Path

import pandas as pd

root = Path(__file__).resolve().parents[1] if "__file__" in globals() else Path.cwd().parent
comparison = Path(os.environ.get("ABLATE_STUDY", root / "runs" / "quick-fetal")) / "comparison"
if not (comparison / "table.csv").exists():
    raise SystemExit(f"no finished study at {comparison.parent}: run `make sweep` first")

# %% [markdown]
# Mean and standard deviation over the test frames. The re-simulation row is the target simulated again with other
# scatterers: a floor for patch chi-square and the Frechet distance, a level for PSNR and MAE.

# %%
table = pd.read_csv(comparison / "table.csv").set_index("variant")
columns = ["psnr", "mae", "pchi2", "fd_speckle", "parameters"]
shown = table[[f"{c}_{part}" for c in columns for part in ("mean", "sd") if f"{c}_{part}" in table]]
print(shown.round(3).to_string())

# %% [markdown]
# Paired differences to the reference on the same frames (the paper's Fig. 4 in numbers).

# %%
paired = pd.read_csv(comparison / "paired.csv")
print(paired[paired["metric"].isin(columns)].round(4).to_string(index=False))

# %% [markdown]
# The same table for LaTeX (booktabs).

# %%
print((comparison / "table.tex").read_text())
