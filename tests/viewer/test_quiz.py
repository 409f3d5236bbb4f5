"""How far an answer is from the plane that was asked for."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ablate.viewer.quiz import Quiz, miss


def turned(axis: str, degrees: float, moved: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    pose[1, 3] = moved
    return pose


@pytest.mark.parametrize(("axis", "degrees", "left"), [("X", 20, 20), ("Z", 30, 30), ("Z", 180, 0), ("Z", -170, 10)])
def test_distance_and_angle(axis: str, degrees: float, left: float) -> None:
    """Turned round by 180 degrees about its own axis, the probe shows the same plane."""
    found = miss(turned(axis, degrees, moved=7.0), np.eye(4))
    assert found.distance_mm == pytest.approx(7)
    assert found.angle_deg == pytest.approx(left, abs=1e-6)


def test_points_fall_with_the_distance() -> None:
    exact, near, far = (miss(turned("X", a, moved=m), np.eye(4)) for a, m in ((0, 0), (11.99, 14.99), (60, 100)))
    assert (exact.points, near.points) == (100, 50)
    assert far.points < 5
    assert [m.found for m in (exact, near, far)] == [True, True, False]


def test_each_plane_is_asked_for_once_before_any_comes_again() -> None:
    quiz = Quiz({name: np.eye(4) for name in "abcd"}, seed=1)
    with pytest.raises(ValueError, match="no plane has been asked for"):
        _ = quiz.pose
    asked = [quiz.ask() for _ in range(4)]
    assert sorted(asked) == list("abcd")
    assert quiz.ask() != asked[-1]
    assert miss(np.eye(4), quiz.pose).found
