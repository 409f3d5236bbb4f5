"""Rays: hits as embreex has them; the illumination behind surfaces, their echoes, and where these are."""

import pathlib
import re
import time
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.surfaces import embree
from ablate.ultrasound.surfaces.embree import RAY_HIT
from ablate.ultrasound.surfaces.geometry import Geometry
from support.traced_rays import follow, illumination


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
    hits = geometry.closest(origins, directions, reach)
    wanted = theirs.run(origins, directions, dists=np.maximum(reach, 0), query="INTERSECT", output=True)
    met = wanted["geomID"] >= 0
    assert kept
    assert 0.2 < met.mean() < 0.8
    np.testing.assert_array_equal(hits.structure, wanted["geomID"])
    for mine, name in ((hits.distance_mm, "tfar"), (hits.triangle, "primID"), (hits.normal, "Ng")):
        np.testing.assert_array_equal(mine[met], wanted[name][met])


def test_fields_are_those_that_embreex_reads() -> None:
    """It declares them for Cython, whose C compiler checks them against Embree's own header."""
    declared = resources.files("embreex").joinpath("rtcore_ray.pxd").read_text(encoding="utf-8")
    fields = re.findall(r"^ +(?:float|unsigned int) (\w+)", declared, re.MULTILINE)
    assert tuple(fields) == RAY_HIT


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"MAJOR_VERSION": 5}, "embreex brings Embree 4: allowed is embreex>=4,<5"),
        ({"_SIGNATURES": {"rtcIntersectN2": (None, ())}}, "without rtcIntersectN2: allowed is embreex>=4,<5"),
    ],
)
def test_another_embree_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch, changed: dict, message: str) -> None:
    for name, value in changed.items():
        monkeypatch.setattr(embree, name, value)
    with pytest.raises(ImportError, match=message):
        embree._loaded()


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


def test_direct_illumination_behind_flat_faces_is_exact(gel, slab, probe, one_line) -> None:
    """However few the rays are: a direct ray is always transmitted, whether or not it spawns a reflected one."""
    layers = tuple(
        slab(Tissue(f"t{i}", 1540, (2.5, 1.5)[i % 2], 0.0, roughness=0.0), 20.0 + 10 * i, 400.0) for i in range(6)
    )
    truth = (1 - (1 / 4) ** 2) ** np.arange(7)
    for rays in (1, 4, 64):
        settings = replace(one_line, rays=rays)
        level = illumination(follow(Scene(layers, gel, "s"), probe, settings)[1], settings)[0, 15:80:10]
        np.testing.assert_allclose(level, truth, rtol=1e-6)


@pytest.mark.parametrize(("thickness_mm", "in_beam"), [(10.0, True), (30.0, False)])
def test_refraction_bends_the_path(gel, slab, thickness_mm, in_beam) -> None:
    """Depths of a second face seen through an oblique first one follow from Snell's law.

    Rays are there 2.4 or 7.2 mm beside their straight way, so out of their beam or not; a wide aperture alone leaves
    them in it.
    """
    settings = SimulatorSettings(scanlines=3, layers=1, rays=1, aperture_mm=0.0, elevational_aperture_mm=0.0)
    fast = Tissue("fast", 2000, 2.0, 0.0, roughness=0.0, specularity=0.0)
    scene = Scene((slab(fast, 30.0, 30.0 + thickness_mm),), gel, "s")
    echoes, _ = follow(scene, ConvexProbe(fov_deg=60.0), settings)
    edge = np.sort(echoes[echoes.group == 0], order="depth_mm")[:2]
    theta = np.radians(30.0)
    first = (30 + 40 * (1 - np.cos(theta))) / np.cos(theta)
    second = first + thickness_mm / np.cos(np.arcsin(2000 / 1540 * np.sin(theta)))
    np.testing.assert_allclose(edge.depth_mm, (first, second), atol=1e-3)
    assert edge.clutter.tolist() == [False, not in_beam]
    wide, _ = follow(scene, ConvexProbe(), replace(settings, rays=9, elevational_aperture_mm=7.0))
    assert wide.clutter[(wide.group == 1) & (wide.depth_mm < 31)].tolist() == 9 * [False]


def test_a_crossing_inside_a_structure_of_higher_priority_changes_nothing(gel, slab, probe, one_line) -> None:
    hard = Tissue("hard", 1540, 6.0, 1.0, roughness=0.0)
    soft = Tissue("soft", 1540, 1.6, 0.3, roughness=0.0)
    cover = slab(soft, 10.0, 200.0)
    alone = follow(Scene((cover,), gel, "s"), probe, one_line)
    hidden = follow(Scene((slab(hard, 40.0, 60.0), cover), gel, "s"), probe, one_line)
    np.testing.assert_allclose(illumination(alone[1], one_line), illumination(hidden[1], one_line), rtol=1e-5)
    assert len(alone[0].depth_mm) == len(hidden[0].depth_mm)


@pytest.mark.parametrize(("turned_rad", "tilted_rad"), [(0.3, 1e-6), (0.7, 1e-7)])
def test_a_ray_along_a_surface_takes_few_steps(gel, tissue, probe, one_line, turned_rad, tilted_rad):
    """Rounding makes the ray meet the same triangles again; with a fixed small step it would need a million steps."""
    mesh = trimesh.creation.box((100.0, 100.0, 400.0))
    mesh.apply_translation((50.0, 0, 100.0))  # its side is the plane x = 0, which the line lies in
    for angle, axis in ((turned_rad, (0, 0, 1)), (tilted_rad, (0, 1, 0))):
        mesh.apply_transform(trimesh.transformations.rotation_matrix(angle, axis))
    scene = Scene((Structure(mesh, replace(tissue, impedance_mrayl=3.0)),), gel, "s")
    follow(scene, probe, replace(one_line, rays=1))  # compiled
    start = time.process_time()
    follow(scene, probe, one_line)
    assert time.process_time() - start < 5, "a million steps for each of the rays take half a minute"


def test_echoes_behind_forty_structures(gel, slab, probe, one_line) -> None:
    """More structures than one word of a set holds."""
    layers = tuple(
        slab(Tissue(f"t{i}", 1540, (1.8, 1.5)[i % 2], 0.0, roughness=0.0), 20.0 + 3 * i, 400.0) for i in range(40)
    )
    echoes, _ = follow(Scene(layers, gel, "s"), probe, one_line)
    depth = np.unique(np.round(echoes.depth_mm[~echoes.clutter], 2))
    np.testing.assert_allclose(depth, 20.0 + 3 * np.arange(40), atol=0.01)
    amplitude = echoes.amplitude[~echoes.clutter & (echoes.depth_mm > 136)].sum() / one_line.rays
    r = 0.3 / 3.3
    assert amplitude == pytest.approx(r * (1 - r**2) ** 39, rel=1e-5)
