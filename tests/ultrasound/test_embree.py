"""Embree asked from compiled code, against embreex's own arrays: the same hits, and the same frames."""

import pathlib
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import Simulator
from ablate.ultrasound.surfaces import embree
from ablate.ultrasound.surfaces.embree import Geometry


def test_the_library_of_the_pinned_embreex_is_found() -> None:
    assert embree.available


def test_hits_are_those_of_embreex(tissue: Tissue) -> None:
    meshes = [
        trimesh.creation.icosphere(4, 30.0),
        trimesh.creation.box((50, 60, 70)),
        trimesh.creation.icosphere(5, 20),
    ]
    geometry = Geometry([Structure(m, tissue) for m in meshes], np.array([[-40.0] * 3, [40.0] * 3]), np.zeros(3), 200.0)
    theirs = EmbreeScene()
    kept = [TriangleMesh(theirs, m.vertices.astype(np.float32), m.faces.astype(np.int32)) for m in meshes]
    rng = np.random.default_rng(0)
    origins = rng.uniform(-40, 40, (20_000, 3)).astype(np.float32)
    directions = rng.normal(size=origins.shape)
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    reach = rng.uniform(-5, 60, len(origins)).astype(np.float32)
    found = geometry.closest(origins, directions, reach)
    wanted = theirs.run(origins, directions, dists=np.maximum(reach, 0), query="INTERSECT", output=True)
    met = wanted["geomID"] >= 0
    assert kept
    assert 0.2 < met.mean() < 0.8
    np.testing.assert_array_equal(found.structure, wanted["geomID"])
    for mine, name in ((found.distance_mm, "tfar"), (found.triangle, "primID"), (found.normal, "Ng")):
        np.testing.assert_array_equal(mine[met], wanted[name][met])


@pytest.mark.parametrize("scanlines", [64, 100])
def test_frames_are_the_same_without_the_library(slab, ball, probe, small, ahead, monkeypatch, scanlines) -> None:
    """In a cavity rays meet more interfaces than the table of draws has rows at first."""
    wall = Tissue("wall", 1500, 6.0, 0.1, 0.5, 0.0, 0.5)
    fluid = Tissue("fluid", 1540, 1.5, 0.0, 0.0, 0.0, 0.0)
    structures = slab(wall, 10.0, 90.0), ball(fluid, (0.0, 0.0, 50.0), 30.0)
    scene = Scene(structures, Tissue("t", 1540, 1.6, 0.5, 0.5, 0.0, 0.5), "cavity")
    settings = replace(small, scanlines=scanlines)
    asking = Simulator(scene, probe, settings)
    assert asking._geometry.address
    monkeypatch.setattr(embree, "available", False)
    given = Simulator(scene, probe, settings)
    assert not given._geometry.address
    mine, theirs = asking.render(ahead), given.render(ahead)
    for name in ("segmentation", "attenuation", "image", "envelope"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def test_a_scene_that_is_gone_gives_its_memory_back(tissue: Tissue) -> None:
    mesh = trimesh.creation.icosphere(6, 30.0)  # 81,920 triangles, of which Embree keeps some 10 MB

    def resident_mb() -> float:
        with pathlib.Path("/proc/self/status").open() as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024

    def make() -> None:
        Geometry([Structure(mesh, tissue)], np.array([[-40.0] * 3, [40.0] * 3]), np.zeros(3), 200.0)

    for _ in range(3):
        make()
    before = resident_mb()
    for _ in range(12):
        make()
    assert resident_mb() - before < 60
