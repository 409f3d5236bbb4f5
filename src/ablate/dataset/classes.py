"""What the pixels of exported segmentations are: tissues, as in S, or the structures of the scene."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ablate.anatomy import Scene, with_structures_as_tissues
from ablate.dataset.pairs import Pairs
from ablate.dataset.png_tables import MOST_LABELS
from ablate.ultrasound import Simulator


@dataclass(frozen=True)
class Classes:
    """Names of the labels 1, 2, ..., and a function that gives the labels of a frame by its number, (H, W) uint8."""

    names: tuple[str, ...]
    labels: Callable[[int], np.ndarray]


def by_tissue(pairs: Pairs) -> Classes:
    """The tissues, as S has them."""
    return Classes(tuple(pairs.tissues), lambda frame: pairs.stored("segmentation", frame))


def by_structure(pairs: Pairs, scene: Scene) -> Classes:
    """The structures of the scene that simulated pairs were made of; a ValueError where there are too many."""
    named = with_structures_as_tissues(scene)
    if len(named.tissues) > MOST_LABELS:
        found, most = len(named.tissues) - 1, MOST_LABELS - 1  # the background is a class too
        raise ValueError(f"dataset.classes=structures: {found} structures, allowed are at most {most}")
    if pairs.probe is None or pairs.simulator is None:
        raise ValueError(f"dataset.classes=structures: {pairs.folder} was not simulated, allowed is tissues")
    simulator = Simulator(named, pairs.probe, pairs.simulator, poses=pairs.poses)

    def labels(frame: int) -> np.ndarray:
        beam = simulator.beam_maps(pairs.poses[frame], of_surfaces=False)
        return pairs.converter.labels_to_image(beam.segmentation)

    return Classes(tuple(tissue.name for tissue in named.tissues), labels)
