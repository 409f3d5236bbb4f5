"""PyMUST (Garcia 2022, doi:10.1016/j.cmpb.2022.106726): a convex array, diverging waves, delay and sum, compounding.

`scene.target=ablate.simulators.pymust_waves.diverging_waves` makes pairs with it. It sums what each element receives
from each point scatterer, so its speckle, side lobes and grating lobes are those of an array.

Positions are those of `ablate.ultrasound`: x lateral, z depth from the middle of the face, mm. PyMUST has metres, and
z = 0 at the chord of the array.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from ablate.extras import installing
from ablate.ultrasound import ConvexProbe, Echoes, Iq
from ablate.ultrasound.media import DISPLAY_SPEED_M_S
from ablate.ultrasound.probe import sample_depths_mm, scanline_positions

_SCATTERERS_AT_A_TIME = 2000  # fastest: PyMUST's arrays then stay in the processor's cache
_LINES_AT_A_TIME = 16
_THRESHOLD_DB = -60.0  # weaker parts of the pulse's spectrum are left out; PyMUST's own choice for pressure fields
_WAVES = 5
_BELOW_BLACK_DB = 20.0  # points that are darker are left out
_UNIT_SEED, _UNIT_SCATTERERS = 0, 8000  # of the phantom that the level is measured with
_SURFACES = 8  # of that phantom, and parts of its depth
_PARTS = 24
_ORDER = 3  # of the polynomials of depth that levels follow


def _pymust() -> Any:
    """PyMUST, which is an extra; a ModuleNotFoundError that says how it is installed where it is missing."""
    try:
        import pymust
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"PyMUST is not installed: {installing('compare')}") from error
    return pymust


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
    transmissions: int = 15
    source_extent_mm: float = 16.0
    f_number: float = 1.0

    @property
    def param(self) -> Any:
        """PyMUST's description of the array."""
        param = _pymust().utils.Param()
        param.fc = self.frequency_mhz * 1e6
        param.fs = 4 * param.fc
        param.c = DISPLAY_SPEED_M_S
        param.radius = self.radius_mm * 1e-3
        param.Nelements = self.elements
        param.pitch = 2 * param.radius * np.sin(np.radians(self.fov_deg) / self.elements / 2)
        param.width = 0.9 * param.pitch
        param.bandwidth = self.bandwidth_percent
        param.TXnow = self.cycles
        param.fnumber = self.f_number
        return param

    @property
    def wavelength_mm(self) -> float:
        return DISPLAY_SPEED_M_S / self.frequency_mhz / 1e3


@dataclass(frozen=True)
class Scatterers:
    """Point scatterers in the image plane; three arrays of one length."""

    x_mm: np.ndarray
    z_mm: np.ndarray
    strength: np.ndarray


class Levels(NamedTuple):
    """What brings PyMUST's amplitudes to those of `ablate`, (samples,) float64 each."""

    speckle: np.ndarray  # amplitude of speckle whose scatterers have unit power at each sample
    surface: np.ndarray  # amplitude of a point such that a row of them, one a scanline, is as a surface of amplitude 1


class _Strengths(np.ndarray):
    """Strengths whose products with complex numbers are complex64, as PyMUST's phases are.

    With float64 PyMUST would copy the phases of all scatterers and elements to complex128 for every frequency, half of
    its time.
    """

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [np.asarray(value) if isinstance(value, _Strengths) else value for value in inputs]
        result = getattr(ufunc, method)(*plain, **options)
        return result.astype(np.complex64) if np.iscomplexobj(result) else result


def diverging_waves(echoes: Echoes) -> Iq:
    """A frame by PyMUST: scatterers and surfaces as points of the image plane, five diverging waves, delay and sum.

    Frequency and f-number are those of the settings, and the elements lie a wavelength apart; the widths of the pulse
    are those of the array. What is attenuated, shadowed or out of plane is `ablate`'s: each point has the amplitude
    that comes back from it. So are levels: speckle of a given power is as bright. A probe that is not convex is a
    ValueError.
    """
    probe, settings = echoes.probe, echoes.settings
    if not isinstance(probe, ConvexProbe):
        raise ValueError(f"probe.kind={probe.kind}: allowed is convex")
    face_mm = math.radians(probe.fov_deg) * probe.radius_mm
    wavelength_mm = DISPLAY_SPEED_M_S / probe.frequency_mhz / 1e3
    array = Array(
        radius_mm=probe.radius_mm,
        fov_deg=probe.fov_deg,
        elements=math.ceil(face_mm / wavelength_mm),
        frequency_mhz=probe.frequency_mhz,
        transmissions=_WAVES,
        f_number=settings.f_number,
    )
    angles = scanline_positions(probe, settings.scanlines)
    with threadpool_limits(1):  # threads of NumPy's BLAS wait for each other in PyMUST's small products
        levels = _levels(array, probe, (settings.axial_samples, settings.scanlines))
        amplitude = echoes.scattered + levels.surface[:, None] * echoes.surfaces
        unseen_db = settings.dynamic_range_db + _BELOW_BLACK_DB + echoes.gain_db
        unseen = np.abs(amplitude) <= settings.reference_level * 10 ** (-unseen_db / 20)[:, None]
        cloud = _points(array, echoes.depth_mm, angles, np.where(unseen, 0, amplitude))
        (image,) = images(array, [cloud], echoes.depth_mm, angles)
    return Iq(image / levels.speckle[:, None] + echoes.reverberation)


def _points(array: Array, depths_mm: np.ndarray, angles_rad: np.ndarray, amplitude: np.ndarray) -> Scatterers:
    """Points of complex amplitudes at samples, (samples, lines), where these are not 0.

    The phase of an echo is that of the way there and back, so each point is moved along its scanline, by at most a
    quarter of the wavelength.
    """
    row, line = np.nonzero(amplitude)
    turn = 4 * math.pi / array.wavelength_mm  # rad/mm, there and back
    phase = -np.angle(amplitude[row, line]) - turn * depths_mm[row]
    depth_mm = depths_mm[row] + (np.remainder(phase + math.pi, 2 * math.pi) - math.pi) / turn
    from_centre = array.radius_mm + depth_mm
    x, z = from_centre * np.sin(angles_rad[line]), from_centre * np.cos(angles_rad[line]) - array.radius_mm
    return Scatterers(x, z, np.abs(amplitude[row, line]))


@lru_cache(maxsize=4)
def _levels(array: Array, probe: ConvexProbe, shape: tuple[int, int]) -> Levels:
    """Levels of PyMUST at the samples of a grid, (samples, lines): measured on scatterers of unit power, and on arcs.

    They are kept: another frame of this process has the same.
    """
    samples, lines = shape
    depths, angles = sample_depths_mm(probe, samples), scanline_positions(probe, lines)
    generator = np.random.default_rng(_UNIT_SEED)
    share = min(1.0, _UNIT_SCATTERERS / (samples * lines))
    normal = generator.standard_normal((2, samples, lines)) * (generator.random(shape) < share) / math.sqrt(2 * share)
    arcs, rows = np.zeros(shape), np.linspace(0, samples, _SURFACES + 1)[1:-1].astype(int)
    arcs[rows] = 1
    clouds = [_points(array, depths, angles, values) for values in (normal[0] + 1j * normal[1], arcs)]
    speckle, surfaces = (np.abs(image) for image in images(array, clouds, depths, angles))
    parts = np.array_split(np.arange(samples), _PARTS)
    power = [np.square(speckle[part]).mean() for part in parts]
    level = np.exp(_smooth(depths, [depths[part].mean() for part in parts], np.log(power)) / 2)
    half = max(1, round(array.wavelength_mm / (probe.depth_mm / samples)))  # of a window that holds a pulse
    peaks = [np.median(surfaces[max(row - half, 0) : row + half + 1].max(axis=0)) for row in rows]
    return Levels(level, np.exp(_smooth(depths, depths[rows], np.log(level[rows] / peaks))))


def _smooth(depths_mm: np.ndarray, known_mm: Sequence[float] | np.ndarray, values: np.ndarray) -> np.ndarray:
    """A polynomial of depth that fits some values."""
    fit = np.polynomial.Polynomial.fit(known_mm, values, _ORDER, domain=[0, depths_mm[-1]])
    smooth: np.ndarray = fit(depths_mm)
    return smooth


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
    for source, weight in zip(sources, weights, strict=True):
        delays = np.hypot(element_x - source, element_z + apothem[0]) / param.c
        delays = (delays - delays.min())[None]
        signals = [_echoes(param, cloud, delays, shift, samples) for cloud in clouds]
        stacked = np.stack([_pymust().rf2iq(s, param.fs, param.fc).ravel(order="F") for s in signals], axis=-1)
        for first in range(0, x.shape[1], _LINES_AT_A_TIME):
            lines = slice(first, first + _LINES_AT_A_TIME)
            shape = 1j * np.array([samples, array.elements])
            matrix = _pymust().dasmtx(shape, x[:, lines], z[:, lines], delays.copy(), param.copy()).tocsr()
            for total, image in zip(totals, (matrix @ stacked).T, strict=True):
                total[:, lines] += weight * image.reshape(x[:, lines].shape, order="F")
    return list(totals)


def _echoes(param: Any, cloud: Scatterers, delays: np.ndarray, shift: float, samples: int) -> np.ndarray:
    """What the elements receive, (samples, elements) float64; echoes add up, so the cloud is taken in parts."""
    pymust = _pymust()
    options = pymust.utils.Options()
    options.dBThresh = _THRESHOLD_DB
    options.ElementSplitting = 1  # an element is shorter than a wavelength
    total = np.zeros((samples, param.Nelements))
    for first in range(0, len(cloud.x_mm), _SCATTERERS_AT_A_TIME):
        part = slice(first, first + _SCATTERERS_AT_A_TIME)
        x, z = 1e-3 * cloud.x_mm[part], 1e-3 * cloud.z_mm[part] + shift
        strength = cloud.strength[part].view(_Strengths)
        rf, _ = pymust.simus(x, z, strength, delays.copy(), param.copy(), options)
        rf = rf[:samples]
        total[: len(rf)] += rf
    return total
