"""What is kept: frames, poses as a command line, sweeps, and the last five seconds."""

import threading
import time
from dataclasses import replace
from typing import Any

from ablate.viewer.page.page import Page
from ablate.viewer.records import LOOP_S, Sweep, command_line, next_folder, save_frame, save_poses

_FEWEST_POSES = 3
_LAST_S = 0.5  # the last frame of the cine loop stays for so long, and one at which the probe rested


def add_keep_tab(page: Page) -> None:
    """Add buttons to save, a switch to record, and the cine loop."""
    gui, session, settings = page.server.gui, page.session, page.settings

    def save() -> None:
        if page.shown is None:
            raise ValueError("there is no frame yet")
        folder = next_folder(page.folder, settings.scene_name)
        save_frame(folder, page.shown)
        answer.content = f"Saved in `{folder}`, with `frame.json` and `pose.npy`."

    def write_command() -> None:
        pose = save_poses(next_folder(page.folder, "pose") / "pose.npy", session.state.pose)
        seeded = replace(settings, dataset=replace(settings.dataset, seed=session.state.seed))
        command.value = command_line(seeded, session.state, "task=render", f"pose={pose}")

    def switch(_: Any) -> None:
        if record.value:
            page.sweep = Sweep()
            answer.content = "Recording: every frame that is shown is a pose of the sweep."
        elif (sweep := page.sweep) is not None:
            page.sweep = None
            file, count = sweep.save(next_folder(page.folder, "sweep")), len(sweep)
            answer.content = f"{count} poses in `{file.parent}`, with `sweep.gif`. The command makes pairs of them."
            if count >= _FEWEST_POSES:
                words = "task=simulate", f"dataset.poses={file}", f"dataset.frames={count}"
                command.value = command_line(settings, session.state, *words)

    page.add_button("Save the frame", save)
    page.add_button("Pose as a command line", write_command)
    command = gui.add_text("Command", "", multiline=True, disabled=False)
    record = gui.add_checkbox("Record a sweep", initial_value=False, hint="move the probe, then switch it off")
    record.on_update(page.does(switch))
    _add_cine(page)
    answer = gui.add_markdown(f"Everything is kept in `{page.folder}`.")


def _add_cine(page: Page) -> None:
    """Add the cine loop, by a slider or played again and again."""
    gui, session = page.server.gui, page.session
    back = gui.add_slider("Cine: seconds back", min=0.0, max=LOOP_S, step=0.1, initial_value=0.0)
    hint = "the last seconds at their own speed, again and again"
    play = gui.add_checkbox("Cine: play", initial_value=False, hint=hint)

    def look_back(seconds: float) -> None:
        if not session.frozen:
            session.freeze(True)
        page.shown = page.loop.before(seconds)
        page.paint(page.shown)

    def start(_: Any) -> None:
        if play.value:
            look_back(LOOP_S)
            threading.Thread(target=run, name="cine", daemon=True).start()

    def run() -> None:
        """Show the loop until it is switched off, or the picture follows the probe again, or nobody looks."""
        show = page.tells(look_back)
        while play.value:
            frames = list(page.loop)
            for frame, after in zip(frames, [*frames[1:], None], strict=True):
                with page.lock:
                    if not (play.value and session.frozen and page.server.get_clients()):
                        play.value = False
                        return
                    back.value = round(frames[-1].at_s - frame.at_s, 1)
                    show(frames[-1].at_s - frame.at_s)
                time.sleep(_LAST_S if after is None else min(after.at_s - frame.at_s, _LAST_S))

    def refresh() -> None:
        if not session.frozen:
            back.value, play.value = 0.0, False

    back.on_update(page.does(lambda _: look_back(back.value)))
    play.on_update(page.does(start))
    page.refreshers.append(refresh)
