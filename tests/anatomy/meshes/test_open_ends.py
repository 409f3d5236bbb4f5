"""Open ends as of vessels that the border of a scan cuts: random sets, closed as the cups they belong to."""

import numpy as np
import pytest
import trimesh
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


def sheet(width: float, height: float, bump: float = 0.0, hole: bool = False) -> trimesh.Trimesh:
    """A grid of 12 x 12 squares, uneven by up to `bump` within, maybe without its middle."""
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(0, width, 13), np.linspace(0, height, 13)))
    inner = (x > 0) & (x < width) & (y > 0) & (y < height)
    z = bump * inner * np.random.default_rng(0).random(len(x))
    corner = (13 * np.arange(12)[:, None] + np.arange(12)).ravel()
    faces = np.vstack([np.stack([corner, corner + 1, corner + 14], 1), np.stack([corner, corner + 14, corner + 13], 1)])
    if hole:
        faces = faces[np.abs(faces.mean(1) - 84) > 20]
    return trimesh.Trimesh(np.stack([x, y, z], 1), faces, process=False)


def apart(mesh: trimesh.Trimesh, gap: float) -> trimesh.Trimesh:
    """Each facet by itself, a little off its neighbours."""
    pieces = [
        mesh.submesh([facet])[0].apply_translation(gap * number * SKEW) for number, facet in enumerate(mesh.facets)
    ]
    return trimesh.util.concatenate(pieces)


BOX = trimesh.creation.box((60, 60, 60))
SHEETS = {
    "plane": sheet(100, 100),
    "ribbon": sheet(100, 8),
    "uneven": sheet(100, 100, bump=1.9),
    "small": sheet(0.5, 0.3),
    "with a hole": sheet(100, 100, hole=True),
    "two planes": trimesh.util.concatenate([sheet(90, 80), sheet(90, 80).apply_translation((0, 0, 50))]),
    "a box whose sides do not meet": apart(BOX, 1e-3),
}


@pytest.mark.parametrize("name", SHEETS)
def test_a_flat_open_sheet_encloses_nothing(name: str, caplog: pytest.LogCaptureFixture) -> None:
    turned = SHEETS[name].copy().apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    for mesh in (SHEETS[name], turned):
        with pytest.raises(ValueError, match=rf"^x\.obj: its {len(mesh.faces)} triangles enclose nothing"):
            repair(mesh.vertices, mesh.faces, "x.obj")
        beside = trimesh.util.concatenate([mesh, BOX.copy().apply_translation((200, 0, 0))])
        assert abs(repair(beside.vertices, beside.faces, "x.obj").volume) == pytest.approx(60**3)
        assert "x.obj: left out" in caplog.text


def dome(radius: float, height: float, count: int = 12) -> trimesh.Trimesh:
    """A cap of a ball of some radius, open below."""
    angle = np.linspace(0, np.arccos(1 - height / radius), count)
    return trimesh.creation.revolve(np.stack([radius * np.sin(angle), radius * np.cos(angle)], 1), sections=48)


def open_box(*size: float) -> trimesh.Trimesh:
    box = trimesh.creation.box(size)
    return box.submesh([box.face_normals[:, 2] < 0.5])[0]


OPEN: dict[str, tuple[trimesh.Trimesh, float]] = {
    "a half ball": (dome(30, 30), 30**3 * 2 / 3 * np.pi),
    "a bowl": (dome(30, 4), np.pi * 4**2 * (30 - 4 / 3)),
    "a narrow vessel": (open_box(1, 1, 60), 60),
    "a flat vessel": (open_box(60, 0.6, 60), 60 * 0.6 * 60),
}


@pytest.mark.parametrize("name", OPEN)
def test_what_a_cap_closes_is_no_sheet(name: str, caplog: pytest.LogCaptureFixture) -> None:
    mesh, volume = OPEN[name]
    assert not mesh.is_watertight
    closed = repair(mesh.vertices, mesh.faces, name)
    assert abs(closed.volume) == pytest.approx(volume, rel=0.05)
    assert "left out" not in caplog.text
