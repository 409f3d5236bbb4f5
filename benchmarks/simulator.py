"""Milliseconds of a simulated frame, also by stage, its memory, and what the plan saves; medians.

make bench-simulator
make bench-simulator AGAINST=path/to/checkout  # only how long a frame takes, against another checkout
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import numpy as np
import torch
import yaml

from ablate.anatomy import Scene, fetal_abdomen, fetal_sites
from ablate.dataset import probe_poses
from ablate.study.provenance import hardware
from ablate.ultrasound import ConvexProbe, PlanMode, Simulator, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage_times
from turns import HERE, Case, in_turns
from yardstick import ABOUT, Yardstick, in_own_process, peak_gib

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
    """H, L, S and A at the paper's size, with one thread and with all."""
    rows = []
    for threads in sorted({1, torch.get_num_threads()}):
        torch.set_num_threads(threads)
        yardstick = Yardstick()
        high, maps = Simulator(scene), Simulator(scene)
        low = Simulator(scene, settings=SimulatorSettings.low_quality())
        frames = each_time(high.render, poses, yardstick)
        s_and_a = milliseconds(maps.maps, poses)
        with_low = milliseconds(low.render, poses)
        whole = median(frames)
        cells = (s_and_a, whole, whole - s_and_a, with_low, with_low - s_and_a)
        rows.append((str(threads), *(f"{t:.0f}" for t in cells), yardstick.text(frames)))
    table(
        f"**Totals**, ms. H and L are the frame less S and A, with its maps of surfaces. The last column: {ABOUT}",
        ("threads", "S and A", "S, A and H", "H", "S, A and L", "L", "S, A and H in"),
        rows,
    )


def against(scene: Scene, poses: list[np.ndarray], other: Path) -> None:
    """This checkout and another one in turns, with the same scenes."""
    preset = yaml.safe_load((HERE / "conf/preset/quick.yaml").read_text(encoding="utf-8"))
    quick, small = preset["simulator"], fetal_abdomen(triangles=preset["scene"]["triangles"])
    quick["image_shape"] = (256, 355)  # as it is composed for this probe
    cases: dict[str, Case] = {
        "H": (0, {}, {}, "image"),
        "L": (0, {}, {"rays": 1, "layers": 1}, "image"),
        "S, A": (0, {}, {}, "maps"),
        "S, A, H": (0, {}, {}, "render"),
        "quick": (1, preset["probe"], quick, "image"),
        "quick, S, A": (1, preset["probe"], quick, "maps"),
    }
    cases = {name.replace(" ", ""): case for name, case in cases.items()}
    times = in_turns((scene, small), cases, dict.fromkeys(cases, poses), other)
    rows = []
    for name, (here, there) in ((name, of_case.T) for name, of_case in times.items()):
        quartiles = np.percentile(here / there, (25, 50, 75))
        rows.append((name.replace(",", ", "), f"{median(there):.0f}", f"{median(here):.0f}"))
        rows[-1] += (f"{median(here) / median(there):.2f}", "{1:.2f} ({0:.2f} to {2:.2f})".format(*quartiles))
    head = ("image", "the other, ms", "this, ms", "ratio of medians", "median of ratios (quartiles)")
    table(f"**Against another checkout**, in turns, {torch.get_num_threads()} threads.", head, rows)


def by_stage(scene: Scene, poses: list[np.ndarray]) -> None:
    """Medians of each stage of S, A and H, with one thread: with more, some of them run side by side."""
    torch.set_num_threads(1)
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
    table("**Stages** of S, A and H, ms, 1 thread.", ("stage", "ms"), rows)


def plan(scene: Scene, poses: list[np.ndarray]) -> None:
    """The planned simulator against the full one, in turns; the spread is that of the frames' ratios."""
    full = Simulator(scene, settings=SimulatorSettings(plan=PlanMode.full), poses=poses)
    auto = Simulator(scene, poses=poses)
    times = np.concatenate([_in_turns((full, auto), _fresh(poses, turn)) for turn in range(REPEATS)])
    low, middle, high = np.percentile(1 - times[:, 1] / times[:, 0], (25, 50, 75))
    slow, fast = np.median(times, axis=0)
    saved = f"{middle:.0%} ({low:.0%} to {high:.0%})"
    head = ("full, ms", "planned, ms", "saved (quartiles)")
    table("**What the plan leaves out**, of an image alone.", head, [(f"{slow:.0f}", f"{fast:.0f}", saved)])


def _in_turns(simulators: Sequence[Simulator], poses: list[np.ndarray]) -> np.ndarray:
    """Milliseconds of an image, (poses, simulators), after one that does not count."""
    times = np.empty((len(poses) + 1, len(simulators)))
    for row, pose in zip(times, (poses[-1], *poses), strict=True):
        for column, simulator in enumerate(simulators):
            start = time.perf_counter()
            simulator.image(pose)
            row[column] = 1e3 * (time.perf_counter() - start)
    return times[1:]


def _fresh(poses: list[np.ndarray], turn: int) -> list[np.ndarray]:
    """The same poses, a little apart from each other and from those of other turns: no frame is remembered."""
    moved = [pose.copy() for pose in poses]
    for number, pose in enumerate(moved):
        pose[1, 3] += 1e-3 * (turn * len(poses) + number + 1)
    return moved


def memory(scene: Scene, poses: list[np.ndarray]) -> None:
    """Peak memory of a process that loads a built scene and renders frames."""
    before, peak = in_own_process(_peaks, scene, poses[:4])
    text = f"{peak:.2f} GiB, of which {before:.2f} are Python, torch and the scene"
    print(f"\n**Peak memory** of one process, scene already built: {text}.")


def _peaks(scene: Scene, poses: list[np.ndarray]) -> tuple[float, float]:
    """GiB before and after frames are rendered."""
    before = peak_gib()
    simulator = Simulator(scene)
    for pose in poses:
        simulator.render(pose)
    return before, peak_gib()


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, default=None, help="another checkout, which frames are timed against")
    args = parser.parse_args()
    threads = torch.get_num_threads()
    scene = fetal_abdomen()
    all_poses = list(probe_poses(scene, fetal_sites(), 8))
    poses = some(all_poses)
    s, probe = SimulatorSettings(), ConvexProbe()
    triangles = sum(len(structure.mesh.faces) for structure in scene.structures)
    print(f"{hardware()}; medians of {POSES} poses, each seen for the first time. {triangles:,} triangles,")
    print(f"{s.scanlines} scanlines, {s.rays} rays, {s.layers} layers, {s.axial_samples} samples,", end=" ")
    print(f"{s.image_shape[0]} x {s.image_shape[1]} pixels, {probe.frequency_mhz:g} MHz.")
    if args.against:
        against(scene, poses, args.against)
        return
    totals(scene, poses)
    by_stage(scene, poses)
    torch.set_num_threads(threads)
    memory(scene, poses)
    plan(scene, some(all_poses, 6))


if __name__ == "__main__":
    main()
