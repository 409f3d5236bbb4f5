"""Crops are windows of one frame that touch the fan, and depend on (seed, step, index) alone."""

import hashlib
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ablate.dataset import (
    CropLoader,
    Crops,
    CropSettings,
    DamagedShardError,
    Pairs,
    PlacedFrames,
    StoredAs,
    create_pairs,
    fill_pairs,
    network_inputs,
)
from ablate.networks import Space
from ablate.ultrasound import ConvexProbe, SimulatorSettings, compensated_attenuation

H, W, FRAMES = 40, 60, 6
MAPS = frozenset({"segmentation", "attenuation", "target"})
VALUES = np.linspace(-1, 1, 256, dtype=np.float32)[:, None]
PROBE, TGC = ConvexProbe(frequency_mhz=3.0), 0.4
SIMULATED = SimulatorSettings(tgc_db_cm_mhz=TGC)


@pytest.fixture(scope="module")
def stack() -> np.ndarray:
    mask = np.zeros((H, W), bool)
    mask[5:30, 20:45] = True
    return np.random.default_rng(0).integers(1, 255, (FRAMES, H, W)) * mask


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory, stack: np.ndarray) -> Pairs:
    folder, mask = tmp_path_factory.mktemp("pairs"), stack[0] > 0
    placed = PlacedFrames(np.zeros((FRAMES, 4, 4)), np.arange(FRAMES), np.zeros(FRAMES, np.uint8), mask)
    made = create_pairs(folder, placed, StoredAs(3, ["a"]), {})

    def render(frames: np.ndarray, maps: frozenset[str]) -> dict[str, np.ndarray]:
        return {m: stack[frames] / 255 if m == "attenuation" else stack[frames] for m in maps}

    list(fill_pairs(made, MAPS, render))
    return replace(made, probe=PROBE, simulator=SIMULATED)


def crops(pairs: Pairs, in_memory_bytes: int = 1 << 30, **changes: object) -> Crops:
    chosen = CropSettings(**{"size": 16, "batch_size": 2, **changes})  # type: ignore[arg-type]
    maps = frozenset({"attenuation", "compensated"})
    return Crops(pairs, np.arange(FRAMES), maps, VALUES, chosen, in_memory_bytes)


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[k], b[k]) for k in a)


@dataclass
class Numbered:
    """Frames in memory, whose attenuation is the number of the pixel: from a crop one sees where it was cut."""

    fan: np.ndarray
    frames: int
    folder: Path = Path("numbered")

    def mask(self, _: Space) -> np.ndarray:
        return self.fan

    def stored(self, name: str, frames: int | np.ndarray, _: Space = Space.image) -> np.ndarray:
        numbers = np.asarray(frames)[..., None, None]
        if name == "attenuation":
            pixels = (1 + np.arange(self.fan.size, dtype=np.uint16)).reshape(self.fan.shape)
            return 0 * numbers.astype(np.uint16) + pixels
        return np.where(self.fan, numbers + 1, 0).astype(np.uint8)


@st.composite
def fans(draw: st.DrawFn) -> np.ndarray:
    """A frame of any shape with a fan of any size somewhere in it, down to one pixel."""
    height, width = draw(st.integers(1, 70)), draw(st.integers(1, 70))
    top, left = draw(st.integers(0, height - 1)), draw(st.integers(0, width - 1))
    fan = np.zeros((height, width), bool)
    fan[top : top + draw(st.integers(1, height)), left : left + draw(st.integers(1, width))] = True
    return fan


@given(fans(), st.integers(1, 90), st.floats(0, 1), st.booleans(), st.integers(0, 2**40), st.integers(0, 2**40))
@settings(max_examples=100, deadline=None)
def test_any_crop_is_a_window_of_one_frame_that_touches_the_fan(
    fan: np.ndarray, size: int, share: float, flip: bool, seed: int, step: int
) -> None:
    chosen = CropSettings(size, 2, share, flip, seed)
    batch = Crops(Numbered(fan, 3), np.arange(3), frozenset({"attenuation"}), VALUES, chosen, 0)[step]  # type: ignore[arg-type]
    assert {v.shape for n, v in batch.items() if n != "noise_seed"} == {(2, 1, size, size)}
    height, width = fan.shape
    padded, inside = np.zeros((2, height + size, width + size), np.int64)
    padded[:height, :width] = Numbered(fan, 3).stored("attenuation", 0)
    inside[:height, :width] = fan
    for k in range(2):
        crop = {name: batch[name][k, 0].numpy() for name in ("attenuation", "mask", "target", "segmentation")}
        numbers = np.rint(crop["attenuation"] * np.float64(65535))
        row, column = np.argwhere(padded == numbers[numbers > 0].min())[0]
        assert row <= max(height - size, 0)  # the crop leaves the frame only where it is larger than the frame
        assert column <= max(width - size, 0)
        window = padded[row : row + size, column : column + size]
        if flip and not np.array_equal(window, numbers):
            numbers, crop = numbers[:, ::-1], {name: values[:, ::-1] for name, values in crop.items()}
        np.testing.assert_array_equal(numbers, window)
        mask = inside[row : row + size, column : column + size] > 0
        assert mask.any()
        np.testing.assert_array_equal(crop["mask"], mask)
        (grey,) = np.unique(np.rint((crop["target"][mask] + 1) * 127.5)).astype(int)
        assert grey in (1, 2, 3)
        assert (crop["target"][~mask] == -1).all()
        np.testing.assert_array_equal(crop["segmentation"], np.where(mask, VALUES[grey], VALUES[0]))


def test_compensated_attenuation_is_cut_from_what_whole_frames_are_read_as(pairs: Pairs) -> None:
    numbers = np.arange(FRAMES)
    frames = {name: pairs.read(name, numbers) for name in ("segmentation", "attenuation", "compensated")}
    fed = network_inputs(frames, VALUES, pairs.mask())["compensated"][:, 0].numpy()
    np.testing.assert_allclose(fed, compensated_attenuation(frames["attenuation"], PROBE, TGC), atol=0.6 / 65535)
    assert len(np.unique(fed)) > 100
    for crop in crops(pairs, size=64)[0]["compensated"][:, 0].numpy():  # larger than a frame
        assert any(np.array_equal(crop, np.pad(frame, ((0, 64 - H), (0, 64 - W)))) for frame in fed)


def test_compensated_attenuation_of_frames_from_elsewhere_is_refused(pairs: Pairs) -> None:
    with pytest.raises(ValueError, match="compensated attenuation needs the probe and the TGC of the simulation"):
        replace(pairs, probe=None).read("compensated", [0])


def test_crops_are_cut_everywhere_and_from_every_frame() -> None:
    fan = np.ones((19, 23), bool)
    made = Crops(Numbered(fan, 3), np.arange(3), frozenset({"attenuation"}), VALUES, CropSettings(16, 3, 0.0, True), 0)  # type: ignore[arg-type]
    seen = set()
    for step in range(1000):
        batch = made[step]
        for k in range(3):
            first, last = batch["attenuation"][k, 0, 0, 0], batch["attenuation"][k, 0, 0, -1]
            corner = round(float(min(first, last)) * 65535) - 1
            seen.add((divmod(corner, 23), bool(first > last), float(batch["target"][k].max())))
    assert len(seen) == 4 * 8 * 2 * 3  # rows x columns x mirrored x frames


def test_a_crop_depends_on_seed_step_and_index_and_on_nothing_else(pairs: Pairs) -> None:
    made = crops(pairs, flip=True, batch_size=3)
    batches = [made[step] for step in (5, 0, 7, 5)]
    assert same(batches[0], batches[3])
    assert same(crops(pairs, in_memory_bytes=0, flip=True, batch_size=3)[5], batches[0])
    fewer = crops(pairs, flip=True, batch_size=2)[5]
    assert same(fewer, {k: v[:2] for k, v in batches[0].items()})
    seeded = [crops(pairs, flip=True, batch_size=3, seed=seed) for seed in range(3)]
    several = [of_seed[step] for of_seed in seeded for step in range(30)]
    noise = torch.cat([batch["noise_seed"] for batch in several])
    assert len(noise.unique()) == len(noise)
    windows = torch.cat([batch["target"] for batch in several]).flatten(1)
    assert len(windows.unique(dim=0)) > 0.9 * len(windows)


@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("in_memory_bytes", [0, 3 * H * W * 6, 1 << 30])  # none, three and all of the frames
def test_a_resumed_loader_continues_where_the_other_was(pairs: Pairs, workers: int, in_memory_bytes: int) -> None:
    made = crops(pairs, flip=True)
    whole = [made[step] for step in range(20)]
    rest = CropLoader(crops(pairs, in_memory_bytes, flip=True), 5, 20, workers)
    assert all(same(a, b) for a, b in zip(whole[5:], rest, strict=True))


def test_a_loader_that_is_left_leaves_no_thread(pairs: Pairs) -> None:
    before = set(threading.enumerate())
    batches = iter(CropLoader(crops(pairs), 0, 1000, 2))
    next(batches)
    assert set(threading.enumerate()) > before
    batches.close()  # type: ignore[attr-defined]
    assert set(threading.enumerate()) <= before


def test_batches_are_prepared_while_one_is_in_use_and_not_more_than_asked_for() -> None:
    """With two workers, the batch that is in use has two others behind it, and none before anybody asks."""
    made: list[int] = []
    third = threading.Event()

    class Counted:
        def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
            made.append(step)
            if len(made) == 3:
                third.set()
            return {"step": torch.tensor(step)}

    batches = iter(CropLoader(Counted(), 7, 20, 2))  # type: ignore[arg-type]
    assert made == []
    assert next(batches)["step"] == 7
    assert third.wait(10)
    assert sorted(made) == [7, 8, 9]
    assert [int(batch["step"]) for batch in batches] == list(range(8, 20))
    assert sorted(made) == list(range(7, 20))


def test_what_a_thread_raises_is_raised_by_the_loader(pairs: Pairs, monkeypatch: pytest.MonkeyPatch) -> None:
    made = crops(pairs)

    def full(*_: object) -> None:
        raise MemoryError("no more")

    monkeypatch.setattr(made, "_cut", full)
    with pytest.raises(MemoryError, match="no more"):
        next(iter(CropLoader(made, 0, 5, 1)))


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_crops_hold_the_share_of_the_fan_that_is_asked_for(pairs: Pairs, share: float) -> None:
    made = crops(pairs, fan_fraction=share)
    for step in range(50):
        fractions = made[step]["mask"].mean(dim=(1, 2, 3))
        assert (fractions > 0).all()
        assert (fractions >= share).all()


def test_a_damaged_shard_stops_the_loader_with_its_name(tmp_path: Path, pairs: Pairs) -> None:
    placed = PlacedFrames(pairs.poses, pairs.sites, pairs.split, pairs.mask())
    made = create_pairs(tmp_path, placed, StoredAs(3, ["a"]), {})
    list(fill_pairs(made, MAPS, lambda frames, maps: {m: np.ones((len(frames), H, W)) for m in maps}))
    file = made.shard_file("target", 1)
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(DamagedShardError, match=r"'target' of frames 3 to 5.*task=simulate"):
        list(CropLoader(crops(replace(made, probe=PROBE, simulator=SIMULATED), in_memory_bytes=0), 0, 50, 2))


def test_what_cannot_be_cropped_is_refused(pairs: Pairs) -> None:
    with pytest.raises(ValueError, match=r"training\.batch_size=7.*6 training frames"):
        crops(pairs, batch_size=7)


def test_a_batch_is_what_it_was(pairs: Pairs) -> None:
    """Crops are windows and quotients of whole numbers, so every processor gives the same bits."""
    batch = Crops(
        pairs, np.arange(FRAMES), frozenset({"attenuation"}), VALUES, CropSettings(size=16, batch_size=2, flip=True)
    )[3]
    digest = hashlib.sha256(b"".join(name.encode() + batch[name].numpy().tobytes() for name in sorted(batch)))
    assert digest.hexdigest()[:16] == "8daa2bdb90360cb5", (
        "the same settings now cut other crops: raise TRAINING_VERSION in ablate/training/settings.py, so that no "
        "stored run goes on with this code, and pin this digest"
    )
