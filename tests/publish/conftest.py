"""A study that was really trained, stopped once; figures are a subject of other rooms."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from ablate.command.compose import jobs_of
from ablate.publish import publish_study, waiting
from ablate.study.compare import compare_study
from ablate.study.job import Job
from ablate.study.run import listed_runs
from ablate.study.work import log_samples
from ablate.tasks.study import run_job

TINY = ["preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10", "metrics=[psnr,mae]"]
TINY += ["training.steps=4", "training.validate_every=1", "training.log_every=1", "study_name=study"]


@pytest.fixture(autouse=True)
def nothing_said() -> None:
    """What is said once a process is said once a test."""
    waiting._SAID.clear()


@contextmanager
def undrawn() -> Iterator[None]:
    with (
        mock.patch("ablate.study.compare.draw_figures", return_value=[]),
        mock.patch("ablate.sources.prepare.write_contact_sheet", lambda _, path: path.write_bytes(b"")),
    ):
        yield


@pytest.fixture(autouse=True, scope="module")
def no_figures() -> Iterator[None]:
    with undrawn():
        yield


@pytest.fixture(scope="session")
def stopped_once(tmp_path_factory: pytest.TempPathFactory, empty_database: Path) -> Job:
    """A job that was stopped at step 3 of 4, one after its checkpoint, and then finished; and its comparison."""
    with undrawn():
        runs = tmp_path_factory.mktemp("stopped") / "runs"
        runs.mkdir()
        shutil.copy(empty_database, runs)
        (job,) = jobs_of(["variant=sa2h", f"runs_dir={runs}", *TINY])

        def power_cut(*arguments: Any) -> None:
            log_samples(*arguments)
            if arguments[-1] == 3:
                raise RuntimeError("power cut")

        with (
            mock.patch("ablate.study.work.log_samples", power_cut),
            pytest.raises(RuntimeError, match="power cut"),
        ):
            run_job(job)
        run_job(job)
        compared = compare_study(listed_runs([job]), "study")
        assert "Note" not in publish_study(job.settings, compared.study, compared.notes)
    return job
