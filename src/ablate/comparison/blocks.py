"""Which runs of a study can stand in one experiment: on the same pairs, or on pairs that differ in what was varied."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ablate.runs.job import differences, semantic_key
from ablate.runs.run import Run
from ablate.setting import flat
from ablate.settings.components import components
from ablate.settings.study import ConfigurationError

_ANATOMY = "data.scene.anatomy_seed"
_SEEDS = ("seed", "training.seed")


def without_anatomy(data: Mapping[str, Any]) -> dict[str, Any]:
    """What pairs are made from, without the seed of the anatomy: anatomies are the blocks of a study."""
    return {**data, "scene": {k: v for k, v in data["scene"].items() if k != "anatomy_seed"}}


def anatomy_of(run: Run) -> str:
    """The block that a run belongs to: the anatomy that its pairs show."""
    return str(run.spec["semantic"]["data"]["scene"].get("anatomy_seed", ""))


def factors_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """The dotted keys that count as components: the declared ones, then those in labels; no anatomy."""
    declared = (component.key for component in components())
    swept = sorted({key for run in runs for key in run.changed} - {_ANATOMY.removeprefix("data.")})
    return tuple(dict.fromkeys([*declared, *swept]))


def is_block(run: Run, other: Run, factors: Collection[str]) -> bool:
    """Whether the pairs of two runs differ in the anatomy or in components, and in nothing else."""
    varied = {semantic_key(key) for key in factors} | {_ANATOMY}
    unlike = differences(run.spec["semantic"]["data"], other.spec["semantic"]["data"], "data")
    return all(key in varied for key, _, _ in unlike)


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


def check_pixels(runs: Sequence[Run]) -> None:
    """Refuse runs on pairs of one recipe that hold other pixels, as two kinds of processor make them."""
    first: dict[str, Run] = {}
    for run in runs:
        other = first.setdefault(run.data, run)
        if run.result["pixels"] != other.result["pixels"]:
            raise ConfigurationError(
                f"{run.folder} and {other.folder} were scored on two data sets of one recipe, {run.data}: the "
                "pixels of their test frames differ. Processors round "
                "otherwise: remove one of the two, or give it a study_name of its own"
            )
