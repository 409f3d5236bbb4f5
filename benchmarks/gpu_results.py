"""What a run of `gpu.py` leaves: few flat files, each added to, so that a run that was stopped goes on with them.

`gpu.csv` holds a row for each number, `scores.csv` those of every frame, `weights_<n>.zip` the generators in half
precision, `gpu.png` the figure, `gpu.log` what went wrong. No file grows over 15 MB, and there are at most eight.
"""

import csv
import io
import zipfile
from collections.abc import Iterable
from pathlib import Path

import torch

HEAD = ("part", "name", "quantity", "value", "unit", "hardware")
Row = tuple[str, str, str, str, str, str]
_LARGEST, _ZIPS = 15_000_000, 4


def read_rows(folder: Path) -> list[Row]:
    """All numbers so far."""
    file = folder / "gpu.csv"
    if not file.exists():
        return []
    with file.open(newline="") as lines:
        return [tuple(row) for row in list(csv.reader(lines))[1:]]  # type: ignore[misc]


def add_rows(file: Path, head: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Append to a CSV file, which gets its head first."""
    fresh = not file.exists()
    with file.open("a", newline="") as lines:
        writer = csv.writer(lines)
        if fresh:
            writer.writerow(head)
        writer.writerows(rows)


def value_of(rows: Iterable[Row], part: str, name: str, quantity: str) -> float | None:
    """One number, None where it was not measured."""
    found = [row[3] for row in rows if row[:3] == (part, name, quantity)]
    return float(found[-1]) if found else None


def add_weights(folder: Path, name: str, generator: torch.nn.Module) -> bool:
    """Put a generator, in half precision, into the first archive with room for it; False where none has."""
    buffer = io.BytesIO()
    torch.save({key: value.half().cpu() for key, value in generator.state_dict().items()}, buffer)
    for number in range(_ZIPS):
        file = folder / f"weights_{number}.zip"
        size = file.stat().st_size if file.exists() else 0
        if size + buffer.tell() <= _LARGEST:
            with zipfile.ZipFile(file, "a", zipfile.ZIP_STORED) as archive:
                if f"{name}.pt" not in archive.namelist():
                    archive.writestr(f"{name}.pt", buffer.getvalue())
            return True
    return False


def draw(folder: Path, hardware: str) -> None:
    """Bars of all times and rates, one panel a part."""
    from matplotlib.figure import Figure

    rows = read_rows(folder)
    panels = {
        "b signal chain, ms": [(r[2], float(r[3])) for r in rows if r[0] == "b" and r[4] == "ms" and r[1] == "pose 0"],
        "c training, images/s": [(r[1], float(r[3])) for r in rows if r[0] == "c" and r[2] == "rate"],
        "d generated frame, ms": [(r[1], float(r[3])) for r in rows if r[0] == "d" and r[2] == "time"],
        "e, f trainings, MAE in grey levels": [(r[1], float(r[3])) for r in rows if r[0] in "ef" and r[2] == "mae_fan"],
    }
    shown = {title: bars for title, bars in panels.items() if bars}
    if not shown:
        return
    figure = Figure(figsize=(9, 1 + sum(0.6 + 0.2 * len(bars) for bars in shown.values())), layout="constrained")
    axes = figure.subplots(len(shown), squeeze=False, height_ratios=[2 + len(bars) for bars in shown.values()])
    for axis, (title, bars) in zip(axes[:, 0], shown.items(), strict=True):
        axis.barh([name for name, _ in bars], [value for _, value in bars])
        axis.bar_label(axis.containers[0], fmt="%.3g", padding=2, fontsize=7)
        axis.invert_yaxis()
        axis.margins(x=0.12)
        axis.tick_params(labelsize=7)
        axis.set_title(title, fontsize=9, loc="left")
    figure.suptitle(hardware, fontsize=9)
    figure.savefig(folder / "gpu.png", dpi=120)
