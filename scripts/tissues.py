"""Draw docs/tissues.png: the built-in tissue table, from dark to bright.

Hollow markers stand for rows whose values are all assumed. A number at an edge is a value beyond the axis.

python scripts/tissues.py
"""

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
            text = "none" if np.isnan(values[row]) else f"{values[row]:g}"
            x, side = (0.98, "right") if values[row] > limits[1] else (0.02, "left")
            style = {"ha": side, "va": "center", "fontsize": 8, "color": "0.3"}
            axis.text(x, row, text, transform=axis.get_yaxis_transform(), **style)
        axis.set(xscale=scale, xlim=limits)
        axis.set_title(title, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(rows, [name.replace("_", " ") for name in names])
    axes[0].invert_yaxis()
    figure.savefig(Path(__file__).parents[1] / "docs" / "tissues.png", dpi=110)


if __name__ == "__main__":
    main()
