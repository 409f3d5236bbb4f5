"""Notice soon that a training has failed, instead of spending hours on it."""

import math
from collections.abc import Mapping
from typing import NoReturn

# A discriminator that cannot tell real from fake has logits of 0 and the loss 2 ln 2. One that always can has the
# loss 0; in minimax form its gradient then vanishes too.
_GUESSING = 2 * math.log(2)
_LOSS_TOLERANCE, _LOGIT_TOLERANCE = 1e-6, 1e-2
_PATIENCE = 1000


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
