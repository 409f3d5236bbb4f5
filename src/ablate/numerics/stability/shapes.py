"""Touching surfaces, needle triangles, thin films, nested shells, and scenes of all sizes and positions."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import groupby, pairwise, product

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.anatomy.meshes.check import shared_walls
from ablate.numerics.stability.checks import FLOAT32, Case, Check, finite, none, refused
from ablate.numerics.stability.frames import (
    AHEAD,
    GEL,
    PROBE,
    SMALL,
    SOFT,
    both,
    checked_frames,
    envelope_error,
    moved,
    products,
    slab,
)  # fmt: skip
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorSettings
from ablate.ultrasound.imaging.point_spread import axial_kernel
from ablate.ultrasound.probe import pixel_coordinates_mm
from ablate.ultrasound.transport.bounce import SHARED_FROM_GROWTH

HARD = Tissue("hard", 1540, 1.8, 0.5, 0.6, 0.0, 0.8, roughness=0.0)
_LENGTHS = (
    "axial_fwhm_mm", "lateral_fwhm_mm", "elevational_fwhm_mm", "focus_mm", "focal_range_mm", "aperture_mm",
    "elevational_aperture_mm", "layer_extent_mm", "scatterer_pitch_mm",
)  # fmt: skip


def _film(thickness_mm: float, device: str) -> Iterator[Check]:
    """A layer thinner than the pulse, so that its two echoes overlap; the medium behind it is the one before it."""
    probe = ConvexProbe(fov_deg=0.002)
    settings = replace(
        SMALL, scanlines=16, rays=8, layers=1, aperture_mm=0.0, elevational_aperture_mm=0.0, lateral_fwhm_mm=1e-6,
        noise_floor_db=-100.0, tgc_db_cm_mhz=0.0,
    )  # fmt: skip
    around, film = (replace(t, attenuation_db_cm_mhz=0.0, scatterer_density=0.0) for t in (SOFT, HARD))
    scene = Scene((slab(film, 50.0, 50.0 + thickness_mm, 150.0),), around, "film")
    frames = yield from checked_frames(scene, settings, device, probe)
    r = (film.impedance_mrayl - around.impedance_mrayl) / (film.impedance_mrayl + around.impedance_mrayl)
    pulse = axial_kernel(probe, settings)
    _, z = pixel_coordinates_mm(probe, settings.image_shape)
    inside = (z > 50) & (z < 50 + thickness_mm)
    for dtype, frame in frames.items():
        echo = frame.envelope[:, 8].sum(dtype=float) / pulse.sum()
        error = abs(echo - r * (2 - r * r))
        why = "So weak a surface reflects no ray: only impedances and sums over the pulse are rounded."
        yield Check(dtype, "both echoes against R + (1 - R^2) R", error, (len(pulse) + 4) * FLOAT32, why)
        wrong = (frame.segmentation[:, 138] == 2) != inside
        yield none(dtype, "rows of S that are wrong", wrong, "The tissue at a pixel's centre is exact.")


def _coincident(device: str) -> Iterator[Check]:
    """Boxes that share a wall, as neighbours in a label map do: the tissue behind the wall is undefined."""
    below = slab(SOFT, 20.0, 50.0)
    mirrored = below.mesh.copy().apply_transform(np.diag([1.0, 1.0, -1.0, 1.0])).apply_translation((0, 0, 100.0))
    frames = yield from checked_frames(Scene((below, Structure(mirrored, HARD)), GEL, "touching"), SMALL, device)
    named = len(shared_walls([below.mesh, mirrored]))
    yield Check("float64", "shared walls not named", abs(1 - named), 0, "Their triangles coincide.")
    for dtype, frame in frames.items():
        unknown = ~np.isin(frame.segmentation[frame.mask], (1, 2, 3))
        yield none(dtype, "labels of no tissue", unknown, "Each label is a tissue of the scene.")
    for dtype, frame in both(Scene((below, slab(HARD, 50.001, 90.0)), GEL, "apart"), SMALL, device).items():
        order = [label for label, _ in groupby(frame.segmentation[frame.mask[:, 138], 138])]
        why = "A ray continues 2e-7 of the scene's extent beyond a surface, here 0.1 um."
        yield none(dtype, "labels down the middle that are wrong, 1 um apart", order != [1, 2, 3, 1], why)


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


def _awkward(make: Callable[[], Structure], device: str) -> Iterator[Check]:
    """A layer 10 mm thick made of badly shaped triangles, against the same layer made of twelve."""
    plain = both(Scene((slab(HARD, 65.0, 75.0),), SOFT, "shape"), SMALL, device)
    awkward = yield from checked_frames(Scene((make(),), SOFT, "shape"), SMALL, device)
    moved_by = 8 * FLOAT32 * 400 / (150 / SMALL.axial_samples)
    for dtype, frame in awkward.items():
        why = "No pixel's centre is within float32's rounding of the surface."
        yield _same_labels(dtype, "twelve triangles", frame, plain[dtype], why)
        error, bound = envelope_error(frame, plain[dtype]), moved_by + products(SMALL) ** 1.5 * FLOAT32
        why = "A hit is exact to 8 roundings of 400 mm, and its echo moves by this share of a sample."
        yield Check(dtype, "envelope against twelve triangles, of its largest", error, bound, why)


def _same_labels(dtype: str, other: str, frame: Frame, plain: Frame, why: str) -> Check:
    return none(dtype, f"pixels of S against {other}", frame.segmentation != plain.segmentation, why)


def _scaled(size: float) -> tuple[ConvexProbe, SimulatorSettings, Scene]:
    """Make a layer in soft tissue with probe and pulse, all lengths times `size` and attenuation divided by it."""
    soft, hard = (replace(t, attenuation_db_cm_mhz=t.attenuation_db_cm_mhz / size) for t in (SOFT, HARD))
    settings = replace(SMALL, tgc_db_cm_mhz=SMALL.tgc_db_cm_mhz / size)
    settings = replace(settings, **{name: getattr(SMALL, name) * size for name in _LENGTHS})
    mesh = slab(hard, 40.0, 60.0, 100.0).mesh.apply_scale(size)
    return ConvexProbe(40 * size, 70, 150 * size), settings, Scene((Structure(mesh, hard),), soft, f"size {size:g}")


def _another_unit(size: float, device: str) -> Iterator[Check]:
    """The same scene, probe and pulse in another unit of length: the frames are the same."""
    (probe, settings, scene), (_, _, plain) = _scaled(size), _scaled(1.0)
    in_mm = both(plain, SMALL, device)
    frames = yield from checked_frames(scene, settings, device, probe)
    for dtype, frame in frames.items():
        why = "The unit is a power of two: only the exponents of coordinates change."
        yield _same_labels(dtype, "millimetres", frame, in_mm[dtype], why)
        error, bound = envelope_error(frame, in_mm[dtype]), products(settings, probe) ** 1.5 * FLOAT32
        why = "The same scatterers are summed in the same order."
        yield Check(dtype, "envelope against millimetres, of its largest", error, bound, why)


def _far(away_mm: float, size: float, device: str) -> Iterator[Check]:
    """Scene and probe far from the origin of the world: the same labels, other speckle with the same statistics."""
    probe, settings, scene = _scaled(size)
    near = both(scene, settings, device, probe)
    there = np.array([away_mm, -away_mm, away_mm])
    mesh = scene.structures[0].mesh.copy().apply_translation(there)
    away = replace(scene, structures=(Structure(mesh, scene.structures[0].tissue),))
    far = yield from checked_frames(away, settings, device, probe, pose=moved(*there))
    for dtype, frame in far.items():
        why = "Coordinates are taken relative to the middle of the scene before they become float32."
        yield _same_labels(dtype, "those at the origin", frame, near[dtype], why)
        yield from _same_speckle(dtype, frame, near[dtype])


def _lost(device: str) -> Iterator[Check]:
    """A probe 1000 km from its scene, surrounded by soft tissue only."""
    plain = both(Scene((), SOFT, "plain"), SMALL, device)
    scene = Scene((slab(HARD, 40.0, 60.0),), SOFT, "left")
    frames = yield from checked_frames(scene, SMALL, device, pose=moved(1e9, -1e9, 1e9))
    for dtype, frame in frames.items():
        yield from _same_speckle(dtype, frame, plain[dtype])


def _same_speckle(dtype: str, frame: Frame, plain: Frame) -> Iterator[Check]:
    """Compare speckle between 15 and 37 mm with another frame's mean, and with the deviation of a Rayleigh variable."""
    part, other = (f.envelope[100:250].astype(float) for f in (frame, plain))
    grains = part.size / 8 / 2  # a pulse is 8 samples long and a beam at least two lines wide
    error, bound = abs(part.mean() / other.mean() - 1), 5 * np.sqrt(2) * 0.523 / np.sqrt(grains)
    why = "Five standard errors of two means over speckle cells; their deviation is 0.523 of their mean."
    yield Check(dtype, "mean of speckle against that at the origin, relative", error, bound, why)
    level = part.mean(axis=1, keepdims=True)
    error, bound = abs((part / level).std() - 0.523), 5 * 0.523 / np.sqrt(grains)
    why = "Five standard errors; the square of a cell varies about as much."
    yield Check(dtype, "deviation over mean of speckle against 0.523", error, bound, why)


def _shells(device: str) -> Iterator[Check]:
    """Sixty-four nested boxes, 0.9 mm apart."""
    tissues = [replace(HARD, name=f"t{i}", impedance_mrayl=1.63 + 0.01 * (i % 2)) for i in range(64)]
    boxes = [slab(t, 20.0 + 0.9 * i, 140.0 - 0.9 * i, 280.0 - i) for i, t in enumerate(tissues)]
    frames = yield from checked_frames(Scene(tuple(boxes), SOFT, "shells"), SMALL, device)
    _, z = pixel_coordinates_mm(PROBE, SMALL.image_shape)
    right = 1 + np.clip(np.ceil(np.minimum(z - 20, 140 - z) / 0.9), 0, 64)
    for dtype, frame in frames.items():
        wrong = (frame.segmentation[:, 138] != right) & frame.mask[:, 138]
        yield none(dtype, "rows of S that are wrong", wrong, "Each crossing changes one bit.")


def _stack(pressure: float, gap_mm: float, faces: int, device: str) -> Iterator[Check]:
    """A stack of surfaces with reflection coefficients +-R_p and no attenuation: the sum of all echoes is bounded."""
    around = replace(SOFT, attenuation_db_cm_mhz=0.0, scatterer_density=0.0)
    hard = replace(around, name="hard", impedance_mrayl=around.impedance_mrayl * (1 + pressure) / (1 - pressure))
    slabs = tuple(slab((hard, around)[i % 2], 20.0 + gap_mm * i, 400.0 - gap_mm * i) for i in range(faces))
    settings = replace(SMALL, tgc_db_cm_mhz=0.0)
    frames = yield from checked_frames(Scene(slabs, around, "stack"), settings, device)
    pulse = axial_kernel(PROBE, settings).sum()
    for dtype, frame in frames.items():
        received = float(frame.envelope.sum(axis=0, dtype=float).mean() / pulse)
        bound = 1 / pressure + 5 / 4 * SHARED_FROM_GROWTH * (PROBE.depth_mm - 20) / gap_mm
        why = (
            "Direct echoes sum to R_p (1 + (1 - R) + (1 - R)^2 ...) = 1 / R_p at most. The reflected rays carry this "
            "weight times 5/4 of SHARED_FROM_GROWTH at most, and add R_p of it in every gap."
        )
        yield Check(dtype, "sum of the echoes of a line, over a mirror's", received, bound, why)


def _labels(device: str) -> Iterator[Check]:
    """As many tissues as there are labels; one tissue more is refused."""
    tissues = [replace(HARD, name=f"t{i}") for i in range(254)]
    boxes = tuple(slab(t, 10 + 0.5 * i, 10.3 + 0.5 * i) for i, t in enumerate(tissues))
    settings = replace(SMALL, device=device, rays=1, layers=1, image_shape=(1000, 3))
    frame = Simulator(Scene(boxes[:-1], SOFT, "full"), None, settings).render(AHEAD)
    yield finite("float32", frame.envelope, frame.attenuation)
    missing = 254 - len(np.unique(frame.segmentation[frame.mask]))
    yield Check("float32", "labels missing", missing, 0, "All tissues are in view, each with its own label.")
    yield refused("float32", lambda: Simulator(Scene(boxes, SOFT, "too many"), None, settings))


def _on_a_face(device: str) -> Iterator[Check]:
    """A surface that touches the middle of the probe's face, and a sphere that coincides with the whole face."""
    sphere = trimesh.creation.icosphere(5, 40.0).apply_translation((0, 0, -40.0))
    for label, structure in (("plane", slab(HARD, 0.0, 100.0)), ("sphere", Structure(sphere, HARD))):
        yield from checked_frames(Scene((structure,), SOFT, label), SMALL, device, label=label)


CASES = (
    Case("a layer of 0.1 mm", partial(_film, 0.1)),
    Case("a film of 1 um", partial(_film, 1e-3)),
    Case("coincident surfaces", _coincident),
    Case("needle triangles", partial(_awkward, needles)),
    Case("slivers", partial(_awkward, slivers)),
    Case("a scene of metres", partial(_another_unit, 64.0)),
    Case("a scene of micrometres", partial(_another_unit, 1 / 1024)),
    Case("a scene 1000 km from the origin", partial(_far, 1e9, 1.0)),
    Case("a scene of metres, 1000 km from the origin", partial(_far, 1e9, 64.0)),
    Case("a scene of micrometres, a metre from the origin", partial(_far, 1e3, 1 / 1024)),
    Case("a probe 1000 km from its scene", _lost),
    Case("sixty-four shells", _shells),
    Case("250 surfaces of R_p = 0.1, 0.5 mm apart", partial(_stack, 0.1, 0.5, 250)),
    Case("64 surfaces of R_p = 0.5, 1 mm apart", partial(_stack, 0.5, 1.0, 64)),
    Case("64 surfaces of R_p = 0.97, 1 mm apart", partial(_stack, 0.97, 1.0, 64)),
    Case("254 tissues, and one more", _labels),
    Case("a probe's face in a surface", _on_a_face),
)
