"""Rays of a scene, followed to their last echo."""

from __future__ import annotations

import numpy as np

from ablate.anatomy import Scene
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.bundle import leave_probe, probe_rays
from ablate.ultrasound.draws import (
    Draws,
)
from ablate.ultrasound.embree import Geometry
from ablate.ultrasound.illumination import Nodes
from ablate.ultrasound.plan import compile_scene
from ablate.ultrasound.rays import Echoes, View
from ablate.ultrasound.transport import trace


def follow(
    scene: Scene, probe: ConvexProbe, settings: SimulatorSettings, faintest_db: float = -200.0
) -> tuple[Echoes, Nodes]:
    compiled = compile_scene(scene, probe, settings, None)
    geometry = Geometry(compiled.structures, np.array([[-400.0] * 3, [400.0] * 3]), np.zeros(3), 200.0)
    draws = Draws(settings.path_seed, settings.scanlines * settings.layers, settings.rays)
    bundle = leave_probe(geometry, probe_rays(probe, settings, draws), np.eye(4))
    nodes = Nodes(0.0, 1.0, np.ones((len(bundle.starts), 151), bool), np.zeros((len(bundle.starts), 151)))
    lines, ways = (
        (bundle.starts, bundle.directions),
        (settings.rays, draws.seed, probe.depth_mm, faintest_db, geometry.step_mm),
    )
    view = View(compiled.media, compiled.tissue_of_owner, *lines, *ways)
    return trace(geometry, view, draws, bundle, nodes), nodes


def lit(nodes: Nodes, settings: SimulatorSettings) -> np.ndarray:
    """Linear illumination of each group at each millimetre."""
    return nodes.amplitude / settings.rays
