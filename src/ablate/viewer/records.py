"""What is kept of a session: the last seconds, a sweep of the probe, single frames on disk, and command lines."""

import json
import re
import shlex
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
from PIL import Image

from ablate.command.compose import job_of
from ablate.command.words import quoted
from ablate.setting import plain
from ablate.settings.study import StudySettings
from ablate.storage import write_image, write_json, written_whole
from ablate.viewer.pictures import framed
from ablate.viewer.session import ViewerState, Views

LOOP_S = 5.0
_LOOP_BYTES = 256e6
_SECTIONS = ("scene", "probe", "simulator", "dataset")
_OF_DATASET = ("seed", "press_mm")  # what decides a frame that is rendered alone
_CHOSEN_BEFORE = {"kind", "folder"}  # keys that a command line begins with


class CineLoop(deque[Views]):
    """The frames of the last five seconds, fewer where they are so large that they would fill the memory."""

    def add(self, views: Views) -> None:
        """Keep a frame and forget those that are too old."""
        self.append(views)
        arrays = (views.target, views.segmentation, views.attenuation, views.mask, *views.generated)
        most = max(1, int(_LOOP_BYTES / sum(array.nbytes for array in arrays if array is not None)))
        while len(self) > most or views.at_s - self[0].at_s > LOOP_S:
            self.popleft()

    def before(self, seconds: float) -> Views:
        """The frame that was shown so long before the last one; a ValueError where there is no frame."""
        if not self:
            raise ValueError("there is no frame yet")
        frames = list(self)  # another thread adds to them
        return min(frames, key=lambda views: abs(frames[-1].at_s - seconds - views.at_s))


class Sweep(list[tuple[np.ndarray, Image.Image, float]]):
    """Pose, picture and time, s, of frames one after the other; a pose that is shown twice in a row counts once."""

    def add(self, views: Views) -> None:
        """Record a frame; at rest its full quality replaces the coarse one."""
        if views.image is None:
            return
        picture = framed(views.image, views.mask, views.state.probe)
        is_last_pose = bool(self) and np.array_equal(self[-1][0], views.state.pose)
        at_s = self.pop()[2] if is_last_pose else views.at_s
        self.append((views.state.pose, picture, at_s))

    def save(self, folder: Path) -> Path:
        """Write `sweep.gif` at the speed of the recording and `poses.npy`, (n, 4, 4) float64, and return its path.

        Where nothing has been recorded it is a ValueError.
        """
        if not self:
            raise ValueError("nothing was recorded: move the probe while recording")
        poses, pictures, times_s = zip(*self, strict=True)
        file = save_poses(folder / "poses.npy", np.stack(poses))
        images = [picture.resize(pictures[0].size) for picture in pictures]  # another depth may have another width
        spans_ms = [max(20, round(1e3 * span)) for span in (*np.diff(times_s), 0.5)]
        with written_whole(folder / "sweep.gif") as partial:
            images[0].save(partial, "GIF", save_all=True, append_images=images[1:], duration=spans_ms, loop=0)
        return file


def save_frame(folder: Path, views: Views) -> None:
    """Write the frame as `simulated.png`, `segmentation.png`, `attenuation.png` (65535 is 1) and `generated_<k>.png`.

    `frame.json` beside them has pose, probe, settings, display, seed and runs, and `pose.npy` the pose alone. The
    folder is made.
    """
    state = views.state
    save_poses(folder / "pose.npy", state.pose)
    images = {
        "simulated": views.target,
        "segmentation": views.segmentation,
        "attenuation": np.rint(65535 * views.attenuation).astype(np.uint16),
    }
    images |= {f"generated_{k}": image for k, image in enumerate(views.generated)}
    for name, image in images.items():
        if image is not None:
            write_image(folder / f"{name}.png", image)
    described = {
        "pose": state.pose.tolist(),
        "hold": plain(state.hold),
        "probe": plain(state.probe),
        "simulator": plain(state.simulator),
        "display": plain(state.display),
        "seed": state.seed,
        "runs": [str(run) for run in state.runs],
        "quality": views.quality.value,
        "time_gain_db": views.time_gain_db,  # the curve of tgc=patient
    }
    write_json(folder / "frame.json", described)


def save_poses(file: Path, poses: np.ndarray) -> Path:
    """Write poses, (4, 4) or (n, 4, 4), as NumPy's own file into a folder that is made, and return its path."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(file) as partial:
        np.save(partial, poses)
    return file


def next_folder(parent: Path, name: str) -> Path:
    """The first of `name_1`, `name_2`, ... that does not exist yet."""
    folders = (parent / f"{name}_{k}" for k in count(1))
    return next(folder for folder in folders if not folder.exists())


def command_line(settings: StudySettings, state: ViewerState, *words: str) -> str:
    """A command line with these words that is composed to the same scene, probe and simulator as a state.

    `settings` are those that the viewer was started with.
    """
    wanted = replace(settings, probe=state.probe, simulator=state.simulator)
    overrides = [f"preset={wanted.preset}", f"scene={wanted.scene.kind}", f"probe={wanted.probe.kind}"]
    if wanted.scene.folder:
        overrides.append(f"scene.folder={_typed(Path(wanted.scene.folder).resolve())}")
    if wanted.runs_dir != StudySettings.runs_dir:
        overrides.append(f"runs_dir={_typed(wanted.runs_dir)}")
    changed: dict[str, str] = {}
    for _ in range(2):  # what follows from a value that is not given, as the pulse from the depth, differs only then
        composed = job_of([*overrides, *_assignments(changed), "task=describe"]).settings
        changed |= _differing(wanted, composed)
    return shlex.join(["python", "-m", "ablate", *words, *overrides, *_assignments(changed)])


def _typed(path: object) -> str:
    """A path as it is typed behind `key=`; in quotes only where Hydra would read it as something else."""
    return str(path) if re.fullmatch(r"[A-Za-z0-9_./-]*[A-Za-z/][A-Za-z0-9_./-]*", str(path)) else quoted(path)


def _assignments(values: Mapping[str, str]) -> list[str]:
    return [f"{key}={text}" for key, text in values.items()]


def _differing(wanted: StudySettings, composed: StudySettings) -> dict[str, str]:
    """The keys of what is seen whose values are not the wanted ones, with the wanted ones as Hydra reads them."""
    differing = {}
    for section in _SECTIONS:
        values, composed_values = plain(getattr(wanted, section)), plain(getattr(composed, section))
        names = _OF_DATASET if section == "dataset" else sorted(values.keys() - _CHOSEN_BEFORE)
        for name in names:
            value = values[name]
            if value != composed_values[name]:
                text = value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
                differing[f"{section}.{name}"] = text
    return differing
