"""How labels and grey levels become values in [-1, 1] for the networks, and attenuation 16 bits for the disk.

The order of the labels is a hidden component of such a study: in trials it moved PSNR by 0.5 to 4 dB, more than any
component under test. It is therefore chosen and recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from ablate.anatomy import Tissue, TissueKind, echogenicity_order
from ablate.dataset.split import Drawn
from ablate.networks.spec import GRAIN

if TYPE_CHECKING:
    from torch import Tensor

#: Grey levels a unit: 0 to 255 are -1 to 1.
HALF_RANGE = 127.5
#: What an attenuation of 1 is stored as.
ATTENUATION_SCALE = np.float32(65535)
_ATTENUATION_BITS = 9


class Encoding(StrEnum):
    """How labels become what the networks read.

    `echogenicity`: one number, from dark to bright by the built-in tissue table; `arbitrary`: one number, by an order
    drawn with the run's seed; `properties`: three numbers from the tissue table.
    """

    echogenicity = "echogenicity"
    arbitrary = "arbitrary"
    properties = "properties"


# Middle and half range of the properties.
_LEVEL_DB = (-20.0, 20.0)  # of the scatterers
_IMPEDANCE_MRAYL = (1.6, 0.2)


def label_values(tissues: Sequence[Tissue], encoding: Encoding, seed: int = 0) -> np.ndarray:
    """Values of every label, (len(tissues) + 1, channels) float32 in [-1, 1]; label 0 is outside the fan.

    `tissues` are `Scene.tissues`, behind labels 1, 2, ...; `seed` is that of `Encoding.arbitrary`. An order is one
    channel: -1 outside, the others equally spaced to 1. Properties are the level of the scatterers, in dB, the
    impedance and whether a tissue is bone, -1 outside; what is beyond their range has its end.
    """
    n = len(tissues)
    if Encoding(encoding) is Encoding.properties:
        outside = (-1.0, -1.0, -1.0)
        return np.clip([outside, *map(_properties, tissues)], -1, 1).astype(np.float32)
    if encoding == Encoding.echogenicity:
        rank = np.asarray(echogenicity_order(tissues))
    else:
        rank = np.random.default_rng([seed, Drawn.label_order]).permutation(n)
    return np.concatenate([[-1.0], -1 + 2 * (rank + 1) / n]).astype(np.float32)[:, None]


def _properties(tissue: Tissue) -> tuple[float, float, float]:
    """Level, impedance and kind of a tissue, of which usual ones lie in [-1, 1]."""
    level_db = 10 * np.log10(max(tissue.scatter_power, 1e-9))
    return (
        (level_db - _LEVEL_DB[0]) / _LEVEL_DB[1],
        (tissue.impedance_mrayl - _IMPEDANCE_MRAYL[0]) / _IMPEDANCE_MRAYL[1],
        1.0 if tissue.kind is TissueKind.bone else -1.0,
    )


def alike_labels(tissues: Sequence[Tissue], values: np.ndarray) -> list[str]:
    """A sentence for each group of labels whose `values`, of `label_values`, are equal: no network tells them apart."""
    names = ["outside the fan", *(tissue.name for tissue in tissues)]
    by_values: dict[tuple[float, ...], list[str]] = {}
    for name, row in zip(names, values.tolist(), strict=True):
        by_values.setdefault(tuple(row), []).append(name)
    return [f"The network reads the same for {' and '.join(alike)}." for alike in by_values.values() if len(alike) > 1]


def encode_grey_levels(levels: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Grey levels, uint8, as float32 in [-1, 1]."""
    out = np.divide(levels, np.float32(HALF_RANGE), out=out)
    out -= 1
    return out


_COUNTING: list[list[tuple[int, int]]] = []  # of the blocks that are open


@contextmanager
def counted_clipping() -> Iterator[list[tuple[int, int]]]:
    """Count, for every image that `decode_grey_levels` makes while the block is open, clipped pixels and the fan's."""
    counts: list[tuple[int, int]] = []
    _COUNTING.append(counts)
    try:
        yield counts
    finally:
        _COUNTING[:] = [others for others in _COUNTING if others is not counts]


def decode_grey_levels(image: Tensor, mask: Tensor) -> Tensor:
    """Floats in [-1, 1] as uint8 grey levels, (H, W); 0 outside `mask`.

    Values outside [-1, 1] become black or white; `counted_clipping` counts them. NaN or infinite ones are a ValueError.
    """
    import torch

    if not torch.isfinite(image).all():
        raise ValueError("the generator's output holds NaN or infinite values")
    fan = mask > 0
    grey = ((image.float() + 1) * HALF_RANGE * fan).round()
    for counts in _COUNTING:
        counts.append((int(torch.count_nonzero((grey < 0) | (grey > 255))), int(torch.count_nonzero(fan))))
    return grey.clamp(0, 255).to(torch.uint8)


def encode_attenuation(values: np.ndarray) -> np.ndarray:
    """Attenuation in [0, 1] as uint16, of which the 9 leading bits are kept: within 0.2 % or half a step of 65535.

    The bits below are noise to zstd and to nobody else; without them a frame of attenuation takes about half the
    space, and small values are as fine as before.
    """
    scaled = np.multiply(np.clip(values, 0, 1), ATTENUATION_SCALE, dtype=np.float32)
    share, power = np.frexp(scaled)  # scaled = share * 2 ** power
    kept = np.ldexp(np.floor(share * 2**_ATTENUATION_BITS + 0.5), power - _ATTENUATION_BITS)
    return np.rint(np.minimum(kept, ATTENUATION_SCALE)).astype(np.uint16)


def decode_attenuation(stored: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """The inverse of `encode_attenuation`, float32."""
    return np.divide(stored, ATTENUATION_SCALE, out=out, dtype=np.float32)


def grain_channels(grain: np.ndarray) -> np.ndarray:
    """Grain, (..., rows, scanlines, 2) complex64, as networks read it: (..., 4, rows, scanlines) float32.

    Real and imaginary part of the first value of each row, then of the second.
    """
    return np.moveaxis(grain.view(np.float32), -1, -3)


def network_inputs(maps: Mapping[str, np.ndarray], values: np.ndarray, mask: np.ndarray) -> dict[str, Tensor]:
    """Convert maps, (k, H, W) each, to what the networks read, (k, 1, H, W) float32 each.

    `maps` holds `segmentation` uint8, of which there are as many channels as `values`, (labels, channels) float32 of
    `label_values`, has; and, where they are wanted, `low` uint8, `grain` complex64, which becomes four channels, and
    the other maps as float32. Outside of `mask`, (H, W) or (k, H, W) bool, `low` is black.
    """
    import torch

    read = {name: value[:, None] for name, value in maps.items()}
    read["segmentation"] = np.ascontiguousarray(np.moveaxis(values[maps["segmentation"]], -1, -3))
    if GRAIN in maps:
        read[GRAIN] = np.ascontiguousarray(grain_channels(maps[GRAIN]))
    if "low" in maps:
        read["low"] = np.where(mask, encode_grey_levels(maps["low"]), np.float32(-1))[:, None]
    return {name: torch.from_numpy(value) for name, value in read.items()}
