"""What is kept: frames, poses as a command line, sweeps, and the last five seconds."""

import threading
import time
from typing import Any

import numpy as np

from ablate.storage import written_whole
from ablate.viewer.command import data_command, render_command
from ablate.viewer.page.controls import add_button
from ablate.viewer.page.page import Page
from ablate.viewer.records import LOOP_S, Sweep, next_folder, save_frame

_FEWEST_POSES = 3
_LAST_S = 0.5  # the last frame of the cine loop stays for so long, and one at which the probe rested


def add_keep_tab(page: Page) -> None:
    """Buttons to save, a switch to record, and the cine loop."""
    gui = page.server.gui
    add_button(page, "Save the frame", lambda _: _save(page, said))
    add_button(page, "Pose as a command line", lambda _: _command(page, command))
    command = gui.add_text("Command", "", multiline=True, disabled=False)
    record = gui.add_checkbox("Record a sweep", initial_value=False, hint="move the probe, then switch it off")
    record.on_update(page.does(lambda _: _record(page, record.value, said, command)))
    back = gui.add_slider("Cine: seconds back", min=0.0, max=LOOP_S, step=0.1, initial_value=0.0)
    back.on_update(page.does(lambda _: _look_back(page, back.value)))
    play = gui.add_checkbox(
        "Cine: play", initial_value=False, hint="the last seconds at their own speed, again and again"
    )
    play.on_update(page.does(lambda _: _start_cine(page, play, back)))

    def refresh() -> None:
        if not page.session.frozen:
            back.value, play.value = 0.0, False

    page.refreshers.append(refresh)
    said = gui.add_markdown(f"Everything is kept in `{page.folder}`.")


def _save(page: Page, said: Any) -> None:
    shown = page.shown
    if shown is None:
        raise ValueError("there is no frame yet")
    folder = save_frame(next_folder(page.folder, page.settings.scene_name), shown.state, shown.views)
    said.content = f"Saved in `{folder}`, with `frame.json` and `pose.npy`."


def _command(page: Page, command: Any) -> None:
    folder = next_folder(page.folder, "pose")
    folder.mkdir(parents=True)
    with written_whole(folder / "pose.npy") as partial, partial.open("wb") as partial_file:
        np.save(partial_file, page.session.state.pose)
    command.value = render_command(page.settings, page.session.state, folder / "pose.npy")


def _record(page: Page, recording: bool, said: Any, command: Any) -> None:
    if recording:
        page.sweep = Sweep()
        said.content = "Recording: every frame that is shown is a pose of the sweep."
        return
    sweep, page.sweep = page.sweep, None
    if sweep is None:
        return
    folder = sweep.save(next_folder(page.folder, "sweep"))
    state, poses = page.session.state, folder / "poses.npy"
    said.content = f"{len(sweep.poses)} poses in `{folder}`, with `sweep.gif`. The command makes pairs of them."
    if len(sweep.poses) >= _FEWEST_POSES:
        command.value = data_command(page.settings, state, poses, len(sweep.poses))


def _start_cine(page: Page, play: Any, back: Any) -> None:
    if play.value:
        _look_back(page, LOOP_S)
        threading.Thread(target=_cine, args=(page, play, back), name="cine", daemon=True).start()


def _cine(page: Page, play: Any, back: Any) -> None:
    """Show the loop until it is switched off, or the picture follows the probe again, or nobody looks."""
    show = page.tells(lambda seconds: _look_back(page, seconds))
    while play.value:
        frames = list(page.loop.frames)
        for frame, after in zip(frames, [*frames[1:], None], strict=True):
            with page.lock:
                if not (play.value and page.session.frozen and page.server.get_clients()):
                    play.value = False
                    return
                back.value = round(frames[-1].at_s - frame.at_s, 1)
                show(frames[-1].at_s - frame.at_s)
            time.sleep(_LAST_S if after is None else min(after.at_s - frame.at_s, _LAST_S))


def _look_back(page: Page, seconds: float) -> None:
    if not page.session.frozen:
        page.session.freeze(True)
    if (frame := page.loop.before(seconds)) is None:
        raise ValueError("there is no frame yet")
    page.shown = frame
    page.paint(frame.state, frame.views)
