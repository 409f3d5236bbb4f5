"""The simulator of this checkout and of another, in turns, with the same scenes and poses; `simulator.py --against`.

Each checkout is a process that stays. Every pose is rendered by one, then by the other, so what else runs on the
machine disturbs both. No pose comes twice: each round moves it by a micrometre, which costs the same, and the shortest
of the rounds counts.
"""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parents[1]
ROUNDS = 3
_SERVE = """
import pickle, sys, time
import numpy as np, trimesh
from ablate.anatomy import Scene, Structure, load_tissues
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
with open(sys.argv[1], "rb") as file:
    scenes, cases = pickle.load(file)
tissues = load_tissues()
built = [
    Scene(tuple(Structure(trimesh.Trimesh(*mesh, process=False), tissues[name]) for *mesh, name in meshes),
          tissues[background], "scene")
    for meshes, background in scenes
]
calls = {
    name: getattr(Simulator(built[scene], ConvexProbe(**probe), SimulatorSettings(**settings)), call)
    for name, (scene, probe, settings, call) in cases.items()
}
print(flush=True)
for line in sys.stdin:
    name, *pose = line.split()
    pose = np.array(pose, float).reshape(4, 4)
    start = time.perf_counter()
    calls[name](pose)
    print(1e3 * (time.perf_counter() - start), flush=True)
"""

Case = tuple[int, dict[str, Any], dict[str, Any], str]  # number of a scene, values of probe and settings, method


def described(scene: Any) -> tuple[list[tuple[np.ndarray, np.ndarray, str]], str]:
    """A scene as any checkout can build it: vertices, faces and tissue of each structure; and the background."""
    meshes = [(np.array(s.mesh.vertices), np.array(s.mesh.faces), s.tissue.name) for s in scene.structures]
    return meshes, scene.background.name


def in_turns(
    scenes: Sequence[Any], cases: dict[str, Case], poses: dict[str, Sequence[np.ndarray]], other: Path
) -> dict[str, np.ndarray]:
    """Milliseconds of each case, (poses, 2), of this checkout and of the other: the shortest of the rounds."""
    times = {name: np.full((len(poses[name]), 2), np.inf) for name in cases}
    with tempfile.NamedTemporaryFile(suffix=".pickle") as file, ExitStack() as stack:
        pickle.dump(([described(scene) for scene in scenes], cases), file)
        file.flush()
        workers = []
        for checkout in (HERE, other.resolve()):
            command = [sys.executable, "-c", _SERVE, file.name]
            environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
            workers.append(stack.enter_context(subprocess.Popen(command, **pipes, cwd=checkout)))  # type: ignore
        for worker in workers:
            _answer(worker)
        moved = 0
        for turn in range(-1, ROUNDS):  # the first, of one pose, does not count
            for name in cases:
                for row, pose in enumerate(poses[name][:1] if turn < 0 else poses[name]):
                    pose, moved = pose.copy(), moved + 1
                    pose[1, 3] += 1e-3 * moved
                    for column, worker in enumerate(workers):
                        worker.stdin.write(f"{name} {' '.join(repr(float(x)) for x in pose.ravel())}\n")
                        worker.stdin.flush()
                        taken = float(_answer(worker))
                        if turn >= 0:
                            times[name][row, column] = min(times[name][row, column], taken)
    return times


def _answer(worker: Any) -> str:
    line: str = worker.stdout.readline()
    if not line:
        raise SystemExit("a process that renders ended early; its message is above")
    return line
