"""A server for a group as docs/cluster.md has it: PostgreSQL, artifacts through the server, user and password."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pytest
import requests
from mlflow import MlflowClient

from ablate.metrics.metric import FRAME_TIME
from ablate.study.log import read_log
from ablate.study.scores import read_score
from ablate.study.training import Training, trainings_in
from support.servers import Mlflow, Postgres, new_postgres, why_no_postgres
from support.studies import run

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(why_no_postgres()), reason=why_no_postgres())]

USER, PASSWORD = "anna", "canary-8f3b61c2"
FOLDERS, STUDIES = 2, 4  # two people with four studies each, of the same names
VARIANTS = ("sa2h", "sa2h-att")
STEPS = 20
DOWN_S = 10.0
NOT_ALL, MOST_REPEATED = "not all is in MLflow yet", 5
SWEEP = (
    *("-m", f"variant={','.join(VARIANTS)}", "preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10"),
    *(f"training.steps={STEPS}", "training.log_every=1", "training.validate_every=10", "metrics=[psnr,mae]"),
    *("evaluation.pictures=1", "evaluation.timed_frames=1"),
)


@dataclass(frozen=True)
class Group:
    """A server, what is below it, and the folders of two people who use it."""

    postgres: Postgres
    mlflow: Mlflow
    runs: tuple[Path, ...]

    def ask(self, question: str) -> list[tuple[object, ...]]:
        """What the tables behind the server answer, without MLflow."""
        connection = self.postgres.connection("mlflow")
        try:
            with connection.cursor() as cursor:
                cursor.execute(question)
                return list(cursor.fetchall())
        finally:
            connection.close()


@pytest.fixture(scope="module")
def group(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Group]:
    """The server, with one user, and an equal data set in both folders."""
    place = tmp_path_factory.mktemp("group")
    with new_postgres() as postgres, pytest.MonkeyPatch.context() as patch:
        mlflow = Mlflow(postgres, place)
        try:
            mlflow.up()
            new_user = {"username": USER, "password": PASSWORD}
            pages = f"{mlflow.uri}/api/2.0/mlflow/users/create"
            requests.post(pages, json=new_user, auth=("admin", mlflow.password), timeout=60).raise_for_status()
            patch.setenv("MLFLOW_TRACKING_USERNAME", USER)
            patch.setenv("MLFLOW_TRACKING_PASSWORD", PASSWORD)
            runs = tuple(place / f"person{k}" / "runs" for k in range(FOLDERS))
            assert run(*SWEEP, f"runs_dir={runs[0]}", "task=simulate") == 0
            for folder in runs[1:]:
                shutil.copytree(runs[0] / "data", folder / "data")
            yield Group(postgres, mlflow, runs)
        finally:
            mlflow.kill()


@dataclass(frozen=True)
class Command:
    """A command line in a process of its own, and the file of what it says."""

    process: subprocess.Popen[bytes]
    log: Path

    @property
    def said(self) -> str:
        return self.log.read_text("utf-8")

    def wait(self) -> Command:
        self.process.wait()
        return self


def sweep(group: Group, number: int, *more: str) -> Command:
    """Start a sweep of a person, whose name and password are in the environment."""
    runs, study = group.runs[number % FOLDERS], f"s{number // FOLDERS}"
    line = [*SWEEP, f"study_name={study}", f"runs_dir={runs}", f"tracking.uri={group.mlflow.uri}", *more]
    log = runs.parent / f"{study}.txt"
    command = [sys.executable, "-m", "ablate", *line]
    with log.open("wb") as file:
        process = subprocess.Popen(command, cwd=runs.parent, env=os.environ, stdout=file, stderr=file)
    return Command(process, log)


def trainings(group: Group) -> list[Training]:
    """All that have begun."""
    return [training for runs in group.runs for s in range(STUDIES) for training in trainings_in(runs / f"s{s}")]


def test_eight_sweeps_at_once_lose_and_double_nothing_though_the_database_is_killed_in_between(
    group: Group, capsys: pytest.CaptureFixture[str]
) -> None:
    count = FOLDERS * STUDIES
    began = time.monotonic()
    running = [sweep(group, number) for number in range(count)]
    while not any(steps_logged(training.folder) > STEPS // 2 for training in trainings(group)):
        assert all(c.process.poll() is None for c in running), [c.said[-1000:] for c in running]
        time.sleep(0.1)
    group.postgres.kill()
    time.sleep(DOWN_S)
    group.postgres.up()
    ended = [command.wait() for command in running]
    seconds = time.monotonic() - began
    codes = [command.process.returncode for command in ended]
    assert codes == [0] * count, [command.said[-1000:] for command in ended]
    arrived = values(group)
    for number, command in enumerate(ended):
        repeated = command
        for _ in range(MOST_REPEATED):  # on a slow machine a command gives up before all is logged, and says so
            if NOT_ALL not in repeated.said:
                break
            repeated = sweep(group, number, "task=compare").wait()
        assert repeated.process.returncode == 0, repeated.said[-1000:]
        assert NOT_ALL not in repeated.said, repeated.said[-1000:]
    with capsys.disabled():
        rate = f"{arrived / seconds:.1f} a second"
        print(f"\n{arrived} of {values(group)} values arrived in the {seconds:.0f} s of {count} sweeps at once, {rate}")
    check_runs(group)
    check_values(group)
    check_artifacts(group)
    for path in (path for runs in group.runs for path in runs.parent.rglob("*") if path.is_file()):
        assert PASSWORD.encode() not in path.read_bytes(), path


def values(group: Group) -> int:
    """How many values the database holds."""
    return int(str(group.ask("SELECT count(*) FROM metrics")[0][0]))


def steps_logged(folder: Path) -> int:
    return sum(point.key == "train/l1" for point in read_log(folder).points)


def check_runs(group: Group) -> None:
    """One run a job and one a study, each finished; equal names of two people are runs of their own."""
    names = Counter(group.ask("SELECT name, status FROM runs WHERE lifecycle_stage = 'active'"))
    jobs = {(f"{variant}/seed0", "FINISHED"): FOLDERS * STUDIES for variant in VARIANTS}
    assert names == jobs | {(f"s{s}", "FINISHED"): FOLDERS for s in range(STUDIES)}
    parents = group.ask(
        "SELECT t.value, count(*) FROM tags t JOIN runs r USING (run_uuid) "
        "WHERE t.key = 'mlflow.parentRunId' AND r.lifecycle_stage = 'active' GROUP BY t.value"
    )
    assert [children for _, children in parents] == [len(VARIANTS)] * FOLDERS * STUDIES


def check_values(group: Group) -> None:
    """Every value of every log is there once, and no other of its keys."""
    rows = group.ask(
        "SELECT h.value, r.name, p.value, m.key, m.step, m.value FROM metrics m JOIN runs r USING (run_uuid) "
        "JOIN tags h ON h.run_uuid = m.run_uuid AND h.key = 'mlflow.parentRunId' "
        "JOIN tags p ON p.run_uuid = h.value AND p.key = 'runs' WHERE r.lifecycle_stage = 'active'"
    )
    owners = {(runs / ".owner").read_text(): runs for runs in group.runs}
    names = group.ask("SELECT run_uuid, name FROM runs")
    studies = {run_id: str(name) for run_id, name in names}
    stored = Counter((owners[str(owner)] / studies[p], n, k, s, v) for p, n, owner, k, s, v in rows)
    assert max(stored.values()) == 1
    for training in trainings(group):
        logged = {(point.key, point.step, point.value) for point in read_log(training.folder).points}
        assert {key for key, *_ in logged} >= {"train/l1", "val/psnr_fan_curve"}
        here = {(k, s, v) for study, n, k, s, v in stored if (study, n) == (training.folder.parent, training.name)}
        assert logged <= here
        scalars = dict(training.result["scalars"])
        for file in training.score_files():
            scalars |= read_score(file).scalars
        assert ("test/psnr", 0, scalars["test/psnr"]) in here
        assert {k for k, *_ in here - logged} <= scalars.keys() | {FRAME_TIME}  # the comparison's


def check_artifacts(group: Group) -> None:
    """The files of each job came through the server, and are what is on disk."""
    client = MlflowClient(group.mlflow.uri)
    (experiment,) = client.search_experiments(filter_string="name = 'ablate'")
    assert experiment.artifact_location.startswith("mlflow-artifacts:")
    jobs = client.search_runs([experiment.experiment_id], "tags.kind = 'job'")
    files = [client.download_artifacts(job.info.run_id, "per_image.parquet") for job in jobs]
    frames = Counter(pd.util.hash_pandas_object(pd.read_parquet(file), index=False).sum() for file in files)
    on_disk = []
    for training in trainings(group):
        values = pd.concat([read_score(file).values for file in training.score_files()], ignore_index=True)
        on_disk.append(pd.util.hash_pandas_object(values, index=False).sum())
    assert frames == Counter(on_disk)
    assert not list(group.runs[0].glob("artifacts/*"))
