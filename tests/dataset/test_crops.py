"""Crops depend on (seed, step, index) alone, touch the fan, and keep the maps of a pair together."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ablate.dataset import Crops, CropSettings, Pairs, create_pairs, crop_loader, fill_pairs

H, W = 40, 60
VALUES = np.linspace(-1, 1, 256).astype(np.float32)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    mask = np.zeros((H, W), bool)
    mask[5:30, 20:45] = True
    n = 6
    made = create_pairs(
        tmp_path_factory.mktemp("pairs"),
        np.zeros((n, 4, 4)),
        np.arange(n),
        np.zeros(n, np.uint8),
        mask,
        3,
        ["a"],
        {},
    )
    rng = np.random.default_rng(0)
    stack = rng.integers(1, 255, (n, H, W)) * mask

    def render(frames: np.ndarray, maps: frozenset[str]) -> dict[str, np.ndarray]:
        return {m: stack[frames] / 255 if m == "attenuation" else stack[frames] for m in maps}

    list(fill_pairs(made, frozenset({"segmentation", "attenuation", "high"}), render))
    return made


def crops(pairs: Pairs, **changes: object) -> Crops:
    settings = CropSettings(**{"size": 16, "batch_size": 2, **changes})  # type: ignore[arg-type]
    return Crops(pairs, np.arange(6), frozenset({"attenuation"}), VALUES, settings)


def test_a_resumed_loader_continues_where_the_other_was(pairs: Pairs) -> None:
    whole = list(crop_loader(crops(pairs, flip=True), 0, 8))
    rest = list(crop_loader(crops(pairs, flip=True), 5, 8))
    for a, b in zip(whole[5:], rest, strict=True):
        assert a.keys() == b.keys()
        assert all(torch.equal(a[k], b[k]) for k in a)


def test_another_seed_gives_other_crops(pairs: Pairs) -> None:
    a, b = crops(pairs)[0], crops(pairs, seed=1)[0]
    assert not torch.equal(a["image"], b["image"])


def test_maps_of_a_crop_belong_together(pairs: Pairs) -> None:
    for step in range(20):
        batch = crops(pairs, flip=True)[step]
        inside = batch["mask"] > 0
        grey = (batch["image"] + 1) * 127.5
        torch.testing.assert_close(grey[inside] / 255, batch["attenuation"][inside], atol=1e-4, rtol=0)
        torch.testing.assert_close(VALUES[grey[inside].round().int().numpy()], batch["segmentation"][inside].numpy())
        assert (batch["image"][~inside] == -1).all()


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_crops_touch_the_fan(pairs: Pairs, share: float) -> None:
    made = crops(pairs, fan_fraction=share)
    for step in range(50):
        fractions = made[step]["mask"].mean(dim=(1, 2, 3))
        assert (fractions > 0).all()
        assert (fractions >= share).all()


def test_a_crop_larger_than_the_frame_is_padded_as_outside(pairs: Pairs) -> None:
    batch = crops(pairs, size=64)[0]
    assert batch["image"].shape == (2, 1, 64, 64)
    assert (batch["mask"][:, :, H:] == 0).all()
    assert (batch["image"][:, :, H:] == -1).all()
    assert (batch["segmentation"][:, :, H:] == VALUES[0]).all()


def test_a_batch_larger_than_the_data_is_refused(pairs: Pairs) -> None:
    with pytest.raises(ValueError, match=r"training\.batch_size=7.*6 training frames"):
        crops(pairs, batch_size=7)
