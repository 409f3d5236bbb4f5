"""How long a mistyped key and the plan of a study wait for their answer, against the import of Hydra alone.

python benchmarks/start.py            # seconds, medians of processes started in turns; nothing else should be running
"""

import argparse
import statistics
import subprocess
import sys
import time

from yardstick import ABOUT, Yardstick

COMMANDS = {
    "python -c 'import hydra'": ["-c", "import hydra"],
    "python -m ablate trainin.steps=3": ["-m", "ablate", "trainin.steps=3"],
    "python -m ablate -m variant=sa2h,sa3h": ["-m", "ablate", "-m", "variant=sa2h,sa3h"],
    "python -m ablate task=plan": ["-m", "ablate", "task=plan"],
}


def seconds(arguments: list[str]) -> float:
    """Wall-clock time of a Python process, from its start to its end."""
    started = time.perf_counter()
    subprocess.run([sys.executable, *arguments], capture_output=True, check=False)
    return time.perf_counter() - started


def main() -> None:
    """Print the median time of each command, and how much longer it takes than the import of Hydra."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    for arguments in COMMANDS.values():
        seconds(arguments)  # compiles what is not compiled yet, and fills the disk cache
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    yardstick = Yardstick()
    for _ in range(rounds):
        yardstick.tick()
        for name, arguments in COMMANDS.items():
            times[name].append(seconds(arguments))
    medians = {name: statistics.median(values) for name, values in times.items()}
    hydra = next(iter(medians.values()))
    for name, median in medians.items():
        print(
            f"{name:40s} {median:6.2f} s   {median - hydra:+.2f} s   {yardstick.text([1e3 * t for t in times[name]])}"
        )
    print(ABOUT)


if __name__ == "__main__":
    main()
