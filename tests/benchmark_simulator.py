"""Milliseconds of one simulated frame, in parts, at two sizes; one thread, medians.

make bench
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import numpy as np
import torch

from ablate.anatomy import fetal_abdomen, fetal_sites
from ablate.dataset import probe_poses
from ablate.studies.sweep import jobs_of
from ablate.tracking import hardware
from ablate.ultrasound import Simulator, SimulatorSettings

POSES = 12


def milliseconds(call: Callable[[np.ndarray], object], poses: list[np.ndarray]) -> float:
    """Median over the poses, after one that does not count."""
    times = []
    for pose in (poses[-1], *poses):
        start = time.perf_counter()
        call(pose)
        times.append(1e3 * (time.perf_counter() - start))
    return median(times[1:])


def row(preset: str) -> tuple[str, ...]:
    """Times at the sizes of one preset."""
    (job,) = jobs_of([f"preset={preset}"])
    s = job.settings
    scene = fetal_abdomen(triangles=s.scene.triangles)
    all_poses = [p.probe_to_world for p in probe_poses(scene, fetal_sites(), s.dataset.press_mm)]
    poses = [all_poses[i] for i in np.linspace(0, len(all_poses) - 1, POSES).astype(int)]
    low = {k: v for k, v in vars(s.simulator).items() if k not in ("rays", "layers")}
    high_sim, maps_sim = (Simulator(scene, s.probe, s.simulator) for _ in range(2))
    low_sim = Simulator(scene, s.probe, SimulatorSettings.low_quality(**low))

    def again(pose: np.ndarray) -> object:
        return high_sim.render(pose, seed=1)

    whole = milliseconds(high_sim.render, poses)
    speckle = [(high_sim.render(p), milliseconds(again, [p]))[1] for p in poses[:4]]
    times = (milliseconds(maps_sim.maps, poses), whole, median(speckle), milliseconds(low_sim.render, poses))
    triangles = sum(len(structure.mesh.faces) for structure in scene.structures)
    return (preset, f"{triangles:,}", *(f"{t:.0f}" for t in times))


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    head = ("preset", "triangles", "S and A", "S, A and H", "H again", "S, A and L")
    rows = [head, *(row(preset) for preset in ("quick", "paper"))]
    widths = [max(len(r[k]) for r in rows) for k in range(len(head))]
    print(f"ms per frame, median of {POSES} poses, one thread; {hardware()}")
    for r in rows:
        print("  ".join(cell.rjust(width) for cell, width in zip(r, widths, strict=True)))
    print("H again: the same pose with other scatterers, rays kept.")


if __name__ == "__main__":
    main()
