"""What is done with what is seen: the tab Compare, with generators beside the simulator, and the tab Keep."""

import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ablate.metrics import patch_chi2, psnr, rms
from ablate.viewer.generators import is_shipped, pickable
from ablate.viewer.page.page import Page
from ablate.viewer.records import LOOP_S, Sweep, command_line, next_folder, save_frame, save_poses
from ablate.viewer.session import Views
from ablate.viewer.words import in_markdown

_NONE = "none"
_TRAINS = "No run with weights here. `make sweep` trains three, and `python -m ablate variant=sa2h` trains one."
_LAST_S = 0.5  # the last frame of the cine loop stays for so long, and one at which the probe rested


def add_compare_tab(page: Page, runs: Path) -> None:
    """Add two pickers of the generators in a folder, the difference, and the numbers."""
    session, gui = page.session, page.server.gui
    offered = pickable(runs)
    picked = tuple(name for name, folder in offered.items() if folder in session.state.runs)
    first, second = (*picked, _NONE, _NONE)[:2]
    pickers = [
        gui.add_dropdown("Generator", (_NONE, *offered), initial_value=first),
        gui.add_dropdown("A second one", (_NONE, *offered), initial_value=second),
    ]

    def name_runs() -> None:
        page.layout = replace(page.layout, names={folder: name for name, folder in offered.items()})

    def invitation() -> str:
        return _TRAINS if all(map(is_shipped, offered.values())) else ""

    def pick(_: Any) -> None:
        folders = [offered[picker.value] for picker in pickers if picker.value in offered]
        session.show(runs=tuple(dict.fromkeys(folders)))

    def look_again() -> None:
        offered.clear()
        offered.update(pickable(runs))
        name_runs()
        for picker in pickers:
            picker.options = (_NONE, *offered)
        trained.content = invitation()

    for picker in pickers:
        picker.on_update(page.does(pick))
    page.add_button("Look for new runs", look_again)
    trained = gui.add_markdown(invitation())
    difference = gui.add_checkbox("Difference to the simulated image", initial_value=False)
    difference.on_update(page.does(lambda wanted: page.lay_out(difference=wanted)))
    numbers = gui.add_markdown("")
    page.painters.append(lambda views: setattr(numbers, "content", _distances(page.layout.names, views)))
    name_runs()


def _distances(names: Mapping[Path, str], views: Views) -> str:
    """Distances of the generated images to the simulated one, as they are shown, as a table."""
    rows = []
    for run, image in zip(views.state.runs, views.generated, strict=True):
        if image is not None and views.target is not None:
            name = in_markdown(names.get(run, run.name))
            psnr_db = psnr(views.target, image, mask=views.mask)
            chi2 = rms(patch_chi2(views.target, image))
            rows.append(f"| {name} | {psnr_db:.1f} | {'–' if chi2 is None else f'{chi2:.3f}'} |")
    head = "| to the simulated image | PSNR in the fan (dB) | patch χ² |\n| --- | --- | --- |\n"
    return head + "\n".join(rows) if rows else ""


def add_keep_tab(page: Page) -> None:
    """Add buttons to save, a switch to record, and the cine loop."""
    gui, session, settings = page.server.gui, page.session, page.settings

    def shown() -> Views:
        if page.shown is None:
            raise ValueError("there is no frame yet")
        return page.shown

    def save() -> None:
        folder = next_folder(page.folder, settings.scene_name)
        save_frame(folder, shown())
        answer.content = f"Saved in `{folder}`, with `frame.json` and `pose.npy`."

    def write_command() -> None:
        views = shown()
        state = views.state
        pose = save_poses(next_folder(page.folder, "pose") / "pose.npy", state.pose)
        seeded = replace(settings, dataset=replace(settings.dataset, seed=state.seed))
        simulator = replace(state.simulator, time_gain_db=views.time_gain_db)
        if state.display is not None and state.display.dynamic_range_db:
            simulator = replace(simulator, dynamic_range_db=state.display.dynamic_range_db)
        words = ["task=render", f"pose={pose}"]
        if state.display is not None and state.display.gain_db:
            words.append(f"gain_db={state.display.gain_db:g}")
        command.value = command_line(seeded, replace(state, simulator=simulator), *words)

    def switch(records: bool) -> None:
        if records:
            page.sweep = Sweep()
            answer.content = "Recording: every frame that is shown is a pose of the sweep."
        elif page.sweep is not None:
            sweep, page.sweep = page.sweep, None
            answer.content = kept_in
            file = sweep.save(next_folder(page.folder, "sweep"))
            kept = f"{len(sweep)} poses in `{file.parent}`, with `sweep.gif`. The command makes pairs of them."
            alike = "Poses beside each other look alike, so its test frames are not unseen sites (docs/anatomy.md)."
            answer.content = f"{kept} {alike}"
            if len(sweep) >= 3:  # one of each part
                words = "task=simulate", f"dataset.poses={file}", f"dataset.frames={len(sweep)}"
                command.value = command_line(settings, session.state, *words)

    page.add_button("Save the frame", save)
    page.add_button("Pose as a command line", write_command)
    command = gui.add_text("Command", "", multiline=True, disabled=False)
    record = gui.add_checkbox("Record a sweep", initial_value=False, hint="move the probe, then switch it off")
    record.on_update(page.does(switch))
    _add_cine(page)
    kept_in = f"Everything is kept in `{page.folder}`."
    answer = gui.add_markdown(kept_in)


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

    newest: threading.Thread | None = None  # an older one may still sleep between two frames

    def start(plays: bool) -> None:
        nonlocal newest
        if plays:
            look_back(LOOP_S)
            newest = threading.Thread(target=run, name="cine", daemon=True)
            newest.start()

    def run() -> None:
        """Show the loop until it is switched off, or the picture follows the probe again, or nobody looks."""
        show = page.tells(look_back)
        while play.value:
            frames = list(page.loop)
            for frame, after in zip(frames, [*frames[1:], None], strict=True):
                with page.lock:
                    if newest is not threading.current_thread():
                        return
                    if not (play.value and session.frozen and page.server.get_clients()):
                        play.value = False
                        return
                    back.value = round(frames[-1].at_s - frame.at_s, 1)
                    show(frames[-1].at_s - frame.at_s)
                time.sleep(_LAST_S if after is None else min(after.at_s - frame.at_s, _LAST_S))

    def refresh() -> None:
        if not session.frozen:
            back.value, play.value = 0.0, False

    back.on_update(page.does(look_back, streams=True))
    play.on_update(page.does(start))
    page.refreshers.append(refresh)
