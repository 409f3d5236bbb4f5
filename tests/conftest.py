"""What the tests of several rooms share."""

from __future__ import annotations

import gc
import logging
import os
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch

if TYPE_CHECKING:
    from collections.abc import Iterator

    from support.studies import TinyStudy

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
torch.set_num_threads(1)
gc.set_threshold(100_000, 50, 100)  # looking for garbage took 7 % of the time of tests that compose
_STARTED = time.monotonic()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seconds", type=float, help="skip tests that would start later (`make quick`)")


def pytest_runtest_setup(item: pytest.Item) -> None:
    seconds = item.config.getoption("--seconds")
    if seconds is not None and time.monotonic() - _STARTED > seconds:
        pytest.skip(f"starts after {seconds:g} s")


@pytest.fixture(autouse=True)
def _no_handler_left() -> Iterator[None]:
    """Hydra logs to the stream of the test that called it; one that stays writes to a closed stream in the next."""
    root = logging.getLogger()
    before = root.handlers[:]
    yield
    for handler in root.handlers[:]:
        if handler not in before and type(handler) is logging.StreamHandler:
            root.removeHandler(handler)


@pytest.fixture(scope="session")
def cases() -> Path:
    """Scene folders made by others; they are not part of the project, and tests that need them skip without."""
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("ABLATE_CASES", root.parent / "shared" / "cases"))
    if not folder.is_dir():
        pytest.skip(f"no scene folders at {folder}; ABLATE_CASES names another place")
    return folder


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MLflow's SQLite file without a run, to be copied to `mlflow.db`."""
    from support.laid_out import empty_database

    path = tmp_path_factory.mktemp("database") / "mlflow.db"
    path.write_bytes(empty_database())
    return path


@pytest.fixture
def runs(empty_database: Path, tmp_path: Path) -> Path:
    """A folder for runs with an empty database."""
    folder = tmp_path / "runs"
    folder.mkdir()
    shutil.copy(empty_database, folder)
    return folder


@pytest.fixture(scope="session")
def tiny_study(tmp_path_factory: pytest.TempPathFactory) -> TinyStudy:
    """A finished study for tests that read one; what a test changes of it, it puts back."""
    from support.studies import make_tiny_study  # imports every room

    return make_tiny_study(tmp_path_factory.mktemp("tiny_study"))
