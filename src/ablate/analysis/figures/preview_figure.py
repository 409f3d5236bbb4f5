"""One frame with the probe that saw it: the body in 3-D, beside it the image and its segmentation."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator

from ablate.analysis.figures.body_view import MARK, Axes3D, draw_body, seen_direction, tick_mm
from ablate.analysis.figures.scene_parts import Colour, tissue_colours
from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import Scene
from ablate.storage import written_whole
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of

_HEIGHT = 0.64  # of the figure, over its width
_OUTSIDE: Colour = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Preview:
    """What is shown of one frame.

    Attributes
    ----------
    pose : (4, 4) float64
        Probe to world, mm.
    image, segmentation : (H, W) uint8
    axis, front : 3 floats
        The scene's long axis, and the side that angle 0 looks at.
    """

    title: str
    pose: np.ndarray
    image: np.ndarray
    segmentation: np.ndarray
    axis: tuple[float, float, float]
    front: tuple[float, float, float]


def preview_figure(scene: Scene, probe: Probe, shown: Preview, path: Path) -> Path:
    """Draw body, probe and fan in 3-D, and beside them the frame's image and segmentation in the same colours.

    The image lies on the fan where it was taken; a green ball marks the side of the probe that is left in it. The scene
    needs one structure or more. The file is a PNG; `path` is returned.
    """
    colours = tissue_colours(scene.tissues)
    with house_style(), rc_context({"grid.color": "#dddddd", "grid.linewidth": 0.5}):
        figure = Figure(figsize=(PAGE_IN, _HEIGHT * PAGE_IN))
        space = figure.add_axes((-0.01, 0.02, 0.6, 0.6 / _HEIGHT), projection="3d", proj_type="ortho")
        draw_body(space, scene, probe, shown.pose, shown.image, shown.segmentation > 0, shown.axis)
        _draw_compass(figure, space, shown)
        upper, lower = (figure.add_axes((0.69, bottom, 0.3, 0.355)) for bottom in (0.61, 0.205))
        _draw_image(upper, probe, shown.image, "image")
        _draw_image(lower, probe, np.array([_OUTSIDE, *colours])[shown.segmentation], "segmentation")
        upper.tick_params(labelbottom=False)
        lower.set_xlabel("lateral (mm)")
        names = {i: scene.tissues[i - 1].name.replace("_", " ") for i in np.unique(shown.segmentation) if i}
        patches = [Patch(facecolor=colours[i - 1], label=name) for i, name in names.items()]
        where: dict[str, Any] = {"loc": "upper right", "bbox_to_anchor": (1.0, 0.13), "ncols": 4, "fontsize": 6}
        small: dict[str, Any] = {"handlelength": 0.8, "handleheight": 0.8, "columnspacing": 0.8, "labelspacing": 0.3}
        figure.legend(handles=patches, frameon=False, **where, **small)
        figure.text(0.01, 0.98, shown.title, va="top")
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as partial:
            figure.savefig(partial, dpi=PNG_DPI)
    return path


def _draw_image(axes: Axes, probe: Probe, image: np.ndarray, title: str) -> None:
    height, width = fan_of(probe).size_mm
    top = -fan_of(probe).sag_mm
    extent = (-width / 2, width / 2, top + height, top)
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="antialiased")
    axes.plot(-0.42 * width, top + 0.07 * height, "o", color=MARK, ms=4)
    axes.set_title(title, loc="right", pad=2)
    axes.set_ylabel("depth (mm)")
    for each in (axes.xaxis, axes.yaxis):
        each.set_major_locator(MultipleLocator(tick_mm(min(height, width))))


def _draw_compass(figure: Figure, space: Axes3D, shown: Preview) -> None:
    """Arrows along the scene's axis and to its front, as the 3-D view sees them."""
    axes = figure.add_axes((0.025, 0.74, 0.11, 0.11 / _HEIGHT))
    axes.set(xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), aspect="equal")
    axes.set_axis_off()
    for name, vector in (("axis", shown.axis), ("front", shown.front)):
        seen = seen_direction(space, vector)
        length = max(float(np.linalg.norm(seen)), 1e-6)
        axes.annotate("", tuple(seen), (0, 0), arrowprops={"arrowstyle": "->", "lw": 1.0, "shrinkA": 0, "shrinkB": 0})
        across, up = seen * (length + 0.4) / length
        axes.text(across, up, name, ha="center", va="center")
