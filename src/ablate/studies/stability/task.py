"""`task=stability`: try every case, print and keep the table, and fail where a bound is not kept."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from inspect import cleandoc
from pathlib import Path

import pandas as pd
import torch
from tqdm import tqdm

from ablate.studies.preflight import check
from ablate.studies.stability import extremes, losses, maps, metrics, networks, shapes, sound, statistics
from ablate.studies.stability.checks import Case, Check
from ablate.studies.sweep import Job
from ablate.tracking import RunLog, Status, git_state, hardware, open_store, task_run
from ablate.training import chosen_device

COLUMNS = ["case", "dtype", "quantity", "measured", "bound", "holds"]


def all_cases() -> tuple[Case, ...]:
    """Every case: the simulator's, the maps', the networks', the losses', the metrics' and the statistics'."""
    return (
        *sound.CASES, *shapes.CASES, *extremes.CASES, *maps.CASES, *networks.cases(), *losses.CASES, *metrics.CASES,
        *statistics.CASES,
    )  # fmt: skip


def stability(jobs: Sequence[Job]) -> int:
    """Try every case; 1 where one falls, which is named on stderr."""
    check(jobs)
    settings = jobs[0].settings
    folder = settings.runs / "stability"
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # on arrays so small they would wait for each other
    store = open_store(settings.runs, settings.tracking.uri, settings.tracking.experiment)
    run = RunLog(store, task_run(store, "stability", settings.study))
    status = Status.failed
    try:
        cases = all_cases()
        table = _tried(cases, str(chosen_device(settings.training.device)))
        files = _written(table, cases, folder)
        fallen = list(dict.fromkeys(table.loc[~table["holds"], "case"]))
        verdict = f"{len(cases) - len(fallen)} of {len(cases)} cases hold, {len(table)} figures"
        print(f"{_shown(table)}\n\n{verdict}\n", *files, sep="\n")
        for name in fallen:
            print(f"falls: {name}", file=sys.stderr)
        for path in files:
            run.artifact(path)
        run.metrics({"cases": len(cases), "cases_that_hold": len(cases) - len(fallen)})
        run.describe("\n\n".join([verdict, *(f"Falls: {name}" for name in fallen), "The table: Artifacts."]))
        status = Status.failed if fallen else Status.finished
    except KeyboardInterrupt:
        status = Status.killed
        raise
    finally:
        code = {k: v for k, v in git_state(Path(__file__).parent).items() if k != "git_diff"}
        run.tags({"hardware": hardware(), **code})
        run.end(status)
        torch.set_num_threads(threads)
    return int(bool(fallen))


def _tried(cases: Sequence[Case], device: str) -> pd.DataFrame:
    """The table of all figures, with the reasons of their bounds."""
    rows = []
    with tqdm(cases, unit="case", desc="stability") as bar:
        for case in bar:
            bar.set_postfix_str(case.name)
            rows += [{"case": case.name, **vars(c), "holds": c.holds} for c in _checks(case, device)]
    return pd.DataFrame(rows, columns=[*COLUMNS, "why"])


def _checks(case: Case, device: str) -> list[Check]:
    """The figures of a case; an exception is its fall, and so is an overflow that NumPy warns of."""
    done: list[Check] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of scenes of metres, probes in bone
        warnings.simplefilter("error", RuntimeWarning)
        try:
            done.extend(case.checks(device))
        except Exception as error:
            done.append(Check("", f"{type(error).__name__}: {error}", float("nan"), 0, "A case runs to its end."))
    return done


def _written(table: pd.DataFrame, tried: Sequence[Case], folder: Path) -> list[Path]:
    """The table as CSV, and in Markdown with what each case tries and where each bound comes from."""
    folder.mkdir(parents=True, exist_ok=True)
    csv, pages = folder / "stability.csv", folder / "stability.md"
    table[COLUMNS].to_csv(csv, index=False)
    text = ["# Numerical stability on stiff and extreme cases"]
    for case in tried:
        text += [f"## {case.name}", cleandoc(case.about), "\n".join(_markdown(table[table["case"] == case.name]))]
    pages.write_text("\n\n".join(text) + "\n")
    return [csv, pages]


def _markdown(rows: pd.DataFrame) -> list[str]:
    columns = [*COLUMNS[1:], "why"]
    cells = [
        [str(row[c]) if isinstance(row[c], str | bool) else f"{row[c]:.3g}" for c in columns]
        for row in rows.to_dict("records")
    ]
    lines = [columns, ["---"] * len(columns), *cells]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines]


def _shown(table: pd.DataFrame) -> str:
    """Of each case and type the figure that uses most of its bound, and all that fall."""
    used = (table["measured"] / table["bound"].where(table["bound"] > 0, float("inf"))).fillna(float("inf"))
    nearest = used.groupby([table["case"], table["dtype"]], sort=False).idxmax()
    rows = table.loc[sorted({*nearest, *table.index[~table["holds"]]}), COLUMNS].copy()
    for name in ("case", "dtype", "quantity"):
        rows[name] = rows[name].str.ljust(rows[name].str.len().max())
    return rows.to_string(index=False, justify="left", formatters=dict.fromkeys(("measured", "bound"), "{:.3g}".format))
