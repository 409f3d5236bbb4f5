"""Monte-Carlo transport of direct rays: the illumination behind surfaces, their echoes, and where these are."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.surfaces.embree import Geometry, Hits
from support.traced_rays import follow, illumination


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


def test_refraction_bends_the_path(gel, slab) -> None:
    """Depths of a second face seen through an oblique first one follow from Snell's law."""
    settings = SimulatorSettings(scanlines=3, layers=1, rays=1, aperture_mm=0.0, elevational_aperture_mm=0.0)
    fast = Tissue("fast", 2000, 2.0, 0.0, roughness=0.0, specularity=0.0)
    scene = Scene((slab(fast, 30.0, 60.0),), gel, "s")
    echoes, _ = follow(scene, ConvexProbe(fov_deg=60.0), settings)
    edge = np.sort(echoes.depth_mm[(echoes.group == 0) & ~echoes.reflected])
    assert len(edge) == 2
    theta = np.radians(30.0)
    first = (30 + 40 * (1 - np.cos(theta))) / np.cos(theta)
    second = first + 30 / np.cos(np.arcsin(2000 / 1540 * np.sin(theta)))
    assert edge[0] == pytest.approx(first, abs=1e-3)
    assert edge[1] == pytest.approx(second, abs=1e-3)


def test_a_crossing_inside_a_structure_of_higher_priority_changes_nothing(gel, slab, probe, one_line) -> None:
    hard = Tissue("hard", 1540, 6.0, 1.0, roughness=0.0)
    soft = Tissue("soft", 1540, 1.6, 0.3, roughness=0.0)
    cover = slab(soft, 10.0, 200.0)
    alone = follow(Scene((cover,), gel, "s"), probe, one_line)
    hidden = follow(Scene((slab(hard, 40.0, 60.0), cover), gel, "s"), probe, one_line)
    np.testing.assert_allclose(illumination(alone[1], one_line), illumination(hidden[1], one_line), rtol=1e-5)
    assert len(alone[0].depth_mm) == len(hidden[0].depth_mm)


@pytest.mark.parametrize(("turned_rad", "tilted_rad"), [(0.3, 1e-6), (0.7, 1e-7)])
def test_a_ray_along_a_surface_takes_few_steps(gel, tissue, probe, one_line, monkeypatch, turned_rad, tilted_rad):
    """Rounding makes the ray meet the same triangles again; with a fixed small step it would need a million steps."""
    mesh = trimesh.creation.box((100.0, 100.0, 400.0))
    mesh.apply_translation((50.0, 0, 100.0))  # its side is the plane x = 0, which the line lies in
    for angle, axis in ((turned_rad, (0, 0, 1)), (tilted_rad, (0, 1, 0))):
        mesh.apply_transform(trimesh.transformations.rotation_matrix(angle, axis))
    met = []
    closest = Geometry.closest

    def counted(self: Geometry, *rays: np.ndarray) -> Hits:
        hits = closest(self, *rays)
        met.append(np.count_nonzero(hits.structure >= 0))
        return hits

    monkeypatch.setattr("ablate.ultrasound.surfaces.embree.available", False)  # compiled code asks without `closest`
    monkeypatch.setattr(Geometry, "closest", counted)
    follow(Scene((Structure(mesh, replace(tissue, impedance_mrayl=3.0)),), gel, "s"), probe, one_line)
    assert sum(met) > 3 * one_line.rays
    assert len(met) < 100


def test_echoes_behind_forty_structures(gel, slab, probe, one_line) -> None:
    """More structures than one word of a set holds."""
    layers = tuple(
        slab(Tissue(f"t{i}", 1540, (1.8, 1.5)[i % 2], 0.0, roughness=0.0), 20.0 + 3 * i, 400.0) for i in range(40)
    )
    echoes, _ = follow(Scene(layers, gel, "s"), probe, one_line)
    depth = np.unique(np.round(echoes.depth_mm[~echoes.reflected], 2))
    np.testing.assert_allclose(depth, 20.0 + 3 * np.arange(40), atol=0.01)
    amplitude = echoes.amplitude[~echoes.reflected & (echoes.depth_mm > 136)].sum() / one_line.rays
    r = 0.3 / 3.3
    assert amplitude == pytest.approx(r * (1 - r**2) ** 39, rel=1e-5)
