"""A tracking server that dies, stays dead or freezes while a run trains."""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

from faults.bench import STUDY, Bench, Fault, Round
from faults.commands import ablate
from faults.judge import last_step, logged_points, tracked

_STALL_S = 5.0
_UP_S = 600.0
_TIMED_STEPS = 200
_VARIANT = "sa2h"
_STUDY = (f"variant={_VARIANT}", "preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10")
_STUDY = (*_STUDY, "training.log_every=1", "training.validate_every=0", "evaluation.pictures=1")


class Server:
    """MLflow's server on this machine, over a SQLite file of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri = f"http://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start it and wait until it answers."""
        stored = ["--backend-store-uri", f"sqlite:///{self.folder}/server.db", "--artifacts-destination"]
        command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(self.port)]
        with (self.folder / "server.txt").open("a") as said:
            self.process = subprocess.Popen(
                [*command, "--workers", "1", *stored, str(self.folder / "artifacts")],
                env={**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"},
                start_new_session=True,
                stdout=said,
                stderr=said,
            )
        until = time.monotonic() + _UP_S
        while time.monotonic() < until:
            try:
                with urllib.request.urlopen(f"{self.uri}/health", timeout=5):
                    return
            except OSError:
                time.sleep(0.1)
        raise RuntimeError(f"the server does not answer: {(self.folder / 'server.txt').read_text()[-500:]}")

    def signal(self, number: int) -> None:
        os.killpg(self.process.pid, number)
        if number == signal.SIGKILL:
            self.process.wait()


def outage(how: Callable[[Server], None], seconds: float, bench: Bench, rng: random.Random, _: int) -> Round:
    """Train for longer than the server is away; then the same command again, with the server there."""
    runs = bench.runs()
    server = Server(runs.parent)
    server.start()
    try:
        steps = _steps(bench, 2 * seconds + 20)
        line = [*_STUDY, f"training.steps={steps}", f"runs_dir={runs}", f"tracking.uri={server.uri}"]
        folder = runs / STUDY / _VARIANT / "seed0"
        command, begin = ablate(line, runs.parent), steps * rng.uniform(0.05, 0.2)
        command.wait_until(lambda: last_step(folder) >= begin)
        how(server)
        ended = command.wait()
        if server.process.poll() is not None:
            server.start()
        again = ablate(line, runs.parent).wait()
    finally:
        if server.process.poll() is None:
            server.signal(signal.SIGKILL)
    wrong = [f"exit code {each.code}: {each.said[-300:]}" for each in (ended, again) if each.code]
    return Round(
        [*wrong, *_missing(folder, steps, runs.parent / "server.db")], 1, {"between two steps, s": _stall(folder)}
    )


def _steps(bench: Bench, seconds: float) -> int:
    """Steps that take about so long; how long one takes is found out once."""
    if bench not in _step_seconds:
        runs = bench.runs()
        line = [*_STUDY, f"training.steps={_TIMED_STEPS}", f"runs_dir={runs}"]
        command = ablate(line, runs.parent)
        folder = runs / STUDY / _VARIANT / "seed0"
        command.wait_until(lambda: last_step(folder) >= 5)
        began = time.monotonic()
        command.wait_until(lambda: last_step(folder) >= _TIMED_STEPS)
        _step_seconds[bench] = (time.monotonic() - began) / (_TIMED_STEPS - 5)
        command.signal(signal.SIGKILL)
        command.wait()
    return max(_TIMED_STEPS, round(seconds / _step_seconds[bench]))


_step_seconds: dict[Bench, float] = {}


def _stall(folder: Path) -> float:
    """The longest time between two steps of the training, s; each is reported."""
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text("utf-8").splitlines()]
    times = [line["time"] for line in lines if "train/l1" in line.get("metrics", {})]
    return max((b - a for a, b in pairwise(times)), default=0) / 1000


def _missing(folder: Path, steps: int, database: Path) -> list[str]:
    wrong = []
    if _stall(folder) > _STALL_S:
        wrong.append(f"training stood still for {_stall(folder):.1f} s")
    here, there = logged_points(folder), tracked(database)
    reported = sum(key == "train/l1" for key, _ in here)
    if last_step(folder) != steps or reported != steps:
        wrong.append(f"{reported} reports up to step {last_step(folder)}, not of {steps} steps")
    twice = [key for key, count in Counter(point[:3] for point in there.points).items() if count > 1]
    if twice:
        wrong.append(f"{len(twice)} values are logged twice, as {twice[0]}")
    logged = {(key, step): value for name, key, step, value in there.points if name == f"{_VARIANT}/seed0"}
    if missing := here.keys() - logged.keys():
        wrong.append(f"{len(missing)} of {len(here)} values are not logged, as {min(missing)}")
    if odd := [(name, status) for name, status in there.runs if status != "FINISHED"]:
        wrong.append(f"not finished in MLflow: {odd}")
    return wrong


def _dead(seconds: float, server: Server) -> None:
    server.signal(signal.SIGKILL)
    time.sleep(seconds)
    server.start()


def _dead_for_good(server: Server) -> None:
    server.signal(signal.SIGKILL)


def _frozen(seconds: float, server: Server) -> None:
    server.signal(signal.SIGSTOP)
    time.sleep(seconds)
    server.signal(signal.SIGCONT)


_MUST = "training stalls for at most 5 s, 0 steps lost, everything logged afterwards, once"
FAULTS = (
    Fault(
        "dead",
        "tracking server killed, and started again after 60 s",
        _MUST,
        partial(outage, partial(_dead, 60.0), 60.0),
        5,
        0,
    ),
    Fault("gone", "tracking server killed for good", _MUST, partial(outage, _dead_for_good, 30.0), 5, 0),
    Fault("frozen", "tracking server frozen for 30 s", _MUST, partial(outage, partial(_frozen, 30.0), 30.0), 5, 0),
)
