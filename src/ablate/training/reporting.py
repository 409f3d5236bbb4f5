"""Reports of a training: metrics, a progress bar or lines of text, validation, and that it has failed."""

import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import torch
from lightning.pytorch import Callback, Trainer
from tqdm import tqdm

from ablate.networks import Generator
from ablate.training.module import PairGAN
from ablate.training.settings import TrainingSettings

# Takes metrics and the number of images seen; a Lightning logger's `log_metrics` is one.
MetricSink = Callable[[dict[str, float], int], None]
# Called with the generator to evaluate and the number of images seen; gives metrics.
Validation = Callable[[Generator, int], Mapping[str, float]]

_LOG = logging.getLogger(__name__)
_LINE = "{desc}: {percentage:3.0f}% of {total_fmt} steps, {remaining} left{postfix}"  # on a terminal
_LINES = 10  # about so many lines of the log in a training
# What a line shows of the metrics that there are.
_FORMATS = {
    "train/images_per_second": "{:.1f} images/s",
    "train/l1": "L1 {:.3f}",
    "train/crps": "CRPS {:.3f}",
    "train/loss_g": "G {:.2f}",
    "train/loss_d": "D {:.2f}",
    "train/noise_weight": "noise weight {:.3f}",
}
# Mean weight under which injected noise no longer shows in an image.
DYING_NOISE = 0.02


class DivergenceError(RuntimeError):
    """Training has failed; the message says how and when."""


class Report(Callback):
    """Send metrics every `log_every` steps, check them, and show progress; validate the generator to evaluate.

    The x axis is images seen, so that runs of different batch sizes compare. On a terminal there is one line that
    begins with `title` and is redrawn; the log has a line about every tenth of the run, marked `in_bar` where that line
    shows the same. Both say how much time is left.
    """

    def __init__(self, sink: MetricSink, validation: Validation | None = None, title: str = "") -> None:
        self.sink = sink
        self.validation = validation
        self.title = title
        self._bar: tqdm[Any] = tqdm(disable=True)

    def on_train_start(self, _trainer: Trainer, module: PairGAN) -> None:  # type: ignore[override]
        """Open the bar, start the clock, and validate the untrained network, where curves begin."""
        steps, done = module.settings.steps, module.steps_done
        # With `disable=None` it is shown on a terminal alone.
        self._bar = tqdm(None, self.title, steps, initial=done, disable=None, dynamic_ncols=True, bar_format=_LINE)
        self._since = self._began = time.perf_counter()
        self._first = done
        self._steps_timed = 0
        if module.steps_done == 0:
            self._validate(module)

    def on_train_batch_end(self, _trainer: Trainer, module: PairGAN, *_: Any) -> None:  # type: ignore[override]
        """Report and validate if it is time."""
        self._steps_timed += 1
        self._bar.update()
        if module.steps_done % module.settings.log_every == 0 or module.steps_done == module.settings.steps:
            self._report(module)
        self._validate(module)

    def on_train_end(self, *_: Any) -> None:
        """Close the bar."""
        self._bar.close()

    def on_exception(self, *_: Any) -> None:
        """Close the bar, so that what is said of the error has a line of its own."""
        self._bar.close()

    def _report(self, module: PairGAN) -> None:
        step = module.steps_done
        settings = module.settings
        metrics = module.drain()
        for name, value in metrics.items():
            if not math.isfinite(value):
                advice = "the last good checkpoint is kept; a lower training.learning_rate or another seed may help"
                raise DivergenceError(f"training has failed at step {step}: {name} is {value}; {advice}")
        now = time.perf_counter()
        metrics["train/images_per_second"] = self._steps_timed * settings.batch_size / (now - self._since)
        self._since = now
        self._steps_timed = 0
        magnitude = module.generator.noise_magnitude()
        if magnitude is not None:
            metrics["train/noise_weight"] = float(magnitude)
            if step == settings.steps:
                _warn_of_dying_noise(float(magnitude), settings)
        self.sink(metrics, step * settings.batch_size)
        text = ", ".join(form.format(metrics[name]) for name, form in _FORMATS.items() if name in metrics)
        self._bar.set_postfix_str(text)
        lines = step * _LINES // settings.steps
        lines_before = (step - settings.log_every) * _LINES // settings.steps
        if lines > lines_before or step == settings.steps:
            left = f", {self._left(step, settings.steps)} left" if step < settings.steps else ""
            _LOG.info("step %d of %d%s: %s", step, settings.steps, left, text, extra={"in_bar": not self._bar.disable})

    def _left(self, step: int, steps: int) -> str:
        """The time that the steps left take, at the pace since the start, such as 04:10."""
        seconds = (time.perf_counter() - self._began) / (step - self._first) * (steps - step)
        return str(tqdm.format_interval(round(seconds)))

    def _validate(self, module: PairGAN) -> None:
        every = module.settings.validate_every
        if self.validation is None or every == 0 or module.steps_done % every:
            return
        images_seen = module.steps_done * module.settings.batch_size
        began = time.perf_counter()
        modes = {part: part.training for part in module.evaluated.modules()}  # some may not train, as they were made
        with torch.no_grad():
            metrics = dict(self.validation(module.evaluated.eval(), images_seen))
        for part, mode in modes.items():
            part.training = mode
        self.sink(metrics, images_seen)
        self._since += time.perf_counter() - began  # `train/images_per_second` is of training alone


def _warn_of_dying_noise(weight: float, settings: TrainingSettings) -> None:
    """Warn at the end of a training that has taken the noise away, if it was long enough to bring it back."""
    furthest = settings.steps * settings.learning_rate  # Adam's steps are no longer than its rate
    if weight < DYING_NOISE <= furthest:
        _LOG.warning(
            "the mean weight of injected noise is %.3f after %d steps, under %s: the network hardly uses it; "
            "model.noise_start sets where it begins",
            weight,
            settings.steps,
            DYING_NOISE,
        )
