"""The campaign of benchmarks/chaos.py: what judges a study, how it is counted, and a short one."""

import importlib
import os
import random
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from support.studies import TinyStudy

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def chaos(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("chaos")


def execute(runs: Path, statement: str) -> None:
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection, connection:
        assert connection.execute(statement).rowcount > 0


def folder_in(runs: Path) -> Path:
    """The training of SA2H."""
    (folder,) = (runs / "tiny-fetal").glob("sa2h-seed0-*")
    return folder


def mae_of(runs: Path) -> Path:
    (score,) = folder_in(runs).glob("scores/mae@*.parquet")
    return score


def score_changed(runs: Path) -> None:
    table = pd.read_parquet(mae_of(runs))
    table.assign(value=table["value"] + 1e-12).to_parquet(mae_of(runs))


def value_logged_again(runs: Path) -> None:
    execute(
        runs,
        "INSERT INTO metrics (key, value, timestamp, run_uuid, step, is_nan) "
        "SELECT key, value, timestamp + 1, run_uuid, step, is_nan FROM metrics JOIN runs USING (run_uuid) "
        "WHERE key = 'train/l1' AND lifecycle_stage = 'active' LIMIT 1",
    )


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a lost result": (
        lambda runs: (folder_in(runs) / "trained.json").unlink(),
        "trained.json: missing, added or another",
    ),
    "an empty result": (
        lambda runs: (folder_in(runs) / "trained.json").write_text(""),
        "trained.json: missing, added or another",
    ),
    "another score": (score_changed, "parquet: missing, added or another"),
    "a lost score": (lambda runs: mae_of(runs).unlink(), "parquet: missing, added or another"),
    "lost frames": (lambda runs: mae_of(runs).write_bytes(b"PAR1"), "parquet"),
    "a value twice": (value_logged_again, "1 values are there twice"),
    "a lost value": (
        lambda runs: execute(runs, "DELETE FROM metrics WHERE key = 'test/mae'"),
        "3 values are missing or others",
    ),
    "a run left open": (
        lambda runs: execute(runs, "UPDATE runs SET status = 'RUNNING' WHERE name = 'sa2h/seed0'"),
        "RUN",
    ),
    "a run too many": (lambda runs: execute(runs, "UPDATE runs SET name = 'sa2h/seed0'"), "the runs are"),
    "no comparison": (lambda runs: shutil.rmtree(runs / "tiny-fetal" / "comparison"), "paired.csv: missing"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_judge_finds_what_is_lost_doubled_or_changed(
    chaos: ModuleType, tiny_study: TinyStudy, tmp_path: Path, fault: str
) -> None:
    differences = sys.modules[chaos.Bench.__module__].differences
    runs = tmp_path / "runs"
    shutil.copytree(tiny_study.runs, runs, ignore=shutil.ignore_patterns("data", "artifacts"))
    assert differences(runs, tiny_study.runs) == []
    damage, message = FAULTS[fault]
    damage(runs)
    assert message in " ".join(differences(runs, tiny_study.runs))


def test_a_campaign_takes_turns_and_counts_the_rounds_in_which_something_was_wrong(
    chaos: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[float] = []

    def every_second_fails(_: object, rng: random.Random, number: int) -> list[str]:
        drawn.append(rng.random())
        return ["a lost run"] * (number % 2)

    faults = {name: chaos.Fault(f"fault {name}", "nothing is lost", every_second_fails) for name in ("a", "b")}
    monkeypatch.setattr(chaos, "FAULTS", faults)
    found = chaos.campaign(["a", "b"], None, seed=1, seconds=60.0, rounds=3)
    assert found == {name: [[], ["a lost run"], []] for name in ("a", "b")}
    assert len(set(drawn)) == 6, "each round draws its own numbers"
    assert "| fault b | nothing is lost | 2 of 3 |" in chaos.table(found)


@pytest.mark.slow
def test_a_short_campaign_finds_nothing_wrong(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "chaos.py"), "--only", "kill,twice,damage", "--rounds", "1"]
    environment = {key: value for key, value in os.environ.items() if key != "MLFLOW_TRACKING_URI"}
    done = subprocess.run(
        [*command, "--folder", str(tmp_path)], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("1 of 1") == 3
