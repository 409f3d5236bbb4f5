"""Repair of meshes: what is dropped, what is closed, what is refused."""

import logging
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, load_tissues
from ablate.anatomy.meshes.check import folds, overlaps, shared_walls, warn_of_overlaps
from ablate.anatomy.meshes.repair import cap_open_ends, load_mesh, odd_edges, repair

Counts = Callable[[], tuple[int, ...]]


@pytest.fixture
def counts(caplog: pytest.LogCaptureFixture) -> Counts:
    """Numbers of degenerate and of duplicate triangles, and of capped ends, of the last repair that is logged."""
    caplog.set_level(logging.INFO, logger="ablate.anatomy.meshes.repair")
    return lambda: caplog.records[-1].args[1:4] if caplog.records else (0, 0, 0)  # type: ignore[index,return-value]


def prism(outline: np.ndarray, height: float, holes: tuple[np.ndarray, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Upright walls over outlines (n, 2), open above and below."""
    vertices, faces, start = [], [], 0
    for loop in (outline, *holes):
        n = len(loop)
        vertices += [np.c_[loop, np.zeros(n)], np.c_[loop, np.full(n, height)]]
        i = np.arange(n)
        j = (i + 1) % n
        faces += [np.stack([i, j, j + n], 1) + start, np.stack([i, j + n, i + n], 1) + start]
        start += 2 * n
    return np.concatenate(vertices), np.concatenate(faces)


def circle(radius: float, count: int = 40, center: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)], 1)


STAR = np.stack([circle(10, 20)[i] * (1.0 if i % 2 else 0.35) for i in range(20)])
L_SHAPE = np.array([(0, 0), (10, 0), (10, 3), (3, 3), (3, 10), (0, 10)], float)


@pytest.mark.parametrize(
    ("outline", "area"),
    [
        (circle(10), 20 * 100 * math.sin(2 * math.pi / 40)),
        (L_SHAPE, 51.0),
        (STAR, 10 * 10 * 3.5 * math.sin(2 * math.pi / 20)),
    ],
    ids=["round", "L", "star"],
)
@pytest.mark.parametrize("flip", [False, True])
def test_flat_ends_are_capped_with_exactly_the_area_of_the_opening(
    outline: np.ndarray, area: float, flip: bool, counts: Counts
) -> None:
    vertices, faces = prism(outline[::-1] if flip else outline, 7.0)
    mesh = repair(vertices, faces, "tube.obj")
    caps = mesh.area_faces[len(faces) :]
    assert counts() == (0, 0, 2)
    assert len(caps) == 2 * (len(outline) - 2)
    assert caps.sum() == pytest.approx(2 * area)  # more would mean overlap
    assert len(odd_edges(mesh.faces)) == 0


def test_nested_openings_become_rings_and_islands(counts: Counts) -> None:
    wall = prism(circle(10), 5.0, (circle(7), circle(3)))
    mesh = repair(*wall, "vessel")
    assert counts() == (0, 0, 6)
    n = 40 / 2 * math.sin(2 * math.pi / 40)
    assert mesh.area_faces[len(wall[1]) :].sum() == pytest.approx(2 * n * (100 - 49 + 9))
    radius = np.array([1.5, 5.0, 8.5, 12.0])
    points = np.stack([radius * 0.96, radius * 0.28, np.full(4, 2.5)], 1)
    assert mesh.contains(points).tolist() == [True, False, True, False]


def test_ends_on_different_planes_and_side_by_side_are_capped_apart(counts: Counts) -> None:
    repair(*prism(circle(4), 5.0, (circle(4, center=(20.0, 0.0)),)), "twins")
    assert counts() == (0, 0, 4)


def test_loops_that_touch_in_one_vertex_are_both_closed() -> None:
    faces = np.array([(0, 1, 2), (0, 3, 4)])
    vertices = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (-1, 0, 0), (-1, -1, 0)], float)
    caps, widths_mm = cap_open_ends(vertices, faces, "bow tie")
    assert len(widths_mm) == 2
    assert len(odd_edges(np.concatenate([faces, caps]))) == 0


def test_cut_sphere_owns_what_the_whole_sphere_below_the_cut_owns(counts: Counts) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    cut = ball.faces[(ball.triangles_center[:, 2] < 5.0)]
    mesh = repair(ball.vertices, cut, "cut ball")
    assert counts() == (0, 0, 1)
    points = np.random.default_rng(0).uniform(-9, 9, (800, 3))
    points = points[(np.abs(np.linalg.norm(points, axis=1) - 10) > 0.5) & (np.abs(points[:, 2] - 5) > 1.5)]
    expected = (np.linalg.norm(points, axis=1) < 10) & (points[:, 2] < 5)
    assert mesh.contains(points).tolist() == expected.tolist()


def test_hole_that_is_not_flat_is_refused_with_its_size() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    saddle = ball.faces[ball.triangles_center[:, 2] < 12.0 * np.sin(2 * np.arctan2(*ball.triangles_center[:, :2].T))]
    with pytest.raises(ValueError, match=r"torn\.obj: cannot be closed: a hole of (9|10)\d\.\d mm is not flat"):
        repair(ball.vertices, saddle, "torn.obj")


def test_degenerate_and_duplicate_triangles_are_dropped_and_counted(counts: Counts) -> None:
    box = trimesh.creation.box((4, 4, 4))
    bad = np.concatenate([box.faces, [(0, 0, 1), (2, 2, 2)], box.faces[:3]])
    assert repair(box.vertices, bad, "box").volume == pytest.approx(64)
    assert counts() == (2, 3, 0)


def test_surface_exported_twice_stays_once_and_a_folded_flap_goes(counts: Counts) -> None:
    box = trimesh.creation.box((4, 4, 4))
    mesh = repair(box.vertices, np.concatenate([box.faces, box.faces[:, ::-1]]), "twice")
    assert counts() == (0, 12, 0)
    assert mesh.volume == pytest.approx(64)
    edge = box.edges[0]
    flap = np.array([(*edge, 8), (*edge[::-1], 8)])
    mesh = repair(np.vstack([box.vertices, (9.0, 9.0, 9.0)]), np.concatenate([box.faces, flap]), "flap")
    assert counts() == (0, 2, 0)
    assert len(mesh.faces) == 12


def test_lone_flap_goes_though_its_edges_are_open() -> None:
    box = trimesh.creation.box((4, 4, 4))
    vertices = np.vstack([box.vertices, (9.0, 9.0, 9.0)])
    mesh = repair(vertices, np.concatenate([box.faces, [(*box.edges[0], 8)]]), "flap")
    assert len(mesh.faces) == 12
    assert mesh.volume == pytest.approx(64)
    with pytest.raises(ValueError, match="leaf: its 1 triangles enclose nothing"):
        repair(vertices, np.array([(0, 1, 8)]), "leaf")


def test_needle_in_the_middle_of_a_wall_keeps_the_mesh_closed() -> None:
    box = trimesh.creation.box((2, 2, 2))
    a, b, c = box.faces[0]
    middle = (box.vertices[a] + box.vertices[b]) / 2
    vertices = np.concatenate([box.vertices, [middle]])
    faces = np.concatenate([box.faces[1:], [(a, 8, c), (8, b, c), (a, b, 8)]])  # the last has no area
    mesh = repair(vertices, faces, "needle")
    assert len(odd_edges(mesh.faces)) == 0
    assert mesh.volume == pytest.approx(8)


def test_soup_of_triangles_is_merged() -> None:
    box = trimesh.creation.box((2, 3, 4))
    mesh = repair(box.triangles.reshape(-1, 3), np.arange(36).reshape(12, 3), "soup")
    assert len(mesh.vertices) == 8
    assert abs(mesh.volume) == pytest.approx(24)


def test_a_mesh_of_one_point_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"point\.obj: all its 1 triangles are degenerate"):
        repair(np.zeros((3, 3)), np.array([(0, 1, 2)]), "point.obj")


def scene_of(*meshes: trimesh.Trimesh) -> Scene:
    tissues = load_tissues()
    return Scene(tuple(Structure(mesh, tissues["liver"]) for mesh in meshes), tissues["blood"], "s")


def test_shared_walls_are_found_and_named(caplog: pytest.LogCaptureFixture) -> None:
    a = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    b = trimesh.creation.icosphere(subdivisions=3, radius=9.0)
    c = trimesh.Trimesh(a.vertices + np.array([0.0, 0.0, 2e-5]), a.faces[:, ::-1], process=False)
    d = trimesh.Trimesh(a.vertices + np.array([0.02, 0.03, 0.05]), a.faces, process=False)
    for name, mesh in zip("abcd", (a, b, c, d), strict=True):
        mesh.metadata["name"] = name
    walls = shared_walls([a, b, c, d])
    assert [pair[:2] for pair in walls] == [("a", "c")]
    assert walls[0][2] > 250
    with caplog.at_level(logging.WARNING, logger="ablate.anatomy.meshes.check"):
        warn_of_overlaps(scene_of(a, c))
    assert "a and c share a wall" in caplog.text
    assert shared_walls([a]) == shared_walls([]) == []


def test_a_structure_that_a_later_one_hides_is_told(caplog: pytest.LogCaptureFixture) -> None:
    organ, body, beside = (trimesh.creation.icosphere(3, radius=radius) for radius in (10.0, 40.0, 10.0))
    beside.apply_translation((38, 0, 0))
    for name, mesh in {"organ": organ, "body": body, "beside": beside}.items():
        mesh.metadata["name"] = name
    warn_of_overlaps(scene_of(body, organ, beside))
    warn_of_overlaps(scene_of(beside, body))
    assert not caplog.records
    warn_of_overlaps(scene_of(organ, body))
    assert "organ lies within body, which comes after it and hides it" in caplog.text


def test_scenes_of_more_structures_than_embree_has_devices_are_looked_at(caplog: pytest.LogCaptureFixture) -> None:
    """Each mesh of trimesh that casts rays has a device of its own, and a process with 1,000 of them crashes."""
    boxes = [trimesh.creation.box((8, 8, 0.3)).apply_translation((0, 0, 0.5 * i)) for i in range(1100)]
    boxes[1000].apply_translation((0, 0, 0.2))
    warn_of_overlaps(scene_of(*boxes))
    assert [record.args[:2] for record in caplog.records] == [("structure 1000", "structure 1001")]


@pytest.mark.parametrize("extents", [(80, 80, 30), (300, 200, 30), (20, 20, 30)])
def test_flush_faces_with_other_triangles_are_a_shared_wall(extents: tuple[float, ...]) -> None:
    below = trimesh.creation.box((80, 80, 40)).apply_translation((0, 0, 30))
    flush = trimesh.creation.box(extents).apply_translation((0, 0, 50 + extents[2] / 2))
    assert len(shared_walls([below, flush])) == 1
    assert shared_walls([below, flush.copy().apply_translation((0, 0, 0.05))]) == []
    assert shared_walls([below, flush.copy().apply_translation((1, 2, -1))]) == []


def test_pieces_of_one_mesh_that_overlap_are_told(caplog: pytest.LogCaptureFixture) -> None:
    ball = trimesh.creation.icosphere(3, radius=15.0)
    inner = trimesh.creation.icosphere(3, radius=5.0)

    def joined(*pieces: trimesh.Trimesh) -> trimesh.Trimesh:
        return trimesh.util.concatenate([ball, *pieces])

    inner.invert()
    for fine in (ball, joined(inner), joined(ball.copy().apply_translation((40, 0, 0)))):
        warn_of_overlaps(scene_of(fine))
        assert overlaps(fine) < 3
    assert not caplog.text
    lobes = joined(ball.copy().apply_translation((25, 0, 0)))
    assert overlaps(lobes) > 10
    lobes.metadata["name"] = "liver.obj"
    with caplog.at_level(logging.WARNING, logger="ablate.anatomy.meshes.check"):
        warn_of_overlaps(scene_of(lobes))
    assert "liver.obj: pieces of it lie in each other" in caplog.text


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_a_concave_polygon_that_was_cut_into_a_fan_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, suffix: str
) -> None:
    corners = [(0, 0), (40, 0), (40, 10), (10, 10), (10, 40), (0, 40)]
    points = [(x, y, z) for z in (0, 30) for x, y in corners]
    walls = [(i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i) for i in range(6)]
    polygons = [(5, 4, 3, 2, 1, 0), (6, 7, 8, 9, 10, 11), *walls]
    if suffix == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {' '.join(str(i + 1) for i in p)}" for p in polygons]
    else:
        lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property float {c}" for c in "xyz")]
        lines += [f"element face {len(polygons)}", "property list uchar int vertex_indices", "end_header"]
        lines += [f"{x} {y} {z}" for x, y, z in points] + [f"{len(p)} {' '.join(map(str, p))}" for p in polygons]
    (path := tmp_path / f"corner.{suffix}").write_text("\n".join([*lines, ""]))
    warn_of_overlaps(scene_of(load_mesh(path)))
    assert f"corner.{suffix}: 2 pairs of its triangles lie on each other" in caplog.text


def test_a_filler_of_a_long_edge_that_has_no_height_lies_on_nothing() -> None:
    box = trimesh.creation.box((40.0, 30.0, 20.0))
    for number, (a, b) in enumerate(box.face_adjacency_edges):
        other = box.face_adjacency[number][1]
        (c,) = set(box.faces[other]) - {a, b}
        middle = (box.vertices[a] + box.vertices[b]) / 2 + 1e-6 * (box.vertices[c] - box.vertices[a]) / 20
        faces = [*np.delete(box.faces, other, axis=0), (a, 8, c), (8, b, c), (a, b, 8)]
        mesh = trimesh.Trimesh(np.vstack([box.vertices, middle]), faces, process=False)
        assert len(odd_edges(mesh.faces)) == 0
        assert folds(mesh) == 0


def test_rims_with_vertices_on_a_straight_line_and_rims_that_cross_themselves_are_closed(counts: Counts) -> None:
    square = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)], float)
    mesh = repair(*prism(square, 3.0), "box")
    assert counts() == (0, 0, 2)
    assert len(mesh.faces) == 16 + 12
    assert len(odd_edges(mesh.faces)) == 0
    assert abs(mesh.volume) == pytest.approx(12.0)
    crossed = repair(*prism(circle(5)[[0, 7, 20, 13, 33, 26]], 3.0), "crossed")
    assert len(odd_edges(crossed.faces)) == 0
