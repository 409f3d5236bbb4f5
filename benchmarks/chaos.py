"""Small studies under faults, judged against an unbroken one: what is lost, doubled, mixed or left running.

make chaos ARGS="--minutes 60"             # the campaign; its table is kept in docs/reliability.md
python benchmarks/chaos.py --only kill,parent --minutes 5
python benchmarks/chaos.py --short         # a round or two of each cheap fault; `make test-all` does this

Faults take turns, so that all have had about the same time when it ends; a row says how often its fault was tried.
The same seed gives the same faults; when in a study they strike depends on the machine's speed too. With `--keep` each
round is noted below runs/chaos: the same call on the same commit goes on where it stopped. Calls with other faults or
seeds may run side by side; those with other seeds share the planned times of each fault.
"""

import argparse
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

from faults import at_once, canaries, changes, disks, inputs, kills, servers, stops, surroundings
from faults.bench import Bench, Fault, Round
from faults.commands import none_left_behind

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reliability.md"
BEGIN, END = "<!-- written by benchmarks/chaos.py: begin -->", "<!-- written by benchmarks/chaos.py: end -->"
KEPT = ROOT / "runs" / "chaos"  # <commit>-<seed>/<fault>.json
HEAD = ("fault", "done", "must reach", "reached", "verdict", "commit", "seeds")
_THEMES = (kills, changes, disks, inputs, canaries, stops, servers, at_once, surroundings)
FAULTS: tuple[Fault, ...] = tuple(fault for theme in _THEMES for fault in theme.FAULTS)


@dataclass
class Row:
    """What the rounds of a fault have found so far."""

    fault: Fault
    wanted: int
    rounds: int = 0
    done: int = 0
    seconds: float = 0.0
    wrong: list[str] = field(default_factory=list)
    failed: int = 0
    largest: dict[str, float] = field(default_factory=dict)
    is_over: bool = False

    @property
    def is_open(self) -> bool:
        return not self.is_over and self.done < self.wanted

    def cells(self, *last: str) -> tuple[str, ...]:
        """The row of the table; its last cells are the commit and the seeds."""
        measured = [f"at most {value:.1f} {name}" for name, value in self.largest.items()]
        first = re.sub(r"\s+", " ", self.wrong[0])[:160] if self.wrong else ""
        kept = [
            f"{self.rounds - self.failed} of {self.rounds} rounds as they must be",
            *measured,
            *([first] * bool(first)),
        ]
        whole = f"{self.done}" if self.is_over else f"{self.done} of {self.wanted}"
        verdict = "FAILED" if self.wrong else "holds" if self.done and not self.is_open else "holds so far"
        if not self.rounds:
            return self.fault.what, whole, self.fault.must_reach, "", "not tried", *last
        return self.fault.what, whole, self.fault.must_reach, "; ".join(kept), verdict, *last


def campaign(
    rows: Sequence[Row],
    bench: Bench,
    seed: int,
    seconds: float,
    most: int | None = None,
    notes: Path | None = None,
) -> None:
    """Try faults in turns, next the one that has had the least time, until all are done or the time is over.

    Of each fault there are at most `most` rounds. Each is noted in the folder `notes`; those that are noted beside it,
    with other seeds, count too.
    """
    ends = time.monotonic() + seconds

    def is_open(row: Row) -> bool:
        whole = of_all_seeds(row.fault, notes.parent, notes.name.partition("-")[0])[0] if notes else row
        return row.is_open and whole.is_open and (most is None or row.rounds < most)

    while (waiting := [row for row in rows if is_open(row)]) and time.monotonic() < ends:
        row = min(waiting, key=lambda row: row.seconds)
        bench.unbroken  # noqa: B018  # made before a clock runs
        began = time.monotonic()
        found = _round(row, bench, random.Random(f"{seed} {row.fault.name} {row.rounds}"))
        row.seconds += time.monotonic() - began
        row.rounds, row.done = row.rounds + 1, row.done + found.count
        row.is_over = found.is_last
        row.failed += bool(found.wrong)
        row.wrong += found.wrong
        for name, value in found.largest.items():
            row.largest[name] = max(value, row.largest.get(name, value))
        took = f"{time.monotonic() - began:.0f} s"
        print(f"{row.fault.name} {row.rounds}: {'; '.join(found.wrong) or 'as it must be'} ({took})", flush=True)
        if notes is not None:
            write_note(row, notes)


def _round(row: Row, bench: Bench, rng: random.Random) -> Round:
    """The next round of a row; one that fails itself is told as a fault that was not withstood."""
    try:
        return row.fault.round(bench, rng, row.rounds)
    except Exception as error:
        traceback.print_exc()
        return Round([f"{type(error).__name__}: {error}"])


def noted(fault: Fault, folder: Path) -> Row:
    """The row as `write_note` left it in a folder; one without rounds where there is none."""
    file = folder / f"{fault.name}.json"
    return Row(fault, fault.wanted, **json.loads(file.read_text("utf-8")) if file.exists() else {})


def write_note(row: Row, folder: Path) -> None:
    """Replace the note of a row, for `noted`."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{row.fault.name}.json"
    found = {name: value for name, value in asdict(row).items() if name not in ("fault", "wanted")}
    unfinished = file.with_suffix(".partial")
    unfinished.write_text(json.dumps(found), "utf-8")
    unfinished.replace(file)


def of_all_seeds(fault: Fault, folder: Path, code: str) -> tuple[Row, str]:
    """The rows of a fault that were noted below a folder for a commit, with any seed, as one row; and those seeds."""
    found = {f.name.partition("-")[2]: noted(fault, f) for f in sorted(folder.glob(f"{code}-*"))}
    rows = {seed: row for seed, row in found.items() if row.rounds}
    both = Row(fault, fault.wanted, is_over=any(row.is_over for row in rows.values()))
    for row in rows.values():
        both.rounds += row.rounds
        both.failed += row.failed
        both.wrong += row.wrong
        both.done += row.done
        both.largest |= {name: max(value, both.largest.get(name, value)) for name, value in row.largest.items()}
    return both, ", ".join(rows)


def table(rows: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in (HEAD, ["---"] * len(HEAD), *rows)
    )


def write_page(rows: Sequence[Sequence[str]], about: str) -> None:
    """Replace these rows in the table of the page; one that is complete is not replaced by one that is not, yet."""
    before, begin, rest = PAGE.read_text("utf-8").partition(BEGIN)
    kept, end, after = rest.partition(END)
    if not (begin and end):
        sys.exit(f"{PAGE} lacks the markers {BEGIN} and {END}")
    there = {line.split(" | ")[0].removeprefix("| "): line for line in kept.splitlines() if line.startswith("| ")}
    new = {row[0]: row for row in rows if row[4] != "holds so far" or " | holds | " not in there.get(row[0], "")}
    lines = [tuple(there[f.what].strip("| ").split(" | ")) if f.what in there else () for f in FAULTS]
    both = [new.get(f.what, line) for f, line in zip(FAULTS, lines, strict=True)]
    PAGE.write_text(f"{before}{BEGIN}\n\n{table([row for row in both if row])}\n\n{about}\n\n{END}{after}", "utf-8")


def commit() -> str:
    """The short name of the last commit that changed what is tried, with a + where files differ from it."""
    code = ("--", "src", "conf")

    def git(*arguments: str) -> str:
        return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True).stdout

    changed = git("status", "--porcelain", "--untracked-files=no", *code).strip()
    return git("log", "-1", "--format=%h", *code).strip() + "+" * bool(changed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; 1 where something was not as it must be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, help="at most so many of each fault")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help=f"of {', '.join(f.name for f in FAULTS)}; several with commas")
    parser.add_argument("--short", action="store_true", help="few rounds, of the cheap faults")
    parser.add_argument("--keep", action="store_true", help="write the rows into docs/reliability.md")
    parser.add_argument("--folder", type=Path, help="where the studies lie; a temporary one unless it is given")
    asked = parser.parse_args(arguments)
    chosen = asked.only.split(",") if asked.only else [fault.name for fault in FAULTS]
    if unknown := set(chosen) - {fault.name for fault in FAULTS}:
        parser.error(f"--only {','.join(sorted(unknown))}: allowed are {', '.join(f.name for f in FAULTS)}")
    code, faults = commit(), [fault for fault in FAULTS if fault.name in chosen]
    rows = [Row(f, f.short if asked.short else f.wanted) for f in faults]
    notes = None
    if asked.keep and not asked.short and not code.endswith("+"):  # what is in no commit has no name to go on with
        notes = KEPT / f"{code}-{asked.seed}"
        rows = [noted(fault, notes) for fault in faults]
    with tempfile.TemporaryDirectory(prefix="chaos-", dir=asked.folder) as folder, none_left_behind():
        campaign(rows, Bench(Path(folder)), asked.seed, 60 * asked.minutes, asked.rounds, notes)
    made = [row.cells(code, str(asked.seed)) for row in rows if row.rounds or not asked.short]
    print(f"\n{table(made)}")
    if asked.keep:
        from ablate.tracking import hardware

        if notes is not None:
            of_commit = [of_all_seeds(fault, KEPT, code) for fault in FAULTS]
            made = [row.cells(code, seeds) for row, seeds in of_commit if row.rounds]
        write_page(made, f"The last call was on {hardware()}.")
    return int(any(row.wrong for row in rows))


if __name__ == "__main__":
    sys.exit(main())
