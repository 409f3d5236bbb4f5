"""The figures of docs/table2.md: what each part is worth beside the paper, and one frame of the seven networks.

python scripts/table2.py          # first, with the study in runs/table2
python scripts/table2_figures.py  # docs/table2.png and docs/table2_frames.png
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ablate.analysis.figures.style import COLOURS, PAGE_IN, house_style, new_figure
from table2 import ABLATED, PAPER, PRIMARY, read_runs, seen_sites, tests

DOCS = Path(__file__).parents[1] / "docs"
NAMES = {name: name.upper() if "-" not in name else f"SA2H{name[4:]}" for name in PAPER.index}
WHAT = {
    "sa2h": "all parts",
    "sa2h-att": "without A",
    "sa2h-concat": "S and A at the first level only",
    "sa2h-conv": "transposed convolution",
    "sa2h-noise": "noise as an input",
    "nsa2h": "U-Net, N, S, A",
    "lsa2h": "U-Net, L, S, A",
}
#: Where the text of docs/table2.md points: column and row of the arrow's head, px of the frame.
ARROWS: Mapping[str, tuple[tuple[int, int], ...]] = {
    "sa2h": ((256, 199),),
    "sa2h-att": ((255, 199),),
    "nsa2h": ((274, 194),),
}


def effects_figure(table: pd.DataFrame) -> Figure:
    """By how much each ablated network is worse than SA2H, in percent of SA2H's value, with the paper's effect.

    `table` is that of `table2.tests`.
    """
    with house_style():
        figure = new_figure(PAGE_IN, 2.4)
        for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(PRIMARY))), PRIMARY, strict=True):
            _effects(axes, table[table["metric"] == metric].set_index("network"))
            title = {"pchi2": "patch chi-square", "psnr": "PSNR"}[metric]
            axes.set_xlabel(f"worse in {title} than SA2H, %")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _effects(axes: Axes, of_metric: pd.DataFrame) -> None:
    rows = np.arange(len(ABLATED))[::-1]
    shown = of_metric.loc[list(ABLATED)]
    share = 100 * shown["share"]
    reach = 100 * (shown["upper_share"] - shown["share"])
    axes.axvline(0, color="#444444", linewidth=0.6)
    axes.errorbar(share, rows, xerr=reach, fmt="o", color=COLOURS[0], markersize=4, label="here, 95 % interval")
    axes.plot(100 * shown["paper"], rows, "D", color=COLOURS[1], markerfacecolor="none", markersize=5, label="paper")
    axes.set_yticks(rows, [f"{NAMES[name]}\n{WHAT[name]}" for name in ABLATED])
    axes.set_ylim(-0.6, len(ABLATED) - 0.4)


def frames_figure(folder: Path, anatomy: int = 10, seed: int = 0) -> Figure:
    """The first test frame of a site that training has not seen: the target, and the seven networks of one seed."""
    from ablate.study.training import Training

    trained = {
        name: Training(next(folder.glob(f"{name}.anatomy_seed-{anatomy}-seed{seed}-*"))) for name in PAPER.index[::-1]
    }
    data = trained["sa2h"].data_set
    seen = seen_sites(folder, data.folder.name)
    frame = next(k for k in sorted(trained["sa2h"].pictures) if int(data.pairs.sites[k]) not in seen)
    images = {"target": data.pairs.read("target", np.array([frame]))[0]}
    images |= {name: training.pictures[frame] for name, training in trained.items()}
    with house_style():
        figure = new_figure(PAGE_IN, 3.4)
        for axes, (name, image) in zip(figure.subplots(2, 4).flat, images.items(), strict=True):
            axes.imshow(image, cmap="gray", vmin=0, vmax=255)
            axes.set_title(f"{NAMES[name]}\n{WHAT[name]}" if name in NAMES else "simulated\n", fontsize=7)
            axes.set_axis_off()
            for column, row in ARROWS.get(name, ()):
                axes.annotate(
                    "",
                    xy=(column, row),
                    xytext=(column + 28, row - 28),
                    arrowprops={"arrowstyle": "-|>", "color": "#ffcc00", "lw": 1.2},
                )
    return figure


def main() -> None:
    """Draw both from the finished study."""
    folder = Path("runs/table2")
    runs = read_runs(folder)
    effects = effects_figure(tests(runs[runs["labels"] == "arbitrary"]))
    effects.savefig(DOCS / "table2.png", dpi=170)
    frames_figure(folder).savefig(DOCS / "table2_frames.png", dpi=170)


if __name__ == "__main__":
    main()
