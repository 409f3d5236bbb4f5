"""Milliseconds of a simulated frame: by stage, as each size grows, and what the plan saves; medians.

make bench-simulator
make bench-simulator SCENE=path/to/folder      # the plan's table with that scene, too
"""

import argparse
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import count, product
from pathlib import Path
from statistics import median

import numpy as np
import torch
import trimesh

from ablate.anatomy import Scene, Structure, fetal_abdomen, fetal_sites, load_scene, load_sites, load_tissues
from ablate.dataset import probe_poses
from ablate.tracking import hardware
from ablate.ultrasound import ConvexProbe, PlanMode, Simulator, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage_times
from yardstick import ABOUT, Yardstick, busy_core

POSES = 12
REPEATS = 3


def milliseconds(call: Callable[[np.ndarray], object], poses: list[np.ndarray]) -> float:
    """Median over the poses, after one that does not count."""
    return median(each_time(call, poses))


def each_time(
    call: Callable[[np.ndarray], object], poses: list[np.ndarray], yardstick: Yardstick | None = None
) -> list[float]:
    """Milliseconds of each pose, after one that does not count, in turns with the yardstick."""
    times = []
    for pose in (poses[-1], *poses):
        start = time.perf_counter()
        call(pose)
        times.append(1e3 * (time.perf_counter() - start))
        if yardstick is not None and len(times) > 1:
            yardstick.tick()
    return times[1:]


def table(title: str, head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a Markdown table."""
    print(f"\n{title}\n\n| {' | '.join(head)} |\n| {' | '.join('---' for _ in head)} |")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


def some(poses: list[np.ndarray], count: int = POSES) -> list[np.ndarray]:
    """A few, equally spaced."""
    return [poses[i] for i in np.linspace(0, len(poses) - 1, count).astype(int)]


def totals(scene: Scene, poses: list[np.ndarray]) -> None:
    """H, L, S and A at the paper's size, with one thread and with all, idle and beside a process that uses a core."""
    rows = []
    idle: dict[int, float] = {}
    for threads, beside in product(sorted({1, torch.get_num_threads()}), (nullcontext, busy_core)):
        torch.set_num_threads(threads)
        yardstick = Yardstick()
        with beside():
            high, maps = Simulator(scene), Simulator(scene)
            low = Simulator(scene, settings=SimulatorSettings.low_quality())
            frames = each_time(high.render, poses, yardstick)
            seeds = count(1)
            again = median(milliseconds(partial(_other_speckle, high, seeds), [pose]) for pose in poses[:4])
            s_and_a = milliseconds(maps.maps, poses)
            with_low = milliseconds(low.render, poses)
        whole = median(frames)
        cells = (s_and_a, whole, whole - s_and_a, again, with_low, with_low - s_and_a)
        word = "idle" if beside is nullcontext else f"busy, {whole / idle[threads]:.1f} times idle"
        idle.setdefault(threads, whole)
        rows.append((str(threads), word, *(f"{t:.0f}" for t in cells), yardstick.text(frames)))
    table(
        "**Totals**, ms. H and L are the frame less its maps; H again is the same pose with other scatterers. Busy: "
        f"beside a process that keeps a core busy. The last column is of S, A and H; {ABOUT}",
        ("threads", "machine", "S and A", "S, A and H", "H", "H again", "S, A and L", "L", "yardstick"),
        rows,
    )


def _other_speckle(simulator: Simulator, seeds: Iterator[int], pose: np.ndarray) -> object:
    return simulator.render(pose, seed=next(seeds))


def by_stage(scene: Scene, poses: list[np.ndarray]) -> None:
    """Medians of each stage of S, A and H."""
    simulator = Simulator(scene)
    simulator.render(poses[-1])
    frames = []
    with stage_times() as taken:
        for pose in poses:
            start = time.perf_counter()
            simulator.render(pose)
            frames.append(1e3 * (time.perf_counter() - start))
    each = {name: np.sum(np.reshape(taken[name], (len(poses), -1)), axis=1) for name in Stage}
    rows = [(name.value, f"{median(times):.1f}") for name, times in each.items()]
    rows.append(("everything else", f"{median(frames - np.sum(list(each.values()), axis=0)):.1f}"))
    rows.append(("the frame", f"{median(frames):.1f}"))
    table(f"**Stages** of S, A and H, ms, {torch.get_num_threads()} threads.", ("stage", "ms"), rows)


def growth(poses: list[np.ndarray], scene: Scene) -> None:
    """How the time of S, A and H grows with each size, all others as in the paper."""
    few = some(poses, 6)

    def frame(settings: SimulatorSettings) -> str:
        return f"{milliseconds(Simulator(scene, settings=settings).render, few):.0f}"

    sizes: dict[str, tuple[int, ...]] = {
        "rays": (1, 2, 4, 8, 16, 32, 64, 128),
        "layers": (1, 3, 5),
        "scanlines": (48, 96, 192, 384),
        "axial_samples": (768, 1536, 3072, 6144),
    }
    for name, values in sizes.items():
        times = tuple(frame(replace(SimulatorSettings(), **{name: value})) for value in values)
        table(f"**{name}**, ms.", tuple(map(str, values)), [times])
    triangles, times = [], []
    for wanted in (20_000, 100_000, 300_000, 1_000_000):
        other = fetal_abdomen(triangles=wanted)
        triangles.append(f"{sum(len(s.mesh.faces) for s in other.structures):,}")
        times.append(f"{milliseconds(Simulator(other).render, few):.0f}")
    table("**triangles**, ms.", tuple(triangles), [tuple(times)])


def plans(scene: Scene, poses: list[np.ndarray], folder: Path | None) -> None:
    """The planned simulator against the full one."""
    tissues = load_tissues()
    organ = Structure(trimesh.creation.icosphere(5, 40.0), tissues["liver"])
    organ.mesh.apply_translation((0.0, 0.0, 70.0))
    ahead = [np.eye(4)] * REPEATS
    no_gas = Scene(tuple(s for s in scene.structures if s.tissue.name != "gas"), scene.background, "fetus, no gas")
    cases = [
        ("gel only", Scene((), tissues["coupling_gel"], "gel"), ahead),
        ("one organ", Scene((organ,), replace(tissues["soft_tissue"], roughness=0.0), "organ"), ahead),
        ("fetus", scene, some(poses, 6)),
        ("fetus without gas", no_gas, some(poses, 6)),
    ]
    if folder is not None:
        placed = probe_poses(load_scene(folder), load_sites(folder), 8)
        cases.append((folder.name, load_scene(folder), some([p.probe_to_world for p in placed], 6)))
    rows = []
    for name, each, where in cases:
        full = Simulator(each, settings=SimulatorSettings(plan=PlanMode.full), poses=where)
        auto = Simulator(each, poses=where)
        apart = max(int(np.abs(full.render(p).image.astype(int) - auto.render(p).image).max()) for p in where[:2])
        times = [(milliseconds(full.render, _fresh(where)), milliseconds(auto.render, _fresh(where))) for _ in range(3)]
        slow, fast = (median(column) for column in zip(*times, strict=True))
        rows.append((name, f"{slow:.0f}", f"{fast:.0f}", f"{1 - fast / slow:.0%}", str(apart), _short(auto.left_out)))
    head = ("scene", "full, ms", "planned, ms", "saved", "largest grey difference", "left out")
    table("**What the plan leaves out.**", head, rows)


def _short(notes: tuple[str, ...]) -> str:
    return "; ".join(note.split(":")[0].split(" (")[0] for note in notes) or "nothing"


def _fresh(poses: list[np.ndarray]) -> list[np.ndarray]:
    """The same poses, a little apart from each other, so that no frame is remembered."""
    moved = [pose.copy() for pose in poses]
    for number, pose in enumerate(moved):
        pose[1, 3] += 1e-3 * (number + 1)
    return moved


_CHILD = """
import pickle, sys
from ablate.ultrasound import Simulator
with open(sys.argv[1], "rb") as file:
    scene, poses = pickle.load(file)
def peak():  # of this program; getrusage would count what its parent had
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmHWM")) / 2**20
before = peak()
simulator = Simulator(scene)
for pose in poses:
    simulator.render(pose)
print(f"{peak():.2f} GiB, of which {before:.2f} are Python, torch and the scene")
"""


def memory(scene: Scene, poses: list[np.ndarray]) -> None:
    """Peak memory of a process that loads a built scene and renders frames."""
    with tempfile.NamedTemporaryFile(suffix=".pickle") as file:
        pickle.dump((scene, poses[:4]), file)
        file.flush()
        done = subprocess.run([sys.executable, "-c", _CHILD, file.name], check=True, capture_output=True, text=True)
    print(f"\n**Peak memory** of one process, scene already built: {done.stdout.strip()}.")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=None, help="a scene folder for the plan's table")
    args = parser.parse_args()
    threads = torch.get_num_threads()
    scene = fetal_abdomen()
    all_poses = [pose.probe_to_world for pose in probe_poses(scene, fetal_sites(), 8)]
    poses = some(all_poses)
    s, probe = SimulatorSettings(), ConvexProbe()
    triangles = sum(len(structure.mesh.faces) for structure in scene.structures)
    print(f"{hardware()}; medians of {POSES} poses, each seen for the first time. {triangles:,} triangles,")
    print(f"{s.scanlines} scanlines, {s.rays} rays, {s.layers} layers, {s.axial_samples} samples,", end=" ")
    print(f"{s.image_shape[0]} x {s.image_shape[1]} pixels, {probe.frequency_mhz:g} MHz.")
    totals(scene, poses)
    torch.set_num_threads(threads)
    by_stage(scene, poses)
    memory(scene, poses)
    plans(scene, all_poses, args.scene)
    growth(all_poses, scene)


if __name__ == "__main__":
    main()
