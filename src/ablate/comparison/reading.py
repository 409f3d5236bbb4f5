"""The runs of a study as comparisons read them: their tables and pictures, and how they were made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ablate import analysis
from ablate.analysis import REFERENCE, RESIMULATION, Component, Design, FramePictures, ordered_variants
from ablate.comparison.frame_times import frame_times
from ablate.comparison.usable_runs import factors_of, levels_of
from ablate.metrics.metric import BOUNDS, FLOOR_PREFIX, FRAME_TIME, MODEL, RESIMULATED, is_bound
from ablate.networks.spec import Family
from ablate.runs.run import Run
from ablate.runs.store_copy import ABOUT_CODE
from ablate.settings.conf import NOT_OF_CUSTOM, components


def scored_frames(runs: Sequence[Run]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Test values of every run, and once a data set those of the re-simulation, as two tables.

    The first has columns variant, seed, frame, site, metric, value, data: one row a metric of a frame of a run. The
    second has variant, seed, data, metric, value, lower, upper: one row a metric that only a run has, with the interval
    of a distance. `data` is the name of the pairs; frames and sites are numbers within them.
    """
    frames, scalars = [], []
    first: dict[str, Run] = {}  # of each data set: the run that has most values of re-simulation
    for run in sorted(runs, key=lambda run: -(run.scores["source"] == RESIMULATED).sum() - len(run.result["scalars"])):
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
        values: dict[str, float] = run.result["scalars"]
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
        if run.label not in stored and (images := run.pictures):
            stored[run.label] = images
    numbers = sorted(set.intersection(*(set(images) for images in stored.values()))) if stored else []
    if not numbers:
        return []
    pairs = runs[0].data_set.pairs
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
    texts = {"data": ", ".join(dict.fromkeys(f"{run.data} (pixels {run.result['pixels']})" for run in runs))}
    recorded = {run.name: run.made_with for run in runs}
    for key in (key for key in ABOUT_CODE if any(key in about for about in recorded.values())):
        names: dict[str, list[str]] = {}
        for name, about in recorded.items():
            names.setdefault(str(about.get(key, "unknown")), []).append(name)
        several = "; ".join(f"{value} ({', '.join(whose)})" for value, whose in names.items())
        texts[key] = several if len(names) > 1 else next(iter(names))
    return texts


@dataclass(frozen=True, eq=False)
class Answers:
    """The design of a study, and what follows from it; the tables are those of `ablate.analysis`.

    `runs` has one row a run of the study: variant, seed, data, its components, its mean of every metric over the frames
    of which all runs have a value, and the quartiles of its time a frame.
    """

    design: Design | None  # None where no component varies; `effects` is then empty
    means: pd.DataFrame  # one row a metric of a run of the design
    effects: pd.DataFrame
    verdicts: pd.DataFrame
    runs: pd.DataFrame
    components: tuple[Component, ...]  # what was judged: the declared ones, and keys that somebody swept
    spreads: Mapping[str, float]  # of the measurement of a cost


def answers(runs: Sequence[Run], reference: str = REFERENCE) -> Answers:
    """Find the design of runs, which may show several anatomies, and judge its components."""
    levels = {run.label: levels_of(run.spec["semantic"]) for run in runs}
    told = {run.label: run.changed | levels[run.label] for run in runs}  # with seeds and groups that a label names
    factors = factors_of(runs)
    judged = analysis.with_undeclared(components(), factors)
    block = {run.data: str(run.spec["semantic"]["data"]["scene"].get("anatomy_seed", "")) for run in runs}
    per_image, scalars = scored_frames(runs)
    design = analysis.find_design(levels, factors, reference)
    means = analysis.run_means(per_image, scalars, design)
    means["data"] = means["data"].map(block)
    times = scalars[scalars["metric"] == FRAME_TIME]  # their spread is half the distance of the quartiles
    spreads = {FRAME_TIME: float((times["upper"] - times["lower"]).mean() / 2)} if len(times) else {}
    effects = pd.DataFrame() if design is None else analysis.effects_table(means, design)
    verdicts = analysis.verdict_table(means, design, judged, spreads)
    return Answers(design, means, effects, verdicts, _wide(per_image, scalars, told, factors), judged, spreads)


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
