"""One frame with the probe that saw it: the body in 3-D, beside it the image and its segmentation."""

import math
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import Bbox

from ablate.analysis.figures.body_view import MARK, Axes3D, draw_body, fit_body
from ablate.analysis.figures.scene_parts import Colour, tissue_colours
from ablate.analysis.figures.style import PAGE_IN, PNG_DPI, house_style
from ablate.anatomy import Scene, SiteGrid
from ablate.storage import written_whole
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of

_HEIGHT = 0.64  # of the figure, over its width
_ROOM = Bbox([(0.01, 0.01), (0.6, 0.92)])  # of the body, in shares of the figure
_COLUMNS = 4  # of the legend
_OUTSIDE: Colour = (0.0, 0.0, 0.0)


def preview_figure(
    path: Path,
    title: str,
    scene: Scene,
    probe: Probe,
    pose: np.ndarray,
    image: np.ndarray,
    segmentation: np.ndarray,
    grid: SiteGrid,
) -> Path:
    """Draw body, probe and fan in 3-D, and beside them the frame's image and segmentation in the same colours.

    The image lies on the fan where it was taken; a green ball marks the side of the probe that is left in it.

    Parameters
    ----------
    path : Path
        Of the PNG; its folder is made.
    title : str
        Stands above.
    scene : Scene
        With one structure or more.
    probe : Probe
        That took the image.
    pose : (4, 4) float, mm
        Probe to world.
    image : (H, W) uint8
        Grey levels.
    segmentation : (H, W) uint8
        Labels, 0 outside the fan.
    grid : SiteGrid
        Its axis and front are drawn as arrows.
    """
    colours = tissue_colours(scene.tissues)
    with house_style(), rc_context({"grid.color": "#dddddd", "grid.linewidth": 0.5}):
        figure = Figure(figsize=(PAGE_IN, _HEIGHT * PAGE_IN))
        space = figure.add_axes((0.03, 0.0, 0.58, 0.58 / _HEIGHT), projection="3d", proj_type="ortho")
        draw_body(space, scene, probe, pose, image, segmentation > 0, grid.axis)
        fit_body(space, _ROOM)
        _draw_compass(figure, space, grid)
        upper = figure.add_axes((0.69, 0.61, 0.3, 0.355))
        lower = figure.add_axes((0.69, 0.205, 0.3, 0.355))
        _draw_image(upper, probe, image, "image")
        _draw_image(lower, probe, np.array([_OUTSIDE, *colours])[segmentation], "segmentation")
        upper.tick_params(labelbottom=False)
        lower.set_xlabel("lateral (mm)")
        names = {i: scene.tissues[i - 1].name.replace("_", " ") for i in np.unique(segmentation) if i}
        patches = [Patch(facecolor=colours[i - 1], label=name) for i, name in names.items()]
        figure.legend(
            handles=patches,
            frameon=False,
            loc="upper right",
            bbox_to_anchor=(1.0, 0.135),
            ncols=_COLUMNS,
            fontsize=min(6, 27 / math.ceil(len(patches) / _COLUMNS)),  # so many points fit below the images
            handlelength=0.8,
            handleheight=0.8,
            columnspacing=0.8,
            labelspacing=0.3,
        )
        figure.text(0.01, 0.98, title, va="top")
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
    axes.locator_params(nbins=4)


def _draw_compass(figure: Figure, space: Axes3D, grid: SiteGrid) -> None:
    """Arrows along the scene's axis and to its front, as the 3-D view sees them."""
    axes = figure.add_axes((0.015, 0.765, 0.11, 0.11 / _HEIGHT))
    axes.set(xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), aspect="equal")
    axes.set_axis_off()
    turn = space.get_proj()[:2, :3]
    for name, vector in (("axis", grid.axis), ("front", grid.front)):
        seen = turn @ vector / np.linalg.norm(vector) / np.linalg.norm(turn[0])
        axes.annotate("", tuple(seen), (0, 0), arrowprops={"arrowstyle": "->", "lw": 1.0, "shrinkA": 0, "shrinkB": 0})
        across, up = seen * (1 + 0.4 / max(float(np.linalg.norm(seen)), 1e-6))
        axes.text(across, up, name, ha="center", va="center")
