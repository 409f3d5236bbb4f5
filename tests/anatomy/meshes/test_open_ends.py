"""Open ends as of vessels that the border of a scan cuts: random sets, closed as the cups they belong to."""

import logging

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ablate.anatomy.meshes.repair import odd_edges, repair

SKEW = np.array([0.3127, 0.5412, 0.7803])
CORNERS = 14
Cup = tuple[float, float, float, float, float]  # middle x and y of the rim, its radius, its height z, and the depth

cups = st.lists(
    st.tuples(
        st.floats(-25, 25), st.floats(-25, 25), st.sampled_from([4.0, 9.0, 17.0, 30.0, 50.0]),
        st.sampled_from([0.0, 0.0, 1.0, 2.0, 2.4, 4.0, 7.0]), st.sampled_from([60.0, 80.0, 110.0]),
    ),
    min_size=1,
    max_size=7,
)  # fmt: skip


def cup_meshes(drawn: list[Cup]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of cones that stand on their tips, open above."""
    turn = 2 * np.pi * np.arange(CORNERS) / CORNERS
    vertices, faces = [], []
    for number, (x, y, radius, z, depth) in enumerate(drawn):
        rim = np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn), np.full(CORNERS, z)])
        vertices += [rim, [[x, y, z - depth]]]
        tip = (CORNERS + 1) * number + CORNERS
        faces += [(tip - CORNERS + i, tip - CORNERS + (i + 1) % CORNERS, tip) for i in range(CORNERS)]
    return np.vstack(vertices), np.array(faces)


def crossings(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many triangles (m, 3, 3) a skew ray from each point (n, 3) meets; those on each other count each."""
    origin, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = np.cross(SKEW, second)
    determinant = (first * across).sum(1)
    offset = points[:, None] - origin
    u = (offset * across).sum(-1) / determinant
    normal = np.cross(offset, first)
    v, t = (normal * SKEW).sum(-1) / determinant, (normal * second).sum(-1) / determinant
    return ((u > 0) & (v > 0) & (u + v < 1) & (t > 0)).sum(1)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of triangles along the ray
@settings(deadline=None, max_examples=200)
@given(drawn=cups, seed=st.integers(0, 2**32 - 1))
def test_any_set_of_open_ends_is_closed_as_the_cups_that_they_end(drawn: list[Cup], seed: int) -> None:
    """A point is inside where an odd number of cups holds it, whichever lie in each other, side by side, or cross."""
    assume(len({(x, y) for x, y, *_ in drawn}) == len(drawn))
    mesh = repair(*cup_meshes(drawn), "cups")
    assert len(odd_edges(mesh.faces)) == 0
    points = np.random.default_rng(seed).uniform((-60, -60, -50), (60, 60, -4), (200, 3))  # below every rim
    held, clear = np.zeros(len(points), int), np.ones(len(points), bool)
    for x, y, radius, z, depth in drawn:
        radius_there = radius * (points[:, 2] - (z - depth)) / depth
        distance = np.hypot(points[:, 0] - x, points[:, 1] - y)
        held += distance < radius_there
        # the cup is a polygon within its circle
        clear &= ~((distance > np.cos(np.pi / CORNERS) * radius_there - 1e-3) & (distance < radius_there + 1e-3))
    assert (crossings(mesh.triangles, points)[clear] % 2).tolist() == (held[clear] % 2).tolist()
