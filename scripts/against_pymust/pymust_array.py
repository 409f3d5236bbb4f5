"""A convex array in PyMUST (Garcia 2022, doi:10.1016/j.cmpb.2022.106726): diverging waves, delay and sum, compounding.

Positions are those of `ablate.ultrasound`: x lateral, z depth from the middle of the face, mm. PyMUST has metres, and
z = 0 at the chord of the array.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pymust
from speckle_measures import half_width
from tqdm import tqdm

_SCATTERERS_AT_A_TIME = 2000  # fastest: PyMUST's arrays then stay in the processor's cache
_LINES_AT_A_TIME = 16
_THRESHOLD_DB = -60.0  # weaker parts of the pulse's spectrum are left out; PyMUST's own choice for pressure fields


@dataclass(frozen=True)
class Array:
    """The array and how it is used.

    Each transmission is a diverging wave from a virtual source beside the centre of curvature; the images are added
    with Hann weights. Reception is a plain sum over the elements that see a pixel within atan(1 / (2 f_number)) of
    their normal.
    """

    radius_mm: float = 40.0
    fov_deg: float = 70.0
    elements: int = 96
    frequency_mhz: float = 3.0
    bandwidth_percent: float = 60.0
    cycles: float = 1.5
    speed_m_s: float = 1540.0
    transmissions: int = 15
    source_extent_mm: float = 16.0
    f_number: float = 1.0

    @property
    def param(self) -> pymust.utils.Param:
        """PyMUST's description of the array."""
        param = pymust.utils.Param()
        param.fc = self.frequency_mhz * 1e6
        param.fs = 4 * param.fc
        param.c = self.speed_m_s
        param.radius = self.radius_mm * 1e-3
        param.Nelements = self.elements
        param.pitch = 2 * param.radius * np.sin(np.radians(self.fov_deg) / self.elements / 2)
        param.width = 0.9 * param.pitch
        param.bandwidth = self.bandwidth_percent
        param.TXnow = self.cycles
        param.fnumber = self.f_number
        return param


@dataclass(frozen=True)
class Scatterers:
    """Point scatterers in the image plane; three arrays of one length."""

    x_mm: np.ndarray
    z_mm: np.ndarray
    strength: np.ndarray


def images(
    array: Array, clouds: Sequence[Scatterers], depths_mm: np.ndarray, angles_rad: np.ndarray
) -> list[np.ndarray]:
    """The compounded complex image of each cloud on a polar grid about the centre of curvature.

    Parameters
    ----------
    array : Array
    clouds : sequence of Scatterers
    depths_mm : (samples,) float
        Below the face.
    angles_rad : (lines,) float

    Returns
    -------
    list of (samples, lines) complex128
    """
    param = array.param
    element_x, element_z, _, apothem = (values.ravel() for values in param.getElementPositions())
    shift = param.radius - apothem[0]
    from_centre = array.radius_mm + depths_mm[:, None]
    x = 1e-3 * from_centre * np.sin(angles_rad)
    z = 1e-3 * (from_centre * np.cos(angles_rad) - array.radius_mm) + shift
    longest = 2 * (depths_mm.max() + 2 * array.radius_mm) * 1e-3 / param.c
    samples = int(longest * param.fs)
    sources = 1e-3 * np.linspace(-array.source_extent_mm, array.source_extent_mm, array.transmissions)
    weights = np.hanning(array.transmissions + 2)[1:-1]
    totals = np.zeros((len(clouds), *x.shape), np.complex128)
    for source, weight in zip(tqdm(sources, "PyMUST", disable=None), weights, strict=True):
        delays = np.hypot(element_x - source, element_z + apothem[0]) / param.c
        delays = (delays - delays.min())[None]
        signals = [_echoes(param, cloud, delays, shift, samples) for cloud in clouds]
        stacked = np.stack([pymust.rf2iq(s, param.fs, param.fc).ravel(order="F") for s in signals], axis=-1)
        for first in range(0, x.shape[1], _LINES_AT_A_TIME):
            lines = slice(first, first + _LINES_AT_A_TIME)
            shape = 1j * np.array([samples, array.elements])
            matrix = pymust.dasmtx(shape, x[:, lines], z[:, lines], delays.copy(), param.copy()).tocsr()
            for total, image in zip(totals, (matrix @ stacked).T, strict=True):
                total[:, lines] += weight * image.reshape(x[:, lines].shape, order="F")
    return list(totals)


def _echoes(param: pymust.utils.Param, cloud: Scatterers, delays: np.ndarray, shift: float, samples: int) -> np.ndarray:
    """What the elements receive, (samples, elements) float64; echoes add up, so the cloud is taken in parts."""
    options = pymust.utils.Options()
    options.dBThresh = _THRESHOLD_DB
    options.ElementSplitting = 1  # an element is shorter than a wavelength
    total = np.zeros((samples, param.Nelements))
    for first in range(0, len(cloud.x_mm), _SCATTERERS_AT_A_TIME):
        part = slice(first, first + _SCATTERERS_AT_A_TIME)
        x, z = 1e-3 * cloud.x_mm[part], 1e-3 * cloud.z_mm[part] + shift
        rf, _ = pymust.simus(x, z, cloud.strength[part], delays.copy(), param.copy(), options)
        rf = rf[:samples]
        total[: len(rf)] += rf
    return total


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
