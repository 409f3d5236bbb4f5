"""Full frames: black outside the fan, the seed's noise, grey levels as the images have them."""

import numpy as np
import pytest
import torch

from ablate.dataset import decode_grey_levels
from ablate.networks import Generator
from ablate.training import TrainingPrecision, generate
from support.tiny_training import SPEC, batch


@pytest.fixture
def generator() -> Generator:
    torch.manual_seed(0)
    return Generator(SPEC).eval()


@pytest.mark.parametrize("precision", [TrainingPrecision.fp32, TrainingPrecision.bf16])
def test_frames(generator: Generator, precision: TrainingPrecision) -> None:
    given = batch(0)
    maps = {name: value[..., :30, :27] for name, value in given.items() if name != "noise_seed"}
    frames = generate(generator, maps, maps["mask"], given["noise_seed"], precision)
    assert frames.shape == (2, 30, 27)
    assert frames.dtype == np.uint8
    assert not frames[maps["mask"][:, 0].numpy() == 0].any()
    assert frames[maps["mask"][:, 0].numpy() == 1].any()
    again = generate(generator, maps, maps["mask"][0, 0].bool(), given["noise_seed"], precision)
    np.testing.assert_array_equal(frames, again)
    masks = torch.ones(2, 30, 27) * torch.tensor([1, 0])[:, None, None]
    masks[0, :9] = 0
    fans = generate(generator, maps, masks, given["noise_seed"], precision) > 0  # no pixel of this generator is black
    np.testing.assert_array_equal(fans, masks > 0)
    other = generate(generator, maps, maps["mask"], given["noise_seed"] + 1, precision)
    assert (frames != other).any()


def test_threads_change_no_frame(generator: Generator) -> None:
    given = batch(0)
    maps = {name: torch.cat([value] * 3) for name, value in given.items() if name != "noise_seed"}
    seeds = torch.arange(6)
    images = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            images.append(generate(generator, maps, maps["mask"], seeds, TrainingPrecision.fp32))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(1)
    np.testing.assert_array_equal(*images)
    one = {name: value[4:5] for name, value in maps.items()}
    alone = generate(generator, one, one["mask"], seeds[4:5], TrainingPrecision.fp32)
    np.testing.assert_array_equal(images[0][4], alone[0])


def test_grey_levels_round_trip_and_end_at_0_and_255() -> None:
    levels = torch.arange(256, dtype=torch.uint8)[None]
    everywhere = torch.ones_like(levels)
    assert torch.equal(decode_grey_levels(levels.float() / 127.5 - 1, everywhere), levels)
    assert not decode_grey_levels(torch.ones(1, 4), torch.zeros(1, 4)).any()


def test_a_missing_map_is_named(generator: Generator) -> None:
    with pytest.raises(KeyError, match="attenuation"):
        generate(generator, {"segmentation": batch(0)["segmentation"]}, torch.ones(32, 32), None)


def test_masks_and_maps_that_do_not_fit_and_training_mode_are_refused(generator: Generator) -> None:
    given = batch(0)
    maps, seeds = {name: value for name, value in given.items() if name != "noise_seed"}, given["noise_seed"]
    for mask in (maps["mask"][..., :1], maps["mask"][:1], maps["mask"].repeat(1, 2, 1, 1), torch.ones(3, 32, 32)):
        with pytest.raises(
            ValueError, match=r"mask: shape .*, allowed is that of the maps, or one of \(H, W\) for all"
        ):
            generate(generator, maps, mask, seeds)
    raw = maps | {"segmentation": maps["segmentation"].to(torch.uint8)}
    for precision in (TrainingPrecision.fp32, TrainingPrecision.bf16):
        with pytest.raises(ValueError, match=r"segmentation: torch\.uint8, allowed are floats"):
            generate(generator, raw, maps["mask"], seeds, precision)
    with pytest.raises(ValueError, match="generator: in training mode"):
        generate(generator.train(), maps, maps["mask"], seeds)
