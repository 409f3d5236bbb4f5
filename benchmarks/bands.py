"""Share of a preset's frames with bright bands in fluid, and milliseconds a frame, of this checkout and of another.

make bench-bands ARGS="--frames 24"
make bench-bands ARGS="--anatomies 0 1 2 3"
make bench-bands ARGS="--against path/to/another/checkout"

A frame has bands where over 1 % of its fluid is more than 15 grey levels brighter than in the converged image, that of
many rays with the same scatterers and the same noise. Both are means over 7 x 7 pixels, of fluid alone. Each checkout
is compared with its own converged images, and the frames are timed in turns.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter

from yardstick import Yardstick

FLUIDS = ("amniotic_fluid", "urine")
BRIGHTER, SHARE = 15, 0.01
SIDE = 7  # px
LEAST_FLUID = 200  # px; frames with less are left out
HERE = Path(__file__).parents[1]


def serve(preset: str, frames: int, many: int, anatomy: int) -> None:
    """Render frames on request: each line of the standard input is rays and frame, each answer is a line of ms."""
    import torch
    from ablate.jobs.compose import jobs_of
    from ablate.runs import simulated

    from ablate.ultrasound import Simulator

    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        job = jobs_of([f"preset={preset}", f"scene.anatomy_seed={anatomy}", f"runs_dir={folder}"])[0]
        settings = job.settings
        scene, grid = simulated.build_scene(settings)
        poses = simulated.lay_out(settings, scene, grid).poses
        simulator = settings.simulator
        with suppress(ImportError):  # earlier checkouts have one time gain for all scenes
            from ablate.runs.prepare import simulator_of

            simulator = simulator_of(job, scene, grid, poses)
        poses = poses[np.linspace(0, len(poses) - 1, min(frames, len(poses))).astype(int)]
        few = Simulator(scene, settings.probe, simulator, poses=poses)
        dense = Simulator(scene, settings.probe, replace(simulator, rays=many), poses=poses)
        labels = [k + 1 for k, tissue in enumerate(scene.tissues) if tissue.name in FLUIDS]
        few.render(poses[0])
        print(len(poses), flush=True)
        for line in sys.stdin:
            kind, frame, path = line.split()
            start = time.perf_counter()
            shown = (dense if kind == "many" else few).render(poses[int(frame)])
            taken = time.perf_counter() - start
            np.savez(path, image=shown.image, fluid=np.isin(shown.segmentation, labels))
            print(1e3 * taken, flush=True)


class Checkout:
    """A process that renders with the sources of one checkout."""

    def __init__(self, process: "subprocess.Popen[str]", folder: Path) -> None:
        self._process, self._file = process, folder / "frame.npz"
        self.frames = int(self._answer())

    def render(self, kind: str, frame: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Image, fluid and milliseconds."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{kind} {frame} {self._file}\n")
        self._process.stdin.flush()
        taken = float(self._answer())
        with np.load(self._file) as made:
            return made["image"].astype(float), made["fluid"], taken

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("a process that renders ended early; its message is above")
        return line


@contextmanager
def opened(checkout: Path, *arguments: str) -> Iterator[Checkout]:
    """Start this script with the sources of a checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
    command = [sys.executable, str(Path(__file__).resolve()), "--serve", *arguments]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=folder
        ) as process,
    ):
        yield Checkout(process, Path(folder))


def shares(image: np.ndarray, converged: np.ndarray, fluid: np.ndarray) -> tuple[float, float, float]:
    """Shares of the fluid that are too bright and too dark, and its mean difference in grey levels."""
    within = np.maximum(uniform_filter(fluid.astype(float), SIDE), 1e-9)
    difference = (uniform_filter(np.where(fluid, image - converged, 0.0), SIDE) / within)[fluid]
    return float((difference > BRIGHTER).mean()), float((difference < -BRIGHTER).mean()), float(difference.mean())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--frames", type=int, default=100, help="equally spaced among the preset's")
    parser.add_argument("--anatomies", type=int, nargs="+", default=[0], help="values of scene.anatomy_seed")
    parser.add_argument("--many", type=int, default=1024, help="rays of the converged images")
    parser.add_argument("--against", type=Path, help="another checkout of this repository")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args.preset, args.frames, args.many, *args.anatomies)
        return
    chosen = {"this checkout": HERE} | ({"the other": args.against} if args.against else {})
    numbers = "--preset", args.preset, "--frames", str(args.frames), "--many", str(args.many)
    found: dict[str, list[Any]] = {f"{name}, anatomy {seed}": [] for name in chosen for seed in args.anatomies}
    yardstick = Yardstick()
    for seed in args.anatomies:
        with ExitStack() as stack:
            served = (*numbers, "--anatomies", str(seed))
            running = {name: stack.enter_context(opened(path.resolve(), *served)) for name, path in chosen.items()}
            for frame in range(min(each.frames for each in running.values())):
                yardstick.tick()
                for name, each in running.items():
                    image, fluid, taken = each.render("few", frame)
                    if fluid.sum() >= LEAST_FLUID:
                        converged, _, _ = each.render("many", frame)
                        found[f"{name}, anatomy {seed}"].append((*shares(image, converged, fluid), taken))
    if not all(found.values()):
        sys.exit(f"no frame has {LEAST_FLUID} pixels of fluid; more frames are needed, or a scene with fluid")
    print("| images of | frames | with bands | too bright, % of fluid | too dark, % | mean difference | ms a frame |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in chosen if len(args.anatomies) > 1 else ():
        found[f"{name}, all"] = [row for seed in args.anatomies for row in found[f"{name}, anatomy {seed}"]]
    for name, rows in found.items():
        bright, dark, mean, taken = np.array(rows).T
        cells = f"{len(rows)}", f"{(bright > SHARE).sum()}", f"{100 * bright.mean():.2f}", f"{100 * dark.mean():.2f}"
        print(f"| {name} | {' | '.join(cells)} | {mean.mean():.2f} | {np.median(taken):.0f} |")
    print(f"\n{yardstick.line()}")


if __name__ == "__main__":
    main()
