"""What a case is, the errors that it must keep within their bounds, and the frames that many cases render."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.threads import torch_threads
from ablate.ultrasound import ConvexProbe, Frame, Probe, Simulator, SimulatorPrecision, SimulatorSettings
from ablate.ultrasound.imaging.point_spread import axial_kernel, lateral_kernels

# Unit roundoff: the largest relative error of one rounding.
FLOAT32 = 2.0**-24
FLOAT64 = 2.0**-53
TF32 = 2.0**-11
BFLOAT16 = 2.0**-8

AHEAD = np.eye(4)
GEL = Tissue("gel", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
SOFT = Tissue("soft tissue", 1540, 1.63, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
PROBE = ConvexProbe()
#: A frame with every part of the model, in a tenth of a second.
SMALL = SimulatorSettings(
    scanlines=64, axial_samples=1024, rays=8, layers=3, image_shape=(200, 277), axial_fwhm_mm=1.2, lateral_fwhm_mm=1.6
)


@dataclass(frozen=True)
class Check:
    """An error, computed in `dtype`, that must not exceed its bound, which `why` explains; 0 is perfect."""

    dtype: str
    quantity: str
    measured: float
    bound: float
    why: str

    @property
    def holds(self) -> bool:
        return self.measured <= self.bound  # false for NaN


class Checks:
    """The errors of one case, in the order that the case adds them.

    `device` is where the case computes. `dtype` and `label` are those of the errors that are added next; a label stands
    before the name of the quantity where a case has several settings.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self.dtype = "float64"
        self.label = ""
        self.added: list[Check] = []

    def add(self, quantity: str, measured: float, bound: float, why: str, dtype: str | None = None) -> None:
        """Add an error with its bound.

        Parameters
        ----------
        quantity : str
            What is in error; the present label stands before it.
        measured, bound : float
            The error, and what it must not exceed.
        why : str
            The reason of the bound, a sentence.
        dtype : str, optional
            In which it was computed; the present one without it.
        """
        shown = f"{self.label}: {quantity}" if self.label else quantity
        self.added.append(Check(dtype or self.dtype, shown, float(measured), bound, why))

    def finite(self, *arrays: np.ndarray, what: str = "values", dtype: str | None = None) -> None:
        """Count the values that are infinite or NaN."""
        count = sum(int(np.count_nonzero(~np.isfinite(array))) for array in arrays)
        self.add(f"{what} not finite", count, 0, "An image, a gradient or a score of NaN is useless.", dtype)

    def refused(self, *attempts: Callable[[], object]) -> None:
        """Count the attempts that raise no ValueError."""
        accepted = 0
        for attempt in attempts:
            with suppress(ValueError):
                attempt()
                accepted += 1
        self.add("inputs not refused", accepted, 0, "What has no answer is refused in words.")

    def none(self, quantity: str, wrong: object, why: str) -> None:
        """Count the true values of `wrong`, of which there must be none."""
        self.add(quantity, int(np.count_nonzero(wrong)), 0, why)  # type: ignore[call-overload]

    def both(
        self, scene: Scene, settings: SimulatorSettings = SMALL, probe: Probe = PROBE, pose: np.ndarray = AHEAD
    ) -> dict[str, Frame]:
        """Render a frame in float32 and in float64, and add nothing.

        Parameters
        ----------
        scene : Scene
        settings : SimulatorSettings
            But for precision and device, which are those of the case.
        probe : Probe
        pose : (4, 4) float, mm
            Probe to world.

        Returns
        -------
        dict of str to Frame
            By the name of the precision.
        """
        frames = {}
        for precision in SimulatorPrecision:
            exact = replace(settings, precision=precision, device=self.device)
            frames[precision.value] = Simulator(scene, probe, exact).render(pose)
        return frames

    def frames(
        self, scene: Scene, settings: SimulatorSettings = SMALL, probe: Probe = PROBE, pose: np.ndarray = AHEAD,
        *, label: str = "",
    ) -> Iterator[Frame]:  # fmt: skip
        """Render `both`, add what must hold for any frame, and give each frame in turn; `dtype` is its precision.

        Parameters
        ----------
        scene, settings, probe, pose
            As of `both`.
        label : str
            Of what is added, here and while a frame is given.
        """
        rendered = self.both(scene, settings, probe, pose)
        self.label = label
        self.any_frame(rendered, settings, probe)
        for self.dtype, frame in rendered.items():
            yield frame
        self.label = ""

    def render(self, scene: Scene, *arguments: Any, **options: Any) -> None:
        """Add what must hold for any frame, and no more; with the arguments of `frames`."""
        list(self.frames(scene, *arguments, **options))

    def any_frame(self, frames: dict[str, Frame], settings: SimulatorSettings, probe: Probe = PROBE) -> None:
        """Add what must hold for any frame: values are finite, and float32 is near float64."""
        for self.dtype, frame in frames.items():
            self.finite(frame.envelope, frame.attenuation, what="samples and pixels")
            outside = max(-frame.attenuation.min(), frame.attenuation.max() - 1, 0.0)
            self.add("A outside [0, 1]", outside, 0, "A is the ratio of an amplitude to a larger one.")
        single = frames["float32"]
        double = frames["float64"]
        self.dtype = "float32"
        why = (
            "A sample is a sum of n products. Random rounding errors are sqrt(n) 2^-24 of the sum of magnitudes "
            "(Higham and Mary 2019), and this sum is at most n times the largest."
        )
        self.same_envelope("envelope against float64, of its largest", single, double, why, settings, probe)
        apart = np.abs(single.image.astype(int) - double.image) > 1
        why = "Values that differ by far less than a grey level can be rounded to two neighbouring levels."
        self.none("pixels more than a grey level from float64", apart, why)
        bound = (settings.axial_samples + settings.scanlines) * 2 * FLOAT32 + 4 * FLOAT32
        why = "The position of a pixel among n samples is rounded by n 2^-23 samples, in which A changes by at most 1."
        self.add("A against float64", off(single.attenuation, double.attenuation), bound, why)

    def same_envelope(
        self, quantity: str, frame: Frame, right: Frame, why: str, settings: SimulatorSettings = SMALL,
        probe: Probe = PROBE, moved_by: float = 0.0,
    ) -> None:  # fmt: skip
        """Add the largest difference of two envelopes over the largest sample of the right one.

        Its bound is the rounding of the products that are summed for a sample, of pulse, beam and layers.

        Parameters
        ----------
        quantity, why : str
            As of `add`.
        frame, right : Frame
            The one that is judged, and the right one.
        settings : SimulatorSettings
        probe : Probe
        moved_by : float
            What is added to the bound.
        """
        beam = np.count_nonzero(lateral_kernels(probe, settings), axis=-1).max()
        products = len(axial_kernel(probe, settings)) + int(beam) + settings.layers
        error = off(frame.envelope, right.envelope) / (float(right.envelope.max()) or 1.0)
        self.add(quantity, error, moved_by + products**1.5 * FLOAT32, why)


#: A stiff or extreme input: a function that adds its errors, and whose docstring says what is tried, and its arguments.
Case = tuple[Callable[..., None], tuple[object, ...]]
#: Every case by its name; the modules of cases fill it.
CASES: dict[str, Case] = {}


def run(case: Case, device: str) -> list[Check]:
    """Run a case on a device, in one thread, as its arrays are too small for several.

    An exception is an error, too, and ends it; so is an overflow, of which NumPy only warns.
    """
    checks = Checks(device)
    measure, arguments = case
    try:
        with torch_threads(1), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about scenes of metres and probes in bone
            warnings.simplefilter("error", RuntimeWarning)
            measure(checks, *arguments)
    except Exception as error:
        why = "A case raises no exception."
        checks.added.append(Check("", f"{type(error).__name__}: {error}", float("nan"), 0, why))
    return checks.added


def case(name: str, *arguments: object) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a function of `Checks` and of these arguments as a case; a function can be several, the lowest first."""

    def declare(measure: Callable[..., None]) -> Callable[..., None]:
        assert name not in CASES
        CASES[name] = measure, arguments
        return measure

    return declare


def off(measured: np.ndarray, right: np.ndarray | float) -> float:
    """Compute the largest absolute difference of two arrays in float64."""
    return float(np.abs(np.asarray(measured, np.float64) - right).max())


def slab(tissue: Tissue, near_mm: float, far_mm: float, wide_mm: float = 300.0) -> Structure:
    """Make a box around the probe's axis.

    Parameters
    ----------
    tissue : Tissue
    near_mm, far_mm : float
        The depths of its faces.
    wide_mm : float
        Its width, in both directions across the axis.
    """
    mesh = trimesh.creation.box((wide_mm, wide_mm, far_mm - near_mm))
    return Structure(mesh.apply_translation((0, 0, (near_mm + far_mm) / 2)), tissue)


def moved(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0, tilt_deg: float = 0.0) -> np.ndarray:
    """Make a pose.

    Parameters
    ----------
    x_mm, y_mm, z_mm : float
        Its origin.
    tilt_deg : float
        By which it is rotated about the probe's y.

    Returns
    -------
    (4, 4) float, mm
        Probe to world.
    """
    cosine = np.cos(np.radians(tilt_deg))
    sine = np.sin(np.radians(tilt_deg))
    return np.array([[cosine, 0, sine, x_mm], [0, 1, 0, y_mm], [-sine, 0, cosine, z_mm], [0, 0, 0, 1]])
