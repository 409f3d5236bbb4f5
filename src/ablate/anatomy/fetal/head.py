"""Inside of the fetal head: skull, cerebrospinal fluid, brain, midline, ventricles, eyes. The head's axes, mm."""

import numpy as np
import trimesh

from ablate.anatomy.fetal import sdf
from ablate.anatomy.fetal.axes import SIDES
from ablate.anatomy.fetal.parts import Part
from ablate.anatomy.fetal.tubes import Vector, interpolated, joined, tube

HEAD_BOX: sdf.Bounds = ((-45.0, -55.0, -50.0), (45.0, 50.0, 45.0))
SKULL_RADII = (27.0, 36.35, 29.0)  # BPD 54 mm, HC 200 mm, outer edge to outer edge
SKULL_MM = 1.3
FALX_MM = 1.0
EYE_CENTER = (11.8, -31.0, -17.5)  # of the left one


def fetal_head(scale: float, seed: int) -> list[Part]:
    """The head's contents, outermost first."""

    def solid(field: sdf.Field, tissue: str, pitch_mm: float | Vector, name: str, coarsest_mm: float | Vector) -> Part:
        pitch = np.minimum(np.asarray(pitch_mm) * scale, coarsest_mm)
        return Part(sdf.mesh_field(field, HEAD_BOX, pitch, name), tissue)

    skull = sdf.rippled(sdf.ellipsoid((0.0, 0.0, 0.0), SKULL_RADII), seed, 0.12, 30.0)
    gap = sdf.ellipsoid((0.0, -17.5, 25.5), (6.0, 9.5, 6.0))  # from outside the skull into it
    bone = [sdf.shrunk(skull, -0.35), sdf.outside(sdf.shrunk(skull, SKULL_MM + 0.35))]
    fontanelle = sdf.intersection([gap, *bone], 0.3)
    cortex = sdf.rippled(sdf.shrunk(skull, SKULL_MM + 1.3), seed + 1, 0.35, 7.0)
    fissures = [sdf.outside(sdf.ellipsoid((s * 24.0, -4.0, -2.0), (4.5, 9.0, 3.0))) for s in SIDES[::-1]]
    brain = sdf.intersection([cortex, *fissures], 1.5)
    behind = sdf.ellipsoid((0.0, 22.0, -14.0), (15.0, 9.5, 8.5))
    cistern = sdf.intersection([behind, sdf.shrunk(skull, SKULL_MM + 0.7)], 1.0)
    cerebellum = sdf.union([sdf.ellipsoid((s * 6.6, 20.0, -13.5), (7.2, 5.8, 5.8)) for s in SIDES[::-1]], 4.0)
    cerebellum = sdf.intersection([cerebellum, sdf.shrunk(cistern, 1.0)], 1.0)
    sheet = sdf.intersection(
        [
            lambda x, y, z: np.abs(x) - FALX_MM / 2.0 + 0.0 * (y + z),
            sdf.shrunk(skull, SKULL_MM + 0.5),
            sdf.outside(sdf.ellipsoid((0.0, -0.5, -9.0), (40.0, 21.5, 14.0))),
            lambda x, y, z: -9.0 - z + 0.0 * (x + y),
        ],
        0.4,
    )
    thalami = sdf.union([_thalamus(s) for s in SIDES[::-1]], 0.8)
    cavum = sdf.box((0.0, -12.5, 1.0), (2.1, 4.4, 3.2), 1.2)
    third_ventricle = sdf.ellipsoid((0.0, 4.0, 0.0), (0.75, 5.6, 4.5))
    return [
        solid(skull, "fetal_bone", 0.95, "skull", 7.0),
        Part(joined(_sutures(scale), "sutures"), "soft_tissue"),
        solid(fontanelle, "soft_tissue", 0.6, "anterior fontanelle", 2.0),
        solid(sdf.shrunk(skull, SKULL_MM), "csf", 0.95, "subarachnoid space", 7.0),
        solid(brain, "brain", 0.85, "brain", 7.0),
        solid(cistern, "csf", 0.7, "cisterna magna", 3.0),
        solid(cerebellum, "brain", 0.6, "cerebellum", 3.0),
        solid(sheet, "falx", (0.35, 1.0, 1.0), "falx", (0.45, 7.0, 7.0)),
        solid(thalami, "thalamus", 0.55, "thalami", 2.5),
        solid(third_ventricle, "csf", (0.35, 0.6, 0.6), "third ventricle", (0.5, 1.5, 1.5)),
        solid(sdf.shrunk(cavum, -0.7), "falx", 0.5, "septa pellucida", 1.4),
        solid(cavum, "csf", 0.5, "cavum septi pellucidi", 1.4),
        *_ventricles(scale),
        *_eyes(scale),
    ]


def _thalamus(side: float) -> sdf.Field:
    """Half of the diamond that the thalami make in an axial plane."""
    turn = np.deg2rad(side * 16.0)
    axes = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return sdf.ellipsoid((side * 5.2, 5.0, 0.0), (4.4, 8.2, 5.6), axes)


def _sutures(scale: float) -> list[trimesh.Trimesh]:
    """Narrow gaps of the skull: the coronal, sagittal and lambdoid sutures, which stop short of each other."""
    sides, count = max(4, round(10 / scale)), max(8, round(40 / scale))
    a, b, c = np.array(SKULL_RADII) - SKULL_MM / 2.0
    t = np.linspace(0.0, 1.0, count)
    lines = [np.stack([0.0 * t, -4.0 + 29.0 * t, np.full(count, 30.0)], axis=1)]
    for side in SIDES[::-1]:
        lines.append(np.stack([side * (8.0 + 19.0 * t), -14.5 - 2.0 * t, 24.0 - 30.0 * t], axis=1))
        lines.append(np.stack([side * (3.0 + 17.0 * t), 28.0 - 4.0 * t, 18.0 - 26.0 * t], axis=1))
    sutures = []
    for line in lines:
        path = line / np.linalg.norm(line / (a, b, c), axis=1, keepdims=True)
        radii = np.broadcast_to((SKULL_MM / 2.0 + 0.35, 0.8), (count, 2))
        sutures.append(tube(path, radii, sides, up=path[0] / np.array((a, b, c)) ** 2))
    return sutures


def _ventricles(scale: float) -> list[Part]:
    """Lateral ventricles with choroid plexus in their atria."""
    sides, count = max(3, round(14 / scale)), max(6, round(40 / scale))
    t = np.linspace(0.0, 1.0, 6)
    stations = np.array(
        [(4.5, -17.0, 5.0), (5.5, -9.0, 8.0), (7.5, 1.0, 9.0), (10.0, 11.0, 6.0), (11.0, 18.0, 1.0), (9.5, 24.0, -1.0)]
    )
    radii = np.array([0.9, 1.6, 1.9, 3.2, 3.2, 1.0])
    parts = []
    for name, tissue, first, last, share in (
        ("lateral ventricles", "csf", 0.0, 1.0, 1.0),
        ("choroid plexus", "vessel_wall", 0.42, 0.86, 0.66),
    ):
        along = np.linspace(first, last, count)
        path = interpolated(along, t, stations)
        radius = share * np.interp(along, t, radii)
        tubes = [tube(path * (side, 1.0, 1.0), radius, sides) for side in SIDES[::-1]]
        parts.append(Part(joined(tubes, name), tissue))
    return parts


def _eyes(scale: float) -> list[Part]:
    """Eyes and their lenses."""
    x, y, z = EYE_CENTER
    eyes, lenses = [], []
    for side in SIDES[::-1]:
        eye = sdf.ellipsoid((side * x, y, z), (5.2, 5.2, 5.2))
        eyes.append(sdf.mesh_field(eye, HEAD_BOX, min(0.6 * scale, 3.2), "eye"))
        lens = sdf.ellipsoid((side * x, y - 3.4, z), (1.6, 0.9, 1.6))
        lenses.append(sdf.mesh_field(lens, HEAD_BOX, min(0.35 * scale, 0.6), "lens"))
    return [Part(joined(eyes, "eyes"), "csf"), Part(joined(lenses, "lenses"), "cartilage")]
