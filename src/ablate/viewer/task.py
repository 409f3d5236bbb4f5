"""`task=view`: the probe in a browser, until it is stopped."""

import threading
import time
import webbrowser
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from ablate.anatomy import Scene, SiteGrid, structure_names
from ablate.dataset import equally_spaced, place_probe, read_poses
from ablate.setting import did_you_mean
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.sources.simulated import training_poses
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.ultrasound import Display, TimeGain
from ablate.viewer.generators import first_fitting, pickable
from ablate.viewer.hand import Hand
from ablate.viewer.page.browser import add_script, widths
from ablate.viewer.page.operate_tabs import add_hands, add_move_tab, add_row, add_scan_tab
from ablate.viewer.page.page import Page
from ablate.viewer.page.result_tabs import add_compare_tab, add_keep_tab
from ablate.viewer.page.view_tab import add_view_tab
from ablate.viewer.scene_renderer import SceneRenderer
from ablate.viewer.server import HOST, check_server, open_server
from ablate.viewer.session import Session, ViewerState
from ablate.viewer.worker import Worker

_WINDOW_PX = 1366  # until the browser has told its own
_MOST_SITES = 60  # of a list that can be searched by eye


def view(jobs: Sequence[Job]) -> int:
    """Show the page of the first job's scene until the program is stopped."""
    settings = jobs[0].settings
    with refusing():  # a mesh with a hole, a pose that is not rigid, ...
        viewer = Viewer(settings)
    address = f"http://{HOST}:{settings.viewer.port}"
    print(f"{address}  (Ctrl-C ends it)", flush=True)
    if settings.viewer.open:
        webbrowser.open(address)
    try:
        while True:
            time.sleep(3600.0)
    except KeyboardInterrupt as stopped:
        if type(stopped) is not KeyboardInterrupt:  # a signal, which has a number of its own
            raise
        return 0
    finally:
        viewer.close()


class Viewer:
    """A scene, its worker and its page, open on a port.

    What cannot be opened, as a port that is in use or a scene that cannot be used, is an error in one sentence.
    """

    def __init__(self, settings: StudySettings) -> None:
        check_server(settings.viewer.port)
        scene, grid = source_of(settings).scene()
        hand = Hand(scene, grid.axis, grid.front, settings.dataset.press_mm, settings.probe)
        poses = presets(settings, scene, grid, hand)
        runs = runs_folder(settings)
        gain_poses = np.array(list(poses.values()))
        if settings.simulator.tgc is TimeGain.patient:
            gain_poses = training_poses(settings, scene, grid, gain_poses)
        custom = settings.model.target
        self.worker = Worker(SceneRenderer(scene, gain_poses, custom).render)
        display = Display(gain_db=settings.gain_db)
        start = ViewerState(np.eye(4), settings.probe, settings.simulator, display, settings.dataset.seed)
        start = replace(start, runs=first_fitting(pickable(runs), scene.tissues, start, custom))
        self.session = Session(hand, start, poses, self.worker.submit)
        go_to_start(self.session, settings)
        self.server = open_server(settings.viewer.port)
        self.page = Page(self.server, settings, scene, self.session)
        self._fill_page(runs)
        self._lock = threading.Lock()
        self.worker.pause()
        self.worker.start(self.page.show, self.page.fail)
        self.server.on_client_connect(self._follow_pages)
        self.server.on_client_disconnect(self._follow_pages)

    def _fill_page(self, runs: Path) -> None:
        """Add the controls on the left; the body is in the middle, and the images are on the right."""
        gui, page = self.server.gui, self.page
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.set_panel_label(f"ablate: {page.settings.scene_name}")
        add_row(page)
        add_script(gui, page.does, lambda place, shift: page.image_clicked(place, shift), self._fit)
        tabs = gui.add_tab_group()
        contents: dict[str, Callable[[Page], None]] = {
            "Move": add_move_tab,
            "Scan": add_scan_tab,
            "View": add_view_tab,
            "Compare": partial(add_compare_tab, runs=runs),
            "Keep": add_keep_tab,
        }
        for name, add_content in contents.items():
            with tabs.add_tab(name):
                add_content(page)
        add_hands(page)
        gui.main_panel.dock_left()
        page.images.dock_right()
        self._fit(_WINDOW_PX)
        page.refresh()

    def _fit(self, window_px: float) -> None:
        """Divide the width of a window between the controls, the body and the images."""
        controls, images = widths(window_px)
        self.server.gui.main_panel.set_width(controls)
        self.page.images.set_width(images)

    def close(self) -> None:
        """Stop the server, the worker and the thread that draws."""
        self.server.stop()
        self.worker.close()
        self.page.close()

    def _follow_pages(self, _: Any) -> None:
        """Compute while a page is open, and nothing otherwise."""
        with self._lock:
            if not self.server.get_clients():
                self.worker.pause()
            elif self.worker.paused:
                self.worker.resume()


def runs_folder(settings: StudySettings) -> Path:
    """The folder whose generators are offered; a ConfigurationError where `runs=` names none."""
    if settings.runs is None:
        return settings.results
    folder = Path(settings.runs)
    if not folder.is_dir():
        allowed = "allowed is a run, a study or a folder of studies"
        raise ConfigurationError(f"runs={settings.runs}: no such folder; {allowed}")
    return folder


def go_to_start(session: Session, settings: StudySettings) -> None:
    """Go to the pose or the plane that the settings name, if they name one."""
    if settings.pose:
        poses, _ = read_poses(Path(settings.pose), "pose")
        session.to_pose(np.asarray(poses[0]))
    elif settings.plane:
        name = settings.plane.replace("_", " ")
        if name not in session.presets:
            hint = did_you_mean(name, session.presets)
            raise ConfigurationError(f"plane={settings.plane}: allowed are {', '.join(session.presets)}{hint}")
        session.to_preset(name)


def presets(settings: StudySettings, scene: Scene, grid: SiteGrid, hand: Hand) -> dict[str, np.ndarray]:
    """Poses to start from, (4, 4) float64, mm, by name: standard planes of the built-in anatomy.

    Of other scenes: through the middle of each structure but the largest, by the structure's name, and probe sites.

    Parameters
    ----------
    settings : StudySettings
        Of the job.
    scene : Scene
        The body; its structures' names are those of their meshes.
    grid : SiteGrid
        If it has many sites, they are evenly spaced ones. At a site the probe stands upright on the skin, and its plane
        is the first of the grid's rolls.
    hand : Hand
        Finds the poses that look at a structure.

    Raises
    ------
    ValueError
        For a scene without a structure, or without a usable probe site.
    """
    planes = source_of(settings).planes()
    if planes:
        return {name.replace("_", " "): pose for name, pose in planes.items()}
    upright = replace(grid, tilts_deg=(0.0,), rolls_deg=grid.rolls_deg[:1])
    placed = place_probe(scene, upright, settings.dataset.press_mm, settings.probe)
    named: dict[str, np.ndarray] = {}
    structures_of: Counter[str] = Counter()
    called = zip(scene.structures, structure_names(scene), strict=True)
    for structure, called_so in sorted(called, key=lambda one: -abs(one[0].mesh.volume))[1:_MOST_SITES]:
        name = called_so.replace("_", " ")
        parts = structure.mesh.split(only_watertight=False)  # one kidney of two, not what lies between them
        pose = hand.aim(max(parts, key=attrgetter("area")).centroid, grid.angles_deg)
        if pose is not None:
            structures_of[name] += 1
            number = structures_of[name]
            named[name if number == 1 else f"{name} {number}"] = pose
    for i in equally_spaced(np.arange(len(placed.poses)), _MOST_SITES):
        height, angle = divmod(int(placed.sites[i]), len(grid.angles_deg))
        named[f"{grid.heights_mm[height]:.0f} mm, {grid.angles_deg[angle]:.0f} degrees"] = placed.poses[i]
    return named
