"""Inside of the fetal head: skull shell, cerebrospinal fluid, brain, midline, ventricles, cerebellum, eyes."""

from __future__ import annotations

import numpy as np
import trimesh

from ablate.anatomy.fetal_frame import head_to_world
from ablate.anatomy.implicit import (
    Bounds,
    Field,
    ellipsoid,
    intersection,
    mesh_field,
    outside,
    rippled,
    shrunk,
    union,
)
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, tube

HEAD_BOX: Bounds = ((-45.0, -55.0, -50.0), (45.0, 50.0, 45.0))
SKULL_RADII = (27.0, 36.35, 29.0)  # BPD 54 mm, HC 200 mm, outer edge to outer edge
SKULL_MM = 1.3
FALX_MM = 1.0


def fetal_head(tissues: dict[str, Tissue], scale: float, seed: int) -> list[Structure]:
    """The head's contents in world mm, outermost first.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every grid spacing.
    seed : int
        Of the surface displacements.
    """

    def solid(
        field: Field,
        tissue: str,
        pitch_mm: float | tuple[float, float, float],
        name: str,
        coarsest_mm: float | tuple[float, float, float],
    ) -> Structure:
        pitch = np.minimum(np.asarray(pitch_mm) * scale, coarsest_mm)
        return Structure(head_to_world(mesh_field(field, HEAD_BOX, pitch, name)), tissues[tissue])

    skull = rippled(ellipsoid((0.0, 0.0, 0.0), SKULL_RADII), seed, 0.12, 30.0)
    cortex = rippled(shrunk(skull, SKULL_MM + 1.3), seed + 1, 0.35, 7.0)
    fissures = [outside(ellipsoid((s * 24.0, -4.0, -3.0), (4.5, 9.0, 3.0))) for s in (-1.0, 1.0)]
    brain = intersection([cortex, *fissures], 1.5)
    cistern = intersection([ellipsoid((0.0, 22.0, -14.0), (15.0, 9.5, 8.5)), shrunk(skull, SKULL_MM + 0.7)], 1.0)
    cerebellum = union([ellipsoid((s * 6.6, 20.0, -13.5), (7.2, 5.8, 5.8)) for s in (-1.0, 1.0)], 4.0)
    cerebellum = intersection([cerebellum, shrunk(cistern, 1.0)], 1.0)
    sheet = intersection(
        [
            lambda x, y, z: np.abs(x) - FALX_MM / 2.0 + 0.0 * (y + z),
            shrunk(skull, SKULL_MM + 0.5),
            outside(ellipsoid((0.0, 2.0, -9.0), (40.0, 17.0, 14.0))),
            lambda x, y, z: -9.0 - z + 0.0 * (x + y),
        ],
        0.4,
    )
    return [
        solid(skull, "fetal_bone", 0.95, "skull", 7.0),
        solid(shrunk(skull, SKULL_MM), "csf", 0.95, "subarachnoid space", 7.0),
        solid(brain, "brain", 0.85, "brain", 7.0),
        solid(cistern, "csf", 0.7, "cisterna magna", 3.0),
        solid(cerebellum, "brain", 0.6, "cerebellum", 3.0),
        solid(sheet, "falx", (0.35, 1.0, 1.0), "falx", (0.45, 7.0, 7.0)),
        solid(ellipsoid((0.0, -11.5, 3.5), (2.1, 5.0, 3.2)), "csf", 0.5, "cavum septi pellucidi", 1.4),
        *_ventricles(tissues, scale),
        _eyes(tissues, scale),
    ]


def _ventricles(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """Lateral ventricles with choroid plexus in their atria."""
    sides, count = max(3, round(14 / scale)), max(6, round(40 / scale))
    t = np.linspace(0.0, 1.0, 6)
    stations = np.array(
        [
            (4.0, -17.0, 5.0),
            (5.0, -9.0, 8.0),
            (7.0, 1.0, 8.5),
            (9.5, 11.0, 5.0),
            (10.5, 17.0, 1.0),
            (9.0, 23.0, -1.0),
        ]
    )
    radii = np.array([0.9, 1.6, 1.9, 3.4, 3.0, 0.9])
    ventricles: list[trimesh.Trimesh] = []
    plexus: list[trimesh.Trimesh] = []
    for part, reach, share in ((ventricles, (0.0, 1.0), 1.0), (plexus, (0.42, 0.78), 0.62)):
        along = np.linspace(*reach, count)
        path = np.stack([np.interp(along, t, stations[:, i]) for i in range(3)], axis=1)
        radius = share * np.interp(along, t, radii)
        part += [tube(path * (side, 1.0, 1.0), radius, sides) for side in (-1.0, 1.0)]
    return [
        Structure(head_to_world(joined(ventricles, "lateral ventricles")), tissues["csf"]),
        Structure(head_to_world(joined(plexus, "choroid plexus")), tissues["vessel_wall"]),
    ]


def _eyes(tissues: dict[str, Tissue], scale: float) -> Structure:
    pitch = min(0.6 * scale, 3.2)
    eyes = [
        mesh_field(ellipsoid((side * 11.8, -31.0, -17.5), (5.2, 5.2, 5.2)), HEAD_BOX, pitch, "eye")
        for side in (-1.0, 1.0)
    ]
    return Structure(head_to_world(joined(eyes, "eyes")), tissues["csf"])
