"""Monte-Carlo path tracing of rays: they meet surfaces, echo there, and are transmitted, reflected, or both.

All rays of a part advance by one surface at a time: intersect, interact, sample the scattering, connect to the element
(an echo), Russian roulette, spawn.

The weight of a ray, its throughput, is a two-way amplitude. Through an interface its expectation is
1 - R = t12 t21 with R = R_p^2, exactly what a pulse keeps on its way there and back. The echo of a ray that was
reflected before returns straight to its element, where the surface that reflected it does not reflect it again: the
expectation off that interface is |R_p|, once.

How a ray goes on is sampled so that errors are small, with these expectations. A direct ray, never reflected, carries
the image: a surface splits it into a transmitted one, with 1 - R of its weight, and a reflected one, with |R_p|. A ray
that was reflected once is split, too. So that rays do not multiply, one that was reflected more often is either
reflected, with the probability |R_p|, or transmitted. Were it reflected with the probability R, the few that are would
have the weight 1 / |R_p|, and would appear as isolated dots in dark fluid. Russian roulette ends faint reflected rays.
"""

import math

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays
from ablate.ultrasound.media import RenderPlan
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import HAS_PACKETS, PACKET
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport.advance import bounces
from ablate.ultrasound.transport.bounce import REVERBERATION_SHARE, reverberation_share
from ablate.ultrasound.transport.lines import ECHO, Nodes
from ablate.ultrasound.transport.rays import (
    Bundle,
    Draws,
    View,
    at_pose,
    probe_rays,
    start_rays,
)

_GROUPS_OF_A_PART = 24  # with larger parts a thread waits for the others at the end

#: Russian roulette may end reflected rays under this level above white. One path is a small part of its line: of 16
#: rays in 3 layers, spread over its surroundings, an echo of this level is 61 dB under white; of 32 rays, 6 dB more.
_ROULETTE_DB = 24.0


class Tracer:
    """Traces the rays of frames of a geometry, for one probe, one set of settings and one angle of the scanlines."""

    def __init__(
        self,
        geometry: Geometry,
        plan: RenderPlan,
        probe: Probe,
        settings: SimulatorSettings,
        steered_rad: float = 0.0,
    ) -> None:
        self._geometry = geometry
        self._plan = plan
        self._settings = settings
        self._depth_mm = probe.depth_mm
        self._draws = Draws(settings.path_seed, settings.scanlines * settings.layers, settings.rays)
        self._rays = probe_rays(probe, settings, self._draws, steered_rad)
        depths_mm = sample_depths_mm(probe, settings.axial_samples)
        self._largest_gain_db = float(time_gain_db(depths_mm, probe, settings.time_gain).max())

    def at(self, pose: np.ndarray) -> Bundle:
        """The rays at a pose, which leads to the geometry's world."""
        return at_pose(self._geometry, self._rays, pose)

    def __call__(self, bundle: Bundle, nodes: Nodes) -> np.ndarray:
        """The echoes, (n,) ECHO, of rays at a pose; what insonifies the scanlines is added to `nodes`."""
        followed = reverberation_share(self._settings.rays)
        roulette_db = _ROULETTE_DB + 20 * math.log10(REVERBERATION_SHARE / followed)
        view = View(
            media=self._plan.media,
            tissue_of_owner=self._plan.tissue_of_owner,
            elements=bundle.starts,
            axes=bundle.directions,
            origins=bundle.origins,
            ways=bundle.ray_directions,
            rays=self._settings.rays,
            together=HAS_PACKETS and self._settings.rays >= PACKET,  # those of several scanlines part too soon
            path_seed=self._draws.seed,
            depth_mm=self._depth_mm,
            roulette_db=roulette_db + 20 * math.log10(self._settings.reference_level) - self._largest_gain_db,
            followed=followed,
            gain_db_mm=self._largest_gain_db / self._depth_mm,
            step_mm=self._geometry.step_mm,
        )
        return trace(self._geometry, view, self._draws, bundle, nodes)


@stage(Stage.tracing)
def trace(geometry: Geometry, view: View, draws: Draws, bundle: Bundle, nodes: Nodes) -> np.ndarray:
    """Trace the rays of a frame until they are deeper than the image.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    view : View
        What the rays travel through, and what receives their echoes.
    draws : Draws
        Random numbers of all rays.
    bundle : Bundle
        The rays at a pose.
    nodes : Nodes
        What insonifies the scanlines; the rays' amplitudes are added to it.

    Returns
    -------
    (n,) ECHO
        The echoes, part by part.
    """

    def part(begin: int, end: int) -> np.ndarray:
        chosen = slice(begin * view.rays, end * view.rays)
        rays = start_rays(bundle, chosen, view)
        arrays: Arrays = (rays, bundle.inside[chosen].copy(), np.empty(4 * len(rays), ECHO))
        n, rows, count = len(rays), 0, 0
        while n:  # comes back for more of the table of draws
            table, rows = draws.table(rows + 1)
            arrays, n, count = bounces(geometry.address, arrays, n, count, view, table, rows, nodes)
        return arrays[2][:count]

    return np.concatenate(in_parts(part, len(bundle.starts), _GROUPS_OF_A_PART))
