"""`task=stability`: run every case, print and store the table, and fail if an error exceeds its bound."""

import sys
import warnings
from collections.abc import Sequence
from inspect import cleandoc
from pathlib import Path

import pandas as pd
import torch
from tqdm import tqdm

from ablate.numerics.stability import extremes, losses, maps, metrics, networks, shapes, sound, statistics
from ablate.numerics.stability.checks import Case, Check
from ablate.runs.job import Job
from ablate.runs.store_copy import open_store
from ablate.storage import write_text, written_whole
from ablate.tracking import Status, git_state, hardware, recorded_task
from ablate.training import chosen_device

COLUMNS = ["case", "dtype", "quantity", "measured", "bound", "holds"]


def all_cases() -> tuple[Case, ...]:
    """List the cases of the simulator, the maps, the networks, the losses, the metrics and the statistics."""
    return (
        *sound.CASES, *shapes.CASES, *extremes.CASES, *maps.CASES, *networks.cases(), *losses.CASES, *metrics.CASES,
        *statistics.CASES,
    )  # fmt: skip


def stability(jobs: Sequence[Job]) -> int:
    """Run every case; return 1 if one fails, and name it on stderr."""
    settings = jobs[0].settings
    folder = settings.results / "stability"
    code = {k: v for k, v in git_state().items() if k != "git_diff"}
    with recorded_task(folder, settings.study, lambda: open_store(settings)) as record:
        record.tags |= {"hardware": hardware(), **code}
        cases = all_cases()
        table = _tried(cases, str(chosen_device(settings.training.device)))
        files = _written(table, cases, folder)
        fallen = list(dict.fromkeys(table.loc[~table["holds"], "case"]))
        verdict = f"{len(cases) - len(fallen)} of {len(cases)} cases hold, {len(table)} figures"
        print(f"{_shown(table)}\n\n{verdict}\n", *files, sep="\n")
        for name in fallen:
            print(f"falls: {name}", file=sys.stderr)
        record.files += files
        record.scores |= {"cases": len(cases), "cases_that_hold": len(cases) - len(fallen)}
        record.description = "\n\n".join([verdict, *(f"Falls: {name}" for name in fallen), "The table: Artifacts."])
        record.status = Status.failed if fallen else Status.finished
    return int(bool(fallen))


def _tried(cases: Sequence[Case], device: str) -> pd.DataFrame:
    """Make the table of all errors, with the reasons of their bounds."""
    rows = []
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the arrays are too small for several
    with tqdm(cases, unit="case", desc="stability") as bar:
        for case in bar:
            bar.set_postfix_str(case.name)
            rows += [{"case": case.name, **vars(c), "holds": c.holds} for c in _checks(case, device)]
    torch.set_num_threads(threads)
    return pd.DataFrame(rows, columns=[*COLUMNS, "why"])


def _checks(case: Case, device: str) -> list[Check]:
    """Run a case; an exception, or an overflow that NumPy warns of, is its failure."""
    done: list[Check] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about scenes of metres and probes in bone
        warnings.simplefilter("error", RuntimeWarning)
        try:
            done.extend(case.checks(device))
        except Exception as error:
            done.append(Check("", f"{type(error).__name__}: {error}", float("nan"), 0, "A case raises no exception."))
    return done


def _written(table: pd.DataFrame, tried: Sequence[Case], folder: Path) -> list[Path]:
    """Write the table as CSV, and as Markdown with what each case tries and the reason of each bound."""
    folder.mkdir(parents=True, exist_ok=True)
    csv, pages = folder / "stability.csv", folder / "stability.md"
    with written_whole(csv) as partial:
        table[COLUMNS].to_csv(partial, index=False)
    text = ["# Numerical stability on stiff and extreme cases"]
    for case in tried:
        text += [f"## {case.name}", cleandoc(case.about), "\n".join(_markdown(table[table["case"] == case.name]))]
    write_text(pages, "\n\n".join(text) + "\n")
    return [csv, pages]


def _markdown(rows: pd.DataFrame) -> list[str]:
    columns = [*COLUMNS[1:], "why"]
    shown = rows[columns].map(lambda cell: f"{cell:.3g}" if isinstance(cell, float) else str(cell))
    lines = [columns, ["---"] * len(columns), *shown.to_numpy().tolist()]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines]


def _shown(table: pd.DataFrame) -> str:
    """Print, for each case and type, the error nearest to its bound, and all that exceed it."""
    used = (table["measured"] / table["bound"].where(table["bound"] > 0, float("inf"))).fillna(float("inf"))
    nearest = used.groupby([table["case"], table["dtype"]], sort=False).idxmax()
    rows = table.loc[sorted({*nearest, *table.index[~table["holds"]]}), COLUMNS].copy()
    for name in ("case", "dtype", "quantity"):
        rows[name] = rows[name].str.ljust(rows[name].str.len().max())
    return rows.to_string(index=False, justify="left", formatters=dict.fromkeys(("measured", "bound"), "{:.3g}".format))
