"""The same sweep started several times at once."""

import random
import time
from functools import partial

from faults.bench import SWEEP, Bench, Fault, Round
from faults.commands import ablate
from faults.judge import differences

_WITHIN_S = 2.0  # the commands start at random moments of so long


def same_sweep(commands: int, bench: Bench, rng: random.Random, _: int) -> Round:
    """Start one command several times in a fresh folder of runs; wait for all."""
    runs = bench.place() / "runs"
    running = []
    for moment in _moments(commands, rng):
        time.sleep(moment)
        running.append(ablate([*SWEEP, f"runs_dir={runs}"], runs.parent))
    ended = [command.wait() for command in running]
    wrong = [f"exit code {each.code}: {each.said[-300:]}" for each in ended if each.code]
    tables = {each.said[each.said.find("re-simulation") :].partition("all metrics")[0] for each in ended}
    if len(tables) > 1 and not wrong:
        wrong.append("the commands print different comparisons")
    return Round(wrong or differences(runs, bench.unbroken))


def _moments(commands: int, rng: random.Random) -> list[float]:
    """How long to wait before each start."""
    moments = sorted(rng.uniform(0, _WITHIN_S) for _ in range(commands))
    return [b - a for a, b in zip([moments[0], *moments], moments, strict=False)]


_MUST = "all exit 0, one run a job, one comparison, scores equal to the bit"
FAULTS = (
    Fault("twice", "the same sweep twice at once", _MUST, partial(same_sweep, 2), 10, 1),
    Fault("eight", "the same sweep eight times at once", _MUST, partial(same_sweep, 8), 2, 0),
)
