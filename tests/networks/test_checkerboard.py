"""The pattern of period 2 px that up-sampling leaves before anything is learned, with `upsampling` on and off.

A transposed convolution of stride 2 computes the four pixels of a 2 x 2 cell with different taps of its kernel: 3x3
with 1, 2, 2 and 4 of them, 4x4 with 4 each (Odena et al., "Deconvolution and checkerboard artifacts", Distill 2016).
So the first weights of the texture-friendly block leave the stronger pattern, and its stride-1 convolution does not
remove it: white weights pass every frequency alike. After `resize` all pixels have the same 9 taps. What training makes
of it is measured (`nyquist_excess`).
"""

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from ablate.networks import Generator, GeneratorSpec, Upsampling
from ablate.networks.families import UpBlock
from ablate.networks.layers import draw_initial_weights

SIDE, BAND = 256, 5


def peak_db(images: Tensor) -> float:
    """Power at the three frequencies of a 2 x 2 pattern over that of their neighbours; (C, H, W), dB."""
    power = torch.fft.fft2(images - images.mean((-2, -1), keepdim=True)).abs().square().mean(0)
    middle = power.shape[-1] // 2
    near, low = slice(middle - 1 - BAND, middle - 1), slice(1, 1 + BAND)
    peak = power[middle, 0] + power[0, middle] + power[middle, middle]
    around = power[near, low].mean() + power[low, near].mean() + power[near, near].mean()
    return float(10 * torch.log10(peak / around))


@pytest.mark.parametrize(
    ("upsampling", "taps"),
    [
        (Upsampling.texture, ((1, 2), (2, 4))),
        (Upsampling.transposed, ((4, 4), (4, 4))),
    ],
)
def test_pixels_of_a_cell_follow_the_number_of_taps_that_make_them(
    upsampling: Upsampling, taps: tuple[tuple[int, int], tuple[int, int]]
) -> None:
    torch.manual_seed(0)
    block = UpBlock(64, 512, 0, GeneratorSpec(upsampling=upsampling))
    draw_initial_weights(block)
    with torch.no_grad():
        grown = F.relu(block.grow(torch.randn(1, 64, 64, 64)))[0, :, 2:-2, 2:-2]
    means = torch.stack([grown[:, i::2, j::2].mean() for i in (0, 1) for j in (0, 1)])
    # Sums of n independent terms have a standard deviation, and rectified a mean, that goes with sqrt(n).
    expected = np.sqrt(np.asarray(taps, float).ravel())
    np.testing.assert_allclose(means / means.mean(), expected / expected.mean(), rtol=0.02)


def test_the_peak_at_initialisation_with_the_component_on_and_off() -> None:
    labels = torch.randint(0, 8, (1, 1, 16, 16), generator=torch.Generator().manual_seed(0)) / 4.0 - 1
    segmentation = labels.repeat_interleave(SIDE // 16, -1).repeat_interleave(SIDE // 16, -2)
    attenuation = torch.linspace(1, 0.2, SIDE)[:, None].expand(1, 1, SIDE, SIDE)
    peaks: dict[Upsampling, list[float]] = {}
    for upsampling in Upsampling:
        for seed in range(4):
            torch.manual_seed(seed)
            generator = Generator(GeneratorSpec(upsampling=upsampling, width=0.25))
            with torch.no_grad():
                image = generator(segmentation, attenuation)[0]
            peaks.setdefault(upsampling, []).append(peak_db(image))
    on, off = (np.median(peaks[upsampling]) for upsampling in (Upsampling.texture, Upsampling.transposed))
    assert on > off + 3
    assert off > 3
    assert peak_db(torch.randn(16, SIDE, SIDE, generator=torch.Generator().manual_seed(0))) < 2
