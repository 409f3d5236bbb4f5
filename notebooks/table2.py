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
# # Table II: the models compared
#
# This notebook reads the study that `make sweep` left in `runs/`. The environment variable `ABLATE_STUDY` can name
# another study. Nothing is trained.

# %%
from IPython.display import Markdown

from ablate.analysis import paired_table, to_latex, to_markdown
from ablate.analysis.tables import resimulation_note
from ablate.metrics import Shown, shown_in
from ablate.study.opened import found_study

study = found_study()
columns = shown_in(Shown.table)
table = study.table[study.table["metric"].isin(columns)]
frames, sites = study.per_image["frame"].nunique(), study.per_image["site"].nunique()
print(f"{study.folder.name}: {len(study.usable.runs)} runs, {frames} test frames of {sites} probe sites")

# %% [markdown]
# ## The table
#
# Mean and standard deviation are over the test frames. The best network of each column is bold.

# %%
Markdown(f"{to_markdown(table)}\n\n{resimulation_note(list(dict.fromkeys(table['metric'])))}")

# %% [markdown]
# ## Paired differences
#
# Every variant is compared with the reference on the same frames. The columns are the median shift (Hodges-Lehmann),
# its 95 % interval over probe sites, and the p-value after Holm's correction. They say whether these trained networks
# differ on these frames. The claim that a component matters needs three seeds or more. The file `report.html` in the
# folder `comparison` of the study judges this claim.

# %%
paired = paired_table(study.per_image, study.reference)
shown = paired[paired["metric"].isin(columns)].drop(columns="reference")
shown.set_index(["variant", "metric"]).round(4)

# %% [markdown]
# ## The same table for LaTeX

# %%
print(to_latex(table))
