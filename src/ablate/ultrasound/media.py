"""A scene as the simulator uses it: tables of its tissues for rays to index, without what the scene does not need."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound.probe import check_pose, fan_lines
from ablate.ultrasound.settings import DepthMode, PlanMode, Probe, SimulatorSettings

DISPLAY_SPEED_M_S = 1540.0
_MAX_TISSUES = 254  # 0 is outside the fan
_MARGIN = 1.001  # of the reach: for rounding, and for poses some micrometres beside


class Media(NamedTuple):
    """Tables over tissues, (tissues,) float32 unless said otherwise; a tuple, so that compiled code can take it."""

    speed_m_s: np.ndarray
    impedance_mrayl: np.ndarray
    specularity: np.ndarray
    thickness_mm: np.ndarray
    loss_db_mm: np.ndarray  # one way, at the probe's frequency
    lobe_exponent: np.ndarray  # 1 / (s + 1) of the power-cosine lobe of normals, roughness / (1 + roughness)
    stretch: np.ndarray  # displayed over geometric length: 1, or 1540 / speed in time-of-flight mode
    anechoic: np.ndarray  # bool: whether it is the background, and has no scatterers
    differs: np.ndarray  # (tissues, tissues) bool: where an interface reflects or refracts
    refracts: bool  # whether the tissues need refraction, rough normals, surface thickness at all
    rough: bool
    thick: bool


class Medium(NamedTuple):
    """A row of `Media`, in numbers: what a ray that travels in it needs."""

    loss_db_mm: float
    stretch: float
    anechoic: bool


class Surface(NamedTuple):
    """A row of `Media`, in numbers: what a ray that meets the surface of a structure needs."""

    lobe_exponent: float
    specularity: float
    thickness_mm: float


def loss_db_mm(tissue: Tissue, frequency_mhz: float) -> float:
    """Amplitude lost one way, alpha f^b, dB/mm."""
    return tissue.attenuation_db_cm_mhz * frequency_mhz**tissue.attenuation_power / 10


def tabulate(tissues: Sequence[Tissue], used: np.ndarray, frequency_mhz: float, mode: DepthMode, full: bool) -> Media:
    """Tables of some tissues; steps that no tissue in use needs are switched off unless `full`.

    Parameters
    ----------
    tissues : sequence of Tissue
        All of the scene.
    used : (n,) int
        Those that something within reach is filled with.
    frequency_mhz : float
        Of the probe; attenuation depends on it.
    mode : DepthMode
        Whether depths are geometric or times of flight.
    full : bool
        Whether nothing is switched off.
    """
    speed, impedance, specularity, roughness, thickness = (
        np.array([getattr(tissue, name) for tissue in tissues], np.float32)
        for name in ("speed_m_s", "impedance_mrayl", "specularity", "roughness", "thickness_mm")
    )
    stretch = np.float32(DISPLAY_SPEED_M_S) / speed if mode is DepthMode.time_of_flight else np.ones_like(speed)
    return Media(
        speed_m_s=speed,
        impedance_mrayl=impedance,
        specularity=specularity,
        thickness_mm=thickness,
        loss_db_mm=np.array([loss_db_mm(t, frequency_mhz) for t in tissues], np.float32),
        lobe_exponent=roughness / (1 + roughness),
        stretch=stretch,
        anechoic=np.array([i == 0 and t.scatter_power == 0 for i, t in enumerate(tissues)]),
        differs=(impedance[:, None] != impedance) | (speed[:, None] != speed),
        refracts=full or bool((speed[used] != speed[used][0]).any()),
        rough=full or bool(roughness[used].any()),
        thick=full or bool(thickness[used].any()),
    )


@dataclass(frozen=True)
class RenderPlan:
    """A scene as the simulator uses it."""

    structures: tuple[Structure, ...]  # those within reach, in the scene's order
    tissue_of_owner: np.ndarray  # (structures + 1,) uint8, index into `Scene.tissues`; entry 0 is the background's
    media: Media
    anechoic: bool  # whether nothing within reach scatters or reflects: then no ray is cast
    left_out: tuple[str, ...]  # what was left out, and why, one line each
    reach_mm: float  # of echoes, from the middle of the face
    out_of_reach: np.ndarray  # (n, 2, 3) float64, mm, bounds of the structures that were left out

    def check_reach(self, pose: np.ndarray) -> None:
        """Refuse a pose, by a ValueError, from which a structure that was left out might be seen."""
        if _within_mm(self.reach_mm, self.out_of_reach, pose[None, :3, 3]).any():
            raise ValueError("pose: a structure that was left out is in reach; `poses` must hold all that are rendered")


def plan_scene(
    scene: Scene, probe: Probe, settings: SimulatorSettings, poses: Iterable[np.ndarray] | None
) -> RenderPlan:
    """Leave out what cannot change an image.

    Parameters
    ----------
    scene : Scene
        All structures.
    probe : Probe
        How deep it sees.
    settings : SimulatorSettings
        How far beside its plane it sees, and whether anything is left out at all.
    poses : iterable of (4, 4) float, or None
        From where it looks; no structure is left out where they are not known.

    Returns
    -------
    RenderPlan
        The scene as the simulator uses it.

    Raises
    ------
    ValueError
        When the scene has more tissues than labels, or a pose is not rigid.
    """
    if len(scene.tissues) > _MAX_TISSUES:
        raise ValueError(f"scene {scene.name!r} has {len(scene.tissues)} tissues; at most {_MAX_TISSUES}")
    full = settings.plan is PlanMode.full
    near, reach_mm = np.ones(len(scene.structures), bool), _reach_mm(scene, probe, settings)
    bounds = np.array([structure.mesh.bounds for structure in scene.structures]).reshape(-1, 2, 3)
    if not full and poses is not None:
        middles = np.array([check_pose(pose)[:3, 3] for pose in poses]).reshape(-1, 3)
        near = _within_mm(_MARGIN * reach_mm, bounds, middles)
    kept = np.flatnonzero(near)
    tissue_of_owner = np.array([0, *(scene.structure_tissues[i] for i in kept)], np.uint8)
    used = np.unique(tissue_of_owner)
    media = tabulate(scene.tissues, used, probe.frequency_mhz, settings.depth_mode, full)
    echogenic = any(scene.tissues[i].scatter_power for i in used) or bool(media.differs[np.ix_(used, used)].any())
    # Where structures are out of reach, rays are cast all the same: the warning about contact needs their labels.
    anechoic = not (full or echogenic) and bool(near.all())
    notes = [] if full else _notes(scene, near, used, media, settings)
    if anechoic:
        notes = ["rays, scatterers and pulse: nothing in reach scatters or reflects", *notes]
    structures = tuple(scene.structures[i] for i in kept)
    return RenderPlan(structures, tissue_of_owner, media, anechoic, tuple(notes), reach_mm, bounds[~near])


def _within_mm(reach_mm: float, bounds: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which boxes, (n, 2, 3), are within `reach_mm` of some of the points, (m, 3)."""
    gaps = [np.maximum(np.maximum(lower - points, points - upper), 0) for lower, upper in bounds]
    return np.array([(np.linalg.norm(gap, axis=-1) <= reach_mm).any() for gap in gaps], bool)


def _reach_mm(scene: Scene, probe: Probe, settings: SimulatorSettings) -> float:
    """Distance from the middle of the face beyond which no echo in the image can come from.

    An echo's depth is half its whole path, so a point farther than the depth from every start is never seen,
    however often a ray was reflected.
    """
    face = float(np.linalg.norm(fan_lines(probe, 2)[0][0]))  # to where the outer scanlines start
    off_plane = settings.layer_extent_mm + settings.aperture_mm + settings.elevational_aperture_mm
    fastest = 1.0
    if settings.depth_mode is DepthMode.time_of_flight:
        fastest = max(1.0, max(t.speed_m_s for t in scene.tissues) / DISPLAY_SPEED_M_S)
    return probe.depth_mm * fastest + face + off_plane


def _notes(scene: Scene, near: np.ndarray, used: np.ndarray, media: Media, settings: SimulatorSettings) -> list[str]:
    notes = []
    if not near.all():
        names = ", ".join(dict.fromkeys(scene.structures[i].tissue.name for i in np.flatnonzero(~near)))
        notes.append(f"{(~near).sum()} of {len(near)} structures: out of every fan's reach ({names})")
    absent = [t.name for i, t in enumerate(scene.tissues) if i not in used]
    if absent:
        notes.append(f"scatterers of tissues not in reach: {', '.join(absent)}")
    silent = [scene.tissues[i].name for i in used if not scene.tissues[i].scatter_power]
    if 0 < len(silent) < len(used):
        notes.append(f"scatterers where a tissue has none: {', '.join(silent)}")
    unneeded = {
        "refraction: all speeds of sound agree": not media.refracts,
        "reflection and roulette: all impedances and speeds agree": not media.differs[np.ix_(used, used)].any(),
        "rough normals: every roughness is zero": not media.rough,
        "surface thickness: every thickness is zero": not media.thick,
        "texture: every contrast is zero": not any(scene.tissues[i].texture_contrast_db for i in used),
        "elevational weights: there is one layer": settings.layers == 1,
    }
    return notes + [note for note, holds in unneeded.items() if holds]
