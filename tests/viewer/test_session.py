"""What is set is what is asked of the worker; what cannot be is said."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ablate.ultrasound.probe import pixel_size_mm
from ablate.viewer.hand import Hand, Hold
from ablate.viewer.session import OFF_BODY, Session, ViewerState
from support.viewed_body import BODY, STATE

Start = Callable[[], tuple[Session, list[ViewerState]]]


@pytest.fixture
def start() -> Start:
    """A new session with two presets, and the states that it asks for."""

    def make() -> tuple[Session, list[ViewerState]]:
        hand = Hand(BODY, (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 5.0, STATE.probe)
        places = {name: hand.place(hold) for name, hold in (("front", Hold(0, 0)), ("side", Hold(20, 60, 90, 5)))}
        asked: list[ViewerState] = []
        return Session(hand, STATE, {n: h[0] for n, h in places.items() if h is not None}, asked.append), asked

    return make


def test_a_preset_is_the_exact_pose_and_the_next_step_goes_on_from_there(start: Start) -> None:
    session, asked = start()
    session.to_preset("side")
    np.testing.assert_array_equal(asked[-1].pose, session.presets["side"])
    session.nudge(height_mm=4.0)
    moved = asked[-1].pose[:3, 3] - session.presets["side"][:3, 3]
    np.testing.assert_allclose(moved, [0, 0, 4], atol=0.2)
    np.testing.assert_allclose(asked[-1].pose[:3, :3], session.presets["side"][:3, :3], atol=1e-2)


def test_beyond_the_body_the_probe_stays_and_it_is_said(start: Start) -> None:
    session, asked = start()
    before, told = len(asked), []
    session.listeners.append(lambda: told.append(session.words))
    session.move(height_mm=900.0)
    assert told == [OFF_BODY]
    assert len(asked) == before
    session.move(height_mm=10.0)
    assert told[-1] == ""


def test_keys_go_round_the_body_and_stop_where_the_sliders_end(start: Start) -> None:
    session, asked = start()
    for _ in range(62):
        session.nudge(angle_deg=3.0, roll_deg=5.0)
    assert (session.hold.angle_deg, session.hold.roll_deg) == (186.0 - 360, 310.0 - 360)
    for _ in range(70):
        session.nudge(tilt_deg=3.0, rock_deg=-3.0)
    assert (session.hold.tilt_deg, session.hold.rock_deg) == (60.0, -60.0)
    assert asked[-1].hold == session.hold


def test_a_frozen_picture_follows_nothing_until_it_is_released(start: Start) -> None:
    session, asked = start()
    session.freeze(True)
    before = len(asked)
    session.nudge(angle_deg=5.0)
    session.new_speckle()
    assert len(asked) == before
    session.freeze(False)
    assert asked[-1].seed == 1
    assert asked[-1].pose is session.state.pose


def test_pixels_stay_square_whatever_the_depth(start: Start) -> None:
    session, asked = start()
    own = asked[-1].simulator.image_shape
    before = pixel_size_mm(asked[-1].probe, own)
    session.scan(depth_mm=80.0)
    height, width = pixel_size_mm(asked[-1].probe, asked[-1].simulator.image_shape)
    assert height / width == pytest.approx(before[0] / before[1], rel=0.02)
    session.scan(depth_mm=150.0)
    assert asked[-1].simulator.image_shape == own


def test_reset_is_the_beginning_with_the_runs_that_are_picked(start: Start, tmp_path: Path) -> None:
    session, asked = start()
    session.scan(depth_mm=80.0)
    session.show(runs=(tmp_path,))
    session.new_speckle()
    session.to_preset("side")
    session.reset()
    assert asked[-1].probe == STATE.probe
    assert asked[-1].simulator == STATE.simulator
    assert (asked[-1].seed, asked[-1].runs) == (0, (tmp_path,))
    np.testing.assert_array_equal(asked[-1].pose, session.presets["front"])


def test_settings_that_no_scanner_has_change_nothing(start: Start) -> None:
    session, asked = start()
    before = session.state
    with pytest.raises(ValueError, match="depth_mm"):
        session.scan(depth_mm=-5.0)
    with pytest.raises(ValueError, match="rays"):
        session.simulate(rays=0)
    assert session.state is before
    assert asked[-1] is before
