"""`task=stability`: run every case, print and store the table, and fail if an error exceeds its bound."""

import sys
from collections.abc import Sequence
from importlib.resources import files
from inspect import getdoc
from pathlib import Path

import pandas as pd
from jinja2 import Template
from tqdm import tqdm

from ablate.numerics.stability import extremes, metrics, networks, shapes, sound  # noqa: F401 (their cases)
from ablate.numerics.stability.checks import CASES, run
from ablate.publish import published_task
from ablate.storage import write_text
from ablate.study.job import Job
from ablate.study.log import Status
from ablate.training import chosen_device

COLUMNS = ["case", "dtype", "quantity", "measured", "bound", "holds"]


def stability(jobs: Sequence[Job]) -> int:
    """Run every case; return 1 if one fails, and name it on stderr."""
    settings = jobs[0].settings
    folder = settings.results / "stability"
    with published_task(settings, folder) as view:
        device = str(chosen_device(settings.training.device))
        rows = []
        with tqdm(CASES.items(), unit="case", desc="stability", disable=None) as bar:
            for name, case in bar:
                bar.set_postfix_str(name)
                rows += [{"case": name, **vars(check), "holds": check.holds} for check in run(case, device)]
        table = pd.DataFrame(rows, columns=[*COLUMNS, "why"])
        files = _written(table, folder)
        fallen = list(table.loc[~table["holds"], "case"].unique())
        verdict = f"{len(CASES) - len(fallen)} of {len(CASES)} cases hold, {len(table)} figures"
        print(f"{_shown(table)}\n\n{verdict}\n", *files, sep="\n")
        for name in fallen:
            print(f"falls: {name}", file=sys.stderr)
        view.scores |= {"cases": len(CASES), "cases_that_hold": len(CASES) - len(fallen)}
        view.description = "\n\n".join([verdict, *(f"Falls: {name}" for name in fallen), "The table: Artifacts."])
        view.status = Status.failed if fallen else Status.finished
    return int(bool(fallen))


def _written(table: pd.DataFrame, folder: Path) -> list[Path]:
    """Write the table as CSV, and as Markdown with what each case tries and the reason of each bound."""
    folder.mkdir(parents=True, exist_ok=True)
    csv = folder / "stability.csv"
    pages = folder / "stability.md"
    write_text(csv, table[COLUMNS].to_csv(index=False))
    head = [*COLUMNS[1:], "why"]
    names = dict.fromkeys(table["case"])
    cells = table[head].map(lambda cell: f"{cell:.3g}" if isinstance(cell, float) else str(cell).replace("|", r"\|"))
    cases = [(name, getdoc(CASES[name][0]), cells[table["case"] == name].to_numpy()) for name in names]
    page = Template(files("ablate.numerics.stability").joinpath("stability.md.jinja").read_text("utf-8"))
    write_text(pages, page.render(cases=cases, head=head) + "\n")
    return [csv, pages]


def _shown(table: pd.DataFrame) -> str:
    """Print, for each case and type, the error nearest to its bound, and all that exceed it."""
    used = (table["measured"] / table["bound"].where(table["bound"] > 0, float("inf"))).fillna(float("inf"))
    nearest = used.groupby([table["case"], table["dtype"]], sort=False).idxmax()
    rows = table.loc[sorted({*nearest, *table.index[~table["holds"]]}), COLUMNS].copy()
    for name in ("case", "dtype", "quantity"):
        rows[name] = rows[name].str.ljust(rows[name].str.len().max())
    return rows.to_string(index=False, justify="left", formatters=dict.fromkeys(("measured", "bound"), "{:.3g}".format))
