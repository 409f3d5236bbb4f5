"""How far an answer of the quiz is from the plane that was asked for."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ablate.viewer.page.operate_tabs import miss, points


@pytest.mark.parametrize(("axis", "degrees", "left"), [("X", 20, 20), ("Z", 30, 30), ("Z", 180, 0), ("Z", -170, 10)])
def test_distance_and_angle(axis: str, degrees: float, left: float) -> None:
    """Turned round by 180 degrees about its own axis, the probe shows the same plane."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    pose[1, 3] = 7.0
    assert miss(pose, np.eye(4)) == pytest.approx((7, left), abs=1e-6)


def test_points_fall_with_the_distance() -> None:
    assert (points(0, 0), points(14.99, 11.99)) == (100, 50)
    assert points(100, 60) < 5
