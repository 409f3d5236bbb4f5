"""What MLflow shows of a study: the description of its parent run, and the model in the registry."""

import re
from collections.abc import Mapping, Sequence

import pandas as pd

from ablate import analysis, tracking
from ablate.dataset import Part, label_values
from ablate.networks import conditions
from ablate.runs.run import Run
from ablate.settings.study import StudySettings
from ablate.tracking import Store, StoredRun
from ablate.training import load_generator

_EXAMPLE_PX = 64  # size of the example input of a registered model


def describe_study(
    run: StoredRun, runs: Sequence[Run], ids: Mapping[str, str], table: pd.DataFrame, cautions: Sequence[str]
) -> None:
    """Write the parent run's description (links, a `comparison_table` in Markdown, cautions) and the table's means.

    `ids` are those of the stored runs, by name.
    """
    first: dict[str, str] = {}
    for one in sorted(runs, key=lambda r: r.seed):
        if one.name in ids:
            first.setdefault(one.label, ids[one.name])
    report = tracking.artifact_page(run.store, run.run_id, "report.html")
    compared = tracking.comparison_page(run.store, list(first.values()))
    links = f"[The report]({report}) · [the variants side by side]({compared})"
    rows = analysis.to_markdown(table).splitlines()  # MLflow's pages show no space between the columns of a table
    spaced = [row if set(row) <= set("|-: ") else row.replace(" |", "\u00a0\u00a0|") for row in rows]
    run.describe("\n\n".join([links, "\n".join(spaced), *cautions]))
    means = table[["metric", "variant", "mean"]].dropna().itertuples(index=False)
    run.scores({re.sub(r"[^\w/. -]", "_", f"test/{metric}/{variant}"): float(mean) for metric, variant, mean in means})


def register_reference(settings: StudySettings, runs: Sequence[Run], store: Store, ids: Mapping[str, str]) -> str:
    """Register the reference's generator of the seed with the best validation PSNR; returns a line for the screen.

    `ids` are those of the stored runs, by name.
    """
    from ablate.tracking.registration import register_generator  # its import takes seconds

    name = settings.tracking.register
    of_reference = [run for run in runs if run.label == settings.reference and run.name in ids]
    if not of_reference:
        return f"not registered: {settings.reference} has no finished run in MLflow"
    chosen = max(of_reference, key=lambda run: run.result["scalars"]["val/psnr_fan"])
    trained, data = chosen.settings, chosen.data_set
    space = trained.model.space
    sizes = data.pairs.shape_in(space)
    middle = [slice(max(0, (size - _EXAMPLE_PX) // 2), (size + _EXAMPLE_PX) // 2) for size in sizes]
    frame = data.pairs.frames(Part.test)[:1]
    version = register_generator(
        store,
        str(name),
        ids[chosen.name],
        load_generator(chosen.checkpoint),
        label_values(data.tissues, trained.encoding, trained.label_seed),
        trained.training.precision,
        {name: data.pairs.read(name, frame, space)[:, *middle] for name in conditions(trained.model)},
        f"{chosen.name} of the study {settings.study}, the seed that validates best.",
    )
    return f"models:/{name}/{version}    ({chosen.name})"
