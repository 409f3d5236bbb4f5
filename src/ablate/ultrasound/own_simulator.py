"""A simulator of the user's own, a function of `Echoes` named by a dotted path, in place of the signal chain."""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from scipy.signal import hilbert

from ablate.anatomy import Scene
from ablate.ultrasound.echoes import Echoes, Iq, Rf
from ablate.ultrasound.imaging.bmode import Display
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.simulator import Simulator
from ablate.user_code import describe_error, load

Form = Callable[[Echoes], np.ndarray | Rf | Iq]


class OwnSimulatorError(ValueError):
    """A simulator of the user's own fails, or returns what is no image; the message says which and what in one line."""


def load_form(target: str) -> Form:
    """The function that a dotted path names; an OwnSimulatorError where it cannot be imported, or is none."""
    try:
        form: Form = load(target)
    except ValueError as error:
        allowed = "allowed is the path of a function, as my_package.my_simulator"
        raise OwnSimulatorError(f"target={target}: {error}; {allowed}") from error
    if not callable(form):
        raise OwnSimulatorError(f"target={target}: is a {type(form).__name__}, allowed is a function")
    return form


def check_settings_of_own(target: str, settings: SimulatorSettings) -> None:
    """Refuse, by an OwnSimulatorError, settings that have no meaning for a simulator of the user's own."""
    if settings.compound_angles > 1:
        why = "which transmits as it likes, gets the scanlines of one angle"
        raise OwnSimulatorError(f"target={target}: allowed is compound_angles=1, as a simulator of your own, {why}")


def simulators_of(target: str | None) -> Callable[..., Simulator]:
    """What makes simulators, called as `Simulator` is: ours, or with a dotted path those of the user's own."""
    return Simulator if target is None else partial(OwnSimulator, target)


class OwnSimulator(Simulator):
    """Renders a scene by a function of the user's own; labels, attenuation and all other maps are ours.

    Parameters
    ----------
    target : str
        Dotted path of the function.
    scene, probe, settings, poses, beside
        As of `Simulator`.

    Raises
    ------
    OwnSimulatorError
        When there is no such function, or frames are to be compounded.
    ValueError
        As of `Simulator`.
    """

    def __init__(
        self,
        target: str,
        scene: Scene,
        probe: Probe | None = None,
        settings: SimulatorSettings | None = None,
        poses: Iterable[np.ndarray] | None = None,
        beside: Simulator | None = None,
    ) -> None:
        super().__init__(scene, probe, settings, poses, beside)
        check_settings_of_own(target, self.settings)
        self._target, self._form = target, load_form(target)

    def _image(self, pose: np.ndarray, seed: int, display: Display | None) -> tuple[np.ndarray, np.ndarray]:
        """The image, (rows, scanlines) uint8, and its envelope, (scanlines, samples); of grey levels (0, 0)."""
        echoes = self.echoes(pose, seed)
        try:
            returned = self._form(echoes)
        except (Exception, SystemExit) as error:  # whatever the user's function does
            raise self._error(echoes, f"fails: {describe_error(error)}") from error
        if fault := _fault_of(returned, self.settings):
            raise self._error(echoes, f"returns {fault}")
        if isinstance(returned, Rf | Iq):
            lines = _at_samples(returned, self.settings.axial_samples).T
            signal = np.array([lines.real, lines.imag], self._chain.speckle.dtype, order="C")
            nothing = np.empty((0, signal.shape[2]), signal.dtype)
            return self._chain.shown([(signal, nothing)], echoes.pose, echoes.seed, display)
        picture = np.rint(returned).astype(np.uint8)
        if display is not None:
            depth = sample_depths_mm(self.probe, len(picture))[:, None] / self.probe.depth_mm
            picture = display.shown(picture, depth, self.settings)
        return picture, np.empty((0, 0), np.float32)

    def _error(self, echoes: Echoes, what: str) -> OwnSimulatorError:
        place = ", ".join(f"{value:.1f}" for value in echoes.pose[:3, 3])
        return OwnSimulatorError(f"scene.target={self._target}: {what} (probe at {place} mm, seed {echoes.seed})")


def _fault_of(returned: object, settings: SimulatorSettings) -> str:
    """What is wrong with what a function returns, and what is allowed; empty where nothing is."""
    is_lines = isinstance(returned, Rf | Iq)
    values = returned.lines if isinstance(returned, Rf | Iq) else returned
    name = f"{type(returned).__name__} of " if is_lines else ""
    rows, scanlines = settings.beam_shape
    if not isinstance(values, np.ndarray):
        grey = f"grey levels, a NumPy array of {rows} x {scanlines}"
        return f"{name}{type(values).__name__}; allowed are {grey}, or ablate.ultrasound.Rf or Iq of an array"
    shape = " x ".join(map(str, values.shape)) or "one number"
    kinds = {Rf: "f", Iq: "c"}.get(type(returned), "uif")
    if values.dtype.kind not in kinds:
        allowed = {"f": "real numbers", "c": "complex numbers"}.get(kinds, "uint8, or other real numbers from 0 to 255")
        hint = "; complex lines are ablate.ultrasound.Iq(lines)" if name == "" and values.dtype.kind == "c" else ""
        return f"{name}{values.dtype}; allowed are {allowed}{hint}"
    if is_lines and (values.ndim != 2 or values.shape[1] != scanlines or len(values) < 2):
        return f"{name}{shape} values; allowed are lines of any number of samples, (n, {scanlines})"
    if not is_lines and values.shape != (rows, scanlines):
        return f"grey levels of {shape}; allowed are {rows} x {scanlines}, rows x scanlines"
    if not np.isfinite(values).all():
        return f"{name}{(~np.isfinite(values)).sum()} of {values.size} values that are NaN or infinite"
    if not is_lines and (values.min() < 0 or values.max() > 255):
        return f"grey levels from {values.min():g} to {values.max():g}; allowed are 0 to 255"
    return ""


def _at_samples(made: Rf | Iq, samples: int) -> np.ndarray:
    """The signal at the samples, (samples, scanlines) complex; of another number of steps, its envelope."""
    lines = hilbert(made.lines, axis=0) if isinstance(made, Rf) else made.lines
    if len(lines) == samples:
        return lines
    at = (np.arange(samples) + 0.5) * (len(lines) / samples) - 0.5
    steps = np.arange(len(lines))
    return np.stack([np.interp(at, steps, envelope) for envelope in np.abs(lines).T], axis=1).astype(complex)
