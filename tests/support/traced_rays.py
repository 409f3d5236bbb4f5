"""Rays of a scene, followed to their last echo, and a tilted pose."""

import numpy as np

from ablate.anatomy import Scene
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.media import plan_scene
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.transport.bounce import reverberation_share
from ablate.ultrasound.transport.lines import Nodes
from ablate.ultrasound.transport.rays import Draws, View, at_pose, probe_rays
from ablate.ultrasound.transport.tracing import trace


def follow(
    scene: Scene, probe: ConvexProbe, settings: SimulatorSettings, roulette_db: float = -200.0, together: bool = False
) -> tuple[np.recarray, Nodes]:
    """Echoes, with the fields of ECHO as attributes, and the illumination at each millimetre."""
    plan = plan_scene(scene, probe, settings, None)
    geometry = Geometry(plan.structures, np.array([[-400.0] * 3, [400.0] * 3]), np.zeros(3), 200.0)
    draws = Draws(settings.path_seed, settings.scanlines * settings.layers, settings.rays)
    rays = probe_rays(probe, settings, draws)
    bundle = at_pose(geometry, rays, np.eye(4))
    groups = len(bundle.starts)
    nodes = Nodes(0.0, 1.0, np.ones((groups, 151), bool), np.zeros((groups, 151)))
    view = View(
        media=plan.media,
        tissue_of_owner=plan.tissue_of_owner,
        elements=bundle.starts,
        axes=bundle.directions,
        origins=bundle.origins,
        ways=bundle.ray_directions,
        rays=settings.rays,
        together=together,
        path_seed=draws.seed,
        depth_mm=probe.depth_mm,
        roulette_db=roulette_db,
        followed=reverberation_share(settings.rays),
        gain_db_mm=0.0,
        step_mm=geometry.step_mm,
    )
    return trace(geometry, view, draws, bundle, nodes).view(np.recarray), nodes


def illumination(nodes: Nodes, settings: SimulatorSettings) -> np.ndarray:
    """Linear illumination of each group at each millimetre."""
    return nodes.amplitude / settings.rays


def tilted(degrees: float) -> np.ndarray:
    """A pose at the world's origin, turned about the probe's y."""
    angle, pose = np.radians(degrees), np.eye(4)
    pose[0, 0], pose[0, 2], pose[2, 0], pose[2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    return pose
