"""Which runs of a list can be compared with each other, and what can make them differ."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ablate.analysis import listed
from ablate.setting import flat
from ablate.settings.components import components
from ablate.settings.study import StudySettings
from ablate.study.job import Job, differences, identity_key
from ablate.study.run import Run, RunList, read_list
from ablate.study.scores import definition_in, is_whole, metric_in
from ablate.training.settings import TRAINING_VERSION
from ablate.ultrasound.settings import SIMULATOR_VERSION

_ANATOMY = "data.scene.anatomy_seed"
_SEEDS = ("seed", "training.seed", "encoding.seed")
#: The versions that results may be of, with their words.
_VERSIONS = {
    "data.simulator_version": ("simulator", SIMULATOR_VERSION),
    "training_version": ("training", TRAINING_VERSION),
}
_TOLD_BY_VARIANTS = ("training.loss", "training.discriminator_width")
#: What a file of conf/ decides whose name a label tells.
_OF_GROUPS = {
    "probe": ("probe.", "simulator.", "dataset."),
    "scene": ("scene.", "simulator.", "dataset."),
    "preset": ("",),
}


@dataclass(frozen=True)
class ComparableRuns:
    """Finished runs of a study.

    `blocks` are on pairs that differ from those of `runs` in the anatomy, or in a component. They take part in the
    effects of components.
    """

    runs: tuple[Run, ...]  # on the same pairs, so that they can be compared frame by frame
    blocks: tuple[Run, ...]
    notes: tuple[str, ...]  # what was left aside, a sentence each; for the report

    @property
    def all(self) -> tuple[Run, ...]:
        return (*self.runs, *self.blocks)


def comparable_runs(asked: RunList) -> ComparableRuns:
    """Choose those that can be compared.

    Of runs on different pairs those on the reference's are taken, or else on the pairs that most runs have; and as
    blocks those on pairs that differ from them only in the anatomy or in components. Scores on other frames, which
    another processor may have made of the same recipe, are left aside; so are scores by another definition of a metric
    than that of most runs. A training counts once, and so does a name.
    """
    aside = {"not finished": list(asked.unfinished)}
    once, aside["left aside, as a run before has the same training or the same name"] = _counted_once(asked.runs)
    alike, definition_notes = _of_same_definitions(once)
    runs, other_pixels = _of_same_pixels(alike)
    aside["left aside, scored on other pixels of the same recipe: processors round otherwise"] = other_pixels
    blocks: list[Run] = []
    if runs:
        reference_runs = [run for run in runs if run.label == asked.reference]
        chosen = Counter(run.data for run in reference_runs or runs).most_common(1)[0][0]
        elsewhere = [run for run in runs if run.data != chosen]
        varied = {identity_key(key) for key in factors_of(runs)} | {_ANATOMY}
        runs = [run for run in runs if run.data == chosen]
        pairs = runs[0].identity["data"]
        for run in elsewhere:
            unlike = {key for key, *_ in differences(run.identity["data"], pairs, "data")}
            if unlike <= varied:
                blocks.append(run)
        part = f"{'takes' if len(blocks) == 1 else 'take'} part in effects and verdicts only"
        aside[f"left aside, made from other pairs than {chosen}"] = [r.name for r in elsewhere if r not in blocks]
        aside[f"on another anatomy or data set than {chosen} {part}"] = [run.name for run in blocks]
    notes = [
        f"{len(names)} run{'' if len(names) == 1 else 's'} {what}: {listed(names)}."
        for what, names in aside.items()
        if names
    ]
    used = [*runs, *blocks]
    notes += [*definition_notes, *untold_differences(runs, asked.reference), *_counted_twice(used), *_versions(used)]
    return ComparableRuns(tuple(runs), tuple(blocks), tuple(notes))


def kept_list(study_dir: Path, reference: str) -> RunList:
    """The runs that the comparison on disk is of; the default `reference` of a command leaves the reference it has."""
    kept = read_list(study_dir)
    return kept if reference == StudySettings.reference else replace(kept, reference=reference)


def with_earlier(asked: RunList) -> RunList:
    """The runs that a command compares, in view of the comparison that its study has on disk.

    They are its own. But repeating some jobs of a sweep does not take the others out of its comparison. And one job
    alone joins the runs that are there, in place of one of its name or its training, unless it differs from them in
    what no label tells, or in the definition of a metric.
    """
    kept = kept_list(asked.folder, asked.reference)
    if asked.unfinished or not kept.runs:
        return asked
    wanted = {(run.training.folder, run.score_names) for run in asked.runs}
    if wanted < {(run.training.folder, run.score_names) for run in kept.runs}:
        return kept
    if len(asked.runs) == 1:
        (own,) = asked.runs
        others = [run for run in kept.runs if run.name != own.name and run.training.folder != own.training.folder]
        joined = (*others, own)
        if not untold_differences(joined, kept.reference) and not _of_same_definitions(joined)[1]:
            replaced = f"{own.label}-seed{own.seed}-"
            return replace(
                kept,
                runs=joined,
                unfinished=tuple(name for name in kept.unfinished if not name.startswith(replaced)),
                unread=tuple(entry for entry in kept.unread if not str(entry["training"]).startswith(replaced)),
            )
    return asked


def with_scores_on_disk(asked: RunList) -> RunList:
    """The runs, each also with the scores that it has on disk, and another of them shows, though no command names them.

    They are of the same definition and frames. So a run that lacks a value of a metric was not scored by it.
    """
    shown = dict.fromkeys((metric_in(name), definition_in(name)) for run in asked.runs for name in run.score_names)
    runs = []
    for run in asked.runs:
        own = {metric_in(name) for name in run.score_names}
        more = (f"{metric}@{how}-{run.pixels}.parquet" for metric, how in shown if metric not in own)
        found = tuple(name for name in more if is_whole(run.training.scores / name))
        runs.append(replace(run, score_names=(*run.score_names, *found)))
    return replace(asked, runs=tuple(runs))


def _counted_once(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """The runs but those of a training or a name that one before has; and of these the names."""
    once: list[Run] = []
    again = []
    for run in runs:
        if any(run.training.folder == other.training.folder or run.name == other.name for other in once):
            again.append(run.name)
        else:
            once.append(run)
    return once, again


def _of_same_definitions(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """The runs without scores by another definition of a metric than most have, and a sentence for each such metric.

    A definition is the version or code of a metric and the number of noise draws.
    """
    definitions: dict[str, Counter[str]] = {}
    for run in runs:
        for name in run.score_names:
            definitions.setdefault(metric_in(name), Counter())[definition_in(name)] += 1
    usual = {metric: counted.most_common(1)[0][0] for metric, counted in definitions.items()}
    notes = []
    for metric, counted in definitions.items():
        if len(counted) > 1:
            others = [
                run.name
                for run in runs
                if any(metric_in(name) == metric and definition_in(name) != usual[metric] for name in run.score_names)
            ]
            differing = ", ".join(counted)
            notes.append(f"{metric} is computed in more than one way ({differing}): left aside in {listed(others)}.")
    alike = []
    for run in runs:
        names = tuple(name for name in run.score_names if definition_in(name) == usual[metric_in(name)])
        if names:
            alike.append(run if names == run.score_names else replace(run, score_names=names))
    return alike, notes


def _of_same_pixels(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """Of each data set the runs that were scored on the pixels that most of them have, and the names of the others."""
    usual = {}
    for data in dict.fromkeys(run.data for run in runs):
        usual[data] = Counter(run.pixels for run in runs if run.data == data).most_common(1)[0][0]
    alike = [run for run in runs if run.pixels == usual[run.data]]
    return alike, [run.name for run in runs if run not in alike]


def versions_of(runs: Sequence[Run]) -> list[tuple[str, object]]:
    """The versions of the simulator and of the training that results are of; pairs made elsewhere have no simulator."""
    identities = [dict(flat(run.identity)) for run in runs]
    return [
        (what, version)
        for key, (what, _) in _VERSIONS.items()
        for version in sorted({identity[key] for identity in identities if key in identity}, key=str)
    ]


def _versions(runs: Sequence[Run]) -> list[str]:
    """A sentence where runs are of other versions of the simulator or the training than this program."""
    found = versions_of(runs)
    notes = []
    for what, version in _VERSIONS.values():
        versions = [one for name, one in found if name == what]
        if set(versions) - {version}:
            run_versions = " and ".join(map(str, versions))
            notes.append(
                f"These results are of version {run_versions} of the {what}; this program has version {version}."
            )
    return notes


def untold_differences(jobs: Sequence[Job | Run], reference: str) -> list[str]:
    """A sentence for each key in which networks differ though their labels do not tell it.

    `jobs` are those of a command that are still to be done, or runs that are.
    """
    declared = {component.key for component in components()}
    swept = {key for job in jobs for key in dict(job.changed)}
    in_labels = ("model.", *(start for group in swept & _OF_GROUPS.keys() for start in _OF_GROUPS[group]))
    levels = {job.label: levels_of(job.identity) for job in jobs}
    notes = []
    for key in sorted({key for level in levels.values() for key in level}):
        if key.startswith(in_labels) or key in declared or key in _TOLD_BY_VARIANTS:
            continue
        silent = {job.label for job in jobs if key not in dict(job.changed)}
        value_of = {label: level[key] for label, level in levels.items() if key in level and label in silent}
        is_of_reference = key in swept and reference not in value_of
        if value_of and (len(set(value_of.values())) > 1 or is_of_reference):
            notes.append(f"{key} is {', '.join(f'{value} in {label}' for label, value in value_of.items())}.")
    return notes


def _counted_twice(runs: Sequence[Run]) -> list[str]:
    """A sentence for each run with the frames and scores of another, as where a scene has fewer poses than asked."""
    first: dict[object, Run] = {}
    notes = []
    for run in runs:
        scores = tuple(item for item in sorted(run.scalars.items()) if item[0].startswith("test/"))
        twin = first.setdefault((run.pixels, scores), run) if scores else run
        if twin is not run:
            notes.append(f"{twin.name} and {run.name} have the same frames and scores, and count twice: remove one.")
    return notes


def without_anatomy(data: Mapping[str, Any]) -> dict[str, Any]:
    """What pairs are made from, without the seed of the anatomy: anatomies are the blocks of a study."""
    return {**data, "scene": {k: v for k, v in data["scene"].items() if k != "anatomy_seed"}}


def factors_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """The dotted keys that count as components: the declared ones, then those in labels; no anatomy."""
    declared = (component.key for component in components())
    swept = sorted({key for run in runs for key in run.changed} - {_ANATOMY.removeprefix("data.")})
    return tuple(dict.fromkeys([*declared, *swept]))


def levels_of(identity: Mapping[str, Any]) -> dict[str, object]:
    """What can make a run differ from another one of its study: every dotted key that decides its weights.

    `identity` is that of the training or of its job. Where no noise is injected, the weight that it would start with
    says nothing and is left out; seeds and the anatomy are no components.
    """
    content = dict(flat(dict(identity)))
    if content["model.noise"] != "inject":
        content.pop("model.noise_start", None)
    levels = {key: value for key, value in content.items() if key not in (*_SEEDS, _ANATOMY)}
    levels["encoding"] = levels.pop("encoding.order")
    return {key.removeprefix("data."): tuple(v) if isinstance(v, list) else v for key, v in levels.items()}
