"""Miniatures to scale: the levels and the crop that keep the paper's millimetres in a frame of fewer pixels.

The configuration reaches both as OmegaConf resolvers, which read the frame's rows from the job's own
`simulator.image_shape`: `${levels:4}` and `${crop:}`. That shape is `${fan_shape:256}`, the fan in so many rows,
or for pairs made elsewhere `${png_shape:}`.

Where networks know the scatterers, their noise is the lattice: `${noise:inject}` and, of U-Nets, `${noise:none}` with
`${extra_noise:}`.
"""

import math
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ablate.networks.spec import DEPTHS, ExtraInput, GeneratorSpec, Noise, Space
from ablate.training.settings import SMALLEST_CROP, Reconstruction, TrainingSettings
from ablate.ultrasound.probe import square_pixels
from ablate.ultrasound.settings import ConvexProbe, Probe, SimulatorSettings, probe_from

PAPER_SHAPE = SimulatorSettings().image_shape
PAPER_ROWS = PAPER_SHAPE[0]
PAPER_CROP = TrainingSettings().crop
_UNET_LEVELS = DEPTHS[-1]


def levels(at_paper: int, rows: int) -> int:
    """Levels of a network that has `at_paper` of them in the paper's frame: one less for every halving of its rows.

    A receptive field of depth d grows as 2^d px; it covers the same millimetres within a factor of sqrt(2)."""
    halvings = round(math.log2(PAPER_ROWS / max(rows, 1)))  # fewer rows than 1 are refused with the other settings
    return min(max(at_paper - halvings, DEPTHS[0]), DEPTHS[-1])


def paper_levels(depth: int, rows: int) -> int | None:
    """Levels in the paper's frame that are `depth` at this one; None where no network of the paper's frame is so deep.

    Where several are, in frames too small for a level less, it is that of SA2H or of the U-Net if it can be.
    """
    known = (GeneratorSpec.depth, DEPTHS[-1], *reversed(DEPTHS))
    return next((at_paper for at_paper in known if levels(at_paper, rows) == depth), None)


def crop(rows: int) -> int:
    """Side of the crop, px: the paper's share of the rows (0.512), in multiples of 2^levels of the U-Net."""
    unit = 2 ** levels(_UNET_LEVELS, rows)
    return max(round(rows * PAPER_CROP / PAPER_ROWS / unit) * unit, unit, SMALLEST_CROP)


def register_resolvers() -> None:
    """Make the names that conf/ uses between `${` and `}` known to OmegaConf."""
    resolvers: dict[str, Callable[..., Any]] = {
        "levels": lambda at_paper, *, _root_: levels(int(at_paper), _rows(_root_)),
        # the side of a crop of an image; in beam space 0, whole frames
        "crop": lambda *, _root_: 0 if str(_root_.model.space) == Space.beam else crop(_rows(_root_)),
        "noise": lambda by_pixel, *, _root_: str(Noise.body if _knows_scatterers(_root_) else by_pixel),
        "extra_noise": lambda *, _root_: str(ExtraInput.none if _knows_scatterers(_root_) else ExtraInput.noise),
        "png_shape": _png_shape,
        "home": _home,
        # an image of the probe's fan with so many rows and square pixels
        "fan_shape": lambda rows, *, _root_: list(square_pixels(_probe(_root_), int(rows))),
    }
    for name, resolver in resolvers.items():
        OmegaConf.register_new_resolver(name, resolver, replace=True)


def _knows_scatterers(root: DictConfig) -> bool:
    """Whether noise can be the lattice of scatterers: in beam space, of simulated frames, with a loss of one draw."""
    in_beam_space = str(root.model.space) == Space.beam
    is_of_one_draw = str(root.training.reconstruction) != Reconstruction.crps
    return in_beam_space and is_of_one_draw and str(root.scene.kind) != "pairs"


def _probe(root: DictConfig) -> Probe:
    """The probe of a configuration; where it is refused, which happens later and in one line, some other."""
    with suppress(ValueError):
        return probe_from({str(name): value for name, value in root.probe.items()})
    return ConvexProbe()


def _home(path: str) -> str:
    """A path with the user's home in place of a `~` at its beginning, and variables filled in, as settings have it."""
    return os.path.expandvars(os.path.expanduser(path))  # noqa: PTH111  # any text, as it is typed


def _png_shape(*, _root_: DictConfig) -> list[int]:
    """The size of the images in `scene.folder`; the paper's where there are none, as that folder is refused later."""
    from ablate.dataset import validate_png_folder

    with suppress(OSError, ValueError, TypeError):
        return list(validate_png_folder(_home(_root_.scene.folder)).shape)
    return list(PAPER_SHAPE)


def _rows(root: DictConfig) -> int:
    shape = root.simulator.image_shape
    return int(shape[0]) if len(shape) else 1  # an empty shape is refused with the other settings
