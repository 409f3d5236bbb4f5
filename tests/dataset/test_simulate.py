"""Pairs by the real path: what the simulator renders, and no more of it than is missing."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from skimage.io import imread
from skimage.transform import resize

from ablate.dataset import Pairs, Part, Recipe, simulate_pairs, write_contact_sheet
from ablate.dataset.simulate import nudged, timed_maps
from ablate.dataset.split import resimulation_seed
from ablate.networks import Space
from ablate.ultrasound import Display, Simulator

Blank = Callable[..., Pairs]
Contents = Callable[[Path], dict[str, bytes]]
MAPS = frozenset({"segmentation", "attenuation", "target", "resimulation"})


@pytest.fixture
def pairs(tmp_path: Path, blank: Blank) -> Pairs:
    return blank(tmp_path / "set", 7, 3)


@pytest.mark.parametrize("angles", [1, 3])
def test_the_maps_are_those_of_the_simulator(pairs: Pairs, recipe: Recipe, angles: int) -> None:
    """The low-quality image is of one angle, as it is of one ray."""
    recipe = replace(recipe, settings=replace(recipe.settings, compound_angles=angles))
    assert simulate_pairs(recipe, pairs, MAPS | {"low", "interfaces", "illumination", "compound"}, 1) == 7
    simulator = Simulator(recipe.scene, recipe.probe, recipe.settings)
    low = Simulator(recipe.scene, recipe.probe, replace(recipe.settings, rays=1, layers=1, compound_angles=1))
    for i, pose in enumerate(pairs.poses):
        frame = simulator.render(pose, seed=recipe.seed)
        np.testing.assert_array_equal(pairs.stored("target", i), frame.image)
        np.testing.assert_array_equal(pairs.stored("segmentation", i, Space.beam), frame.beam.segmentation)
        assert (pairs.stored("segmentation", i) != frame.segmentation).mean() < 0.02  # of the nearest sample
        for name in ("interfaces", "illumination"):
            stored = pairs.read(name, [i], Space.beam)[0]
            np.testing.assert_allclose(stored, getattr(frame.beam, name), atol=0.51 / 255)
        np.testing.assert_allclose(pairs.read("attenuation", [i])[0], frame.attenuation, rtol=2**-9, atol=1e-5)
        of_angles = simulator.beam_maps(pose, of_surfaces=False, of_angles=True).compound
        np.testing.assert_allclose(pairs.read("compound", [i], Space.beam)[0], of_angles, rtol=2**-9, atol=1e-5)
        np.testing.assert_array_equal(pairs.stored("low", i), low.render(pose, seed=recipe.seed).image)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_times_of_a_frame_s_maps_add_up_though_some_are_made_side_by_side(recipe: Recipe, threads: int) -> None:
    torch.set_num_threads(threads)
    try:
        settings = replace(recipe.settings, scanlines=128, axial_samples=2048, layers=3)
        names = ["segmentation", "interfaces", "illumination"]
        make = timed_maps(recipe.scene, recipe.probe, settings, np.eye(4)[None])
        for number in range(12):
            start = time.perf_counter()
            _, ms = make(nudged(np.eye(4), number), 0, names, Space.beam)
            whole = 1e3 * (time.perf_counter() - start)
            assert list(ms) == names
            assert min(ms.values()) >= 0
            assert sum(ms.values()) <= whole
    finally:
        torch.set_num_threads(1)


def test_resimulation_has_other_scatterers_and_other_paths(pairs: Pairs, recipe: Recipe) -> None:
    simulate_pairs(recipe, pairs, frozenset({"target", "resimulation"}), 1)
    settings = replace(recipe.settings, path_seed=resimulation_seed(recipe.settings.path_seed))
    same_paths, other_paths = (Simulator(recipe.scene, recipe.probe, s) for s in (recipe.settings, settings))
    again = resimulation_seed(recipe.seed)
    for i in np.flatnonzero(pairs.split != Part.train):
        stored, pose = pairs.stored("resimulation", i), pairs.poses[i]
        np.testing.assert_array_equal(stored, other_paths.render(pose, seed=again).image)
        assert (stored != pairs.stored("target", i)).mean() > 0.3
        assert (stored != other_paths.render(pose, seed=recipe.seed).image).mean() > 0.3, "other scatterers"
        assert (stored != same_paths.render(pose, seed=again).image).any(), "other paths"


def test_only_what_is_missing_is_rendered(
    pairs: Pairs, recipe: Recipe, contents: Contents, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulate_pairs(recipe, pairs, MAPS, 1)
    before = contents(pairs.folder)
    rendered: list[tuple[int, int]] = []
    render = Simulator._image

    def watched(
        self: Simulator, pose: np.ndarray, seed: int, display: Display | None
    ) -> tuple[np.ndarray, torch.Tensor]:
        rendered.append((self.settings.rays, seed))
        return render(self, pose, seed, display)

    monkeypatch.setattr(Simulator, "_image", watched)
    simulate_pairs(recipe, pairs, MAPS, 1)
    assert rendered == []
    pairs.shard_file("segmentation", 1).unlink()
    simulate_pairs(recipe, pairs, MAPS, 1)
    assert rendered == []  # the maps alone need no rays
    simulate_pairs(recipe, pairs, MAPS | {"low"}, 1)
    assert rendered == [(1, recipe.seed)] * 7
    assert before.items() <= contents(pairs.folder).items()


def test_the_contact_sheet_shows_frames_of_each_part_above_their_segmentations(pairs: Pairs, recipe: Recipe) -> None:
    simulate_pairs(recipe, pairs, MAPS, 1)
    write_contact_sheet(pairs, pairs.folder / "sheet.png")
    sheet = imread(pairs.folder / "sheet.png")
    rows, columns = 2 * len(Part), 8
    height, width = ((sheet.shape[k] - 4) // n - 4 for k, n in enumerate((rows, columns)))
    assert sheet.shape == (rows * (height + 4) + 4, columns * (width + 4) + 4, 3)
    for k, part in enumerate(Part):
        first = pairs.frames(part)[0]
        image, below = (sheet[4 + row * (height + 4) :][:height, 4 : 4 + width] for row in (2 * k, 2 * k + 1))
        shown = resize(pairs.stored("target", first), (height, width), preserve_range=True, anti_aliasing=True)
        np.testing.assert_allclose(image, np.repeat(shown[..., None], 3, axis=2), atol=1.01)
        assert (np.ptp(below.astype(int), axis=2) > 0).any(), "labels have colours"
