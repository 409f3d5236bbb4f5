"""Command lines run in the process of a test."""

from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from unittest import mock

from matplotlib.figure import Figure

from ablate.command.compose import jobs_of
from ablate.command.launch import Launch
from ablate.study.job import Job
from ablate.tasks.run_task import run_task
from support.laid_out import empty_database

TINY = ["preset=tiny"]
SWEEP = ["-m", "variant=sa2h,sa2h-att", *TINY]


@cache
def study_group(name: str) -> list[Job]:
    """The jobs of a file of conf/study, composed once for all tests."""
    return jobs_of([f"+study={name}"])


@dataclass(frozen=True)
class TinyStudy:
    """A finished study of two variants in `runs`/tiny-fetal, and what it printed."""

    runs: Path
    printed: str


class Unrendered(Figure):
    """A figure of a comparison that is drawn and saved as empty files; tests/analysis looks at rendered ones."""

    def savefig(self, *_: object, **__: object) -> None:
        pass


def run(*arguments: str) -> int:
    """What `python -m ablate` with these arguments does, and its exit code; a refusal is raised.

    The jobs run in this process, one after another, and what stops one is raised. Figures are not rendered, the contact
    sheet of a data set is not drawn, and a new database of MLflow is a copy of an empty one.
    """
    with (
        mock.patch("ablate.publish.store._make", lambda path: path.write_bytes(empty_database())),
        mock.patch("ablate.analysis.figures.style.Figure", Unrendered),
        mock.patch("ablate.sources.prepare.write_contact_sheet", lambda _, path: path.write_bytes(b"")),
    ):
        return run_task(jobs_of(arguments), Launch(here))


def here(jobs: Sequence[Job], work: Callable[[Job], object]) -> None:
    """In place of a launcher: the jobs one after another, and what stops one is raised."""
    for job in jobs:
        work(job)


def make_tiny_study(runs: Path) -> TinyStudy:
    """Simulate, train and compare SA2H and SA2H-att at the size of conf/preset/tiny.yaml."""
    printed = StringIO()
    with redirect_stdout(printed):
        assert run(*SWEEP, f"runs_dir={runs}") == 0
    return TinyStudy(runs, printed.getvalue())
