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
# # Which parts earn their keep?
#
# This notebook reads the study that `make answer` left in `runs/full_model`, or the copy that is kept in
# `docs/results/full_model`. The environment variable `ABLATE_STUDY` can name another study. Nothing is trained.
#
# Each component is judged on one metric, which was named before the runs were scored. The page `docs/statistics.md`
# has the rule.

# %%
from pathlib import Path
from tempfile import mkdtemp

from IPython.display import Image, display

from ablate.analysis import caption, forest_figure, improvements, interactions
from ablate.metrics import metric_of
from ablate.study.opened import ANSWER, found_study

study = found_study(ANSWER, "make answer")
results = study.results
runs = study.runs.groupby("data", sort=False).size()
print(f"{study.folder.name}: {len(study.runs)} runs; by data set: {runs.to_dict()}")
print(caption("verdicts", reference=study.reference, design=results.design))

# %% [markdown]
# ## The picture
#
# A row is a component. Its unit is the improvement of the component's own metric that is too small to matter. A dot is
# one training.

# %%
of_study = results.means, results.design, results.components
tables = results.verdicts, improvements(*of_study), interactions(*of_study)
drawn = forest_figure(*tables, results.components, Path(mkdtemp()) / "verdicts")
display(Image(drawn[0], width=900)) if drawn else print("No run goes without a component: there is nothing to judge.")

# %% [markdown]
# ## The numbers behind it
#
# The effect is the mean of the runs with the component minus the mean of those without it. The band is the improvement
# that is too small to matter. `p_holm` tests the effect against zero, and `p_band_holm` tests whether the improvement
# is smaller than the band. Both are corrected over the components.

# %%
columns = ["metric", "effect", "lower", "upper", "band", "runs_a", "runs_b", "p_holm", "p_band_holm", "verdict"]
results.verdicts.set_index("component")[columns].round(4)

# %% [markdown]
# The same effects where all other components are on, as in SA2H. In a factorial their intervals are wider, because they
# hold the interactions too. Where one component at a time is off, they are the effects above.

# %%
results.verdicts.set_index("component")[["metric", "full_effect", "full_lower", "full_upper"]].round(4)

# %% [markdown]
# ## What depends on what
#
# An interaction is half of the difference that one component makes to the improvement by another one. The table shows
# those with a false discovery rate below 5 %.

# %%
pairs = tables[2]
pairs[pairs["q"] < 0.05].set_index(["component", "other"]).round(4)

# %% [markdown]
# ## Everything else
#
# Effects on all other metrics are exploratory. These have a false discovery rate below 5 %. They are effects of the
# change from SA2H: what it does to a metric if the component is taken away.

# %%
effects = results.effects
if len(effects):
    found = effects[effects["q"].astype(float) < 0.05].drop(columns=["p", "p_holm", "dof"])
    display(found.set_index(["metric", "effect"]).sort_values("q").round(4))

# %% [markdown]
# ## What is missing
#
# A component is undecided if the runs can neither show that it improves its metric, nor that the improvement is too
# small to matter; or if there are too few runs.

# %%
is_open = (results.verdicts["verdict"] == "undecided") & results.verdicts["metric"].notna()
labels = {component.name: component.label for component in results.components}
for row in results.verdicts[is_open].to_dict("records"):
    print(f"{labels[row['component']]} ({metric_of(row['metric']).label}): {row['why']}")
