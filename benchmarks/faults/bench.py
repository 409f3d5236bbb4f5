"""What the faults of the campaign share: a tiny study, the folders that it runs in, the rounds that are counted."""

import random
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from faults.commands import Start, ablate, start

VARIANTS = ("sa2h", "sa2h-att")
STEPS = 40
STUDY = "tiny-fetal"
# A sweep of two jobs, as small as the tests have them; a study group would cost more and break no other way.
SWEEP = (
    *("-m", f"variant={','.join(VARIANTS)}", "preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10"),
    *(f"training.steps={STEPS}", "training.checkpoint_every=5", "training.validate_every=20", "training.log_every=1"),
    *("evaluation.pictures=1", "evaluation.timed_frames=1", "metrics=[psnr,mae]"),
)
LAUNCHERS = {"basic": ("hydra/launcher=basic",), "processes": ("hydra.launcher.n_jobs=2",)}


@dataclass(frozen=True)
class Round:
    """What a round did and found.

    Attributes
    ----------
    wrong : list of str
        What was not as it must be, a line each.
    count : int
        How often the fault was tried in it; 0 where it came too late, as a kill after the end.
    largest : mapping of str to float
        What was measured, by its name with the unit; the table shows the largest.
    is_last : bool
        Whether there is nothing left to try.
    """

    wrong: list[str]
    count: int = 1
    largest: Mapping[str, float] = field(default_factory=dict)
    is_last: bool = False


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Attributes
    ----------
    name : str
        As `--only` takes it.
    what, must_reach : str
        First and third column.
    round : callable
        Takes the bench, a source of random numbers and the number of the round.
    wanted : int
        How often the fault is tried in a whole campaign, and with `--short`.
    """

    name: str
    what: str
    must_reach: str
    round: "Callable[[Bench, random.Random, int], Round]"
    wanted: int
    short: int


class Bench:
    """Folders for the rounds of a campaign, and the study that no fault has touched."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seconds = self.database_seconds = 0.0  # of an unbroken study; of the making of a database
        self._made = 0

    def place(self) -> Path:
        """A new empty folder."""
        self._made += 1
        made = self.folder / f"round{self._made}"
        made.mkdir(parents=True)
        return made

    def runs(self, database: bool = True) -> Path:
        """A new folder of runs that has pairs and, unless it is to be made, an empty database."""
        runs = self.place() / "runs"
        shutil.copytree(self.unbroken / "data", runs / "data")
        if database:
            shutil.copy(self._empty_database, runs / "mlflow.db")
        return runs

    def copy(self) -> Path:
        """A copy of the unbroken study's folder of runs."""
        return Path(shutil.copytree(self.unbroken, self.place() / "runs"))

    @cached_property
    def unbroken(self) -> Path:
        """The folder of runs of a sweep that nothing has disturbed."""
        runs = self.folder / "unbroken" / "runs"
        runs.mkdir(parents=True)
        started = time.monotonic()
        ended = ablate([*SWEEP, f"runs_dir={runs}"], runs.parent, Start.cold).wait()
        self.seconds = time.monotonic() - started
        if ended.code:
            raise RuntimeError(f"the unbroken study failed:\n{ended.said}")
        return runs

    @cached_property
    def _empty_database(self) -> Path:
        folder = self.folder / "empty"
        folder.mkdir(parents=True)
        ended = start(make_database, (folder,), folder).wait()
        if ended.code:
            raise RuntimeError(f"no database could be made:\n{ended.said}")
        return folder / "mlflow.db"


def make_database(runs: Path) -> None:
    """Make the default store in a folder of runs, with its experiment."""
    from ablate.tracking import open_store

    open_store(runs, None, "ablate")
