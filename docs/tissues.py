"""The built-in tissue table as a figure, tissues.png beside this file: dark to bright, hollow where a whole row is
assumed; numbers at the edges lie beyond the axis.

python docs/tissues.py
"""

from __future__ import annotations

import csv
from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from ablate.anatomy import load_tissues


def main() -> None:
    """Draw and write."""
    tissues = load_tissues()
    with (files("ablate.anatomy") / "tissues.csv").open() as file:
        source = {row["name"]: row["source"] for row in csv.DictReader(file)}
    names = list(tissues)
    rows = np.arange(len(names))
    power = np.array([tissue.scatter_power for tissue in tissues.values()])
    columns = {
        "speed of sound (m/s)": ([t.speed_m_s for t in tissues.values()], (1420, 1700), "linear"),
        "impedance (MRayl)": ([t.impedance_mrayl for t in tissues.values()], (1.36, 1.8), "linear"),
        "attenuation (dB/cm/MHz)": ([t.attenuation_db_cm_mhz for t in tissues.values()], (1e-3, 20), "log"),
        "scatterers' power (dB)": (
            np.where(power > 0, 10 * np.log10(np.maximum(power, 1e-9)), np.nan),
            (-24, 12),
            "linear",
        ),
    }
    wholly_assumed = np.array([source[name].startswith("assumed") for name in names])
    figure, axes = plt.subplots(1, len(columns), figsize=(11, 6.2), sharey=True, constrained_layout=True)
    for axis, (title, (values, limits, scale)) in zip(axes, columns.items(), strict=True):
        values = np.asarray(values, float)
        inside = (values >= limits[0]) & (values <= limits[1])
        axis.grid(axis="y", color="0.92")
        faces = np.where(wholly_assumed, "white", "tab:blue")[inside]
        axis.scatter(values[inside], rows[inside], s=30, facecolors=faces, edgecolors="tab:blue", zorder=2)
        for row in rows[~inside]:
            low = not values[row] > limits[1]
            text = "none" if np.isnan(values[row]) else f"{values[row]:g}"
            place = (0.02, "left") if low else (0.98, "right")
            axis.text(
                place[0],
                row,
                text,
                ha=place[1],
                va="center",
                fontsize=8,
                transform=axis.get_yaxis_transform(),
                color="0.3",
            )
        axis.set(xscale=scale, xlim=limits)
        axis.set_title(title, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(rows, [name.replace("_", " ") for name in names])
    axes[0].invert_yaxis()
    figure.savefig(Path(__file__).with_name("tissues.png"), dpi=110)


if __name__ == "__main__":
    main()
