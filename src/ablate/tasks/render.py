"""Frames at poses of your choice as files, with what they were made with; and one drawn with its probe in 3-D."""

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ablate.analysis import preview_figure
from ablate.anatomy import Scene
from ablate.command.labels import frame_words
from ablate.dataset import Pairs, Part, read_poses
from ablate.setting import cut_name, plain
from ablate.settings.study import ConfigurationError, ExportFormat, StudySettings, refusing
from ablate.sources.prepare import frames_of, simulator_of
from ablate.sources.source import source_of
from ablate.storage import known_json, write_image, write_json, written_whole
from ablate.study.job import Job
from ablate.tasks.export import check_dicom
from ablate.ultrasound import SIMULATOR_VERSION, Display, Frame, SimulatorSettings, simulators_of
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.pulse import pulse_widths
from ablate.user_code import code_digest

_PREVIEW = frozenset({"segmentation", "target"})
_FRAME_MS = 50  # of a cine: 20 frames a second


@refusing()  # a mesh with a hole, a pose that is not rigid, ...
def render(jobs: Sequence[Job]) -> int:
    """Render the first job's `pose`, `plane` or `frame`, and print the folder of the files."""
    job, settings = jobs[0], jobs[0].settings
    check_dicom(settings.dataset.format)
    named = _named_poses(job)  # before the anatomy is built
    scene, grid = source_of(settings).scene()
    if named is None:
        frames = frames_of(settings, job.data, scene, grid)
        check_frame(settings.frame, len(frames.sites))
        named = f"frame_{settings.frame}", np.asarray(frames.poses[settings.frame])[None]
    name, poses = named
    chosen = simulator_of(settings, job.data, scene, grid, poses)
    made_with, display = _made_with(settings, chosen, scene, poses), Display(gain_db=settings.gain_db)
    called = ".".join(filter(None, (f"{settings.scene_name}-{name}", frame_words(job.words))))
    folder = _folder_of(settings.results / "render" / cut_name(called), made_with)
    simulator = simulators_of(settings.scene.target)(scene, settings.probe, chosen, poses=poses)
    images = []
    for i, pose in enumerate(poses):
        frame = simulator.render(pose, settings.dataset.seed, display)  # but for the gain, as a data set holds it
        attenuation = np.rint(frame.attenuation * 65535).astype(np.uint16)  # PNGs are as `scene=pairs` reads them
        pictures = {"image": frame.image, "segmentation": frame.segmentation, "attenuation": attenuation}
        for kind, values in pictures.items():
            write_image(folder / f"{kind}{'' if len(poses) == 1 else f'_{i:04d}'}.png", values)
        images.append(Image.fromarray(frame.image))
    if len(images) > 1:
        with written_whole(folder / "cine.gif") as partial:
            images[0].save(partial, save_all=True, append_images=images[1:], duration=_FRAME_MS, loop=0)
    else:
        with written_whole(folder / "frame.npz") as partial:
            arrays = {name: getattr(frame, name) for name in Frame.__annotations__ if name not in ("beam", "probe")}
            np.savez_compressed(partial, **arrays, pose=poses[0])
    if settings.dataset.format is ExportFormat.dicom:
        from ablate.dataset.dicom_files import write_cine

        size = pixel_size_mm(settings.probe, chosen.image_shape)
        write_cine(folder / "cine.dcm", np.stack([np.asarray(i) for i in images]), simulator.mask, size, _FRAME_MS)
    print(folder)
    return 0


def _folder_of(wanted: Path, made_with: dict[str, Any]) -> Path:
    """The folder for what is made with these settings, with a number behind its name where others are there.

    Its settings are written first, so pictures of two settings never lie in one folder.
    """
    folder, numbers = wanted, count(2)
    while folder.exists():
        if known_json(folder / "settings.json") == made_with:
            return folder
        folder = wanted.with_name(f"{wanted.name}-{next(numbers)}")
    folder.mkdir(parents=True)
    write_json(folder / "settings.json", made_with)
    return folder


def _named_poses(job: Job) -> tuple[str, np.ndarray] | None:
    """A name for what `pose` or `plane` asks for, and its poses, (n, 4, 4); None where `frame` does."""
    settings = job.settings
    if settings.pose:
        return Path(settings.pose).stem, read_poses(Path(settings.pose), "pose")[0]
    if settings.plane:
        return settings.plane, source_of(settings).planes()[settings.plane][None]
    check_frame(settings.frame, len(job.data.pairs) if job.data.exists else settings.dataset.frames)
    return None


def _made_with(
    settings: StudySettings, simulator: SimulatorSettings, scene: Scene, poses: np.ndarray
) -> dict[str, Any]:
    height_mm, width_mm = pixel_size_mm(settings.probe, simulator.image_shape)
    target = settings.scene.target
    target_source = {} if target is None else {"target_source": code_digest(target)}
    return {
        "scene": plain(settings.scene),
        **target_source,
        "probe": plain(settings.probe),
        "simulator": plain(simulator),
        "pulse_mm": dict(pulse_widths(settings.probe, simulator)._asdict()),
        "simulator_version": SIMULATOR_VERSION,
        "gain_db": settings.gain_db,
        "seed": settings.dataset.seed,
        "poses": poses.tolist(),
        "pixel_mm": {"height": height_mm, "width": width_mm},
        "labels": {"0": "outside the fan", **{str(i + 1): t.name for i, t in enumerate(scene.tissues)}},
    }


@refusing()  # a mesh with a hole, no usable pose, ...
def preview(jobs: Sequence[Job]) -> int:
    """Draw frame number `frame` of the first job's data set, and print the path of the picture."""
    job, settings, frame, data = jobs[0], jobs[0].settings, jobs[0].settings.frame, jobs[0].data
    check_frame(frame, len(data.pairs) if data.exists else settings.dataset.frames)
    scene, grid = source_of(settings).scene()
    frames = frames_of(settings, job.data, scene, grid)
    check_frame(frame, len(frames.sites))
    if isinstance(frames, Pairs) and frame // frames.shard not in frames.missing(_PREVIEW):
        image, segmentation = (frames.read(name, [frame])[0] for name in ("target", "segmentation"))
    else:
        chosen = simulator_of(settings, job.data, scene, grid, frames.poses)
        simulator = simulators_of(settings.scene.target)(scene, settings.probe, chosen, poses=frames.poses)
        rendered = simulator.render(frames.poses[frame], seed=settings.dataset.seed)  # as the data set will hold it
        image, segmentation = rendered.image, rendered.segmentation
    part, site = Part(frames.split[frame]).name, frames.sites[frame]
    title = f"{settings.scene_name}: frame {frame} of {len(frames.sites)}, {part}, site {site}"
    if scene.guessed:
        title += f"\ntissues guessed: {scene.guessed}"
    path, pose = data.folder / f"preview_{frame}.png", frames.poses[frame]
    print(preview_figure(path, title, scene, settings.probe, pose, image, segmentation, grid))
    return 0


def check_frame(frame: int, frames: int) -> None:
    """Refuse the number of a frame that a data set has not."""
    if not 0 <= frame < frames:
        raise ConfigurationError(f"frame={frame}: allowed are 0 to {frames - 1}")
