"""Frames at poses of your choice as files: image, S and A, the envelope, and what they were made with."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ablate.anatomy import Scene, SiteGrid, fetal_planes
from ablate.config import ConfigurationError, SceneKind, StudySettings, json_ready, refusing
from ablate.dataset import read_poses
from ablate.storage import write_json, written_whole
from ablate.studies.jobs.job import Job
from ablate.studies.pairs.data import dataset_folder, open_data
from ablate.studies.pairs.simulated import build_scene, lay_out
from ablate.studies.preview import check_frame
from ablate.ultrasound import SIMULATOR_VERSION, Frame, Simulator
from ablate.ultrasound.probe import pixel_size_mm

_FRAME_MS = 50  # of a cine: 20 frames a second


def render(jobs: Sequence[Job]) -> int:
    """Render the first job's `pose`, `plane` or `frame`, and print the folder of the files."""
    with refusing():  # a mesh with a hole, a pose that is not rigid, ...
        print(_rendered(jobs[0].settings))
    return 0


def _rendered(settings: StudySettings) -> Path:
    scene, grid = build_scene(settings)
    name, poses = _poses(settings, scene, grid)
    folder = settings.results / "render" / f"{settings.scene_name}-{name}"
    folder.mkdir(parents=True, exist_ok=True)
    simulator = Simulator(scene, settings.probe, settings.simulator, poses=poses)
    images = []
    for i, pose in enumerate(poses):
        frame = simulator.render(pose, seed=settings.dataset.seed)  # as a data set would hold it
        _write(folder, frame, "" if len(poses) == 1 else f"_{i:04d}")
        images.append(Image.fromarray(frame.image))
    if len(images) > 1:
        with written_whole(folder / "cine.gif") as partial:
            images[0].save(partial, save_all=True, append_images=images[1:], duration=_FRAME_MS, loop=0)
    else:
        with written_whole(folder / "frame.npz") as partial:
            np.savez_compressed(partial, **{k: getattr(frame, k) for k in Frame.__annotations__}, pose=poses[0])
    write_json(folder / "settings.json", _made_with(settings, scene, poses))
    return folder


def _poses(settings: StudySettings, scene: Scene, grid: SiteGrid) -> tuple[str, np.ndarray]:
    """A name for what is rendered, and its poses, (n, 4, 4)."""
    if settings.pose:
        return Path(settings.pose).stem, read_poses(Path(settings.pose), "pose")[0]
    if settings.plane:
        if settings.scene.kind is not SceneKind.fetal:
            raise ConfigurationError(
                f"plane={settings.plane}: planes are those of scene=fetal; allowed are pose and frame"
            )
        planes = fetal_planes(settings.scene.anatomy_seed, settings.dataset.press_mm)
        if settings.plane not in planes:
            raise ConfigurationError(f"plane={settings.plane}: allowed are {', '.join(planes)}")
        return settings.plane, planes[settings.plane][None]
    folder = dataset_folder(settings)
    made = (folder / "about.json").exists()
    poses = open_data(folder).pairs.poses if made else lay_out(settings, scene, grid).poses
    check_frame(settings.frame, len(poses))
    return f"frame_{settings.frame}", np.asarray(poses[settings.frame])[None]


def _write(folder: Path, frame: Frame, number: str) -> None:
    """PNGs as `scene=pairs` reads them: labels and grey levels of 8 bits, the attenuation of 16."""
    pictures = {
        "image": frame.image,
        "segmentation": frame.segmentation,
        "attenuation": np.rint(frame.attenuation * 65535).astype(np.uint16),
    }
    for name, values in pictures.items():
        with written_whole(folder / f"{name}{number}.png") as partial:
            Image.fromarray(values).save(partial)


def _made_with(settings: StudySettings, scene: Scene, poses: np.ndarray) -> dict[str, Any]:
    height_mm, width_mm = pixel_size_mm(settings.probe, settings.simulator.image_shape)
    return {
        "scene": json_ready(settings.scene),
        "probe": json_ready(settings.probe),
        "simulator": json_ready(settings.simulator),
        "simulator_version": SIMULATOR_VERSION,
        "seed": settings.dataset.seed,
        "poses": poses.tolist(),
        "pixel_mm": {"height": height_mm, "width": width_mm},
        "labels": {"0": "outside the fan", **{str(i + 1): t.name for i, t in enumerate(scene.tissues)}},
    }
