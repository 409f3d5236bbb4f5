"""The place of a job's run on disk: what lies there already, and whether the job may use it."""

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import replace

from filelock import FileLock

from ablate.metrics import METRIC_SETS, METRICS, METRICS_VERSION, choose_metrics, needs_inception
from ablate.runs.job import Job, differences, not_shared
from ablate.runs.run import Run, State, runs_of
from ablate.setting import plain
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.storage import known_json, write_json
from ablate.user_code import code_digest, load


def check_place(job: Job) -> None:
    """Refuse a run directory, or a study, that holds another configuration.

    The ConfigurationError names the keys that differ, each with its value there and here.
    """
    for run in runs_of(job.settings.study_dir):
        there, settings = (run.spec.get(part) for part in ("semantic", "settings"))
        if not (isinstance(there, Mapping) and isinstance(settings, Mapping)):
            continue  # a damaged file tells nothing; comparisons leave its run aside
        if run.folder == job.folder:
            unlike = list(differences(there, job.semantic))
        else:
            preset = settings.get("preset"), job.settings.preset
            unlike = not_shared(there, job.semantic, {*run.changed, *dict(job.changed)}, preset)
        if unlike:
            values = ", ".join(f"{k}: {a} there, {b} here" for k, a, b in unlike)
            another = f"{run.folder} holds another configuration ({values})"
            raise ConfigurationError(f"{another}; give this one a place with study_name=...")
    run = job.run
    if run.hash == job.hash and run.result.get("metrics_version", 0) > METRICS_VERSION:
        raise ConfigurationError(f"{run.folder}: {run.why}; nothing older overwrites it, remove it to start again")


def claim_place(job: Job) -> None:
    """Write `spec.json`, which says what a run is, before anything else is written into its folder.

    Of two processes that claim places in a study at the same time, the second sees what the first has claimed.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    with FileLock(job.settings.study_dir / ".claim.lock"):
        check_place(job)
        run = job.run
        if run.hash == job.hash:
            return
        if run.checkpoint.exists() and run.result.get("hash") != job.hash:
            unknown = f"what {run.checkpoint.name} beside it was trained on is not known"
            where = f"{run.folder / 'spec.json'} is damaged"
            raise ConfigurationError(f"{where}: {unknown}; remove {run.folder} to start again")
        known_by = {"label": job.label, "hash": job.hash, "changed": {k: plain(v) for k, v in job.changed}}
        write_json(run.folder / "spec.json", {**known_by, "semantic": job.semantic, "settings": plain(job.settings)})


def finished_run(job: Job) -> Run | None:
    """The finished run of a job, with all metrics that are asked for; else None, and the job is run or scored again.

    A metric of the user's whose code was edited since is asked for again.
    """
    run, asked, inception = job.run, job.settings.metrics, job.settings.evaluation.inception
    if run.hash != job.hash or run.state is not State.finished:
        return None
    of_same_code = sources_of(asked).items() <= run.result["sources"].items()
    if not of_same_code or names_of(asked) - names_of(run.result["metrics"]):
        return None
    lacks_inception = inception is not None and run.result.get("inception") is None
    return None if lacks_inception and needs_inception(choose_metrics(asked)) else run


def forget_scores(jobs: Iterable[Job]) -> None:
    """Let finished runs be scored again, as those of an earlier version of the metrics are; files stay until then."""
    runs = [run for job in jobs if job.settings.evaluation.again and (run := finished_run(job)) is not None]
    for run in runs:
        from ablate.training.checkpoint import read_checkpoint  # loads PyTorch

        with refusing("evaluation.again=true: "):
            read_checkpoint(run.checkpoint)
    for run in runs:
        unfinish(run)
        shutil.rmtree(run.data_set.folder / "resimulation", ignore_errors=True)


def unfinish(run: Run, **changes: str) -> None:
    """Take back that a run is finished, until its files and what is said of them are new."""
    if result := known_json(path := run.folder / "result.json"):
        write_json(path, {**result, "metrics_version": 0, **changes})


def names_of(asked: str | Iterable[str]) -> set[str]:
    """Names of metrics, and paths of a user's own, behind names and sets; nothing is imported."""
    entries = [asked] if isinstance(asked, str) else asked
    return {name for entry in entries for name in METRIC_SETS.get(entry, (entry,))}


def sources_of(asked: str | Iterable[str]) -> dict[str, str]:
    """By the path of each metric of the user's: the name that its values have, and the digest of its code."""
    paths = [name for name in sorted(names_of(asked)) if name not in METRICS and "." in name]
    return {path: f"{getattr(load(path), 'name', path.rpartition('.')[2])} {code_digest(path)}" for path in paths}


def with_earlier_metrics(job: Job) -> StudySettings:
    """The settings of a job, which also ask for the metrics that an earlier call of the same job computed.

    Of those only the package's: a path in `result.json` may come from anybody, and importing it runs code.
    """
    s, run = job.settings, job.run
    before = {} if run.hash != job.hash or run.state is State.unusable else run.result
    earlier = {name for name in before.get("metrics", ()) if name in METRICS}
    inception = s.evaluation.inception or before.get("inception")
    # By name: a set such as `all` may have more of them when the run is looked at again.
    metrics = sorted(names_of(s.metrics) | earlier)
    return replace(s, metrics=metrics, evaluation=replace(s.evaluation, inception=inception))
