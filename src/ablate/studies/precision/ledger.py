"""A table on disk that grows as it is measured."""

from __future__ import annotations

import csv
from pathlib import Path

import pandas as pd


class Ledger:
    """A CSV file to which rows are added one at a time: what was measured outlives an interruption.

    Parameters
    ----------
    path : Path
        Replaced.
    columns : str
        Names, separated by spaces.
    """

    def __init__(self, path: Path, columns: str) -> None:
        self.path, self.columns = path, columns.split()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._write("w", self.columns)

    def add(self, *values: object) -> None:
        """Add one row, in the order of the columns."""
        if len(values) != len(self.columns):
            raise ValueError(f"{self.path.name}: {len(values)} values for the columns {', '.join(self.columns)}")
        self._write("a", values)

    def table(self) -> pd.DataFrame:
        """All rows so far, names and settings as text."""
        return pd.read_csv(self.path, dtype={"setting": str}, keep_default_na=False, na_values=["nan"])

    def _write(self, mode: str, row: object) -> None:
        with self.path.open(mode, newline="") as file:
            csv.writer(file).writerow(row)  # type: ignore[arg-type]
