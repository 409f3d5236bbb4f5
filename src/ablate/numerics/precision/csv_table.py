"""A table on disk to which measurements are added one at a time."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import pandas as pd


class CsvTable:
    """A CSV file that is written row by row, so that an interruption keeps what was measured.

    `columns` are names separated by spaces. An existing file is replaced.
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

    def add_each(self, *first: object, values: Mapping[str, float]) -> None:
        """Add one row for each value: the first columns, its name and the value."""
        for name, value in values.items():
            self.add(*first, name, value)

    def table(self) -> pd.DataFrame:
        """Read all rows; names and settings are text."""
        return pd.read_csv(self.path, dtype={"setting": str}, keep_default_na=False, na_values=["nan"])

    def _write(self, mode: str, row: object) -> None:
        with self.path.open(mode, newline="", encoding="utf-8") as file:
            csv.writer(file).writerow(row)  # type: ignore[arg-type]
