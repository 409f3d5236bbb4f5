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
# Reads the study that `make sweep` left in `runs/`, or the one that the environment variable `ABLATE_STUDY` names;
# trains nothing.

# %%
from IPython.display import Markdown

from ablate.analysis import paired_table, resimulation_note, to_latex, to_markdown
from ablate.studies.reading import open_study

study = open_study()
columns = ["psnr", "mae", "pchi2", "fd_speckle", "fid", "parameters"]
table = study.table[study.table["metric"].isin(columns)]
frames, sites = study.per_image["frame"].nunique(), study.per_image["site"].nunique()
print(f"{study.folder.name}: {len(study.runs)} runs, {frames} test frames of {sites} probe sites")

# %% [markdown]
# ## The table
#
# Mean and standard deviation over the test frames; the best network of a column is bold.

# %%
Markdown(f"{to_markdown(table)}\n\n{resimulation_note(list(dict.fromkeys(table['metric'])))}")

# %% [markdown]
# ## Paired differences
#
# Every variant against the reference on the same frames: the median shift (Hodges-Lehmann), its 95 % interval over
# probe sites, and the p value after Holm's correction. They say that these trained networks differ on these frames.
# That a component matters takes three seeds or more; `report.html` in the study's `comparison` folder judges that.

# %%
paired = paired_table(study.per_image, study.reference)
shown = paired[paired["metric"].isin(columns)].drop(columns="reference")
shown.set_index(["variant", "metric"]).round(4)

# %% [markdown]
# ## The same table for LaTeX

# %%
print(to_latex(table))
