"""What is kept of a session: the last seconds, a sweep of the probe, and single frames on disk."""

import json
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from ablate.setting import plain
from ablate.storage import written_whole
from ablate.viewer.pictures import grey_picture
from ablate.viewer.state import State, Views

LOOP_S = 5.0
_LOOP_BYTES = 256e6
_MOST_POSES = 10_000  # of a recorded sweep


@dataclass(frozen=True, eq=False)
class Shown:
    """Views of a state, and when they were shown, seconds of a monotonic clock."""

    state: State
    views: Views
    at_s: float


@dataclass(eq=False)
class CineLoop:
    """The frames of the last five seconds, fewer where they are so large that they would fill the memory."""

    frames: deque[Shown] = field(default_factory=deque)

    def add(self, state: State, views: Views, at_s: float | None = None) -> None:
        """Keep a frame and forget those that are too old."""
        now = time.monotonic() if at_s is None else at_s
        self.frames.append(Shown(state, views, now))
        most = max(1, int(_LOOP_BYTES / _bytes(views)))
        while len(self.frames) > most or now - self.frames[0].at_s > LOOP_S:
            self.frames.popleft()

    def before(self, seconds: float) -> Shown | None:
        """The frame that was shown so long before the last one; None where there is no frame."""
        if not self.frames:
            return None
        wanted = self.frames[-1].at_s - seconds
        return min(self.frames, key=lambda shown: abs(shown.at_s - wanted))


@dataclass(eq=False)
class Sweep:
    """Poses and pictures that are recorded one after the other; a pose that is shown twice in a row counts once."""

    poses: list[np.ndarray] = field(default_factory=list)
    pictures: list[np.ndarray] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)

    def add(self, state: State, views: Views) -> None:
        """Record a frame; at rest its full quality replaces the coarse one."""
        image = views.target if views.target is not None else views.generated[0]
        if image is None:
            return
        picture = grey_picture(image, views.mask, state.probe)
        if self.poses and np.array_equal(self.poses[-1], state.pose):
            self.pictures[-1] = picture
        elif len(self.poses) < _MOST_POSES:
            self.poses.append(state.pose.copy())
            self.pictures.append(picture)
            self.times_s.append(time.monotonic())

    def save(self, folder: Path) -> Path:
        """Write `poses.npy`, (n, 4, 4) float64, and `sweep.gif` at the speed of the recording.

        Raises
        ------
        ValueError
            When nothing has been recorded.
        OSError
            When the folder cannot be written.
        """
        if not self.poses:
            raise ValueError("nothing was recorded: move the probe while recording")
        folder.mkdir(parents=True, exist_ok=True)
        with written_whole(folder / "poses.npy") as partial, partial.open("wb") as partial_file:
            np.save(partial_file, np.stack(self.poses))
        height, width = self.pictures[0].shape[:2]  # another depth may have another width
        images = [Image.fromarray(picture).resize((width, height)) for picture in self.pictures]
        spans_ms = [max(20, round(1e3 * span)) for span in (*np.diff(self.times_s), 0.5)]
        with written_whole(folder / "sweep.gif") as partial:
            images[0].save(partial, "GIF", save_all=True, append_images=images[1:], duration=spans_ms, loop=0)
        return folder


def save_frame(folder: Path, state: State, views: Views) -> Path:
    """Write the frame as `simulated.png`, `segmentation.png`, `attenuation.png` (65535 is 1) and `generated_<k>.png`.

    `frame.json` beside them has pose, probe, settings, display, seed and runs, and `pose.npy` the pose alone. The
    folder is made, and returned.
    """
    folder.mkdir(parents=True, exist_ok=True)
    maps = {"simulated": views.target, "segmentation": views.segmentation}
    maps["attenuation"] = np.rint(65535 * views.attenuation).astype(np.uint16)
    maps |= {f"generated_{k}": image for k, image in enumerate(views.generated)}
    for name, image in ((name, image) for name, image in maps.items() if image is not None):
        with written_whole(folder / f"{name}.png") as partial:
            Image.fromarray(image).save(partial, "PNG")
    with written_whole(folder / "pose.npy") as partial, partial.open("wb") as partial_file:
        np.save(partial_file, state.pose)
    with written_whole(folder / "frame.json") as partial:
        partial.write_text(json.dumps(described(state) | {"quality": views.quality.value}, indent=2), "utf-8")
    return folder


def next_folder(parent: Path, name: str) -> Path:
    """The first of `name_1`, `name_2`, ... that there is not yet."""
    number = 1
    while (folder := parent / f"{name}_{number}").exists():
        number += 1
    return folder


def described(state: State) -> dict[str, object]:
    """Everything that decides a frame but the scene, JSON-ready."""
    return {
        "pose": state.pose.tolist(),
        "hold": plain(state.hold),
        "probe": plain(state.probe),
        "simulator": plain(state.simulator),
        "display": plain(state.display),
        "seed": state.seed,
        "runs": [str(folder) for folder in state.runs],
    }


def _bytes(views: Views) -> int:
    arrays = (views.target, views.segmentation, views.attenuation, views.mask, *views.generated)
    return sum(array.nbytes for array in arrays if array is not None)
