"""The campaign of benchmarks/chaos.py: what judges a study, how it is counted, and a short one."""

import importlib
import json
import os
import random
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

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


def result_of(runs: Path) -> Path:
    return runs / "tiny-fetal" / "sa2h" / "seed0" / "result.json"


def score_changed(runs: Path) -> None:
    result = json.loads(result_of(runs).read_text())
    result["scalars"]["test/psnr"] += 1e-12
    result_of(runs).write_text(json.dumps(result))


def value_logged_again(runs: Path) -> None:
    execute(
        runs,
        "INSERT INTO metrics (key, value, timestamp, run_uuid, step, is_nan) "
        "SELECT key, value, timestamp + 1, run_uuid, step, is_nan FROM metrics WHERE key = 'train/l1' LIMIT 1",
    )


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a lost result": (lambda runs: result_of(runs).unlink(), "sa2h/seed0: no result"),
    "an empty result": (lambda runs: result_of(runs).write_text(""), "sa2h/seed0: no result"),
    "another score": (score_changed, "other scores: test/psnr"),
    "lost frames": (lambda runs: result_of(runs).with_name("per_image.parquet").write_bytes(b"PAR1"), "per_image"),
    "a value twice": (value_logged_again, "1 values are logged twice"),
    "a lost value": (lambda runs: execute(runs, "DELETE FROM metrics WHERE key = 'test/mae'"), "2 values are missing"),
    "a run left open": (
        lambda runs: execute(runs, "UPDATE runs SET status = 'RUNNING' WHERE name = 'sa2h/seed0'"),
        "RUN",
    ),
    "a run too many": (lambda runs: execute(runs, "UPDATE runs SET name = 'sa2h/seed0'"), "the runs are"),
    "no comparison": (lambda runs: shutil.rmtree(runs / "tiny-fetal" / "comparison"), "comparison: missing"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_judge_finds_what_is_lost_doubled_or_changed(
    chaos: ModuleType, tiny_study: TinyStudy, tmp_path: Path, fault: str
) -> None:
    differences = importlib.import_module("faults.judge").differences
    runs = tmp_path / "runs"
    shutil.copytree(tiny_study.runs, runs, ignore=shutil.ignore_patterns("data", "artifacts"))
    assert differences(runs, tiny_study.runs) == []
    damage, message = FAULTS[fault]
    damage(runs)
    assert message in " ".join(differences(runs, tiny_study.runs))
    assert chaos


def test_a_campaign_goes_on_where_it_stopped_and_the_page_has_all_its_seeds(
    chaos: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bench, tried = SimpleNamespace(unbroken=None), []

    def tries(_: object, rng: random.Random, number: int) -> Any:
        tried.append((number, rng.random()))
        return chaos.Round([], 2, {"waited, s": float(number)})

    fault = chaos.Fault("tries", "a fault", "nothing is lost", tries, 6, 1)
    monkeypatch.setattr(chaos, "FAULTS", (fault,))
    monkeypatch.setattr(chaos, "KEPT", tmp_path)
    for _ in range(2):  # the second call finds that two rounds are done
        row = chaos.noted(fault, tmp_path / "abc-1")
        chaos.campaign([row], bench, 1, 60.0, 2, tmp_path / "abc-1")
    assert [number for number, _ in tried] == [0, 1]
    chaos.campaign([chaos.noted(fault, tmp_path / "abc-2")], bench, 2, 60.0, None, tmp_path / "abc-2")
    assert [number for number, _ in tried] == [0, 1, 0], "another seed does what the first has left"
    assert len({drawn for _, drawn in tried}) == 3, "each round draws its own numbers, whatever call and seed it is in"

    page = tmp_path / "page.md"
    page.write_text(f"before\n{chaos.BEGIN}\n{chaos.END}\nafter")
    monkeypatch.setattr(chaos, "PAGE", page)
    both, seeds = chaos.of_all_seeds(fault, tmp_path, "abc")
    chaos.write_page([both.cells("abc", seeds)], "")
    complete = page.read_text()
    reached = "3 of 3 rounds as they must be; at most 1.0 waited, s"
    assert f"| 6 of 6 | nothing is lost | {reached} | holds | abc | 1, 2 |" in complete
    chaos.campaign([chaos.noted(fault, tmp_path / "def-1")], bench, 1, 60.0, 1, tmp_path / "def-1")
    newer, seeds = chaos.of_all_seeds(fault, tmp_path, "def")
    assert newer.cells("def", seeds)[1::3] == ("2 of 6", "holds so far")
    chaos.write_page([newer.cells("def", seeds)], "")
    assert page.read_text() == complete, "a complete row stays until the new one is complete"


@pytest.mark.slow
def test_a_short_campaign_finds_nothing_wrong(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "chaos.py"), "--short", "--minutes", "20", "--folder", str(tmp_path)]
    environment = {key: value for key, value in os.environ.items() if key != "MLFLOW_TRACKING_URI"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "holds" in done.stdout
