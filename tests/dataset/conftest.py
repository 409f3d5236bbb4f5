"""A scene that renders in milliseconds, and data sets to fill with it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.dataset import Pairs, Part, PlacedFrames, Recipe, StoredAs, create_pairs
from ablate.networks import Space
from ablate.ultrasound import ConvexProbe, SimulatorSettings, fan_mask

Blank = Callable[..., Pairs]
Contents = Callable[[Path], dict[str, bytes]]


@pytest.fixture(scope="session")
def recipe() -> Recipe:
    """A ball of tissue in gel."""
    tissue = Tissue("tissue", 1540, 1.6, 0.5, 0.6, 0.0, 1.0)
    mesh = trimesh.creation.icosphere(2, 40.0)
    mesh.apply_translation((0, 0, 60))
    scene = Scene((Structure(mesh, tissue),), Tissue("gel", 1540, 1.5, 0.1, 0.1, 0.0, 0.2), "ball")
    settings = SimulatorSettings(scanlines=16, axial_samples=128, rays=2, layers=1, image_shape=(48, 66))
    return Recipe(scene, ConvexProbe(), settings, seed=3)


@pytest.fixture(scope="session")
def blank(recipe: Recipe) -> Blank:
    """`blank(folder, frames, shard)` lays out an empty data set of `recipe`; its last four frames are unseen."""

    def lay_out(folder: Path, frames: int, shard: int) -> Pairs:
        poses = np.tile(np.eye(4), (frames, 1, 1))
        poses[:, 0, 3] = np.linspace(-10, 10, frames)
        split = np.full(frames, Part.train, np.uint8)
        split[-4:] = Part.validation, Part.validation, Part.test, Part.test
        mask = fan_mask(recipe.probe, recipe.settings.image_shape)
        placed = PlacedFrames(poses, np.arange(frames), split, mask)
        stored_as = StoredAs(shard, ["gel", "tissue"], Space.beam, recipe.probe, recipe.settings.beam_shape)
        return create_pairs(folder, placed, stored_as, {"made": "so"})

    return lay_out


@pytest.fixture(scope="session")
def contents() -> Contents:
    """`contents(folder)`: every file of a data set but its locks."""

    def read(folder: Path) -> dict[str, bytes]:
        files = [p for p in folder.rglob("*") if p.is_file() and p.suffix != ".lock"]
        return {str(p.relative_to(folder)): p.read_bytes() for p in files}

    return read
