"""A server for a group as docs/cluster.md has it: PostgreSQL, artifacts through the server, user and password."""

from __future__ import annotations

import importlib
import json
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import requests
from ablate.tracking.local_log import points, read_log
from mlflow import MlflowClient

from ablate.metrics.metric import FRAME_TIME
from support.servers import Mlflow, Postgres, new_postgres, why_no_postgres
from support.studies import run

if TYPE_CHECKING:
    from faults import Command

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(why_no_postgres()), reason=why_no_postgres())]

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
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
    ablate: Callable[..., Command]

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
            patch.syspath_prepend(str(BENCHMARKS))
            ablate = importlib.import_module("faults").ablate
            runs = tuple(place / f"person{k}" / "runs" for k in range(FOLDERS))
            assert run(*SWEEP, f"runs_dir={runs[0]}", "task=simulate") == 0
            for folder in runs[1:]:
                shutil.copytree(runs[0] / "data", folder / "data")
            yield Group(postgres, mlflow, runs, ablate)
        finally:
            mlflow.kill()


def sweep(group: Group, number: int, *more: str) -> Command:
    """Start a sweep of a person, in a process of its own."""
    runs = group.runs[number % FOLDERS]
    line = [*SWEEP, f"study_name=s{number // FOLDERS}", f"runs_dir={runs}", f"tracking.uri={group.mlflow.uri}", *more]
    user = {"MLFLOW_TRACKING_USERNAME": USER, "MLFLOW_TRACKING_PASSWORD": PASSWORD}
    return group.ablate(line, runs.parent, environment=user)


def folders(group: Group) -> list[Path]:
    """The folders of all jobs."""
    return [runs / f"s{s}" / v / "seed0" for runs in group.runs for s in range(STUDIES) for v in VARIANTS]


def test_eight_sweeps_at_once_lose_and_double_nothing_though_the_database_is_killed_in_between(
    group: Group, capsys: pytest.CaptureFixture[str]
) -> None:
    count = FOLDERS * STUDIES
    began = time.monotonic()
    running = [sweep(group, number) for number in range(count)]
    while not any(steps_logged(folder) > STEPS // 2 for folder in folders(group)):
        assert all(command.is_alive for command in running), [command.said[-1000:] for command in running]
        time.sleep(0.1)
    group.postgres.kill()
    time.sleep(DOWN_S)
    group.postgres.up()
    ended = [command.wait() for command in running]
    seconds = time.monotonic() - began
    assert [each.code for each in ended] == [0] * count, [each.said[-1000:] for each in ended if each.code]
    arrived = values(group)
    for number, command in enumerate(ended):
        repeated = command
        for _ in range(MOST_REPEATED):  # on a slow machine a command gives up before all is logged, and says so
            if NOT_ALL not in repeated.said:
                break
            repeated = sweep(group, number, "task=compare").wait()
        assert repeated.code == 0, repeated.said[-1000:]
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
    lines, _ = read_log(folder)
    return sum(point.key == "train/l1" for point in points(lines))


def check_runs(group: Group) -> None:
    """One run a job and one a study, each finished; equal names of two people are runs of their own."""
    names = Counter(group.ask("SELECT name, status FROM runs WHERE lifecycle_stage = 'active'"))
    jobs = {(f"{variant}/seed0", "FINISHED"): FOLDERS * STUDIES for variant in VARIANTS}
    assert names == jobs | {(f"s{s}", "FINISHED"): FOLDERS for s in range(STUDIES)}
    parents = group.ask("SELECT value, count(*) FROM tags WHERE key = 'mlflow.parentRunId' GROUP BY value")
    assert [children for _, children in parents] == [len(VARIANTS)] * FOLDERS * STUDIES


def check_values(group: Group) -> None:
    """Every value of every log is there once, and no other of its keys."""
    rows = group.ask(
        "SELECT h.value, r.name, p.value, m.key, m.step, m.value FROM metrics m JOIN runs r USING (run_uuid) "
        "JOIN tags h ON h.run_uuid = m.run_uuid AND h.key = 'mlflow.parentRunId' "
        "JOIN tags p ON p.run_uuid = h.value AND p.key = 'runs'"
    )
    owners = {(runs / ".owner").read_text(): runs for runs in group.runs}
    studies = dict(group.ask("SELECT run_uuid, name FROM runs"))
    stored = Counter((owners[str(owner)] / str(studies[p]) / str(n), k, s, v) for p, n, owner, k, s, v in rows)
    assert max(stored.values()) == 1
    for folder in folders(group):
        lines, _ = read_log(folder)
        logged = {(point.key, point.step, point.value) for point in points(lines)}
        assert {key for key, *_ in logged} >= {"train/l1", "val/psnr_fan_curve"}
        here = {(k, s, v) for place, k, s, v in stored if place == folder}
        assert logged <= here
        scores = json.loads((folder / "result.json").read_text())["scalars"]
        assert ("test/psnr", 0, scores["test/psnr"]) in here
        assert {k for k, *_ in here - logged} <= scores.keys() | {FRAME_TIME}  # the comparison's


def check_artifacts(group: Group) -> None:
    """The files of each job came through the server, and are what is on disk."""
    client = MlflowClient(group.mlflow.uri)
    (experiment,) = client.search_experiments(filter_string="name = 'ablate'")
    assert experiment.artifact_location.startswith("mlflow-artifacts:")
    jobs = client.search_runs([experiment.experiment_id], "tags.kind = 'job'")
    frames = {Path(client.download_artifacts(r.info.run_id, "per_image.parquet")).read_bytes() for r in jobs}
    assert frames == {(folder / "per_image.parquet").read_bytes() for folder in folders(group)}
    assert not list(group.runs[0].glob("artifacts/*"))
