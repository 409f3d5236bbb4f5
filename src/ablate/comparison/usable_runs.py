"""Choose the runs of a study that can be compared with each other, and say which are left aside and why."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ablate.analysis import REFERENCE, listed
from ablate.runs.job import differences, semantic_key
from ablate.runs.run import Run, State, runs_of
from ablate.setting import flat
from ablate.settings.conf import components
from ablate.settings.study import ConfigurationError

_ANATOMY = "data.scene.anatomy_seed"
_SEEDS = ("seed", "training.seed", "encoding.seed")


@dataclass(frozen=True)
class UsableRuns:
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


def usable_runs(study_dir: Path, reference: str = REFERENCE) -> UsableRuns:
    """Read the finished runs of a study, `<label>/seed<k>/`. A run that cannot be used is left aside.

    Of runs on different pairs those on the reference's are taken, or else on the pairs that most runs have; and as
    blocks those on pairs that differ from them only in the anatomy or in components. Runs on pairs of one recipe with
    other pixels are a ConfigurationError.
    """
    runs, aside = _finished(study_dir)
    check_alike(runs)
    blocks: list[Run] = []
    if runs:
        of_reference = [run for run in runs if run.label == reference]
        chosen = Counter(run.data for run in of_reference or runs).most_common(1)[0][0]
        others = [run for run in runs if run.data != chosen]
        varied = {semantic_key(key) for key in factors_of(runs)} | {_ANATOMY}
        runs = [run for run in runs if run.data == chosen]
        pairs = runs[0].spec["semantic"]["data"]
        unlike = [{key for key, *_ in differences(run.spec["semantic"]["data"], pairs, "data")} for run in others]
        blocks = [run for run, keys in zip(others, unlike, strict=True) if keys <= varied]
        part = f"{'takes' if len(blocks) == 1 else 'take'} part in effects and verdicts only"
        aside[f"left aside, made from other pairs than {chosen}"] = [run.name for run in others if run not in blocks]
        aside[f"on another anatomy or data set than {chosen} {part}"] = [run.name for run in blocks]
    counted = {f"{len(names)} run{'s' * (len(names) > 1)} {what}": names for what, names in aside.items() if names}
    notes = [f"{what}: {listed(names)}." for what, names in counted.items()]
    notes += [*_told_by_some_labels(runs, reference), *_counted_twice([*runs, *blocks])]
    return UsableRuns(tuple(runs), tuple(blocks), tuple(notes))


def _finished(study_dir: Path) -> tuple[list[Run], dict[str, list[str]]]:
    """The finished runs of a study, and the names of the others by what is said of them."""
    runs: list[Run] = []
    aside: dict[str, list[str]] = {}
    for run in runs_of(study_dir):
        if run.state is State.finished and run.name == f"{run.label}/seed{run.seed}":
            runs.append(run)
        else:
            why = run.why if run.state is not State.finished else "in a folder that was copied or renamed"
            reason = "not finished" if why in ("", "not finished") else f"left aside, {why}"
            aside.setdefault(reason, []).append(run.name)
    return runs, aside


def _told_by_some_labels(runs: Sequence[Run], reference: str) -> list[str]:
    """A sentence for each key that some labels tell, and others, which differ in it, do not."""
    swept = {key for run in runs for key in run.changed if key.startswith(("training.", "crops.", "evaluation."))}
    told = []
    for key in sorted(swept - {"training.loss"}):
        untold = {run.label: levels_of(run.spec["semantic"]) for run in runs if key not in run.changed}
        levels = {label: of_run[key] for label, of_run in untold.items() if key in of_run}
        if levels and (len(set(levels.values())) > 1 or reference not in levels):
            told.append(f"{key} is {', '.join(f'{value} in {label}' for label, value in levels.items())}.")
    return told


def _counted_twice(runs: Sequence[Run]) -> list[str]:
    """A sentence for each run that has the frames and the scores of another one, under two names of its pairs."""
    twins: dict[object, Run] = {}
    told = []
    for run in runs:
        scores = tuple(item for item in sorted(run.result["scalars"].items()) if item[0].startswith("test/"))
        if scores and (twin := twins.setdefault((run.result["pixels"], scores), run)).data != run.data:
            told.append(f"{twin.name} and {run.name} have the same frames and scores, and count twice: remove one.")
    return told


def without_anatomy(data: Mapping[str, Any]) -> dict[str, Any]:
    """What pairs are made from, without the seed of the anatomy: anatomies are the blocks of a study."""
    return {**data, "scene": {k: v for k, v in data["scene"].items() if k != "anatomy_seed"}}


def factors_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """The dotted keys that count as components: the declared ones, then those in labels; no anatomy."""
    declared = (component.key for component in components())
    swept = sorted({key for run in runs for key in run.changed} - {_ANATOMY.removeprefix("data.")})
    return tuple(dict.fromkeys([*declared, *swept]))


def levels_of(semantic: Mapping[str, Any]) -> dict[str, object]:
    """What can make a run differ from another one of its study: every dotted key that decides its result.

    `semantic` is that of the run or of its job. Where no noise is injected, the weight that it would start with says
    nothing and is left out; seeds and the anatomy are no components.
    """
    content = dict(flat(dict(semantic)))
    if content["model.noise"] != "inject":
        content.pop("model.noise_start", None)
    levels = {key: value for key, value in content.items() if key not in (*_SEEDS, _ANATOMY)}
    levels["encoding"] = levels.pop("encoding.order")
    return {key.removeprefix("data."): tuple(v) if isinstance(v, list) else v for key, v in levels.items()}


def check_alike(runs: Sequence[Run]) -> None:
    """Refuse two networks under one label, one run under two, two codes of a metric, other pixels of one recipe."""
    first, of_label, of_hash = dict[str, Run](), dict[str, Run](), dict[str, Run]()
    scored: dict[str, tuple[Run, str, str]] = {}  # by the name that values have
    for run in runs:
        other = of_label.setdefault(run.label, run)
        own, others = (levels_of({**each.spec["semantic"], "data": {}}) for each in (run, other))
        if keys := ", ".join(key for key, *_ in differences(own, others)):
            raise ConfigurationError(f"{other.folder} and {run.folder} have one label and differ in {keys}: remove one")
        if (twin := of_hash.setdefault(run.result["hash"], run)).folder != run.folder:
            raise ConfigurationError(f"{twin.folder} and {run.folder} are the same run, which counts once: remove one")
        for name, source in run.result["sources"].items():
            other, *code = scored.setdefault(source.partition(" ")[0], (run, name, source))
            if code != [name, source]:
                again = "repeat the command with this metric and the variants and seeds of both"
                raise ConfigurationError(f"{name} has scored {other.name} and {run.name} by different code: {again}")
        other = first.setdefault(run.data, run)
        if run.result["pixels"] != other.result["pixels"]:
            raise ConfigurationError(
                f"{run.folder} and {other.folder} were scored on two data sets of one recipe, {run.data}: pixels "
                "differ. Processors round otherwise: remove one of the two, or give it a study_name of its own"
            )
