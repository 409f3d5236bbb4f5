"""How long must a training be, and what is too small to matter? Validation curves and scores of the pilot study.

python -m ablate +study=pilot    # first: train the pilot
python scripts/pilot.py                                # docs/pilot.csv, docs/pilot.png, and the tables of docs/study.md

Scores are those of the last checkpoints, so this can be called while the pilot still trains.
"""

import argparse
from pathlib import Path

import pandas as pd
from mlflow import MlflowClient

from ablate.analysis.figures.style import PAGE_IN, colour_of, house_style, new_figure
from ablate.dataset import Part, label_values
from ablate.evaluation.run_scores import resimulation_scores
from ablate.metrics import metric_of
from ablate.networks import draws_noise
from ablate.runs.run import runs_of
from ablate.runs.train import generated_images, scorer
from ablate.settings.conf import components
from ablate.training import load_generator
from numerics import fill, markdown

DOCS = Path(__file__).resolve().parents[1] / "docs"
PREFIX, SUFFIX = "val/", "_curve"
SHOWN = ("mae_smooth", "pchi2_tissue", "shadow_contrast", "crps", "fd_speckle", "noise_sd")


def curves(uri: str, study: str) -> pd.DataFrame:
    """The validation curves of a study's runs: columns run, step, metric, value."""
    client, rows = MlflowClient(uri), []
    for experiment in client.search_experiments():
        for run in client.search_runs([experiment.experiment_id], f"tags.study = '{study}' and tags.kind = 'job'"):
            batch = int(client.get_run(run.data.tags["mlflow.parentRunId"]).data.params["training.batch_size"])
            for name in (key for key in run.data.metrics if key.startswith(PREFIX) and key.endswith(SUFFIX)):
                metric = name.removeprefix(PREFIX).removesuffix(SUFFIX)
                points = {p.step: p.value for p in client.get_metric_history(run.info.run_id, name)}
                rows += [(run.data.tags["variant"], images // batch, metric, value) for images, value in points.items()]
    return pd.DataFrame(rows, columns=["run", "step", "metric", "value"]).sort_values(["run", "metric", "step"])


def draw(table: pd.DataFrame, path: Path) -> None:
    """One panel a metric, one line a run; the untrained network, far off, is left out."""
    table = table[table["step"] > 0]
    runs = list(dict.fromkeys(table["run"]))
    with house_style():
        figure = new_figure(PAGE_IN, 3.6)
        for axes, name in zip(figure.subplots(2, 3).flat, SHOWN, strict=True):
            for run in runs:
                line = table[(table["run"] == run) & (table["metric"] == name)]
                axes.plot(line["step"], line["value"], color=colour_of(run, runs), marker=".", label=run)
            metric = metric_of(name)
            axes.set_title(f"{metric.label} ({metric.unit})" if metric.unit else metric.label)
            axes.set_ylim(0, 1.1 * table.loc[table["metric"] == name, "value"].max())
        figure.supxlabel("training steps")
        figure.axes[0].legend(frameon=False)
        figure.savefig(path, dpi=200)


def as_table(table: pd.DataFrame) -> pd.DataFrame:
    """A row a run and step; a column a metric."""
    shown = table[table["metric"].isin(SHOWN) & (table["step"] > 0)]
    wide = shown.pivot(index=["run", "step"], columns="metric", values="value")[list(SHOWN)]
    texts = {metric_of(name).label: wide[name].map(f"{{:.{metric_of(name).decimals}f}}".format) for name in SHOWN}
    return pd.DataFrame(texts, index=wide.index)


def distances(study: Path) -> pd.DataFrame:
    """What separates the runs of a study from re-simulation on all validation frames, in the primary metrics."""
    columns: dict[str, dict[str, float]] = {}
    for run in runs_of(study):
        settings, data = run.settings, run.data_set
        judge = scorer(settings, data)
        values = label_values(data.tissues, settings.encoding, settings.label_seed)
        images = generated_images(load_generator(run.checkpoint), data, values, settings.training.precision)
        if not columns:
            columns["re-simulation"] = resimulation_scores(judge, Part.validation).scalars
        columns[run.label] = judge.score(Part.validation, images, draws_noise(settings.model)).scalars
    table = pd.DataFrame(columns).loc[list(dict.fromkeys(str(c.metric) for c in components()))]
    table["a tenth of the distance to sa2h"] = (table["sa2h"] - table["re-simulation"]) / 10
    return table.rename(index=lambda name: metric_of(name).title)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--study", default="pilot")
    chosen = parser.parse_args()
    table = curves(f"sqlite:///{chosen.runs / 'mlflow.db'}", chosen.study)
    if table.empty:
        raise SystemExit(f"{chosen.runs} holds no validation curve of the study {chosen.study}: train it first")
    table.to_csv(DOCS / "pilot.csv", index=False, float_format="%.5g")
    draw(table, DOCS / "pilot.png")
    texts = {
        "pilot": markdown(as_table(table)),
        "distances": markdown(distances(chosen.runs / chosen.study).rename_axis("metric").map("{:.2f}".format)),
    }
    page = DOCS / "study.md"
    page.write_text(fill(page.read_text(), texts))
    print("\n\n".join(texts.values()))


if __name__ == "__main__":
    main()
