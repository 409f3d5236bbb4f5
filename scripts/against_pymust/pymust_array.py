"""Widths of points in images of a convex array by PyMUST."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from speckle_measures import half_width

from ablate.simulators.pymust_waves import Array, Scatterers, images


@dataclass(frozen=True)
class PointWidths:
    """Full widths at half maximum of the envelope of point targets, mm, one entry a depth."""

    depth_mm: np.ndarray
    axial_mm: np.ndarray
    lateral_mm: np.ndarray


def point_widths(array: Array, depths_mm: Sequence[float] | np.ndarray) -> PointWidths:
    """Measure point targets on the axis, at depths that are at least 8 mm apart."""
    targets = np.asarray(depths_mm, float)
    depth = np.arange(targets.min() - 4, targets.max() + 4, 0.05)
    angle = np.radians(np.linspace(-4, 4, 81))
    cloud = Scatterers(np.zeros_like(targets), targets, np.ones_like(targets))
    envelope = np.abs(images(array, [cloud], depth, angle)[0])
    line_mm = (array.radius_mm + targets) * (angle[1] - angle[0])
    widths = []
    for target, across_mm in zip(targets, line_mm, strict=True):
        patch = envelope[np.abs(depth - target) < 3]
        row, column = np.unravel_index(patch.argmax(), patch.shape)
        along, across = patch[:, column], patch[row]
        axial = half_width(along[row:]) + half_width(along[row::-1])
        lateral = half_width(across[column:]) + half_width(across[column::-1])
        widths.append((axial * (depth[1] - depth[0]), lateral * across_mm))
    axial, lateral = np.array(widths).T
    return PointWidths(targets, axial, lateral)
