"""Secrets that must not be stored or shown, folders of runs that are moved, and databases that are gone."""

import os
import random
import shutil
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path

import ablate
from faults.bench import STUDY, SWEEP, Bench, Fault, Round
from faults.commands import Ended, Start, start
from faults.commands import ablate as start_ablate
from faults.judge import differences

_SOURCE = Path(ablate.__file__).parent


def secrets(bench: Bench, rng: random.Random, number: int) -> Round:
    """A study whose environment, tracking URI and surroundings hold a secret word; is it anywhere afterwards?

    The package lies in another repository, or (every second round) in its own; both have an uncommitted change in
    Latin-1. In its own the change is a part of the provenance, and holds no secret.
    """
    secret = f"canary{rng.getrandbits(64):016x}"
    runs = bench.runs()
    is_own = bool(number % 2)
    site = repository(runs.parent / "repository", "" if is_own else secret, is_own)
    environment = {
        "PYTHONPATH": str(site),
        "CHAOS_TOKEN": secret,
        "CHAOS_URI": f"http://somebody:{secret}@127.0.0.1:9",
        "MLFLOW_TRACKING_PASSWORD": secret,
    }
    line = [*SWEEP, f"runs_dir={runs}"]

    def run(*more: str) -> Ended:
        return start_ablate([*line, *more], runs.parent, Start.cold, environment).wait()

    refused = [run("tracking.uri=${oc.env:CHAOS_URI}"), run(f"tracking.uri=postgresql://a:{secret}@127.0.0.1/b")]
    ended = run()
    wrong = [f"a password in tracking.uri is taken: {each.said[-200:]}" for each in refused if each.code != 2]
    if ended.code:
        return Round([*wrong, f"exit code {ended.code}: {ended.said[-300:]}"])
    if any(secret in each.said for each in (*refused, ended)):
        wrong.append("the secret is on the screen")
    wrong += [f"the secret is in {path.relative_to(runs)}" for path in _holding(runs, secret.encode())]
    changes = (runs / STUDY / "sa2h" / "seed0" / "provenance" / "uncommitted.diff").read_bytes()
    if is_own != (b"caf" in changes):
        wrong.append(f"the uncommitted change of the {'own' if is_own else 'other'} repository: {changes[:80]!r}")
    return Round([*wrong, *differences(runs, bench.unbroken)])


def repository(root: Path, secret: str, is_own: bool) -> Path:
    """A repository with the package in it and an uncommitted change in Latin-1; returns what PYTHONPATH must name."""
    site = root / ("src" if is_own else "site")
    shutil.copytree(_SOURCE, site / "ablate", ignore=shutil.ignore_patterns("__pycache__"))
    name = "ablate-ultrasound" if is_own else "another"
    (root / "pyproject.toml").write_text(f'[project]\nname = "{name}"\nversion = "1"\n')
    conf = root / "conf" if is_own else site / "ablate" / "conf"
    shutil.copytree(_SOURCE.parents[1] / "conf", conf)
    (root / "notes.txt").write_text("begun\n")
    git = ["git", "-C", str(root), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    for arguments in (["init", "-q"], ["add", "-A"], ["commit", "-q", "-m", f"begun {secret}"]):
        subprocess.run([*git, *arguments], check=True)
    (root / "notes.txt").write_bytes(f"caf\xe9 {secret}\n".encode("latin-1"))
    return site


def _holding(folder: Path, secret: bytes) -> list[Path]:
    return [path for path in sorted(folder.rglob("*")) if path.is_file() and secret in path.read_bytes()]


def moved(bench: Bench, _: random.Random, number: int) -> Round:
    """Move or copy the folder of runs, remove or damage its database; `task=compare` must show all of it in MLflow."""
    runs = bench.copy()
    place = runs.parent / "moved" / "runs"
    place.parent.mkdir()
    how = ("moved", "copied", "database removed", "database cut off")[number % 4]
    before = {path: path.stat().st_mtime_ns for path in bench.unbroken.rglob("*")}
    if how in ("moved", "copied"):
        runs = Path(shutil.move(runs, place)) if how == "moved" else Path(shutil.copytree(runs, place))
    else:
        shutil.move(runs, place)
        runs, database = place, place / "mlflow.db"
        shutil.rmtree(runs / "artifacts")
        if how == "database removed":
            database.unlink()
        else:
            os.truncate(database, database.stat().st_size // 2)
    ended = start_ablate([*SWEEP, f"runs_dir={runs}", "task=compare"], runs.parent).wait()
    if ended.code:
        return Round([f"{how}: exit code {ended.code}: {ended.said[-300:]}"])
    wrong = [f"{how}: {line}" for line in differences(runs, bench.unbroken)]
    if {path: path.stat().st_mtime_ns for path in bench.unbroken.rglob("*")} != before:
        wrong.append(f"{how}: the original was written to")
    there, here = (
        sum(1 for p in (folder / "artifacts").rglob("*") if p.is_file()) for folder in (bench.unbroken, runs)
    )
    if there != here:
        wrong.append(f"{how}: {here} artifacts, not {there}")
    return Round(wrong)


_EDITS = ("run renamed", "tags removed", "experiment renamed", "run deleted", "study deleted")


def edited(bench: Bench, _: random.Random, number: int) -> Round:
    """Edit or delete in MLflow; the same command leaves it so, makes nothing twice and says what was deleted."""
    how = _EDITS[number % len(_EDITS)]
    runs = bench.copy()
    line = [*SWEEP, f"runs_dir={runs}"]
    first = start_ablate(line, runs.parent).wait()  # the folder is a copy: its store is made anew
    before = _ids(runs)
    changed = start(_edit, (runs, how), runs.parent).wait()
    ended = start_ablate(line, runs.parent).wait()
    after = _ids(runs)
    wrong = [f"{how}: exit code {e.code}: {e.said[-300:]}" for e in (first, changed, ended) if e.code]
    if after != before:
        wrong.append(f"{how}: the runs were {before} and are {after}")
    if how.endswith("deleted") and "was deleted in MLflow, and is left so" not in ended.said:
        wrong.append(f"{how}: without a word")
    return Round(wrong)


def _edit(runs: Path, how: str) -> None:
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{runs}/mlflow.db")
    experiment = client.get_experiment_by_name("ablate").experiment_id
    kinds = {run.data.tags["kind"]: run for run in client.search_runs([experiment])}
    job, study = (kinds[kind].info.run_id for kind in ("job", "study"))
    if how == "run renamed":
        client.update_run(job, name="the best")
    elif how == "tags removed":
        for run_id, tag in ((job, "config_hash"), (job, "variant"), (job, "kind"), (study, "study")):
            client.delete_tag(run_id, tag)
    elif how == "experiment renamed":
        client.rename_experiment(experiment, "mine")
    else:
        client.delete_run(job if how == "run deleted" else study)


def _ids(runs: Path) -> list[str]:
    """The runs of all experiments, those that were deleted too."""
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection:
        return sorted(run_id for (run_id,) in connection.execute("SELECT run_uuid FROM runs"))


FAULTS = (
    Fault(
        "canary",
        "a secret in tracking.uri, the environment, the diff of another repository; changes in Latin-1",
        "in no file, artifact or output; the study runs",
        secrets,
        4,
        0,
    ),
    Fault(
        "moved",
        "the folder of runs moved or copied; the database removed or cut off",
        "all runs and artifacts are in MLflow again, the original is as it was",
        moved,
        8,
        1,
    ),
    Fault(
        "edited",
        "runs and experiment renamed, untagged or deleted in MLflow",
        "no second run; what was edited is left so, and what was deleted is told",
        edited,
        2 * len(_EDITS),
        0,
    ),
)
