"""Measuring against lengths of polygons and what stays where when the probe moves."""

import numpy as np
import pytest

from ablate.ultrasound import ConvexProbe
from ablate.viewer.calipers import circumference, in_plane, lines, measured, on_plane, values


def test_the_circumference_is_the_length_of_the_outline() -> None:
    """Diameters of 100 and 76 mm, as of a head; they need not be the axes of the drawing."""
    points = np.array([[-40.0, -30.0], [40.0, 30.0], [-22.8, 30.4], [22.8, -30.4]]) + 7
    *diameters, outline = lines(points)
    assert [len(line) for line in diameters] == [2, 2]
    length = np.linalg.norm(np.diff(outline, axis=0), axis=1).sum()
    assert circumference(points) == pytest.approx(length, rel=2e-3)
    np.testing.assert_allclose(outline[0], points[1])
    assert np.min(np.linalg.norm(outline - points[2], axis=1)) < 1e-9
    said = measured(points, "brain", ConvexProbe())
    assert "Axes **100.0** and **76.0 mm**" in said
    assert "not perpendicular" not in said
    assert "not perpendicular" in measured(points + np.array([[0], [0], [12], [12]]), "brain", ConvexProbe())
    circle = np.array([[-5.0, 0.0], [5.0, 0.0], [0.0, -5.0], [0.0, 5.0]])
    assert circumference(circle) == pytest.approx(10 * np.pi)


def test_a_distance_and_an_angle_are_said_with_the_last_tissue() -> None:
    points = np.array([[0.0, 50.0], [30.0, 50.0], [30.0, 90.0]])
    probe = ConvexProbe()
    assert measured(points[:1], "liver", probe) == "**liver**, 50 mm deep. "
    assert "Distance **30.0 mm**" in measured(points[:2], "liver", probe)
    assert "**90°**" in measured(points, "bone", probe)
    assert "**0°**" in measured(points[[0, 1, 0]], "bone", probe)


def test_points_stay_with_the_anatomy_and_go_with_the_plane() -> None:
    pose = np.eye(4)
    point = on_plane(pose, np.array([10.0, 300.0, 60.0]), np.array([0.0, -2.0, 0.0]))
    np.testing.assert_allclose(point, (10, 0, 60))
    moved = pose.copy()
    moved[:3, 3] = 4, 0, 10
    np.testing.assert_allclose(in_plane(point[None], moved), [(6, 50)])
    moved[1, 3] = 3
    assert in_plane(np.stack([point, [10, 3, 60]]), moved).shape == (0, 2), "one of two is off the plane"
    with pytest.raises(ValueError, match="edge on"):
        on_plane(pose, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))


def test_what_is_said_of_points_is_written_beside_them() -> None:
    points = np.array([[0.0, 50.0], [30.0, 50.0], [30.0, 90.0], [10.0, 90.0]])
    assert values(points[:1]) == []
    ((beside, words),) = values(points[:2])
    assert (tuple(beside), words) == ((30.0, 50.0), "30.0 mm")
    ((beside, words),) = values(points[:3])
    assert (tuple(beside), words) == ((30.0, 50.0), "90°")
    assert [words for _, words in values(points)] == ["30.0 mm", "20.0 mm"]
