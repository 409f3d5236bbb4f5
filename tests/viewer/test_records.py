"""What is kept of a session is what was seen, and its command line is composed to the same."""

import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, load_tissues
from ablate.command.compose import jobs_of
from ablate.ultrasound import TimeGain
from ablate.viewer.records import CineLoop, Sweep, command_line
from ablate.viewer.scene_renderer import SceneRenderer
from ablate.viewer.session import Quality, ViewerState
from support.viewed_body import BODY, STATE


@pytest.mark.parametrize(
    "words",
    [
        ["probe=linear"],
        ["probe=phased", "probe.depth_mm=120"],
        ["probe=l11-5v"],
        ["preset=paper"],
        ["simulator.rays=9"],
    ],
)
def test_a_command_line_is_composed_to_the_probe_and_simulator_that_were_seen(words: list[str]) -> None:
    settings = jobs_of(["task=view", *words])[0].settings
    line = command_line(settings, ViewerState(STATE.pose, settings.probe, settings.simulator), "task=render")
    again = jobs_of(shlex.split(line)[3:])[0].settings
    assert (again.probe, again.simulator, again.scene) == (settings.probe, settings.simulator, settings.scene)


@pytest.mark.parametrize(("kind", "depth_mm"), [("linear", 100.0), ("phased", 90.0), ("convex", 80.0)])
def test_after_a_change_of_depth_the_pulse_is_still_the_one_that_was_seen(kind: str, depth_mm: float) -> None:
    """By default it follows from the size of the frame."""
    settings = jobs_of(["task=view", f"probe={kind}"])[0].settings
    probe = replace(settings.probe, depth_mm=depth_mm)
    line = command_line(settings, ViewerState(STATE.pose, probe, settings.simulator), "task=render")
    again = jobs_of(shlex.split(line)[3:])[0].settings
    assert (again.probe, again.simulator) == (probe, settings.simulator)


def test_a_command_line_names_a_folder_whatever_its_name_is(tmp_path: Path) -> None:
    folder, runs = tmp_path / "it's (2), my scene", tmp_path / "runs, mine"
    folder.mkdir()
    trimesh.creation.icosphere(radius=30).export(folder / "liver.stl")
    settings = jobs_of(["task=view"])[0].settings
    settings = replace(settings, scene=replace(settings.scene, kind="folder", folder=str(folder)), runs_dir=str(runs))
    line = command_line(settings, ViewerState(STATE.pose, settings.probe, settings.simulator), "task=render")
    again = jobs_of(shlex.split(line)[3:])[0].settings
    assert (again.scene.folder, again.runs_dir) == (str(folder), str(runs))


def test_a_path_without_blanks_is_typed_without_quotes(tmp_path: Path) -> None:
    trimesh.creation.icosphere(radius=30).export(tmp_path / "liver.stl")
    settings = jobs_of(["task=view"])[0].settings
    scene = replace(settings.scene, kind="folder", folder=str(tmp_path))
    settings = replace(settings, scene=scene, runs_dir=str(tmp_path / "runs"))
    line = command_line(settings, ViewerState(STATE.pose, settings.probe, settings.simulator), "task=render")
    assert not {"'", '"'} & set(line.split("simulator.")[0]), line


def test_a_sweep_keeps_the_pose_of_every_image_that_is_shown() -> None:
    views = SceneRenderer(BODY, STATE.pose[None]).render(STATE, Quality.full)
    assert views.target is not None
    sweep = Sweep()
    sweep.add(replace(views, target=None, generated=(None, views.target)))
    (recorded,) = sweep
    np.testing.assert_array_equal(recorded[0], STATE.pose)


def test_the_cine_loop_is_looked_back_in_while_a_frame_comes() -> None:
    """The frames come from the thread of the worker."""
    views = SceneRenderer(BODY, STATE.pose[None]).render(STATE, Quality.full)

    class Late(float):
        def __rsub__(self, other: float) -> float:
            loop.add(replace(views, at_s=views.at_s + len(loop) / 10))
            return other - float(self)

    loop = CineLoop()
    for seconds in (0.0, 1.0, 2.0):
        loop.add(replace(views, at_s=views.at_s + seconds))
    late = replace(loop[1], at_s=Late(loop[1].at_s))
    loop[1] = late
    assert loop.before(1.0) is late
    assert len(loop) == 4


def test_a_scene_where_nothing_scatters_is_shown() -> None:
    tissues = load_tissues()
    ball = Structure(trimesh.creation.icosphere(radius=80), tissues["urine"])
    scene = Scene((ball,), tissues["coupling_gel"], "a ball of fluid")
    state = replace(STATE, simulator=replace(STATE.simulator, tgc=TimeGain.patient))
    views = SceneRenderer(scene, STATE.pose[None]).render(state, Quality.full)
    assert views.target is not None
    assert views.target[views.mask].any()
