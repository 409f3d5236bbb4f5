"""The stiff cases hold, each by itself; `task=stability` writes and logs them, and fails by name."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mlflow import MlflowClient

from ablate.numerics.stability import task
from ablate.numerics.stability.checks import CASES, Case, Checks
from ablate.numerics.stability.checks import run as run_case
from ablate.ultrasound import attenuation
from support.studies import run as run_command

LONG = (
    *("250 surfaces of R_p = 0.1, 0.5 mm apart", "254 tissues, and one more", "constant maps through the generators"),
    *("sa2h-depth in bf16, float32 and float64", "lsa2h in bf16, float32 and float64", "lambda 0"),
)
CHEAP = ("A: soft tissue behind 2200 dB", "A: one line, one sample, no loss", "grazing incidence, by the formulas")


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=name, marks=[pytest.mark.slow] * (name in LONG)) for name, case in CASES.items()],
)
def test_every_error_is_within_its_bound(case: Case) -> None:
    checks = run_case(case, "cpu")
    assert checks
    assert [check for check in checks if not check.holds] == []
    assert case[0].__doc__, "what is tried is told"


def test_long_cases_are_cases() -> None:
    assert {*LONG} <= {*CASES}


def test_no_module_of_cases_is_forgotten() -> None:
    modules = {measure.__module__.rpartition(".")[2] for measure, _ in CASES.values()}
    assert modules == {"extremes", "metrics", "networks", "shapes", "sound"}


def test_what_is_not_a_number_does_not_hold() -> None:
    checks = Checks("cpu")
    checks.add("not a number", float("nan"), 1.0, "")
    checks.add("its bound", 1.0, 1.0, "")
    checks.finite(np.array([1.0, np.inf]))
    checks.refused(lambda: int("x"))
    checks.refused(lambda: None)
    assert [check.holds for check in checks.added] == [False, True, False, True, False]


@pytest.fixture
def cheap(monkeypatch: pytest.MonkeyPatch) -> dict[str, Case]:
    """A few cases that take no time; what a test adds is tried too."""
    chosen = {name: CASES[name] for name in CHEAP}
    monkeypatch.setattr(task, "CASES", chosen)
    return chosen


def run(runs: Path) -> tuple[int, pd.DataFrame]:
    code = run_command("task=stability", f"runs_dir={runs}")
    return code, pd.read_csv(runs / "stability" / "stability.csv", keep_default_na=False)


def logged(runs: Path) -> tuple[str, dict[str, float], set[str]]:
    """Status, metrics and artifacts of the last run named `stability`."""
    client = MlflowClient(f"sqlite:///{runs / 'mlflow.db'}")
    named = "attributes.run_name = 'stability'"
    last, *_ = client.search_runs(["1"], named, order_by=["attributes.start_time DESC"])
    names = {a.path for a in client.list_artifacts(last.info.run_id)}
    return last.info.status, last.data.metrics, names


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder, and one tracking store, for every run of the task."""
    return tmp_path_factory.mktemp("runs")


@pytest.mark.usefixtures("cheap")
def test_the_table_is_printed_written_and_logged(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, table = run(runs)
    assert code == 0
    assert list(table.columns) == ["case", "dtype", "quantity", "measured", "bound", "holds"]
    assert set(table["case"]) == set(CHEAP)
    assert (table["measured"].astype(float) <= table["bound"].astype(float)).all()
    shown = capsys.readouterr()
    assert f"{len(CHEAP)} of {len(CHEAP)} cases hold" in shown.out
    assert all(name in shown.out for name in CHEAP)
    assert "falls" not in shown.err
    pages = (runs / "stability" / "stability.md").read_text()
    assert all(f"## {name}\n\n{CASES[name][0].__doc__}" in pages for name in CHEAP)
    assert logged(runs) == ("FINISHED", {"cases": 3, "cases_that_hold": 3}, {"stability.csv", "stability.md"})


@pytest.mark.usefixtures("cheap")
def test_a_fault_fells_its_case_by_name(
    runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sums of thousands of nepers in float32: the tissue behind loses its own."""

    def in_float32(labels: np.ndarray, nepers: np.ndarray, total: np.ndarray, begin: int, end: int) -> None:
        total[begin:end] = np.cumsum(nepers.astype(np.float32)[labels[begin:end]], axis=1, dtype=np.float32)

    monkeypatch.setattr(attenuation, "_add_up", in_float32)
    code, table = run(runs)
    assert code == 1
    assert capsys.readouterr().err.splitlines()[-1] == f"falls: {CHEAP[0]}"
    assert set(table.loc[~table["holds"], "case"]) == {CHEAP[0]}
    assert logged(runs)[:2] == ("FAILED", {"cases": 3, "cases_that_hold": 2})


def test_an_exception_is_the_fall_of_its_case_alone(
    cheap: dict[str, Case], runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def breaks(_: Checks) -> None:
        """Breaks."""
        raise ZeroDivisionError("no reason")

    def overflows(checks: Checks) -> None:
        """Overflows, of which NumPy only warns."""
        checks.finite(np.float64(1e308) * np.ones(2) * 10)

    cheap |= {"breaks": (breaks, ()), "overflows": (overflows, ())}
    code, table = run(runs)
    assert code == 1
    assert capsys.readouterr().err.splitlines()[-2:] == ["falls: breaks", "falls: overflows"]
    (what,) = table.loc[table["case"] == "breaks", "quantity"]
    assert what == "ZeroDivisionError: no reason"
    assert set(table.loc[table["holds"], "case"]) == set(CHEAP)
