"""The runs of a study as comparisons read them: their tables and pictures, and how they were made."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ablate import analysis
from ablate.analysis import BASELINES, REFERENCE, RESIMULATION, FramePictures, StudyResults, ordered_variants
from ablate.evaluation import formula_images
from ablate.metrics.metric import BOUNDS, FORMULA, FRAME_TIME, MODEL, SCALAR_PREFIXES, is_bound
from ablate.networks.spec import Family
from ablate.settings.components import NOT_OF_CUSTOM, components
from ablate.study.comparable import ComparableRuns, factors_of, levels_of
from ablate.study.frame_times import formula_of, frame_times, timed_on
from ablate.study.provenance import ABOUT_CODE
from ablate.study.run import Run


def scored_frames(runs: Sequence[Run], reference: str = REFERENCE) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Test values of every run, and once a data set those of the baselines, as two tables.

    The first has columns variant, seed, frame, site, metric, value, data: one row a metric of a frame of a run. The
    second has variant, seed, data, metric, value, lower, upper: one row a metric that only a run has, with the interval
    of a distance. `data` is the name of the pairs; frames and sites are numbers within them. The formula is that of the
    maps that the reference reads.
    """
    frames, scalars = [], []
    tellers = {source: _tellers(runs, source, reference) for source in BASELINES}
    for run in runs:
        keys = {"seed": run.seed, "data": run.data}
        table = run.scores[run.scores["split"] == "test"].assign(data=run.data)
        named = {MODEL: run.label, **{source: name for source, name in BASELINES.items() if run in tellers[source]}}
        frames += [table[table["source"] == source].assign(variant=name) for source, name in named.items()]
        frame_metrics = set(table["metric"])
        for source, name in named.items():
            values = _rows_of_scalars(run.scalars, SCALAR_PREFIXES[source], frame_metrics)
            scalars += [{"variant": name, **keys, **row} for row in values]
        parameters = run.scalars["parameters_generator"] + run.scalars["parameters_discriminator"]
        scalars.append({"variant": run.label, **keys, "metric": "parameters", "value": parameters})
    table, times = pd.DataFrame(scalars), frame_times(runs, reference)
    filled = [part for part in frames if len(part)]
    return (
        pd.concat(filled or frames[:1], ignore_index=True),
        pd.concat([table, times], ignore_index=True) if len(times) else table,
    )


def _tellers(runs: Sequence[Run], source: str, reference: str) -> list[Run]:
    """The run of each data set that has most values of a baseline, of the formula first one of the reference."""

    def order(run: Run) -> tuple[bool, int]:
        is_other = source == FORMULA and run.label.partition(".")[0] != reference
        return is_other, -int((run.scores["source"] == source).sum()) - len(run.scalars)

    first: dict[str, Run] = {}
    for run in sorted(runs, key=order):
        first.setdefault(run.data, run)
    return list(first.values())


def _rows_of_scalars(values: Mapping[str, float], prefix: str, of_frames: Collection[str]) -> list[dict[str, Any]]:
    """The test scores of a source that frames do not have, from all scalars of a run."""
    others = tuple(other for other in SCALAR_PREFIXES.values() if other and other != prefix)
    rows = []
    for name, value in values.items():
        part, _, metric = name.rpartition("/")
        if part != "test" or not metric.startswith(prefix) or metric.startswith(others):
            continue
        metric = metric.removeprefix(prefix)
        if metric not in of_frames and not is_bound(metric):
            rows.append({"metric": metric, "value": value, **{side: values.get(f"{name}_{side}") for side in BOUNDS}})
    return rows


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
    baselines = {RESIMULATION: maps["resimulation"]} if "resimulation" in maps else {}
    formula = formula_of(runs, reference)
    if formula is not None:
        spec = formula[1].training.settings.model
        baselines[FORMULA] = formula_images(runs[0].training.data_set.tissues, pairs, spec)(np.array(numbers), 0)
    stored = {name: dict(zip(numbers, images, strict=True)) for name, images in baselines.items()} | stored
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


def results_of(usable: ComparableRuns, reference: str = REFERENCE, study: str = "") -> StudyResults:
    """The scores of runs, which may show several anatomies, and the design that they make up; without pictures.

    Components are those that were registered for the `study`.
    """
    runs = usable.all
    factors = factors_of(runs)
    declared = components(study)
    per_image, scalars = scored_frames(runs, reference)
    levels = {run.label: levels_of(run.identity) for run in runs}
    design = analysis.find_design(levels, factors, reference, declared)
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
        components=analysis.scaled_bands(analysis.with_undeclared(declared, factors), per_image),
        levels={factor: _levels_in(levels, factor) for factor in factors},
        spreads=spreads,
        machine=timed_on(runs),
    )


def _levels_in(levels: Mapping[str, Mapping[str, object]], factor: str) -> list[object]:
    """The levels that the networks have of a factor, each once; those that have none are left out."""
    network_levels = [
        network[factor] for network in levels.values() if factor in network and not _lacks(network, factor)
    ]
    return list({repr(level): level for level in network_levels}.values())


def _lacks(network: Mapping[str, object], factor: str) -> bool:
    """Whether a network is one of the user's that does not have a component, whatever its settings say."""
    return network.get("model.family") == Family.custom and factor in NOT_OF_CUSTOM


def table_of_runs(runs: Sequence[Run]) -> pd.DataFrame:
    """One row a run: variant, seed, data, the level of every factor that varies or is declared, and every mean.

    Means are over the frames of which all runs have a value; of times there are quartiles too.
    """
    levels = {run.label: run.changed | levels_of(run.identity) for run in runs}  # with seeds and groups of labels
    per_image, scalars = scored_frames(runs)
    columns = ["variant", "seed", "data"]
    wide = analysis.run_means(per_image, scalars).pivot(index=columns, columns="metric", values="value").reset_index()
    times = scalars[scalars["metric"] == FRAME_TIME]
    if len(times):
        bounds = times.set_index(columns)[list(BOUNDS)].add_prefix(f"{FRAME_TIME}_")
        wide = wide.join(bounds.astype("float64"), on=columns)
    for place, factor in enumerate(factors_of(runs), start=len(columns)):
        networks = [levels[variant] for variant in wide["variant"]]
        wide.insert(place, factor, [None if _lacks(network, factor) else network.get(factor) for network in networks])
    return wide
