"""How fast the viewer's page is, driven as a browser drives it.   make bench-viewer ARGS="--frames 10000 preset=tiny"

Three tables: frames a second and motion to picture while the probe moves without rest, with simulator and generator and
with the generator alone; and the memory of the program over many frames. The page's own drawing is not in them. Other
programs on the machine make all of it slower: the load is printed beside it, and what the yardstick took.
"""

import argparse
import os
import socket
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ablate.jobs.compose import jobs_of
from ablate.viewer.task import Viewer
from support.viewer_client import Client
from yardstick import Yardstick

_EVERY_S = 1 / 30  # a hand that moves without rest
_ANGLES_DEG = 20.0  # the probe goes to and fro between minus and plus this
_STEP_DEG = 0.5
_OPEN_S, _WARM_S = 3.0, 30.0  # until the page is there; until the generator has been exported


@dataclass(frozen=True)
class Row:
    """What was seen of one way to render."""

    name: str
    frames_a_second: float
    median_ms: float
    slowest_ms: float


def measure(client: Client, name: str, seconds: float) -> Row:
    """Move the probe without rest, and count the pictures that come; each says in words where it was taken."""
    sent: dict[str, float] = {}
    client.seen.clear()
    begun = time.perf_counter()
    step = 0
    while time.perf_counter() - begun < seconds:
        angle = _ANGLES_DEG * np.sin(step * _STEP_DEG / _ANGLES_DEG) + 1e-3 * (step % 97)
        key = f"around {angle:.1f}\u00b0"
        sent[key] = time.perf_counter()
        client.set("Around (\u00b0)", float(f"{angle:.1f}"))
        step += 1
        time.sleep(_EVERY_S)
    waits = []
    for seen in client.captions():
        words = str(seen.values["content"])
        key = next((key for key in sent if key in words), None)
        if key is not None and seen.at_s >= sent[key]:
            waits.append(1e3 * (seen.at_s - sent[key]))
    rate = len(client.images()) / seconds
    return Row(name, rate, float(np.median(waits)), float(np.percentile(waits, 95)))


def memory_mb() -> float:
    """What this program holds, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each table of speed")
    parser.add_argument("--frames", type=int, default=500, help="over which memory is watched")
    parser.add_argument("settings", nargs="*", help="keys of the command line, such as preset=tiny")
    chosen = parser.parse_args()
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        port = trial.getsockname()[1]
    (job,) = jobs_of(["task=view", f"viewer.port={port}", *chosen.settings])
    viewer = Viewer(job.settings)
    shape = viewer.session.state.simulator.image_shape
    print(f"{shape[0]} x {shape[1]} px, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    with Client(port) as client:
        client.until(lambda: client.captions(), within_s=600.0)
        time.sleep(_OPEN_S)
        print(
            "| moving | frames/s | motion to picture, median (ms) | 95th percentile (ms) |\n| --- | --- | --- | --- |"
        )
        fixed = Yardstick()
        for name in ("simulator and generator", "generator alone"):
            client.set("Moving", name)
            measure(client, name, _WARM_S)
            row = measure(client, name, chosen.seconds)
            said = f"{row.frames_a_second:.1f} | {row.median_ms:.0f} | {row.slowest_ms:.0f}"
            print(f"| {row.name} | {said} |", flush=True)
            fixed.tick()
        print(fixed.line())
        print("| frames | memory (MB) |\n| --- | --- |")
        count, step, rng = 0, max(1, chosen.frames // 5), np.random.default_rng(0)
        while count <= chosen.frames:
            print(f"| {count} | {memory_mb():.0f} |", flush=True)
            client.seen.clear()
            while len(client.images()) < step:
                _wander(client, rng)
            count += step
    print(f"load {os.getloadavg()[0]:.1f}")
    viewer.close()


def _wander(client: Client, rng: np.random.Generator) -> None:
    """Move the probe a little, somewhere else."""
    angle = float(rng.uniform(-_ANGLES_DEG, _ANGLES_DEG))
    client.set("Around (\u00b0)", round(angle, 1))
    time.sleep(_EVERY_S)


if __name__ == "__main__":
    main()
