"""What maps cannot tell: the simulator's own frame, with what `variant=full` does not read taken away step by step.

python scripts/ceiling.py         # a table; docs/networks.md has its end. Errors to the frame itself: half a minute
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import torch
from scipy.ndimage import grey_opening

from ablate.command.compose import jobs_of
from ablate.dataset.split import resimulation_seed
from ablate.metrics import METRICS
from ablate.numerics.precision.bench import Bench, bench_of, shown_progress
from ablate.numerics.precision.errors import Frames, mean_errors
from ablate.ultrasound import Echoes, Iq, Simulator, simulators_of
from ablate.ultrasound.imaging.point_spread import blur, point_spread
from ablate.ultrasound.transport.surface_maps import ECHO_DB

FRAMES = 24
SHOWN = ("psnr", "mae", "mae_smooth")
_HAZE_ROWS = 9  # a longer echo is reverberation, as in `ablate.ultrasound.formula`


@cache
def bench() -> Bench:
    """Test frames of the data set of `make sweep`, which need not be simulated."""
    return bench_of(jobs_of(["preset=quick", "variant=full", f"evaluation.timed_frames={FRAMES}"])[0])


@cache
def simulator() -> Simulator:
    """The simulator of these frames."""
    return Simulator(bench().scene, bench().probe, bench().simulator, poses=bench().poses)


def everything(echoes: Echoes) -> Iq:
    """The frame itself."""
    return formed(echoes, echoes.scattered, echoes.surfaces)


def middle_layer(echoes: Echoes) -> Iq:
    """Of all layers the scatterers, of the middle one alone the sound that reaches them."""
    strength = (echoes.strength * echoes.weight[:, :, None]).sum(axis=0)
    return formed(echoes, strength * echoes.transmission[_middle(echoes)], echoes.surfaces)


def levels(echoes: Echoes) -> Iq:
    """The lattice of scatterers, and the mean level of the middle layer's tissue: not its texture."""
    return formed(echoes, _lattice(echoes), echoes.surfaces)


def map_of_echoes(echoes: Echoes) -> Iq:
    """Surfaces as the map of interfaces has them."""
    return formed(echoes, _lattice(echoes), _direct(echoes))


def other_phases(echoes: Echoes) -> Iq:
    """Reverberation with other phases."""
    other = simulator().echoes(echoes.pose, resimulation_seed(echoes.seed)).reverberation
    return formed(echoes, _lattice(echoes), _direct(echoes), other)


STEPS: dict[str, Callable[[Echoes], Iq]] = {
    "scatterers of all layers, sound of the middle one": middle_layer,
    "lattice and mean level of a tissue, not its texture": levels,
    "surfaces as in the map of interfaces": map_of_echoes,
    "reverberation with other phases": other_phases,
}


def formed(echoes: Echoes, scattered: np.ndarray, surfaces: np.ndarray, reverberation: np.ndarray | None = None) -> Iq:
    """What the point spread makes of amplitudes, (samples, scanlines) each; reverberation is out of focus."""
    parts = np.stack([scattered.T.real, scattered.T.imag]).astype(np.float32)
    spread = point_spread(echoes.probe, echoes.settings, torch.float32)
    real, imaginary = blur(parts, np.ascontiguousarray(surfaces.T, np.float32), spread)
    return Iq((real + 1j * imaginary).T + (echoes.reverberation if reverberation is None else reverberation))


def _middle(echoes: Echoes) -> int:
    return len(echoes.weight) // 2


def _lattice(echoes: Echoes) -> np.ndarray:
    """The lattice at the level of the middle layer's tissues and with its sound, (samples, scanlines)."""
    grain = simulator().grain(echoes.pose, echoes.seed)  # of both samples of a row
    lattice = grain.transpose(0, 2, 1).reshape(echoes.surfaces.shape)
    power = np.array([tissue.scatter_power for tissue in echoes.tissues])
    level = np.sqrt(power[echoes.labels[_middle(echoes)]]) * 10 ** (echoes.settings.scatterer_level_db / 20)
    received: np.ndarray = lattice * level * echoes.transmission[_middle(echoes)]
    return received


def _direct(echoes: Echoes) -> np.ndarray:
    """Amplitudes of surfaces from the map of interfaces, (samples, scanlines): what is short along a scanline."""
    shown = simulator().beam_maps(echoes.pose).interfaces
    zero_db, one_db = ECHO_DB
    amplitude = np.where(shown > 0, 10 ** ((zero_db + shown * (one_db - zero_db)) / 20), 0)
    haze = grey_opening(amplitude, (_HAZE_ROWS, 1))
    each = echoes.settings.samples_per_row
    white = echoes.settings.reference_level * 10 ** (-echoes.gain_db / 20)
    samples: np.ndarray = np.repeat(np.sqrt(amplitude**2 - haze**2), each, axis=0) / each * white[:, None]
    return samples


def main() -> None:
    """Render, compare, print."""
    frames = bench()
    assert frames.simulator.samples_per_row == 2, "the lattice that networks read has both samples of a row"

    def rendered(form: Callable[[Echoes], Iq]) -> Frames:
        make = simulators_of(f"__main__.{form.__name__}")
        renderer = make(frames.scene, frames.probe, frames.simulator, poses=frames.poses)
        images = [renderer.image(pose, frames.seed) for pose in shown_progress(frames.poses, form.__name__)]
        return Frames(np.stack(images))

    whole = Frames(np.stack([simulator().image(pose, frames.seed) for pose in frames.poses]))
    difference = rendered(everything).images.astype(int) - whole.images
    assert np.abs(difference).max() <= 1, "all that is known makes the frame itself, to within rounding"
    print("| known, each row less than the one above |", " | ".join(METRICS[name].title for name in SHOWN), "|")
    print("| --- |" + " --- |" * len(SHOWN))
    for words, form in STEPS.items():
        errors = mean_errors(rendered(form), whole, frames.probe)
        print(f"| {words} |", " | ".join(f"{errors[name]:.{METRICS[name].decimals}f}" for name in SHOWN), "|")


if __name__ == "__main__":
    main()
