"""How far a generated image is from its target, as a mean over the fan: of one image, or of two draws of noise."""

import torch
from torch import Tensor

# The seeds of a batch lie below 2^62 (`Crops`), so with this bit no second draw repeats a first one.
_SECOND_DRAW = 1 << 62


def mean_in_fan(values: Tensor, mask: Tensor) -> Tensor:
    """Average over the fan of a whole batch: every pixel of a fan weighs the same, however much of a crop it fills.

    Parameters
    ----------
    values : (N, 1, H, W) float
        For example errors; what lies outside the fan does not count.
    mask : (N, 1, H, W) float
        1 in the fan, else 0.

    Returns
    -------
    () float
        0 where no pixel of the batch lies in the fan.
    """
    return (values * mask).sum() / mask.sum().clamp(min=1)


def crps_of_two_draws(first: Tensor, second: Tensor, target: Tensor) -> Tensor:
    """Estimate the continuous ranked probability score of each pixel from two draws, in the unit of the images.

    (|x1 - y| + |x2 - y|) / 2 - |x1 - x2| / 2 is the fair (unbiased) estimate for an ensemble of two. Its expectation is
    smallest where the draws have the distribution of the target, so draws gain by their spread. For draws that are
    alike it is the absolute error.

    Notes
    -----
    Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", JASA 2007, equation 21; Ferro,
    "Fair scores for ensemble forecasts", QJRMS 2014. Bendel, Ahmad and Schniter, "A regularized conditional GAN for
    posterior sampling in image recovery problems", NeurIPS 2023, train a conditional GAN with two draws.
    """
    return ((first - target).abs() + (second - target).abs() - (first - second).abs()) / 2


def second_seeds(noise_seed: Tensor) -> Tensor:
    """Derive the seeds of the second draw from those of the first, (N,) int64 both."""
    return torch.bitwise_xor(noise_seed, _SECOND_DRAW)
