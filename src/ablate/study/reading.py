"""The runs of a study as comparisons read them: their tables and pictures, and how they were made."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ablate import analysis
from ablate.analysis import REFERENCE, RESIMULATION, FramePictures, StudyResults, ordered_variants
from ablate.metrics.metric import BOUNDS, FLOOR_PREFIX, FRAME_TIME, MODEL, RESIMULATED, is_bound
from ablate.networks.spec import Family
from ablate.settings.conf import NOT_OF_CUSTOM, components
from ablate.study.comparable import ComparableRuns, factors_of, levels_of
from ablate.study.frame_times import frame_times, timed_on
from ablate.study.provenance import ABOUT_CODE
from ablate.study.run import Run


def scored_frames(runs: Sequence[Run]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Test values of every run, and once a data set those of the re-simulation, as two tables.

    The first has columns variant, seed, frame, site, metric, value, data: one row a metric of a frame of a run. The
    second has variant, seed, data, metric, value, lower, upper: one row a metric that only a run has, with the interval
    of a distance. `data` is the name of the pairs; frames and sites are numbers within them.
    """
    frames, scalars = [], []
    first: dict[str, Run] = {}  # of each data set: the run that has most values of re-simulation
    for run in sorted(runs, key=lambda run: -(run.scores["source"] == RESIMULATED).sum() - len(run.scalars)):
        first.setdefault(run.data, run)
    for run in runs:
        own: dict[str, Any] = {"variant": run.label, "seed": run.seed, "data": run.data}
        with_floor = first[run.data] is run
        table = run.scores[run.scores["split"] == "test"].assign(data=own["data"])
        frames.append(table[table["source"] == MODEL])
        floor = table[table["source"] == RESIMULATED]
        if with_floor and len(floor):
            frames.append(floor.assign(variant=RESIMULATION))
        per_image_metrics = set(table["metric"])
        values: dict[str, float] = run.scalars
        for name, value in values.items():
            part, _, metric = name.rpartition("/")
            is_floor = metric.startswith(FLOOR_PREFIX)
            metric = metric.removeprefix(FLOOR_PREFIX)
            of_frames = metric in per_image_metrics or is_bound(metric)
            if part == "test" and not of_frames and (with_floor or not is_floor):
                whose = own | ({"variant": RESIMULATION} if is_floor else {})
                bounds = {side: values.get(f"{name}_{side}") for side in BOUNDS}
                scalars.append({**whose, "metric": metric, "value": value, **bounds})
        parameters = values["parameters_generator"] + values["parameters_discriminator"]
        scalars.append({**own, "metric": "parameters", "value": parameters})
    table = pd.DataFrame(scalars)
    times = frame_times(runs)
    return pd.concat(frames, ignore_index=True), pd.concat([table, times], ignore_index=True) if len(times) else table


def pictures(runs: Sequence[Run], reference: str = REFERENCE) -> list[FramePictures]:
    """The frames that all variants have pictures of, each variant's from its lowest seed that has any."""
    order = ordered_variants([run.label for run in runs], reference)
    stored: dict[str, dict[int, np.ndarray]] = {}
    for run in sorted(runs, key=lambda r: (order.index(r.label), r.seed)):
        if run.label not in stored and (images := run.training.pictures):
            stored[run.label] = images
    numbers = sorted(set.intersection(*(set(images) for images in stored.values()))) if stored else []
    if not numbers:
        return []
    pairs = runs[0].training.data_set.pairs
    shown = pairs.maps & {"target", "segmentation", "attenuation", "resimulation"}
    maps = {name: pairs.read(name, numbers) for name in shown}
    if "resimulation" in maps:
        stored = {RESIMULATION: dict(zip(numbers, maps["resimulation"], strict=True)), **stored}
    return [
        FramePictures(
            name=f"frame {number}",
            target=maps["target"][k],
            predictions={variant: images[number] for variant, images in stored.items()},
            mask=pairs.mask(),
            segmentation=maps["segmentation"][k],
            attenuation=maps["attenuation"][k] if "attenuation" in maps else None,
        )
        for k, number in enumerate(numbers)
    ]


def provenance(runs: Sequence[Run]) -> dict[str, str]:
    """Data sets, code and hardware of a study; where its runs differ, each value names its runs."""
    texts = {"data": ", ".join(dict.fromkeys(f"{run.data} (pixels {run.pixels})" for run in runs))}
    recorded = {run.name: run.training.made_with for run in runs}
    for key in (key for key in ABOUT_CODE if any(key in about for about in recorded.values())):
        names: dict[str, list[str]] = {}
        for name, about in recorded.items():
            names.setdefault(str(about.get(key, "unknown")), []).append(name)
        several = "; ".join(f"{value} ({', '.join(whose)})" for value, whose in names.items())
        texts[key] = several if len(names) > 1 else next(iter(names))
    return texts


def results_of(usable: ComparableRuns, reference: str = REFERENCE) -> StudyResults:
    """The scores of runs, which may show several anatomies, and the design that they make up; without pictures."""
    runs = usable.all
    factors = factors_of(runs)
    per_image, scalars = scored_frames(runs)
    design = analysis.find_design({run.label: levels_of(run.identity) for run in runs}, factors, reference)
    means = analysis.run_means(per_image, scalars, design)
    anatomy_of = {run.data: str(run.identity["data"]["scene"].get("anatomy_seed", "")) for run in runs}
    means["data"] = means["data"].map(anatomy_of)
    times = scalars[scalars["metric"] == FRAME_TIME]
    spreads = {}
    if len(times):  # half the distance of the quartiles
        spreads[FRAME_TIME] = float((times["upper"] - times["lower"]).mean() / 2)
    compared = usable.runs[0].data
    return StudyResults(
        per_image=per_image[per_image["data"] == compared].reset_index(drop=True),
        scalars=scalars[scalars["data"] == compared].reset_index(drop=True),
        reference=reference,
        blocks=per_image[per_image["data"] != compared],
        design=design,
        means=means,
        components=analysis.with_undeclared(components(), factors),
        spreads=spreads,
        machine=timed_on(runs),
    )


def table_of_runs(runs: Sequence[Run]) -> pd.DataFrame:
    """One row a run: variant, seed, data, the level of every factor that varies or is declared, and every mean.

    Means are over the frames of which all runs have a value; of times there are quartiles too.
    """
    levels = {run.label: run.changed | levels_of(run.identity) for run in runs}  # with seeds and groups of labels
    return _wide(*scored_frames(runs), levels, factors_of(runs))


def _wide(
    per_image: pd.DataFrame, scalars: pd.DataFrame, levels: Mapping[str, Mapping[str, object]], factors: Sequence[str]
) -> pd.DataFrame:
    """One row a run: variant, seed, data, the level of every factor that varies or is declared, and every mean."""
    run = ["variant", "seed", "data"]
    everything = analysis.run_means(per_image, scalars)
    wide = everything.pivot(index=run, columns="metric", values="value").reset_index()
    if len(times := scalars[scalars["metric"] == FRAME_TIME]):
        bounds = times.set_index(run)[list(BOUNDS)].add_prefix(f"{FRAME_TIME}_")
        wide = wide.join(bounds.astype("float64"), on=run)
    for place, factor in enumerate(factors, start=len(run)):
        lack = {v for v, own in levels.items() if own.get("model.family") == Family.custom and factor in NOT_OF_CUSTOM}
        wide.insert(place, factor, [None if v in lack else levels[v].get(factor) for v in wide["variant"]])
    return wide
