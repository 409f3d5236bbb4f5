"""Surfaces that touch, triangles like needles, films, shells within shells, sizes and places of every order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.anatomy.walls import shared_walls
from ablate.studies.stability.checks import FLOAT32, Case, Check, finite, labelled, off, refused
from ablate.studies.stability.frames import AHEAD, GEL, SMALL, SOFT, both, moved, products, slab, usual
from ablate.ultrasound import ConvexProbe, Frame, Simulator, SimulatorSettings
from ablate.ultrasound.point_spread import axial_kernel
from ablate.ultrasound.probe import pixel_coordinates_mm
from ablate.ultrasound.transport import LOUDEST

HARD = Tissue("hard", 1540, 1.8, 0.5, 0.6, 0.0, 0.8, roughness=0.0)
_LENGTHS = (
    "axial_fwhm_mm", "lateral_fwhm_mm", "elevational_fwhm_mm", "focus_mm", "focal_range_mm", "aperture_mm",
    "elevational_aperture_mm", "layer_extent_mm", "scatterer_pitch_mm",
)  # fmt: skip


def _film(thickness_mm: float, device: str) -> Iterator[Check]:
    """A layer whose two echoes add up within one pulse; behind it is what was before it."""
    probe = ConvexProbe(fov_deg=0.002)
    settings = replace(
        SMALL, scanlines=16, rays=8, layers=1, aperture_mm=0.0, elevational_aperture_mm=0.0, lateral_fwhm_mm=1e-6,
        noise_floor_db=-100.0, tgc_db_cm_mhz=0.0,
    )  # fmt: skip
    around, film = (replace(t, attenuation_db_cm_mhz=0.0, scatterer_density=0.0) for t in (SOFT, HARD))
    scene = Scene((slab(film, 50.0, 50.0 + thickness_mm, 150.0),), around, "film")
    frames = both(scene, settings, device, probe)
    yield from usual(frames, settings, probe)
    r = (film.impedance_mrayl - around.impedance_mrayl) / (film.impedance_mrayl + around.impedance_mrayl)
    pulse = axial_kernel(probe, settings)
    _, z = pixel_coordinates_mm(probe, settings.image_shape)
    inside = (z > 50) & (z < 50 + thickness_mm)
    for dtype, frame in frames.items():
        echo = frame.envelope[:, 8].sum(dtype=float) / pulse.sum()
        yield Check(
            dtype, "both echoes against R + (1 - R^2) R", abs(echo - r * (2 - r * r)), (len(pulse) + 4) * FLOAT32,
            "So faint a face turns no ray: only impedances, and sums over the pulse, are rounded.",
        )  # fmt: skip
        wrong = (frame.segmentation[:, 138] == 2) != inside
        yield Check(dtype, "rows of S that are wrong", int(wrong.sum()), 0, "The owner of a pixel's centre is exact.")


def _coincident(device: str) -> Iterator[Check]:
    """Boxes that share a wall, as neighbours in a label map do: who owns what lies behind is undefined."""
    below = slab(SOFT, 20.0, 50.0)
    mirrored = below.mesh.copy().apply_transform(np.diag([1.0, 1.0, -1.0, 1.0])).apply_translation((0, 0, 100.0))
    frames = both(Scene((below, Structure(mirrored, HARD)), GEL, "touching"), SMALL, device)
    yield from usual(frames, SMALL)
    named = len(shared_walls([below.mesh, mirrored]))
    yield Check("float64", "shared walls not named", abs(1 - named), 0, "Their triangles coincide.")
    for dtype, frame in frames.items():
        strange = ~np.isin(frame.segmentation[frame.mask], (1, 2, 3))
        yield Check(dtype, "labels of no tissue", int(strange.sum()), 0, "Whoever owns a point is in the scene.")
    for dtype, frame in both(Scene((below, slab(HARD, 50.001, 90.0)), GEL, "apart"), SMALL, device).items():
        yield Check(
            dtype, "labels down the middle that are wrong, 1 um apart", int(_down_the_middle(frame) != [1, 2, 3, 1]), 0,
            "Rays go on 2e-7 of the scene's extent beyond a surface, here 0.1 um.",
        )  # fmt: skip


def _down_the_middle(frame: Frame) -> list[int]:
    """The labels met on the probe's axis, in order."""
    column = frame.segmentation[frame.mask[:, 138], 138]
    return [int(column[0]), *(int(b) for a, b in pairwise(column) if a != b)]


def needles() -> Structure:
    """A flat cylinder of 2000 sectors: triangles of 200 mm with a base of 0.6 mm."""
    mesh = trimesh.creation.cylinder(radius=200.0, height=10.0, sections=2000)
    return Structure(mesh.apply_translation((0, 0, 70.0)), HARD)


def slivers() -> Structure:
    """A box whose faces are cut at distances of every order from their middle: strips of 150 mm by 15 um."""
    orders = 150.0 * np.logspace(-7, 0, 8)
    cuts = np.concatenate([-orders[::-1], orders])
    return Structure(_gridded_box((cuts, cuts, np.array([65.0, 75.0]))), HARD)


def _gridded_box(cuts: Sequence[np.ndarray]) -> trimesh.Trimesh:
    """A box from the first to the last cut along each axis, its faces cut everywhere."""
    triangles = []
    for axis in range(3):
        across = [pairwise(lines) for k, lines in enumerate(cuts) if k != axis]
        for ((a, b), (c, d)), plane in product(product(*across), (cuts[axis][0], cuts[axis][-1])):
            corners = np.insert([(a, c), (b, c), (b, d), (a, d)], axis, plane, axis=1)
            triangles += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    return trimesh.Trimesh(np.concatenate(triangles), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)


def _awkward(make: Callable[[], Structure], device: str) -> Iterator[Check]:
    """A layer 10 mm thick in triangles of an awkward shape, against the same in twelve."""
    awkward, plain = (both(Scene((s,), SOFT, "shape"), SMALL, device) for s in (make(), slab(HARD, 65.0, 75.0)))
    yield from usual(awkward, SMALL)
    moved_by = 8 * FLOAT32 * 400 / (150 / SMALL.axial_samples)
    for dtype, frame in awkward.items():
        other = plain[dtype]
        yield Check(
            dtype, "pixels of S against twelve triangles", int((frame.segmentation != other.segmentation).sum()), 0,
            "No pixel's centre is so near to the surface that float32 could not tell.",
        )  # fmt: skip
        yield Check(
            dtype, "envelope against twelve triangles, of its largest",
            off(frame.envelope, other.envelope, float(other.envelope.max())),
            moved_by + products(SMALL, ConvexProbe()) ** 1.5 * FLOAT32,
            "Hits are right to 8 roundings of 400 mm, and an echo moves by that share of a sample.",
        )  # fmt: skip


def _scaled(size: float) -> tuple[ConvexProbe, SimulatorSettings, Scene]:
    """A layer in soft tissue with its probe and pulse, all lengths times `size` and losses in step."""
    soft, hard = (replace(t, attenuation_db_cm_mhz=t.attenuation_db_cm_mhz / size) for t in (SOFT, HARD))
    settings = replace(SMALL, tgc_db_cm_mhz=SMALL.tgc_db_cm_mhz / size)
    settings = replace(settings, **{name: getattr(SMALL, name) * size for name in _LENGTHS})
    mesh = slab(hard, 40.0, 60.0, 100.0).mesh.apply_scale(size)
    return ConvexProbe(40 * size, 70, 150 * size), settings, Scene((Structure(mesh, hard),), soft, f"size {size:g}")


def _another_unit(size: float, device: str) -> Iterator[Check]:
    """The same scene, probe and pulse in another unit: frames are the same."""
    (probe, settings, scene), (_, _, plain) = _scaled(size), _scaled(1.0)
    frames, in_mm = both(scene, settings, device, probe), both(plain, SMALL, device)
    yield from usual(frames, settings, probe)
    for dtype, frame in frames.items():
        yield Check(
            dtype, "pixels of S against millimetres", int((frame.segmentation != in_mm[dtype].segmentation).sum()), 0,
            "The unit is a power of two: coordinates are the same but for their exponent.",
        )  # fmt: skip
        yield Check(
            dtype, "envelope against millimetres, of its largest",
            off(frame.envelope, in_mm[dtype].envelope, float(in_mm[dtype].envelope.max())),
            products(settings, probe) ** 1.5 * FLOAT32, "The same scatterers in the same sums.",
        )  # fmt: skip


def _far(away_mm: float, size: float, device: str) -> Iterator[Check]:
    """Scene and probe far from the world's origin: the same labels, and other speckle of the same kind."""
    probe, settings, scene = _scaled(size)
    near = both(scene, settings, device, probe)
    there = np.array([away_mm, -away_mm, away_mm])
    mesh = scene.structures[0].mesh.copy().apply_translation(there)
    away = replace(scene, structures=(Structure(mesh, scene.structures[0].tissue),))
    far = both(away, settings, device, probe, moved(*there))
    yield from usual(far, settings, probe)
    for dtype, frame in far.items():
        yield Check(
            dtype, "pixels of S against those at the origin",
            int((frame.segmentation != near[dtype].segmentation).sum()), 0,
            "Coordinates are counted from the scene's own middle before they become float32.",
        )  # fmt: skip
        yield from _same_speckle(dtype, frame, near[dtype])


def _lost(device: str) -> Iterator[Check]:
    """A probe 1000 km from its scene, in nothing but soft tissue."""
    frames = both(Scene((slab(HARD, 40.0, 60.0),), SOFT, "left"), SMALL, device, pose=moved(1e9, -1e9, 1e9))
    plain = both(Scene((), SOFT, "plain"), SMALL, device)
    yield from usual(frames, SMALL)
    for dtype, frame in frames.items():
        yield from _same_speckle(dtype, frame, plain[dtype])


def _same_speckle(dtype: str, frame: Frame, plain: Frame) -> Iterator[Check]:
    """As bright as another frame's, and as spread as a Rayleigh variable, between 15 and 37 mm."""
    part, other = (f.envelope[100:250].astype(float) for f in (frame, plain))
    grains = part.size / 8 / 2  # a pulse is 8 samples long and a beam at least two lines wide
    yield Check(
        dtype, "mean of speckle against that at the origin, relative", abs(part.mean() / other.mean() - 1),
        5 * np.sqrt(2) * 0.523 / np.sqrt(grains),
        "Five standard errors of two means over grains of speckle, which deviate by 0.523 of their mean.",
    )  # fmt: skip
    level = part.mean(axis=1, keepdims=True)
    yield Check(
        dtype, "deviation over mean of speckle against 0.523", abs((part / level).std() - 0.523),
        5 * 0.523 / np.sqrt(grains), "Five standard errors, of which each grain's square has about its own size.",
    )  # fmt: skip


def _shells(device: str) -> Iterator[Check]:
    """Sixty-four boxes within boxes, 0.9 mm apart."""
    tissues = [replace(HARD, name=f"t{i}", impedance_mrayl=1.63 + 0.01 * (i % 2)) for i in range(64)]
    boxes = [slab(t, 20.0 + 0.9 * i, 140.0 - 0.9 * i, 280.0 - i) for i, t in enumerate(tissues)]
    frames = both(Scene(tuple(boxes), SOFT, "shells"), SMALL, device)
    yield from usual(frames, SMALL)
    _, z = pixel_coordinates_mm(ConvexProbe(), SMALL.image_shape)
    right = 1 + np.clip(np.ceil(np.minimum(z - 20, 140 - z) / 0.9), 0, 64)
    for dtype, frame in frames.items():
        fan = frame.mask[:, 138]
        wrong = frame.segmentation[fan, 138] != right[fan]
        yield Check(dtype, "rows of S that are wrong", int(wrong.sum()), 0, "Each crossing changes one bit of a set.")


def _stack(pressure: float, gap_mm: float, faces: int, device: str) -> Iterator[Check]:
    """Surfaces of +-R_p behind one another, without loss: all that they send to and fro is heard, and ends."""
    around = replace(SOFT, attenuation_db_cm_mhz=0.0, scatterer_density=0.0)
    hard = replace(around, name="hard", impedance_mrayl=around.impedance_mrayl * (1 + pressure) / (1 - pressure))
    slabs = tuple(slab((hard, around)[i % 2], 20.0 + gap_mm * i, 400.0 - gap_mm * i) for i in range(faces))
    settings = replace(SMALL, tgc_db_cm_mhz=0.0)
    frames = both(Scene(slabs, around, "stack"), settings, device)
    yield from usual(frames, settings)
    pulse, depth_mm = axial_kernel(ConvexProbe(), settings).sum(), ConvexProbe().depth_mm
    for dtype, frame in frames.items():
        heard = float(frame.envelope.sum(axis=0, dtype=float).mean() / pulse)
        yield Check(
            dtype, "all echoes of a line, in mirrors", heard, 1 / pressure + LOUDEST / 2 * (depth_mm - 20) / gap_mm,
            "Direct: R_p (1 + (1 - R) + (1 - R)^2 ...) = 1 / R_p at most. Turned: what those 1 / R_p weigh, grown by "
            "LOUDEST / 2 at most (a weight begins at 2), is heard with R_p once a gap.",
        )  # fmt: skip


def _labels(device: str) -> Iterator[Check]:
    """As many tissues as there are labels, and one more."""
    tissues = [replace(HARD, name=f"t{i}") for i in range(254)]
    boxes = tuple(slab(t, 10 + 0.5 * i, 10.3 + 0.5 * i) for i, t in enumerate(tissues))
    settings = replace(SMALL, device=device, rays=1, layers=1, image_shape=(1000, 3))
    frame = Simulator(Scene(boxes[:-1], SOFT, "full"), None, settings).render(AHEAD)
    yield finite("float32", frame.envelope, frame.attenuation)
    missing = 254 - len(np.unique(frame.segmentation[frame.mask]))
    yield Check("float32", "labels missing", missing, 0, "All are in view, and no label stands for two tissues.")
    yield refused("float32", lambda: Simulator(Scene(boxes, SOFT, "too many"), None, settings))


def _on_a_face(device: str) -> Iterator[Check]:
    """The middle of the probe's face in the plane of a surface, and the whole face in a sphere of its radius."""
    plane = both(Scene((slab(HARD, 0.0, 100.0),), SOFT, "plane"), SMALL, device)
    yield from labelled("plane", usual(plane, SMALL))
    mesh = trimesh.creation.icosphere(5, 40.0).apply_translation((0, 0, -40.0))
    sphere = both(Scene((Structure(mesh, HARD),), SOFT, "sphere"), SMALL, device)
    yield from labelled("sphere", usual(sphere, SMALL))


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
