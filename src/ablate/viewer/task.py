"""`task=view`: the probe in a browser, until it is stopped."""

import threading
import time
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ablate.dataset import read_poses
from ablate.runs.job import Job
from ablate.runs.simulated import build_scene
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.viewer.engine import Engine
from ablate.viewer.generators import pickable
from ablate.viewer.hand import Hand
from ablate.viewer.page.server import HOST, check_server, open_server
from ablate.viewer.presets import presets
from ablate.viewer.session import Session, first_state
from ablate.viewer.state import State, Views
from ablate.viewer.worker import Worker

_LOOK_EVERY_S = 3600.0


def view(jobs: Sequence[Job]) -> int:
    """Show the page of the first job's scene until the program is stopped."""
    settings = jobs[0].settings
    port = settings.viewer.port
    check_server(port)
    with refusing():  # a mesh with a hole, a pose that is not rigid, ...
        viewer = Viewer(settings)
    address = f"http://{HOST}:{port}"
    print(f"{address}  (Ctrl-C ends it)", flush=True)
    if settings.viewer.open:
        webbrowser.open(address)
    try:
        while True:
            time.sleep(_LOOK_EVERY_S)
    except KeyboardInterrupt as stopped:
        if type(stopped) is not KeyboardInterrupt:  # a signal, which has a number of its own
            raise
        return 0
    finally:
        viewer.close()


class Viewer:
    """A scene, its worker and its page, open on a port.

    Raises
    ------
    ConfigurationError, ValueError, OSError
        In a sentence, when the port is in use, or the scene or a pose cannot be used.
    """

    def __init__(self, settings: StudySettings) -> None:
        check_server(settings.viewer.port)
        scene, grid = build_scene(settings)
        places = presets(settings, scene, grid)
        offered = offered_generators(settings)
        engine = Engine(scene)
        self.worker: Worker[State, Views] = Worker(engine.render)
        hand = Hand(scene, grid.axis, grid.front, settings.dataset.press_mm, settings.probe)
        picked = tuple(list(offered.values())[:1])
        start = first_state(settings.probe, settings.simulator, settings.dataset.seed, picked)
        self.session = Session(hand, start, places, self.worker.submit)
        if (pose := _first_pose(settings, places)) is not None:
            self.session.to_pose(pose)
        self.server = open_server(settings.viewer.port)
        from ablate.viewer.page.whole import build_page

        self.page = build_page(self.server, settings, scene, self.session, self.worker, offered)
        self._lock = threading.Lock()
        self.worker.pause()
        self.worker.start(self.page.show, self.page.fail)
        self.server.on_client_connect(self._follow_pages)
        self.server.on_client_connect(self.page.fit)
        self.server.on_client_disconnect(self._follow_pages)

    def close(self) -> None:
        """Stop the server and the worker."""
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


def offered_generators(settings: StudySettings) -> dict[str, Path]:
    """The generators that can be picked, by name; a ConfigurationError for `runs` that hold none."""
    if settings.runs is None:
        return pickable(settings.results)
    folder = Path(settings.runs)
    if not folder.is_dir():
        allowed = "a run, a study or a folder of studies"
        raise ConfigurationError(f"runs={settings.runs}: no such folder; allowed is {allowed}")
    return pickable(folder)


def _first_pose(settings: StudySettings, places: dict[str, np.ndarray]) -> np.ndarray | None:
    if settings.pose:
        return np.asarray(read_poses(Path(settings.pose), "pose")[0][0])
    if settings.plane:
        name = settings.plane.replace("_", " ")
        if name not in places:
            raise ConfigurationError(f"plane={settings.plane}: allowed are {', '.join(places)}")
        return places[name]
    return None
