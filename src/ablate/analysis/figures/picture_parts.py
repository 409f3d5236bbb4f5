"""What figures made of pictures share: their sizes, how an image is shown, and the order of variants."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from ablate.analysis.pictures import FramePictures
from ablate.analysis.scored import CHANGED, variant_group

ACROSS = 4  # pictures side by side on a page; with more of them, speckle is lost in print
MOST_TALL = 5.0  # height of the place of a picture, in widths


def draw_picture(axes: Axes, image: np.ndarray, **how: Any) -> AxesImage:
    """Show an image, (H, W), perhaps masked, in axes without ticks and frame; `how` is as for `Axes.imshow`."""
    axes.set_axis_on()
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    return axes.imshow(image, **how)


def draw_grey(axes: Axes, image: np.ndarray) -> AxesImage:
    """Show an image (H, W) uint8 as it is."""
    return draw_picture(axes, image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")


def shown_variants(frames: Sequence[FramePictures]) -> list[str]:
    """Names of all predictions as they come, what was changed beside a variant last."""
    names = dict.fromkeys(name for frame in frames for name in frame.predictions)
    return sorted(names, key=lambda name: variant_group(name) == CHANGED)
