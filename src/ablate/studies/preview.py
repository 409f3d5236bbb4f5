"""One frame with its probe in 3-D, before or after the data set has been simulated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ablate.analysis import Preview, preview_figure
from ablate.anatomy import Scene
from ablate.config import StudySettings
from ablate.dataset import Pairs, Part
from ablate.studies.data import build_scene, dataset_folder, open_data
from ablate.studies.layout import Layout, lay_out
from ablate.studies.preflight import check
from ablate.studies.sweep import ConfigurationError, Job
from ablate.ultrasound import Simulator

_SHOWN = frozenset({"segmentation", "high"})


def preview(jobs: Sequence[Job]) -> int:
    """Draw the frame that `frame` names of the first job's data set, and print where the picture lies."""
    check(jobs)
    try:
        print(_draw(jobs[0].settings))
    except (ValueError, FileNotFoundError) as error:  # a mesh with a hole, no usable pose, ...
        raise ConfigurationError(str(error)) from error
    return 0


def _draw(settings: StudySettings) -> Path:
    folder, frame = dataset_folder(settings), settings.frame
    pairs = open_data(folder).pairs if (folder / "about.json").exists() else None
    _check_frame(frame, settings.dataset.frames if pairs is None else len(pairs))
    scene, grid = build_scene(settings)
    frames: Pairs | Layout = lay_out(settings, scene, grid) if pairs is None else pairs
    _check_frame(frame, len(frames))
    if pairs is not None and frame // pairs.shard not in pairs.missing(_SHOWN):
        image, segmentation = (pairs.read(name, [frame])[0] for name in ("high", "segmentation"))
    else:
        image, segmentation = _simulated(settings, scene, frames.poses, frame)
    part, site = Part(frames.split[frame]).name, frames.sites[frame]
    title = f"{settings.scene_name}: frame {frame} of {len(frames)}, {part}, site {site}"
    shown = Preview(title, frames.poses[frame], image, segmentation, grid.axis, grid.front)
    return preview_figure(scene, settings.probe, shown, folder / f"preview_{frame}.png")


def _simulated(settings: StudySettings, scene: Scene, poses: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Image and segmentation of a frame, as the data set will hold them."""
    simulator = Simulator(scene, settings.probe, settings.simulator, poses=poses)
    rendered = simulator.render(poses[frame], seed=settings.dataset.seed)
    return rendered.image, rendered.segmentation


def _check_frame(frame: int, frames: int) -> None:
    if not 0 <= frame < frames:
        raise ConfigurationError(f"frame={frame}: allowed are 0 to {frames - 1}")
