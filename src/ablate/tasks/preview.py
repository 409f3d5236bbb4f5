"""One frame with its probe in 3-D, before or after the data set has been simulated."""

from collections.abc import Sequence
from pathlib import Path

from ablate.analysis import Preview, preview_figure
from ablate.dataset import Pairs, Part
from ablate.runs.job import Job
from ablate.runs.simulated import Layout, build_scene, lay_out
from ablate.settings.study import ConfigurationError, refusing
from ablate.ultrasound import Simulator

_SHOWN = frozenset({"segmentation", "target"})


def preview(jobs: Sequence[Job]) -> int:
    """Draw frame number `frame` of the first job's data set, and print the path of the picture."""
    with refusing():  # a mesh with a hole, no usable pose, ...
        print(_draw(jobs[0]))
    return 0


def _draw(job: Job) -> Path:
    settings, frame, data = job.settings, job.settings.frame, job.data
    pairs = data.pairs if data.exists else None
    check_frame(frame, settings.dataset.frames if pairs is None else len(pairs))
    scene, grid = build_scene(settings)
    frames: Pairs | Layout = lay_out(settings, scene, grid) if pairs is None else pairs
    check_frame(frame, len(frames))
    if pairs is not None and frame // pairs.shard not in pairs.missing(_SHOWN):
        image, segmentation = (pairs.read(name, [frame])[0] for name in ("target", "segmentation"))
    else:
        simulator = Simulator(scene, settings.probe, settings.simulator, poses=frames.poses)
        rendered = simulator.render(frames.poses[frame], seed=settings.dataset.seed)  # as the data set will hold it
        image, segmentation = rendered.image, rendered.segmentation
    part, site = Part(frames.split[frame]).name, frames.sites[frame]
    title = f"{settings.scene_name}: frame {frame} of {len(frames)}, {part}, site {site}"
    shown = Preview(title, frames.poses[frame], image, segmentation, grid.axis, grid.front)
    return preview_figure(scene, settings.probe, shown, data.folder / f"preview_{frame}.png")


def check_frame(frame: int, frames: int) -> None:
    """Refuse the number of a frame that a data set has not."""
    if not 0 <= frame < frames:
        raise ConfigurationError(f"frame={frame}: allowed are 0 to {frames - 1}")
