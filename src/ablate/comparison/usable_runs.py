"""Choose the runs of a study that can be compared with each other, and say which are left aside and why."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from ablate.analysis import REFERENCE, listed
from ablate.comparison.blocks import check_pixels, factors_of, is_block
from ablate.runs.run import Run, State, runs_of


@dataclass(frozen=True)
class UsableRuns:
    """Finished runs of a study.

    Attributes
    ----------
    runs : tuple of Run
        On the same pairs, so that they can be compared frame by frame.
    blocks : tuple of Run
        On pairs that differ from these in the anatomy, or in a component. They take part in the effects of components.
    notes : tuple of str
        What was left aside, a sentence each; for the report.
    """

    runs: tuple[Run, ...]
    blocks: tuple[Run, ...]
    notes: tuple[str, ...]

    @property
    def all(self) -> tuple[Run, ...]:
        return (*self.runs, *self.blocks)


def usable_runs(study_dir: Path, reference: str = REFERENCE) -> UsableRuns:
    """Read the finished runs of a study, `<label>/seed<k>/`. A run that cannot be used is left aside.

    Of runs on different pairs those on the reference's are taken, or else on the pairs that most runs have; and as
    blocks those on pairs that differ from them only in the anatomy or in components. Runs on pairs of one recipe with
    other pixels are a ConfigurationError.
    """
    runs: list[Run] = []
    aside: dict[str, list[str]] = {}
    for run in runs_of(study_dir):
        if run.state is State.finished:
            runs.append(run)
        else:
            reason = "not finished" if run.why in ("", "not finished") else f"left aside, {run.why}"
            aside.setdefault(reason, []).append(run.name)
    notes = [f"{_counted(names)} {reason}: {listed(names)}." for reason, names in aside.items()]
    check_pixels(runs)
    blocks: list[Run] = []
    if runs:
        of_reference = [run for run in runs if run.label == reference]
        chosen = Counter(run.data for run in of_reference or runs).most_common(1)[0][0]
        others = [run for run in runs if run.data != chosen]
        factors = factors_of(runs)
        runs = [run for run in runs if run.data == chosen]
        blocks = [run for run in others if is_block(run, runs[0], factors)]
        if names := [run.name for run in others if run not in blocks]:
            notes.append(f"{_counted(names)} left aside, made from other pairs than {chosen}: {listed(names)}.")
        if names := [run.name for run in blocks]:
            takes = "takes" if len(names) == 1 else "take"
            notes.append(
                f"{_counted(names)} on another anatomy or data set than {chosen} {takes} part in effects and verdicts "
                f"only: {listed(names)}."
            )
    return UsableRuns(tuple(runs), tuple(blocks), tuple(notes))


def _counted(names: list[str]) -> str:
    return f"{len(names)} run{'' if len(names) == 1 else 's'}"
