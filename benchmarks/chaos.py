"""A small sweep under faults, compared with the same sweep undisturbed: is anything lost, doubled or changed?

make chaos ARGS="--minutes 60"
python benchmarks/chaos.py --only kill,disk --rounds 5

Faults take turns. The same seed gives the same faults; when in a sweep they strike depends on the machine's speed too.
The printed table is the one of docs/reliability.md. The exit status is 1 if something was not as it must be.
"""

import argparse
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

from faults import Bench, at_once, damaged, disk_full, killed


@dataclass(frozen=True)
class Fault:
    """A row of the table; `round` takes the bench, random numbers and its number, and says what is wrong."""

    what: str
    must_reach: str
    round: Callable[[Bench, random.Random, int], list[str]]


FINISHED = "the same command finishes, scores equal to the bit, each value in MLflow once"
FAULTS = {
    "kill": Fault("SIGKILL of all processes at up to 4 random moments of a sweep", FINISHED, killed),
    "disk": Fault(
        "0 to 2 MB free in the folder of runs, then enough",
        f"no finished file changed, no traceback; then {FINISHED}",
        disk_full,
    ),
    "twice": Fault("the same sweep twice at once", "both exit 0, scores equal to the bit, each run once", at_once),
    "damage": Fault(
        "bytes of a file of a finished sweep changed, then as they were",
        f"no traceback; then {FINISHED}",
        damaged,
    ),
}


def campaign(names: Sequence[str], bench: Bench, seed: int, seconds: float, rounds: int) -> dict[str, list[list[str]]]:
    """Try faults in turns until the time is over or each had its rounds; what was wrong in each round, by fault."""
    found: dict[str, list[list[str]]] = {name: [] for name in names}
    ends = time.monotonic() + seconds
    for number in range(rounds):
        for name in names:
            if time.monotonic() > ends:
                return found
            wrong = FAULTS[name].round(bench, random.Random(f"{seed} {name} {number}"), number)
            print(f"{name} {number + 1}: {'; '.join(wrong) or 'as it must be'}", flush=True)
            found[name].append(wrong)
    return found


def table(found: dict[str, list[list[str]]]) -> str:
    """Markdown."""
    lines = ["| fault | must reach | rounds as they must be |", "| --- | --- | --- |"]
    for name, rounds in found.items():
        right = sum(not wrong for wrong in rounds)
        lines.append(f"| {FAULTS[name].what} | {FAULTS[name].must_reach} | {right} of {len(rounds)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=1000, help="at most so many of each fault")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default=",".join(FAULTS), help="some of them, with commas")
    parser.add_argument("--folder", type=Path, help="where the sweeps lie; a temporary one unless it is given")
    asked = parser.parse_args(arguments)
    names = asked.only.split(",")
    if unknown := set(names) - FAULTS.keys():
        parser.error(f"--only {','.join(sorted(unknown))}: allowed are {', '.join(FAULTS)}")
    with tempfile.TemporaryDirectory(prefix="chaos-", dir=asked.folder) as folder:
        found = campaign(names, Bench(Path(folder)), asked.seed, 60 * asked.minutes, asked.rounds)
    print(f"\n{table(found)}")
    return int(any(wrong for rounds in found.values() for wrong in rounds))


if __name__ == "__main__":
    sys.exit(main())
