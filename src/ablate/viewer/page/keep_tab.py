"""What is kept: frames, poses as a command line, sweeps, and the last five seconds."""

from typing import Any

import numpy as np

from ablate.storage import written_whole
from ablate.viewer.command import data_command, render_command
from ablate.viewer.page.controls import add_button
from ablate.viewer.page.page import Page
from ablate.viewer.records import LOOP_S, Sweep, next_folder, save_frame

_FEWEST_POSES = 3


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

    def refresh() -> None:
        if not page.session.frozen:
            back.value = 0.0

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


def _look_back(page: Page, seconds: float) -> None:
    if not page.session.frozen:
        page.session.freeze(True)
    if (frame := page.loop.before(seconds)) is None:
        raise ValueError("there is no frame yet")
    page.shown = frame
    page.paint(frame.state, frame.views)
