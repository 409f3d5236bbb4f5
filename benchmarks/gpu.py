"""Everything that a GPU is needed for, in half an hour of one: tests, times, a small study. docs/gpu.md tells how.

python benchmarks/gpu.py carry carried                # where the project is installed: writes what travels
python benchmarks/gpu.py run carried gpu-results      # on the machine with the GPU, once or in pieces

`run` needs no network, neither Embree nor Numba, and no MLflow, Hydra, Zarr or trimesh. It measures, in this order:
(a) the tests of the suite that need a GPU; (b) the image of the signal chain against the CPU's, and its stages;
(c) images a second of a training at the paper's size, against a plain loop and the rate of bf16 matrix products;
(d) a generated frame at the paper's size; (e) the study of docs/study.md at 512 x 710; (f) SA2H against SA2H-att at
the paper's size in the minutes that are left. Whatever stops it, the same command goes on behind the last finished
measurement; a machine that starts empty each time needs the results so far copied to it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src"))
from ablate.tracking import hardware  # noqa: E402
from ablate.training import chosen_device  # noqa: E402
from gpu_carried import Carried, make_carried  # noqa: E402
from gpu_parts import Place, measure, names  # noqa: E402
from gpu_results import HEAD, add_rows, draw, read_rows  # noqa: E402

_LEAST_S = 20  # that a measurement is begun with
_FAILED = "failed"


def carry(arguments: argparse.Namespace) -> None:
    """Write what travels, and say how large it is."""
    make_carried(arguments.carried, arguments.study_frames, arguments.paper_frames, arguments.tiny)
    size = sum(file.stat().st_size for file in arguments.carried.rglob("*") if file.is_file())
    print(f"{arguments.carried}: {size / 2**20:.0f} MiB")


def run(arguments: argparse.Namespace) -> None:
    """Measure what is missing, one process a measurement, until the time is up."""
    end = time.monotonic() + 60 * arguments.minutes
    out, device, about = arguments.out, chosen_device(arguments.device), hardware()
    out.mkdir(parents=True, exist_ok=True)
    arguments.working.mkdir(parents=True, exist_ok=True)
    wanted = [(p, n) for p, n in names(Carried(arguments.carried), device) if p in arguments.parts]
    for part, name in wanted:
        if any(row[:2] == (part, name) or (part == row[0] == "a") for row in read_rows(out)):
            continue
        left = end - time.monotonic()
        if left < _LEAST_S:
            print("The time is up: run the same command again.")
            return
        rows = in_own_process(arguments, part, name, left)
        if rows is None:
            return
        add_rows(out / "gpu.csv", HEAD, [(part, *row, about) for row in rows])
        for row in rows:
            print(part, *row, flush=True)
        draw(out, about)
    print(f"All is measured: {out}")


def in_own_process(arguments: argparse.Namespace, part: str, name: str, left: float) -> list[list[object]] | None:
    """The rows of a measurement; a row `failed` where it failed, None where the time was up first."""
    given = [str(arguments.carried), str(arguments.out), "--working", str(arguments.working)]
    one = ["--device", arguments.device, "--one", part, name, "--minutes", str(left / 60)]
    command = [sys.executable, __file__, "run", *given, *one]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=left)
    except subprocess.TimeoutExpired:
        print(f"The time was up within {part}, {name}: run the same command again.")
        return None
    if done.returncode:
        with (arguments.out / "gpu.log").open("a") as log:
            log.write(f"\n{part} {name}\n{done.stderr[-4000:]}\n")
        return [[name, _FAILED, 1, (done.stderr.strip().splitlines() or ["?"])[-1][:200]]]
    rows: list[list[object]] = json.loads(done.stdout.splitlines()[-1])
    return rows


def one(arguments: argparse.Namespace) -> None:
    """Measure one thing; prints its rows as JSON."""
    device = chosen_device(arguments.device)
    carried = Carried(arguments.carried)
    place = Place(carried, arguments.out, arguments.working, device, 60 * arguments.minutes)
    print(json.dumps(measure(place, *arguments.one)))


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    there = verbs.add_parser("run", help="measure what is missing")
    there.add_argument("carried", type=Path)
    there.add_argument("out", type=Path)
    there.add_argument("--minutes", type=float, default=9.0, help="of this call")
    there.add_argument("--parts", default="abcdef", help="those to measure, such as bcd")
    there.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    there.add_argument("--working", type=Path, default=Path(tempfile.gettempdir()) / "ablate-gpu")
    there.add_argument("--one", nargs=2, metavar=("PART", "NAME"), help=argparse.SUPPRESS)
    there.set_defaults(act=run)
    here = verbs.add_parser("carry", help="write what travels")
    here.add_argument("carried", type=Path)
    here.add_argument("--study-frames", type=int, default=48, help="of each of the two anatomies")
    here.add_argument("--paper-frames", type=int, default=10)
    here.add_argument("--tiny", action="store_true", help="for a dry run on a CPU")
    here.set_defaults(act=carry)
    arguments = parser.parse_args()
    (one if getattr(arguments, "one", None) else arguments.act)(arguments)


if __name__ == "__main__":
    main()
