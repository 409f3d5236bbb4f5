"""The identity of a run: a hash of the settings that decide its result; no folder may mix two of them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from filelock import FileLock
from pyarrow.parquet import read_schema

from ablate.config import ConfigurationError, StudySettings, json_ready
from ablate.dataset import Encoding
from ablate.metrics import METRIC_SETS, METRICS, METRICS_VERSION, choose_metrics, needs_inception
from ablate.networks import GeneratorSpec, custom_source
from ablate.storage import digest, read_json, write_json
from ablate.studies.jobs.job import Job
from ablate.studies.pairs.data import about_data
from ablate.studies.result_file import read_result, scored_by
from ablate.training.settings import TRAINING_VERSION, TrainingPrecision, TrainingSettings

# These settings say where a job runs and how often it saves or reports. Another device or number of threads rounds
# otherwise, as another processor does; `starts.json` of a run tells them.
_INCIDENTAL_TRAINING = ("device", "threads", "checkpoint_every", "validate_every", "log_every")


def semantic(settings: StudySettings) -> dict[str, Any]:
    """The settings that decide the trained network and its scores, as JSON values."""
    training = {k: v for k, v in json_ready(settings.training).items() if k not in _INCIDENTAL_TRAINING}
    training["precision"] = precision_of(settings.training).name
    arbitrary = settings.encoding is Encoding.arbitrary
    encoding = {"order": settings.encoding.name} | ({"seed": settings.encoding_seed} if arbitrary else {})
    scored = {k: v for k, v in json_ready(settings.evaluation).items() if k not in ("pictures", "inception")}
    return {
        "data": about_data(settings),
        "encoding": encoding,
        "model": _model(settings.model),
        "training": training,
        "evaluation": scored,
        "crops": {k: v for k, v in json_ready(settings.crops).items() if k != "workers"},
        "seed": settings.seed,
        # Version 1 is left out, as it was before there was a version.
        **({} if TRAINING_VERSION == 1 else {"training_version": TRAINING_VERSION}),
    }


def precision_of(training: TrainingSettings) -> TrainingPrecision:
    """The precision that a training has on this machine: `auto` depends on the device."""
    if training.precision is not TrainingPrecision.auto:
        return training.precision
    from ablate.training import chosen_device, chosen_precision  # loads PyTorch

    return chosen_precision(training.precision, chosen_device(training.device))


def _model(spec: GeneratorSpec) -> dict[str, Any]:
    """The values of a generator; of a user's network the code too, and of others no target, as before it existed."""
    values: dict[str, Any] = json_ready(spec)
    target = values.pop("target")
    return values if target is None else {**values, "target": target, "source": custom_source(target)}


def shared(content: Mapping[str, Any]) -> dict[str, Any]:
    """The part of `semantic` that is the same for all runs of a study: pairs, training, width, crops, evaluation.

    The pairs of two runs may show two anatomies; see `shared_pairs`. The rest is what labels tell apart: components,
    encoding, seed, and the adversarial loss.
    """
    training = {k: v for k, v in content["training"].items() if k not in ("seed", "loss")}
    rest = {k: content[k] for k in ("crops", "evaluation")}
    data = shared_pairs(content["data"])
    return {**rest, "data": data, "model.width": content["model"]["width"], "training": training}


def shared_pairs(data: Mapping[str, Any]) -> dict[str, Any]:
    """What `about_data` says without the seed of the anatomy; anatomies are the blocks of a study."""
    return {**data, "scene": {k: v for k, v in data["scene"].items() if k != "seed"}}


def _training_version(content: Mapping[str, Any]) -> dict[str, int]:
    return {"training_version": content.get("training_version", 1)}


def config_hash(settings: StudySettings) -> str:
    """First 16 hexadecimal digits of the SHA-256 of `semantic`."""
    return digest(semantic(settings))


def check_place(job: Job) -> None:
    """Refuse a run directory, or a study, that holds another configuration.

    The ConfigurationError names the keys that differ, each with its value there and here.
    """
    here = semantic(job.settings)
    for spec in sorted(job.settings.study_dir.glob("*/seed*/spec.json")):
        try:
            there = read_json(spec)["semantic"]
            pair = (there, here) if spec.parent == job.folder else (shared(there), shared(here))
            pair = pair[0] | _training_version(there), pair[1] | _training_version(here)
            differences = ", ".join(f"{k}: {a} there, {b} here" for k, a, b in _differences(*pair))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue  # a damaged file tells nothing; comparisons leave its run aside
        if differences:
            another = f"{spec.parent} holds another configuration ({differences})"
            raise ConfigurationError(f"{another}; give this one a place with study_name=...")


def claim_place(job: Job) -> None:
    """Write `spec.json`, which says what a run is, before anything else is written into its folder.

    Of two processes that claim places in a study at the same time, the second sees what the first has claimed.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    with FileLock(job.settings.study_dir / ".claim.lock"):
        check_place(job)
        if not _is_claimed(job):
            known_by = {"label": job.label, "hash": config_hash(job.settings)}
            decided_by = {"semantic": semantic(job.settings), "settings": json_ready(job.settings)}
            write_json(job.folder / "spec.json", {**known_by, **decided_by})


def _is_claimed(job: Job) -> bool:
    """Whether the folder of a job says what its run is; a damaged `spec.json` is a ConfigurationError if it matters."""
    path = job.folder / "spec.json"
    try:
        return bool(read_json(path)["hash"] == config_hash(job.settings))
    except FileNotFoundError:
        return False
    except (OSError, ValueError, KeyError) as error:
        from ablate.training import LAST  # loads PyTorch

        if (job.folder / LAST).exists() and read_result(job.folder, config_hash(job.settings)) is None:
            unknown = f"what {LAST} beside it was trained on is not known; remove {job.folder} to start again"
            raise ConfigurationError(f"{path} is damaged ({' '.join(str(error).split())}): {unknown}") from error
        return False


def finished(job: Job) -> dict[str, Any] | None:
    """The result of a job, or None where it has none of the same configuration with all metrics that are asked for.

    A result that was scored by another version of the metrics, or whose values of frames cannot be read, is not
    finished: the run is scored again.
    """
    s = job.settings
    result = read_result(job.folder, config_hash(s))
    if result is None or scored_by(result) != METRICS_VERSION or not _has_frames(job.folder):
        return None
    with_network = s.evaluation.inception is not None and needs_inception(choose_metrics(s.metrics))
    if _names(s.metrics) - _names(result["metrics"]) or (with_network and result["inception"] is None):
        return None
    return result


def _names(asked: str | Iterable[str]) -> set[str]:
    """Names of metrics, and paths of a user's own, behind names and sets; nothing is imported."""
    entries = [asked] if isinstance(asked, str) else asked
    return {name for entry in entries for name in METRIC_SETS.get(entry, (entry,))}


def _has_frames(folder: Path) -> bool:
    """Whether `per_image.parquet` of a run is there and whole; its end is written last."""
    try:
        read_schema(folder / "per_image.parquet")
    except (OSError, ValueError):  # pyarrow raises children of ValueError
        return False
    return True


def with_earlier_metrics(job: Job) -> StudySettings:
    """The settings of a job, which also ask for the metrics that an earlier call of the same job computed.

    Of those only the package's: a path in `result.json` may come from anybody, and importing it runs code.
    """
    s = job.settings
    before = read_result(job.folder, config_hash(s)) or {}
    # By name: a set such as `all` may have more of them when the run is looked at again.
    metrics = sorted(_names(s.metrics) | (_names(before.get("metrics", ())) & METRICS.keys()))
    inception = s.evaluation.inception or before.get("inception")
    return replace(s, metrics=metrics, evaluation=replace(s.evaluation, inception=inception))


def _differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    if isinstance(a, dict) and isinstance(b, dict):
        for k in sorted(a.keys() | b.keys()):
            yield from _differences(a.get(k), b.get(k), f"{key}.{k}".lstrip("."))
    elif a != b:
        yield key, a, b
