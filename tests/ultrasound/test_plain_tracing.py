"""The compiled path tracer finds the echoes of the plain one, ray by ray, with the same random numbers."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.media import plan_scene
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.transport.rays import MAX_ROWS, Draws, at_pose, probe_rays, tabulated
from support.traced_rays import follow

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from plain_tracing import Ray, Scanline, trace

SETTINGS = SimulatorSettings(scanlines=5, layers=1, rays=12, path_seed=7)
ROULETTE_DB = -80.0  # so that it ends some of the rays and gives others its weight


def plain(scene: Scene, probe: ConvexProbe, settings: SimulatorSettings) -> np.ndarray:
    """Scanline, depth in mm, amplitude and clutter of each echo, (n, 4)."""
    plan = plan_scene(scene, probe, settings, None)
    geometry = Geometry(plan.structures, np.array([[-400.0] * 3, [400.0] * 3]), np.zeros(3), 200.0)
    draws = Draws(settings.path_seed, settings.scanlines, settings.rays)
    table, _ = draws.table(MAX_ROWS)
    bundle = at_pose(geometry, probe_rays(probe, settings, draws), np.eye(4))
    rows = []
    for number in range(len(bundle.origins)):
        group = number // settings.rays
        line = Scanline(
            element=bundle.starts[group],
            axis=bundle.directions[group],
            frequency_mhz=probe.frequency_mhz,
            depth_mm=probe.depth_mm,
            roulette_db=ROULETTE_DB,
        )
        way = bundle.ray_directions[number].astype(float)
        first = Ray(bundle.origins[number].astype(float), way, inside=frozenset())
        drawn = [tabulated(table, row, number) for row in range(MAX_ROWS)]
        rows += [(group, *echo) for echo in trace(scene, line, first, drawn.__getitem__)]
    return np.array(rows)


def in_order(echoes: np.ndarray) -> np.ndarray:
    """Sorted by scanline, depth to a micrometre, and amplitude."""
    return echoes[np.lexsort((echoes[:, 2], np.round(echoes[:, 1], 3), echoes[:, 0]))]


@pytest.mark.parametrize(("roughness", "together"), [(0.0, False), (0.05, False), (0.05, True)])
def test_echoes_are_those_of_the_plain_tracer(gel: Tissue, slab, ball, roughness: float, together: bool) -> None:
    """A strong interface, one that bends rays, and a sphere that overlaps both; reflections of several orders."""
    soft = Tissue("soft", 1460, 2.4, 0.5, roughness=roughness, specularity=2.0, thickness_mm=0.3)
    hard = Tissue("hard", 2000, 5.0, 1.0, roughness=roughness, specularity=0.0)
    deep = replace(soft, name="deep", speed_m_s=1580.0, impedance_mrayl=1.2)
    parts = slab(soft, 20.0, 400.0), slab(hard, 70.0, 90.0, 300.0), ball(deep, (5.0, 0.0, 55.0), 22.0)
    scene = Scene(parts, gel, "s")
    probe = ConvexProbe(frequency_mhz=3.0)
    found, _ = follow(scene, probe, SETTINGS, ROULETTE_DB, together)
    fast = in_order(np.stack([found.group, found.depth_mm, found.amplitude, found.clutter], axis=1).astype(float))
    slow = in_order(plain(scene, probe, SETTINGS))
    assert len(slow) > 200
    assert (slow[:, 3] == 0).sum() > 50
    assert (slow[:, 3] == 1).sum() > 50
    np.testing.assert_array_equal(fast[:, [0, 3]], slow[:, [0, 3]])
    np.testing.assert_allclose(fast[:, 1], slow[:, 1], atol=1e-3)
    np.testing.assert_allclose(fast[:, 2], slow[:, 2], rtol=1e-3)
