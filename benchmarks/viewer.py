"""How fast the viewer's page is, driven as a browser drives it.   make bench-viewer ARGS="--frames 10000 preset=tiny"

Two tables: frames a second and motion to picture while the probe moves without rest, with simulator and generator and
with the generator alone; and the memory of the program over many frames. The page in a browser sends at most 20 poses a
second, and shows no more frames than that. 60 poses a second show how many frames there could be. Every pose is a new
one. The client is a program of its own, as a browser is; the page's own drawing is not in the times. Other programs on
the machine make all of it slower: the load is printed beside it, and what the yardstick took.
"""

import argparse
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from ablate.command.compose import jobs_of
from support.viewer_client import Client
from yardstick import Yardstick

_PAGES_RATE = 20.0  # poses/s that viser's page sends at most: it waits 50 ms between two of a slider or a drag
_RATES = (_PAGES_RATE, 60.0)
_DEGREES = range(-20, 21)  # the probe goes to and fro between these, around the body; then it is rocked and tilted
_OPEN_S, _WARM_S = 3.0, 30.0  # until the page is there; until the generator has been exported
Poses = Iterator[tuple[str, int, tuple[str, ...]]]


@dataclass(frozen=True)
class Row:
    """What was seen of one way to render."""

    frames_a_second: float
    median_ms: float
    slowest_ms: float


def new_poses() -> Poses:
    """A control, its value, and the words of the caption for the pose, which is another one than all before."""
    before: dict[str, int] = {}
    for tilt, (lap, rock) in product(_DEGREES, enumerate(_DEGREES)):
        for angle in _DEGREES if lap % 2 == 0 else reversed(_DEGREES):
            pose = {"Tilt (°)": tilt, "Rock (°)": rock, "Around (°)": angle}
            words = tuple(f"{label.partition(' ')[0].lower()} {value:.1f}°" for label, value in pose.items())
            yield from ((label, value, words) for label, value in pose.items() if before.get(label) != value)
            before = pose


def measure(client: Client, poses: Poses, rate: float, seconds: float) -> Row:
    """Move the probe to `rate` poses a second, and count the pictures; each says in words where it was taken."""
    sent: dict[tuple[str, ...], float] = {}
    client.seen.clear()
    begun = time.perf_counter()
    while time.perf_counter() - begun < seconds:
        label, value, words = next(poses)
        sent[words] = time.perf_counter()
        client.set(label, value)
        time.sleep(1 / rate)
    waits, pictures = [], len(client.images())
    for seen in client.captions():
        said = str(seen.values["content"])
        waits += [1e3 * (seen.at_s - at_s) for words, at_s in sent.items() if all(word in said for word in words)]
    return Row(pictures / seconds, float(np.median(waits)), float(np.percentile(waits, 95)))


def memory_mb(program: int) -> float:
    """What a program holds, MB."""
    pages = int(Path(f"/proc/{program}/statm").read_text().split()[1])
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
    keys = ["task=view", f"viewer.port={port}", "viewer.open=false", *chosen.settings]
    shape = jobs_of(keys)[0].settings.simulator.image_shape
    print(f"{shape[0]} x {shape[1]} px, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    viewer = subprocess.Popen([sys.executable, "-m", "ablate", *keys], stdout=subprocess.PIPE, text=True)
    try:
        assert viewer.stdout is not None
        viewer.stdout.readline()  # its address
        with Client(port) as client:
            _tables(client, viewer.pid, chosen.seconds, chosen.frames)
    finally:
        viewer.terminate()
        viewer.wait()


def _tables(client: Client, program: int, seconds: float, frames: int) -> None:
    client.until(client.captions, within_s=600.0)
    time.sleep(_OPEN_S)
    print("| moving | poses/s | frames/s | motion to picture, median (ms) | 95th percentile (ms) |")
    print("| --- | --- | --- | --- | --- |")
    fixed, poses = Yardstick(), new_poses()
    for name in ("simulator and generator", "generator alone"):
        client.set("Moving", name)
        measure(client, poses, _PAGES_RATE, _WARM_S)
        for rate in _RATES:
            row = measure(client, poses, rate, seconds)
            said = f"{row.frames_a_second:.1f} | {row.median_ms:.0f} | {row.slowest_ms:.0f}"
            print(f"| {name} | {rate:.0f} | {said} |", flush=True)
            fixed.tick()
    print(fixed.line())
    print("| frames | memory (MB) |\n| --- | --- |")
    shown, step = 0, max(1, frames // 5)
    while shown <= frames:
        print(f"| {shown} | {memory_mb(program):.0f} |", flush=True)
        client.seen.clear()
        while len(client.images()) < step:
            client.set(*next(poses)[:2])
            time.sleep(1 / _PAGES_RATE)
        shown += step
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
