"""A table on disk to which measurements are added one at a time."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from io import StringIO
from pathlib import Path

import pandas as pd

from ablate.storage import remove_partial, write_text


class CsvTable:
    """A CSV file that is written whole with each row, so that a kill keeps what was measured and leaves no half a row.

    `columns` are names separated by spaces. An existing file is replaced.
    """

    def __init__(self, path: Path, columns: str) -> None:
        self.path, self.columns = path, columns.split()
        self._text = ""
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_partial(path)
        self._add(self.columns)

    def add(self, *values: object) -> None:
        """Add one row, in the order of the columns."""
        if len(values) != len(self.columns):
            raise ValueError(f"{self.path.name}: {len(values)} values for the columns {', '.join(self.columns)}")
        self._add(values)

    def add_each(self, *first: object, values: Mapping[str, float]) -> None:
        """Add one row for each value: the first columns, its name and the value."""
        for name, value in values.items():
            self.add(*first, name, value)

    def table(self) -> pd.DataFrame:
        """Read all rows; names and settings are text."""
        return pd.read_csv(self.path, dtype={"setting": str}, keep_default_na=False, na_values=["nan"])

    def _add(self, row: object) -> None:
        line = StringIO()
        csv.writer(line, lineterminator="\n").writerow(row)  # type: ignore[arg-type]
        self._text += line.getvalue()
        write_text(self.path, self._text)
