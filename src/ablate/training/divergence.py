"""Notice soon that a training has failed, instead of spending hours on it."""

from __future__ import annotations

import math
from collections.abc import Mapping

# A discriminator that tells nothing has the loss of guessing, 2 ln 2; one that knows everything has none,
# and in minimax form teaches nothing either.
_GUESSING = 2 * math.log(2)
_TOLERANCE = 1e-6


class DivergenceError(RuntimeError):
    """Training has failed; the message says how and when."""


class DivergenceGuard:
    """Look at the mean losses of each logging interval.

    Parameters
    ----------
    patience : int
        Consecutive intervals of a dead discriminator before it is called dead.
    """

    def __init__(self, patience: int = 20) -> None:
        self.patience = patience
        self._dead = 0

    def check(self, metrics: Mapping[str, float], step: int) -> None:
        """Raise if training has failed.

        Raises
        ------
        DivergenceError
            Where a loss is not finite, or where the discriminator's has stayed at that of guessing, or at
            zero, to within 1e-6 for `patience` intervals.
        """
        for name, value in metrics.items():
            if not math.isfinite(value):
                raise DivergenceError(f"step {step}: {name} is {value}, the last checkpoint is from before")
        loss = metrics.get("train/loss_d", 1.0)
        is_dead = loss < _TOLERANCE or abs(loss - _GUESSING) < _TOLERANCE
        self._dead = self._dead + 1 if is_dead else 0
        if self._dead >= self.patience:
            what = "has won, its loss is 0" if loss < _TOLERANCE else "is guessing, its loss is 2 ln 2"
            raise DivergenceError(f"step {step}: the discriminator {what} for {self._dead} intervals of logging")
