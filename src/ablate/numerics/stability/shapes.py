"""Touching surfaces, needle triangles, thin films, nested shells, and scenes of all sizes and positions."""

from collections.abc import Callable
from dataclasses import fields, replace
from itertools import groupby, pairwise, product

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.anatomy.meshes.check import shared_walls
from ablate.numerics.stability.checks import AHEAD, FLOAT32, GEL, PROBE, SMALL, SOFT, Checks, case, moved, slab
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorSettings
from ablate.ultrasound.imaging.point_spread import axial_kernel
from ablate.ultrasound.probe import pixel_coordinates_mm
from ablate.ultrasound.transport.bounce import SHARED_FROM_GROWTH

HARD = Tissue("hard", 1540, 1.8, 0.5, 0.6, 0.0, 0.8, roughness=0.0)
#: What grows with the unit of length.
_LENGTHS = [field.name for field in fields(SimulatorSettings) if field.name.endswith("_mm")]


@case("a film of 1 um", 1e-3)
@case("a layer of 0.1 mm", 0.1)
def _film(checks: Checks, thickness_mm: float) -> None:
    """A layer thinner than the pulse, so that its two echoes overlap; the medium behind it is the one before it."""
    probe = ConvexProbe(fov_deg=0.002)
    settings = replace(
        SMALL, scanlines=16, rays=8, layers=1, aperture_mm=0.0, elevational_aperture_mm=0.0, lateral_fwhm_mm=1e-6,
        noise_level_db=-120.0, tgc_db_cm_mhz=0.0,
    )  # fmt: skip
    around, film = (replace(t, attenuation_db_cm_mhz=0.0, scatterer_density=0.0) for t in (SOFT, HARD))
    r = (film.impedance_mrayl - around.impedance_mrayl) / (film.impedance_mrayl + around.impedance_mrayl)
    pulse = axial_kernel(probe, settings)
    _, z = pixel_coordinates_mm(probe, settings.image_shape)
    inside = (z > 50) & (z < 50 + thickness_mm)
    for frame in checks.frames(Scene((slab(film, 50.0, 50.0 + thickness_mm, 150.0),), around, "film"), settings, probe):
        error = abs(frame.envelope[:, 8].sum(dtype=float) / pulse.sum() - r * (2 - r * r))
        why = "So weak a surface reflects no ray: only impedances and sums over the pulse are rounded."
        checks.add("both echoes against R + (1 - R^2) R", error, (len(pulse) + 4) * FLOAT32, why)
        wrong = (frame.segmentation[:, 138] == 2) != inside
        checks.none("rows of S that are wrong", wrong, "The tissue at a pixel's centre is exact.")


@case("coincident surfaces")
def _coincident(checks: Checks) -> None:
    """Boxes that share a wall, as neighbours in a label map do: the tissue behind the wall is undefined."""
    below = slab(SOFT, 20.0, 50.0)
    mirrored = below.mesh.copy().apply_transform(np.diag([1.0, 1.0, -1.0, 1.0])).apply_translation((0, 0, 100.0))
    for frame in checks.frames(Scene((below, Structure(mirrored, HARD)), GEL, "touching")):
        unknown = ~np.isin(frame.segmentation[frame.mask], (1, 2, 3))
        checks.none("labels of no tissue", unknown, "Each label is a tissue of the scene.")
    named = len(shared_walls([below.mesh, mirrored]))
    checks.add("shared walls not named", abs(1 - named), 0, "They lie on each other.", "float64")
    frames = checks.both(Scene((below, slab(HARD, 50.001, 90.0)), GEL, "apart"))
    for checks.dtype, frame in frames.items():
        order = [label for label, _ in groupby(frame.segmentation[frame.mask[:, 138], 138])]
        why = "A ray continues 2e-7 of the scene's extent beyond a surface, here 0.1 um."
        checks.none("labels down the middle that are wrong, 1 um apart", order != [1, 2, 3, 1], why)


def needles() -> Structure:
    """Make a flat cylinder of 2000 sectors: its triangles are 200 mm long with a base of 0.6 mm."""
    mesh = trimesh.creation.cylinder(radius=200.0, height=10.0, sections=2000)
    return Structure(mesh.apply_translation((0, 0, 70.0)), HARD)


def slivers() -> Structure:
    """Make a box whose faces are cut into strips from 150 mm down to 15 um wide."""
    orders = 150.0 * np.logspace(-7, 0, 8)
    cuts = np.concatenate([-orders[::-1], orders])
    along = cuts, cuts, np.array([65.0, 75.0])
    triangles = []
    for axis in range(3):
        across = [pairwise(lines) for k, lines in enumerate(along) if k != axis]
        for ((a, b), (c, d)), plane in product(product(*across), (along[axis][0], along[axis][-1])):
            corners = np.insert([(a, c), (b, c), (b, d), (a, d)], axis, plane, axis=1)
            triangles += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    return Structure(trimesh.Trimesh(np.concatenate(triangles), faces, process=False), HARD)


@case("slivers", slivers)
@case("needle triangles", needles)
def _awkward(checks: Checks, make: Callable[[], Structure]) -> None:
    """A layer 10 mm thick made of badly shaped triangles, against the same layer made of twelve."""
    plain = checks.both(Scene((slab(HARD, 65.0, 75.0),), SOFT, "shape"))
    moved_by = 8 * FLOAT32 * 400 / (150 / SMALL.axial_samples)
    for frame in checks.frames(Scene((make(),), SOFT, "shape")):
        why = "No pixel's centre is within float32's rounding of the surface."
        _same_labels(checks, "twelve triangles", frame, plain, why)
        why = "A hit is exact to 8 roundings of 400 mm, and its echo moves by this share of a sample."
        quantity = "envelope against twelve triangles, of its largest"
        checks.same_envelope(quantity, frame, plain[checks.dtype], why, moved_by=moved_by)


def _same_labels(checks: Checks, other: str, frame: Frame, right: dict[str, Frame], why: str) -> None:
    checks.none(f"pixels of S against {other}", frame.segmentation != right[checks.dtype].segmentation, why)


def _scaled(size: float) -> tuple[Scene, SimulatorSettings, ConvexProbe]:
    """Make a layer in soft tissue with probe and pulse, all lengths and the wave's times `size`."""
    settings = replace(SMALL, **{name: getattr(SMALL, name) * size for name in _LENGTHS})
    mesh = slab(HARD, 40.0, 60.0, 100.0).mesh.apply_scale(size)
    scene = Scene((Structure(mesh, HARD),), SOFT, f"size {size:g}")
    return scene, settings, ConvexProbe(40 * size, 70, 150 * size, ConvexProbe.frequency_mhz / size)


@case("a scene of micrometres", 1 / 64)
@case("a scene of metres", 32.0)
def _another_unit(checks: Checks, size: float) -> None:
    """The same scene, probe and pulse in another unit of length: the frames are the same."""
    scene, settings, probe = _scaled(size)
    in_mm = checks.both(_scaled(1.0)[0])
    for frame in checks.frames(scene, settings, probe):
        why = "The unit is a power of two: only the exponents of coordinates change."
        _same_labels(checks, "millimetres", frame, in_mm, why)
        why = "The same scatterers are summed in the same order."
        right = in_mm[checks.dtype]
        checks.same_envelope("envelope against millimetres, of its largest", frame, right, why, settings, probe)


@case("a scene of micrometres, a metre from the origin", 1e3, 1 / 64)
@case("a scene of metres, 1000 km from the origin", 1e9, 32.0)
@case("a scene 1000 km from the origin", 1e9, 1.0)
def _far(checks: Checks, away_mm: float, size: float) -> None:
    """Scene and probe far from the origin of the world: the same labels, other speckle with the same statistics."""
    scene, settings, probe = _scaled(size)
    near = checks.both(scene, settings, probe)
    shift_mm = np.array([away_mm, -away_mm, away_mm])
    mesh = scene.structures[0].mesh.copy().apply_translation(shift_mm)
    away = replace(scene, structures=(Structure(mesh, scene.structures[0].tissue),))
    for frame in checks.frames(away, settings, probe, moved(*shift_mm)):
        why = "Coordinates are taken relative to the middle of the scene before they become float32."
        _same_labels(checks, "those at the origin", frame, near, why)
        part, other = (f.envelope[100:250].astype(float) for f in (frame, near[checks.dtype]))  # from 15 to 37 mm
        grains = part.size / 8 / 2  # a pulse is 8 samples long and a beam at least two lines wide
        error = abs(part.mean() / other.mean() - 1)
        bound = 5 * np.sqrt(2) * 0.523 / np.sqrt(grains)
        why = "Five standard errors of two means over speckle cells; their deviation is 0.523 of their mean."
        checks.add("mean of speckle against that at the origin, relative", error, bound, why)
        error = abs((part / part.mean(axis=1, keepdims=True)).std() - 0.523)  # 0.523 is that of a Rayleigh variable
        why = "Five standard errors; the square of a cell varies about as much."
        checks.add("deviation over mean of speckle against 0.523", error, 5 * 0.523 / np.sqrt(grains), why)


@case("64 surfaces of R_p = 0.97, 1 mm apart", 0.97, 1.0, 64)
@case("64 surfaces of R_p = 0.5, 1 mm apart", 0.5, 1.0, 64)
@case("250 surfaces of R_p = 0.1, 0.5 mm apart", 0.1, 0.5, 250)
def _stack(checks: Checks, pressure: float, gap_mm: float, faces: int) -> None:
    """A stack of surfaces with reflection coefficients +-R_p and no attenuation: the sum of all echoes is bounded."""
    around = replace(SOFT, attenuation_db_cm_mhz=0.0, scatterer_density=0.0)
    hard = replace(around, name="hard", impedance_mrayl=around.impedance_mrayl * (1 + pressure) / (1 - pressure))
    slabs = tuple(slab((hard, around)[i % 2], 20.0 + gap_mm * i, 400.0 - gap_mm * i) for i in range(faces))
    settings = replace(SMALL, tgc_db_cm_mhz=0.0)
    pulse = axial_kernel(PROBE, settings).sum()
    bound = 1 / pressure + 5 / 4 * SHARED_FROM_GROWTH * (PROBE.depth_mm - 20) / gap_mm
    why = (
        "Direct echoes sum to R_p (1 + (1 - R) + (1 - R)^2 ...) = 1 / R_p at most. The reflected rays carry this "
        "weight times 5/4 of SHARED_FROM_GROWTH at most, and add R_p of it in every gap."
    )
    for frame in checks.frames(Scene(slabs, around, "stack"), settings):
        received = frame.envelope.sum(axis=0, dtype=float).mean() / pulse
        checks.add("sum of the echoes of a line, over a mirror's", received, bound, why)


@case("254 tissues, and one more")
def _labels(checks: Checks) -> None:
    """As many tissues as there are labels; one tissue more is refused."""
    boxes = tuple(slab(replace(HARD, name=f"t{i}"), 10 + 0.5 * i, 10.3 + 0.5 * i) for i in range(254))
    settings = replace(SMALL, device=checks.device, rays=1, layers=1, image_shape=(1000, 3))
    frame = Simulator(Scene(boxes[:-1], SOFT, "full"), None, settings).render(AHEAD)
    checks.dtype = "float32"
    checks.finite(frame.envelope, frame.attenuation)
    missing = 254 - len(np.unique(frame.segmentation[frame.mask]))
    checks.add("labels missing", missing, 0, "All tissues are in view, each with its own label.")
    checks.refused(lambda: Simulator(Scene(boxes, SOFT, "too many"), None, settings))
