"""The page without a browser: what is sent to it, what it answers, and what it says when it cannot."""

import json
import shlex
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image
from trimesh.transformations import translation_matrix

pytest.importorskip("viser", reason="needs the extra: pip install 'ablate-ultrasound[view]'")

from ablate.command.compose import jobs_of
from ablate.dataset import read_poses
from ablate.settings.study import ConfigurationError, Task
from ablate.sources.prepare import simulator_of
from ablate.sources.source import source_of
from ablate.ultrasound import Display, Simulator
from ablate.viewer.calipers import in_plane
from ablate.viewer.page.body import hides_the_rest
from ablate.viewer.pictures import Window
from ablate.viewer.session import ViewerState
from ablate.viewer.task import Viewer
from ablate.viewer.worker import REST_S
from support.viewed_body import free_port, until
from support.viewer_client import Client

# Threads of viser's server end a moment after it has been told to stop.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture(scope="module")
def arguments(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A body with a bone, as a scene folder."""
    folder = tmp_path_factory.mktemp("scenes") / "ball"
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=60).export(folder / "body.obj")
    trimesh.creation.icosphere(2, radius=15).export(folder / "bone.obj")
    structures = [{"mesh": "body.obj", "tissue": "liver"}, {"mesh": "bone.obj", "tissue": "bone"}]
    sites = {"heights": [-15, 0, 15], "angles": [-40, 0, 40], "axis": [0, 0, 1], "front": [0, -1, 0]}
    (folder / "scene.yaml").write_text(yaml.safe_dump({"structures": structures, "sites": sites}))
    runs = tmp_path_factory.mktemp("runs")
    return ["task=view", "preset=tiny", "scene=folder", f"scene.folder={folder}", f"runs_dir={runs}"]


@pytest.fixture(scope="module")
def viewer(arguments: list[str]) -> Iterator[Viewer]:
    (job,) = jobs_of([*arguments, f"viewer.port={free_port()}"])
    made = Viewer(job.settings)
    yield made
    made.close()


@pytest.fixture
def client(viewer: Viewer) -> Iterator[Client]:
    with Client(viewer.page.settings.viewer.port) as made:
        made.until(lambda: "Cine: play" in made.labels and made.captions())
        viewer.session.reset()
        settle(made, viewer)
        yield made
        viewer.session.freeze(False)


def settle(client: Client, viewer: Viewer) -> None:
    """Wait until the probe has rested and its image has come."""
    time.sleep(2 * REST_S)
    client.until(lambda: viewer.worker.idle and viewer.page.drawn)
    time.sleep(0.1)


def test_the_cine_loop_is_played_until_it_is_switched_off(client: Client, viewer: Viewer) -> None:
    for angle in (5.0, 10.0, 15.0):
        client.set("Around (°)", angle)
        settle(client, viewer)
    held = viewer.page.loop.before(0.0)
    assert held is not None
    client.set("Cine: play", True)
    seen: set[object] = set()

    def played() -> bool:
        seen.add(viewer.page.shown)
        return held in seen and len(seen) >= 3

    client.until(played)
    assert viewer.session.frozen
    client.set("Cine: play", False)
    time.sleep(0.5)
    before, computed = viewer.page.shown, dict(viewer.worker.computed)
    time.sleep(0.5)
    assert viewer.page.shown is before
    assert viewer.worker.computed == computed
    viewer.session.freeze(False)
    settle(client, viewer)


def test_a_cine_loop_that_is_switched_off_and_on_again_is_played_once(client: Client, viewer: Viewer) -> None:
    client.set("Around (°)", 5.0)
    settle(client, viewer)
    for plays in (True, False, True, False, True):
        client.set("Cine: play", plays)
    time.sleep(1.5)
    assert [thread.name for thread in threading.enumerate()].count("cine") == 1
    client.set("Cine: play", False)
    client.until(lambda: "cine" not in {thread.name for thread in threading.enumerate()})
    viewer.session.freeze(False)
    settle(client, viewer)


def test_a_slider_moves_the_probe_and_a_picture_of_it_comes(client: Client, viewer: Viewer) -> None:
    before = len(client.images())
    client.set("Around (°)", 20.0)
    client.until(lambda: viewer.session.hold.angle_deg == 20.0)
    client.until(lambda: "around 20.0°" in str(client.captions()[-1].values) and len(client.images()) > before)
    position = np.array(client.nodes["/probe"]["position"])
    np.testing.assert_allclose(100 * position, viewer.session.state.pose[:3, 3], atol=0.01)


def test_what_comes_while_an_earlier_change_is_answered_counts(client: Client, viewer: Viewer) -> None:
    with viewer.page.lock:  # the answer to the first takes its time, and then shows its state in all controls
        client.set("Around (°)", 11.0)
        client.set("Tilt (°)", 7.0)
        time.sleep(0.3)
    settle(client, viewer)
    assert (viewer.session.hold.angle_deg, viewer.session.hold.tilt_deg) == (11.0, 7.0)


def test_of_a_drag_what_is_stale_is_left_out_and_of_keys_nothing(client: Client, viewer: Viewer) -> None:
    asked: list[float] = []
    viewer.session.listeners.append(lambda: asked.append(viewer.session.hold.angle_deg))
    try:
        with viewer.page.lock:
            for angle in range(1, 11):
                client.set("Around (°)", float(angle))
            for _ in range(3):
                client.press("Probe: around the body, to the right on the page")
            time.sleep(0.3)
        settle(client, viewer)
    finally:
        viewer.session.listeners.pop()
    assert asked[-4:] == [10.0, 13.0, 16.0, 19.0]
    assert len(asked[:-4]) <= 1, "what came alone, or before the rest, may have been answered at once"


def test_a_button_that_waits_stays_the_one_that_was_pressed(client: Client, viewer: Viewer) -> None:
    seed, turned = viewer.session.state.seed, viewer.session.hold.roll_deg
    with viewer.page.lock:
        client.set("Turn (°)", turned + 9)
        client.set("New (N, R)", "Reset")
        client.set("New (N, R)", "Speckle")
        time.sleep(0.3)
    settle(client, viewer)
    assert (viewer.session.state.seed, viewer.session.hold.roll_deg) == (seed + 1, turned)


def test_a_preset_is_gone_to_and_forgotten_at_the_next_step(client: Client, viewer: Viewer) -> None:
    name = list(viewer.session.presets)[2]
    client.set("Plane", name)
    client.until(lambda: np.array_equal(viewer.session.state.pose, viewer.session.presets[name]))
    client.press("Probe: turn clockwise")
    client.until(lambda: "plane" in client.values[client.labels["Plane"]]["value"])


def test_nonsense_closes_its_connection_and_the_viewer_lives_on(viewer: Viewer) -> None:
    with Client(viewer.page.settings.viewer.port) as odd:
        odd.until(lambda: odd.labels)
        odd.send_raw(b"\x81\xa4type\xa4What")
    with Client(viewer.page.settings.viewer.port) as odd:
        odd.until(lambda: odd.labels)
        odd.send({"type": "GuiUpdateMessage", "uuid": "no such part", "updates": {"value": 3}})
    with Client(viewer.page.settings.viewer.port) as next_one:
        next_one.until(lambda: next_one.captions())


def test_a_frame_is_saved_and_its_command_makes_it_again(client: Client, viewer: Viewer) -> None:
    client.set("Depth (mm)", 100)
    client.until(lambda: viewer.session.state.probe.depth_mm == 100)
    client.set("Dynamic range (dB)", 45.0)
    client.set("Gain (dB)", 6.0)
    viewer.session.new_speckle()  # its seed is that of a data set with other training poses, and so another time gain
    settle(client, viewer)
    viewer.session.freeze(True)
    saved = viewer.session.state
    viewer.session.move(angle_deg=7.0)  # the held probe moves on: what is kept is the frame that is shown
    client.press("Save the frame")
    client.until(lambda: "frame.json" in client.texts() and list(viewer.page.folder.glob("ball_*/frame.json")))
    (folder,) = viewer.page.folder.glob("ball_*")
    told = json.loads((folder / "frame.json").read_text())
    np.testing.assert_array_equal(told["pose"], saved.pose)
    client.press("Pose as a command line")
    command = client.labels["Command"]
    client.until(lambda: "task=render" in str(client.values[command].get("value")))
    words = shlex.split(client.values[command]["value"])
    assert words[:3] == ["python", "-m", "ablate"]
    (job,) = jobs_of(words[3:])
    assert job.settings.task is Task.render
    assert job.settings.probe == saved.probe
    assert job.settings.dataset.seed == saved.seed == 1
    np.testing.assert_array_equal(read_poses(str(job.settings.pose), "pose")[0], saved.pose[None])
    settings = simulator_of(
        job.settings, job.data, viewer.page.scene, source_of(job.settings).scene()[1], saved.pose[None]
    )
    simulator, shown = Simulator(viewer.page.scene, saved.probe, settings), Display(gain_db=job.settings.gain_db)
    assert shown.gain_db == 6
    frame = simulator.render(saved.pose, saved.seed, shown)
    np.testing.assert_array_equal(np.array(Image.open(folder / "simulated.png")), frame.image)
    viewer.session.freeze(False)
    viewer.session.reset()


def test_a_sweep_is_recorded(client: Client, viewer: Viewer) -> None:
    client.set("Record a sweep", True)
    client.until(lambda: viewer.page.sweep is not None)
    for angle in (5.0, 10.0, 15.0):
        client.set("Around (°)", angle)
        client.until(lambda angle=angle: viewer.session.hold.angle_deg == angle)
        settle(client, viewer)
    client.set("Record a sweep", False)
    client.until(lambda: list(viewer.page.folder.glob("sweep_*/sweep.gif")))
    (folder,) = viewer.page.folder.glob("sweep_*")
    assert len(np.load(folder / "poses.npy")) >= 3
    client.until(lambda: "dataset.poses" in str(client.values[client.labels["Command"]].get("value")))


def test_a_recording_without_a_pose_ends_too(client: Client, viewer: Viewer) -> None:
    viewer.session.freeze(True)
    settle(client, viewer)
    client.set("Record a sweep", True)
    client.until(lambda: "Recording:" in client.texts())
    client.set("Record a sweep", False)
    client.until(lambda: "nothing was recorded" in client.texts())
    assert "Recording:" not in client.texts()
    viewer.session.freeze(False)


def test_a_click_on_an_image_measures_and_shift_moves_what_is_zoomed(client: Client, viewer: Viewer) -> None:
    settle(client, viewer)

    def click(x: float, y: float, shift: bool = False) -> None:
        client.set("page", "page:" + json.dumps({"place": [x, y], "shift": shift, "at": time.time()}))

    click(0.1, 0.25)
    click(0.2, 0.25)
    client.until(lambda: len(viewer.page.layout.points) == 2)
    client.until(lambda: "Distance" in client.texts())
    points = in_plane(viewer.page.layout.points, viewer.session.state.pose)
    assert points[0, 1] == pytest.approx(points[1, 1])
    assert points[1, 0] > points[0, 0] + 5
    client.set("Fetus", "BPD, biparietal diameter")
    client.until(lambda: "Hadlock 1984" in client.texts())
    client.set("Fetus", "-")
    client.set("Zoom", 2.0)
    client.until(lambda: viewer.page.layout.window.zoom == 2)
    click(0.1, 0.25, shift=True)
    client.until(lambda: viewer.page.layout.window.middle != (0.5, 0.5))
    assert len(viewer.page.layout.points) == 2
    assert viewer.page.layout.window.middle[0] < 0.5
    client.set("Zoom", 1.0)
    viewer.page.lay_out(points=np.empty((0, 3)), window=Window())


def test_the_width_of_the_window_decides_that_of_the_panels(
    client: Client, viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[int] = []
    monkeypatch.setattr(type(viewer.page.images), "set_width", lambda _, width: told.append(width))
    for width in (800, 1366, 1920):
        client.set("page", f'page:{{"width": {width}}}')
    client.until(lambda: len(told) == 3)
    assert told[0] < 500 < 640 < told[1] < told[2] > 900


def test_another_probe_is_taken_and_pressed_on_the_skin(client: Client, viewer: Viewer) -> None:
    before, hold = viewer.session.state.probe, viewer.session.hold
    client.set("Probe", "linear")
    client.until(lambda: viewer.session.state.probe.kind == "linear")
    settle(client, viewer)
    assert viewer.page.shown is not None
    assert viewer.page.shown.state.probe == viewer.session.state.probe
    assert viewer.page.shown.mask.shape == viewer.session.state.simulator.image_shape
    assert viewer.session.hold == hold
    centre, face = np.zeros(3), viewer.session.state.pose[:3, 3]
    assert np.linalg.norm(face - centre) == pytest.approx(60 - 3, abs=1.5), "3 mm into a ball, as its file says"
    client.set("Probe", "as started")
    client.until(lambda: viewer.session.state.probe == before)
    settle(client, viewer)


def test_nothing_is_drawn_before_the_plane_that_is_looked_at(viewer: Viewer) -> None:
    camera = SimpleNamespace(fov=0.7, aspect=1.0, near=0.01)
    looks = SimpleNamespace(client_id=-1, camera=camera, atomic=nullcontext)
    viewer.page.body.face(looks, viewer.session.state)
    distance = np.linalg.norm(camera.position - camera.look_at)
    assert camera.near == pytest.approx(distance - 0.01), "a millimetre before the fan"
    viewer.session.nudge(tilt_deg=3.0)
    assert camera.near == 0.01, "the fan has left that plane"


def test_another_generator_is_picked_and_one_that_is_gone_is_said(
    client: Client, viewer: Viewer, tmp_path: Path
) -> None:
    assert viewer.session.state.runs == (), "the generator that comes with the package was trained with other pixels"
    client.set("Generator", "comes with ablate: sa2h")
    client.until(lambda: len(viewer.session.state.runs) == 1)
    settle(client, viewer)
    assert "| comes with ablate: sa2h |" in client.texts()
    viewer.session.freeze(True)
    client.set("Generator", "none")
    client.until(lambda: viewer.session.state.runs == ())
    viewer.page.lay_out(difference=True)
    assert "| comes with ablate: sa2h |" in client.texts(), "the frozen picture is still of the one that made it"
    viewer.page.lay_out(difference=False)
    viewer.session.freeze(False)
    client.set("Generator", "comes with ablate: sa2h")
    client.until(lambda: len(viewer.session.state.runs) == 1)
    settle(client, viewer)
    client.set("Generator", "none")
    client.until(lambda: viewer.session.state.runs == ())
    viewer.session.show(runs=(tmp_path / "gone",))
    client.until(lambda: "this run is gone" in client.texts())
    client.set("Generator", "comes with ablate: sa2h")
    client.until(lambda: len(viewer.session.state.runs) == 1 and tmp_path / "gone" not in viewer.session.state.runs)


def test_with_the_last_page_closed_nothing_is_computed(viewer: Viewer) -> None:
    with Client(viewer.page.settings.viewer.port) as only:
        only.until(lambda: only.captions() and not viewer.worker.paused)
    until(lambda: viewer.worker.paused)
    time.sleep(0.5)
    before = sum(viewer.worker.computed.values())
    viewer.session.move(angle_deg=3.0)
    time.sleep(3 * REST_S)
    assert sum(viewer.worker.computed.values()) == before


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["viewer.port=0"], "viewer.port=0: allowed are whole numbers from 1 to 65535"),
        (["runs=no/such/folder"], "runs=no/such/folder: no such folder"),
        (["plane=nothing"], "plane=nothing: allowed are"),
        (["pose=none.npy"], "none.npy"),
    ],
)
def test_what_cannot_be_started_is_refused_in_a_sentence(arguments: list[str], given: list[str], says: str) -> None:
    with pytest.raises((ConfigurationError, ValueError, OSError), match=says.replace(".", r"\.")):
        Viewer(jobs_of([*arguments, f"viewer.port={free_port()}", *given])[0].settings)


def test_the_network_that_the_command_line_names_is_the_one_that_generators_may_import(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    named: list[object] = []

    class Stop(Exception):
        pass

    def stop(_: int) -> None:
        raise Stop

    monkeypatch.setattr("ablate.viewer.task.first_fitting", lambda *given: named.append(given[3]) or ())
    monkeypatch.setattr(
        "ablate.viewer.task.SceneRenderer", lambda *given: named.append(given[2]) or SimpleNamespace(render=None)
    )
    monkeypatch.setattr("ablate.viewer.task.open_server", stop)
    port = f"viewer.port={free_port()}"
    for words, target in (([], None), (["variant=custom", "model.target=torch.nn.Identity"], "torch.nn.Identity")):
        named.clear()
        with pytest.raises(Stop):
            Viewer(jobs_of([*arguments, port, *words])[0].settings)
        assert named == [target, target]


def test_it_starts_with_the_gain_of_the_command_line(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    starts: list[ViewerState] = []

    class Stop(Exception):
        pass

    def stop(*given: Any) -> None:
        starts.append(given[2])
        raise Stop

    monkeypatch.setattr("ablate.viewer.task.first_fitting", stop)
    monkeypatch.setattr("ablate.viewer.task.SceneRenderer", lambda *_: SimpleNamespace(render=None))
    with pytest.raises(Stop):
        Viewer(jobs_of([*arguments, f"viewer.port={free_port()}", "gain_db=-4.5"])[0].settings)
    assert starts[0].display == Display(gain_db=-4.5)
    assert starts[0].seed == 0


SKIN = trimesh.creation.icosphere(4, radius=60)
WITHIN = trimesh.creation.icosphere(4, radius=59.5)
WITHIN.invert()


@pytest.mark.parametrize(
    ("mesh", "hides"),
    [
        pytest.param(SKIN, True, id="a body"),
        pytest.param(trimesh.util.concatenate([SKIN, WITHIN]), True, id="skin as a shell"),
        pytest.param(trimesh.creation.box((80, 80, 0.5)), True, id="a flat fascia"),
        pytest.param(trimesh.creation.icosphere(3, radius=15), False, id="an organ"),
        pytest.param(trimesh.creation.cylinder(4, 110), False, id="a vessel"),
        pytest.param(trimesh.creation.box((20, 20, 0.5)), False, id="a valve"),
        pytest.param(trimesh.creation.box((80, 80, 8)), False, id="a muscle"),
    ],
)
def test_what_surrounds_or_covers_the_rest_is_seen_through(mesh: trimesh.Trimesh, hides: bool) -> None:
    assert hides_the_rest(mesh, np.full(3, 120.0)) is hides


def test_a_tissue_is_made_transparent_and_hidden(client: Client, viewer: Viewer) -> None:
    (bone,) = viewer.page.body.tissues["bone"]
    assert bone.opacity is None
    for value, opacity in ((0.4, 0.4), (0.0, 0.0), (1.0, None)):
        client.set("bone", value)
        until(lambda shown=value > 0, opacity=opacity: (bone.visible, bone.opacity) == (shown, opacity))


def test_a_click_on_a_frozen_picture_measures_what_it_shows(client: Client, viewer: Viewer) -> None:
    """The fan is drawn where the probe is held, so the line of sight meets it there, not where the frame was made."""
    viewer.session.freeze(True)
    shown = viewer.page.shown
    assert shown is not None
    viewer.session.nudge(height_mm=12.0, roll_deg=30.0)
    viewer.page.body.hold(viewer.session.state)
    held = viewer.session.state.pose
    seen = held @ (5.0, 0.0, 40.0, 1.0)  # a point of the fan as it is drawn
    viewer.page.body.clicked(seen[:3] + 200 * held[:3, 1] + 50 * held[:3, 0], -200 * held[:3, 1] - 50 * held[:3, 0])
    client.until(lambda: len(viewer.page.layout.points))
    point = np.linalg.inv(shown.state.pose) @ (*viewer.page.layout.points[0], 1.0)
    np.testing.assert_allclose(point[:3], (5, 0, 40), atol=1e-6)
    client.until(lambda: "mm deep" in client.texts())
    beside = replace(shown, state=replace(shown.state, pose=shown.state.pose @ translation_matrix((0, 9, 0))))
    viewer.page.paint(beside)
    client.until(lambda: "The points are not on this plane." in client.texts())
    viewer.page.paint(shown)
    client.until(lambda: "mm deep" in client.texts() and "not on this plane" not in client.texts())
    viewer.session.freeze(False)
    viewer.page.lay_out(points=np.empty((0, 3)))


def test_the_name_of_a_tissue_is_words_on_the_page(
    client: Client, viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scene folder may be a stranger's, and what stands on the page as HTML is run by the browser."""
    named = [SimpleNamespace(name="<img src=x onerror=go()>") for _ in viewer.page.scene.tissues]
    monkeypatch.setattr(viewer.page, "scene", SimpleNamespace(tissues=named))
    held = viewer.session.state.pose
    seen = held @ (0.0, 0.0, 30.0, 1.0)
    viewer.page.body.clicked(seen[:3] + 200 * held[:3, 1], -held[:3, 1])
    client.until(lambda: "onerror" in client.texts() and "30 mm deep" in client.texts())
    assert "<img src=x" not in client.texts()
    viewer.page.lay_out(points=np.empty((0, 3)))


def test_looking_back_a_frame_that_comes_late_is_not_drawn_over_it(client: Client, viewer: Viewer) -> None:
    for angle in (5.0, 10.0):
        client.set("Around (°)", angle)
        settle(client, viewer)
    late = viewer.page.loop.before(0.0)
    client.set("Cine: seconds back", 1.0)
    client.until(lambda: viewer.page.shown is not late)
    held = viewer.page.shown
    viewer.page.show(replace(late, at_s=time.monotonic()))
    assert viewer.page.shown is held
    viewer.session.freeze(False)
    settle(client, viewer)
    assert viewer.page.shown is viewer.page.loop.before(0.0)


def test_a_slider_reaches_what_it_shows(client: Client, viewer: Viewer) -> None:
    viewer.page.add_slider("Shallow (mm)", (40, 240, 5), lambda: 30.0, lambda _: None)
    client.until(lambda: "Shallow (mm)" in client.labels)
    shown = client.values[client.labels["Shallow (mm)"]]
    assert (shown["value"], shown["min"]) == (30, 30)


def test_compounding_is_picked_with_its_price(client: Client, viewer: Viewer) -> None:
    client.until(lambda: "3: about" in client.texts())
    client.set("Compounding", "3")
    settle(client, viewer)
    client.until(lambda: "1: about" in client.texts())
    views = viewer.page.shown
    assert views is not None
    assert views.state.simulator.compound_angles == 3
    settings = replace(views.state.simulator, time_gain_db=views.time_gain_db)
    simulator = Simulator(viewer.page.scene, views.state.probe, settings)
    np.testing.assert_array_equal(views.target, simulator.image(views.state.pose, views.state.seed))
