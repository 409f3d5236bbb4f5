"""Thousands of damaged inputs, each read as the program reads it: refused in one line, or taken; nothing else."""

import json
import os
import random
import resource
import time
from pathlib import Path

from faults.attempts import KINDS
from faults.bench import Bench, Fault, Round
from faults.commands import start

_BATCH = 50
_MOST_S, _MOST_MB = 2.0, 500.0


def damaged(bench: Bench, rng: random.Random, number: int) -> Round:
    """Try a batch of damaged inputs of one kind in a process of its own."""
    place = bench.place()
    kind = sorted(KINDS)[number % len(KINDS)]
    (place / "beside.txt").write_text("nobody's business")
    ended = start(_batch, (kind, rng.getrandbits(32), bench.unbroken, place), place).wait()
    if ended.code:
        return Round([f"{kind}: the process ended with {ended.code}: {ended.said[-300:]}"])
    found = json.loads((place / "found.json").read_text("utf-8"))
    wrong = [f"{kind}: {line}" for line in found["wrong"]]
    beside = sorted(path.name for path in place.iterdir() if not path.name.startswith("said"))
    if (
        beside != ["beside.txt", "found.json", "in", "runs"]
        or (place / "beside.txt").read_text() != "nobody's business"
    ):
        wrong.append(f"{kind}: beside the runs there is now {beside}")
    measured = {
        "of computing to refuse one, s": found["seconds"],
        "more memory than the loaded program, MB": found["mb"],
    }
    if found["seconds"] > _MOST_S:
        wrong.append(f"{kind}: {found['seconds']:.1f} s of computing to refuse one")
    if found["mb"] > _MOST_MB:
        wrong.append(f"{kind}: {found['mb']:.0f} MB")
    return Round(wrong, _BATCH, measured)


def _batch(kind: str, seed: int, unbroken: Path, place: Path) -> None:
    from ablate.settings.study import ConfigurationError

    rng, wrong, longest = random.Random(seed), [], 0.0
    for folder in ("in", "runs"):
        (place / folder).mkdir()
    attempt = KINDS[kind](unbroken, place)
    os.chdir(place / "in")
    before = _resident_mb()
    for k in range(_BATCH):
        began = time.process_time()
        try:
            attempt(rng)
        except ConfigurationError as error:
            longest = max(longest, time.process_time() - began)
            if "\n" in str(error).strip() or len(str(error)) > 2000:
                wrong.append(f"input {k} of seed {seed}: not one line: {str(error)[:200]}")
        except Exception as error:
            import traceback

            traceback.print_exc()
            wrong.append(f"input {k} of seed {seed}: {type(error).__name__}: {str(error)[:200]}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = {"wrong": wrong, "seconds": longest, "mb": max(0.0, peak - before)}
    (place / "found.json").write_text(json.dumps(found))


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


FAULTS = (
    Fault(
        "inputs",
        "mutated scene.yaml, meshes, PNGs and their tables, npz, result.json, spec.json, names",
        "0 tracebacks, nothing outside `runs/`, at most 500 MB and 2 s to refuse",
        damaged,
        5000,
        8 * _BATCH,
    ),
)
