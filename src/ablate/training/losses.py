"""Errors of generated images, as means over the fan; and when the losses say that a training has failed."""

import math
from collections.abc import Mapping
from typing import NoReturn

import torch
from torch import Tensor

# The seeds of a batch lie below 2^62 (`Crops`), so with this bit no second draw repeats a first one.
_SECOND_DRAW = 1 << 62
# A discriminator that cannot tell real from fake has logits of 0 and the loss 2 ln 2. One that always can has the
# loss 0; in minimax form its gradient then vanishes too.
_GUESSING = 2 * math.log(2)
_LOSS_TOLERANCE, _LOGIT_TOLERANCE = 1e-6, 1e-2
_PATIENCE = 1000


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

    Examples
    --------
    >>> mean_in_fan(torch.tensor([1.0, 2.0, 9.0]), torch.tensor([1.0, 1.0, 0.0]))
    tensor(1.5000)
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


class DivergenceError(RuntimeError):
    """Training has failed; the message says how and when."""


class DivergenceGuard:
    """Look at the mean losses of intervals short enough to notice within an epoch that training has failed.

    `interval` is the number of steps between two checks: `log_every`, but at most half an epoch. Training is given up
    after `patience` checks in a row that find the discriminator dead. These are about 1000 steps, but at most an epoch
    from the step at which it died.
    """

    def __init__(self, log_every: int, epoch: int | None = None) -> None:
        self.interval = log_every if epoch is None else max(1, min(log_every, epoch // 2))
        within = _PATIENCE if epoch is None else min(_PATIENCE, epoch - self.interval)
        self.patience = max(1, within // self.interval)
        self._dead = 0

    def check(self, metrics: Mapping[str, float], step: int) -> None:
        """Raise DivergenceError if training has failed, judged by the means of `PairGAN.drain` over the interval.

        It has failed where a loss is not finite, or where the discriminator has guessed or known everything, to within
        1e-6 of its loss, for `patience` intervals. Without a discriminator, losses are only checked to be finite.
        """
        for name, value in metrics.items():
            if not math.isfinite(value):
                _give_up(step, f"{name} is {value}")
        if "train/loss_d" not in metrics:
            return
        loss = metrics["train/loss_d"]
        has_won = loss < _LOSS_TOLERANCE
        logits = max(abs(metrics["train/logit_real"]), abs(metrics["train/logit_fake"]))
        is_guessing = abs(loss - _GUESSING) < _LOSS_TOLERANCE and logits < _LOGIT_TOLERANCE
        self._dead = self._dead + 1 if has_won or is_guessing else 0
        if self._dead >= self.patience:
            what = "has won, its loss is 0" if has_won else "is guessing, its loss is 2 ln 2"
            _give_up(step, f"the discriminator {what} for {self._dead * self.interval} steps")


def _give_up(step: int, what: str) -> NoReturn:
    advice = "the last good checkpoint is kept; a lower training.learning_rate or another seed may help"
    raise DivergenceError(f"training has failed at step {step}: {what}; {advice}")
